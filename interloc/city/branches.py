"""The branches of all places of a map at once, from what each sighting said of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray, distinct
from interloc.config import FusionConfig
from interloc.geometry import wrap_bearing

Branches = tuple[FloatArray, FloatArray, IntArray]
"""Bearings, widths, and how many drives saw each branch of a place."""

SAME_DEG = 20.0
"""A branch of a drive that lies within this of one of the place is that."""


@dataclass(frozen=True)
class SeenBranches:
    """E branches that N sightings of P places saw.

    Attributes
    ----------
    bearing_deg, width_m : (E,) float64
    sighting : (E,) int64
        Which saw it, 0..N-1.
    place, drive : (N,) int64
        Of each sighting; places 0..P-1, all seen.
    """

    bearing_deg: FloatArray
    width_m: FloatArray
    sighting: IntArray
    place: IntArray
    drive: IntArray


def fuse_branches(seen: SeenBranches, min_share: float) -> list[Branches]:
    """Return the branches of each place: those that a share of its sightings saw, but three where it has as many.

    The same as `interloc.mapping.estimation.fuse_bearings` and `fuse_widths`, for sightings that count the same, but
    that a bearing counts for the nearest branch alone.
    """
    config = FusionConfig()
    sightings = np.bincount(seen.place)
    count, apart = len(sightings), config.branch_separation_deg
    place = seen.place[seen.sighting]
    peaks = _peaks(seen.bearing_deg, place, count, config.branch_spread_deg, apart)
    most = peaks.shape[1]
    turn, nearest = _nearest(seen.bearing_deg, place, peaks)
    close = np.abs(turn) <= apart
    key = (place * most + nearest)[close]
    who = distinct(key * len(seen.place) + seen.sighting[close]) // max(len(seen.place), 1)
    share = np.bincount(who, minlength=count * most).reshape(count, most) / sightings[:, None]
    mean = np.bincount(key, turn[close], count * most) / np.maximum(np.bincount(key, minlength=count * most), 1)
    fused = wrap_bearing(peaks + mean.reshape(count, most))
    best = np.lexsort((fused, np.where(np.isfinite(peaks), -share, np.inf)))  # places are rows: each is sorted alone
    rank = np.argsort(best, axis=1)
    fused = np.sort(np.where((share >= min_share) | (rank < 3), fused, np.nan), axis=1)
    turn, nearest = _nearest(seen.bearing_deg, place, fused)
    own = place * most + nearest
    saw = np.abs(turn) <= SAME_DEG
    drives = int(seen.drive.max(initial=0)) + 1
    who = distinct(own[saw] * drives + seen.drive[seen.sighting[saw]]) // drives
    support = np.bincount(who, minlength=count * most).reshape(count, most)
    wide = (np.abs(turn) <= apart / 2) & np.isfinite(seen.width_m)
    order = np.flatnonzero(wide)[np.lexsort((seen.width_m[wide], own[wide]))]
    size = np.bincount(own[wide], minlength=count * most)
    middle = np.cumsum(size) - size + (size - 1) // 2  # the lower median
    width = np.full(count * most, np.nan)
    width[size > 0] = seen.width_m[order[middle[size > 0]]]
    width, branches = width.reshape(count, most), np.isfinite(fused).sum(axis=1).tolist()
    return [(fused[row, :n], width[row, :n], support[row, :n]) for row, n in enumerate(branches)]


def _peaks(bearing_deg: FloatArray, place: IntArray, count: int, spread_deg: float, apart_deg: float) -> FloatArray:
    """Return the peaks of the density of the bearings of each place, (count, B) degrees, highest first, then NaN."""
    degree = np.arange(360)
    around = np.minimum(degree, 360 - degree)
    cells = place * 360 + np.round(bearing_deg).astype(np.int64) % 360
    density = np.bincount(cells, minlength=count * 360).reshape(count, 360).astype(np.float64)
    kernel = np.exp(-0.5 * (around / spread_deg) ** 2)
    density = np.fft.irfft(np.fft.rfft(density) * np.fft.rfft(kernel), 360)
    is_top = density >= np.maximum(np.roll(density, 1, axis=1), np.roll(density, -1, axis=1))
    left = np.where(is_top & (density > 1e-6 * density.max(axis=1, keepdims=True)), density, 0.0)
    found = [np.full(count, np.nan)]
    while (left > 0.0).any():
        peak = np.argmax(left, axis=1)
        found.append(np.where(left.max(axis=1) > 0.0, peak, np.nan))
        left[around[(degree - peak[:, None]) % 360] < apart_deg] = 0.0
    return np.stack(found[1:] or found, axis=1)


def _nearest(bearing_deg: FloatArray, place: IntArray, branches: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return for each bearing how far it is turned against the nearest branch of its place, and which that is."""
    turn, nearest = np.full(len(bearing_deg), np.inf), np.zeros(len(bearing_deg), dtype=np.int64)
    for number in range(branches.shape[1]):
        away = (bearing_deg - branches[place, number] + 180.0) % 360.0 - 180.0
        closer = np.abs(away) < np.abs(turn)  # not where there is none
        turn[closer], nearest[closer] = away[closer], number
    return turn, nearest
