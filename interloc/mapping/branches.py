"""The branches of many intersections at once, from what each sighting said of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray, distinct
from interloc.geometry import wrap_bearing

_SURE = 1e-9  # so far a sum may be off by rounding


@dataclass(frozen=True)
class SeenBranches:
    """E branches that N sightings of P intersections saw."""

    bearing_deg: FloatArray
    width_m: FloatArray
    """(E,) float64: in [0, 360]; NaN is no width."""
    sighting: IntArray
    """(E,) int64: which saw it, 0..N-1."""
    place: IntArray
    """(N,) int64: of each sighting, 0..P-1, all seen."""
    weight: FloatArray
    """(N,) float64."""

    @classmethod
    def of(
        cls, bearings_deg: Sequence[FloatArray], widths_m: Sequence[FloatArray], place: IntArray, weight: FloatArray
    ) -> "SeenBranches":
        """Take those of N sightings, (B,) each."""
        bearing, width = (np.concatenate([np.zeros(0), *each]) for each in (bearings_deg, widths_m))
        return cls(
            bearing, width, np.repeat(np.arange(len(place)), [len(each) for each in bearings_deg]), place, weight
        )


@dataclass(frozen=True)
class FusedBranches:
    """The branches of P intersections, at most B each, and which of them each of E seen ones is."""

    bearing_deg: FloatArray
    width_m: FloatArray
    """(P, B) float64: bearings in [0, 360), ascending, then NaN; NaN where no width is known."""
    nearest: IntArray
    """(E,) int64: which branch of its place lies nearest, 0..B-1."""
    apart_deg: FloatArray
    """(E,) float64: how far from it; infinite where its place has none."""

    def lists(self, *values: Any) -> list[list[Any]]:  # noqa: ANN401 - arrays
        """Return bearings, widths, and other (P, B) values, each as (B,) of every intersection without the NaN."""
        count = np.isfinite(self.bearing_deg).sum(axis=1).tolist()
        columns: tuple[Any, ...] = (self.bearing_deg, self.width_m, *values)
        return [[row[:n] for row, n in zip(each, count, strict=True)] for each in columns]


def fuse_branches(seen: SeenBranches, *, spread_deg: float, separation_deg: float, support: float) -> FusedBranches:
    """Find the branches that the sightings of each intersection agree on, and the weighted medians of their widths.

    Peaks of a density on the circle (a bearing has the standard deviation `spread_deg`), each refined to the weighted
    circular mean of the bearings nearest to it. They lie at least `separation_deg` apart, or half of that where fewer
    than three do (an acute crossing), and the share `support` of the weight of all sightings must have seen each; but
    an intersection has at least three branches (paper, section III-C): the best supported ones fill up to three.
    """
    total = np.bincount(seen.place, seen.weight)
    count, place, weight = len(total), seen.place[seen.sighting], seen.weight[seen.sighting]
    peaks = _peaks(seen.bearing_deg, weight, place, count, spread_deg, separation_deg)
    few = np.isfinite(peaks).sum(axis=1) < 3
    if few.any():
        closer = _peaks(seen.bearing_deg, weight * few[place], place, count, spread_deg, separation_deg / 2)
        peaks = np.pad(peaks, ((0, 0), (0, max(closer.shape[1] - peaks.shape[1], 0))), constant_values=np.nan)
        peaks[few, : closer.shape[1]] = closer[few]
    slots = peaks.shape[1]
    nearest, apart = _nearest(seen.bearing_deg, place, peaks)
    close = apart <= separation_deg
    key = (place * slots + nearest)[close]
    turn = (seen.bearing_deg[close] - peaks.reshape(-1)[key] + 180.0) % 360.0 - 180.0
    pair = distinct(key * len(seen.place) + seen.sighting[close])
    own, who = np.divmod(pair, max(len(seen.place), 1))
    share = np.bincount(own, seen.weight[who], count * slots).reshape(count, slots) / total[:, None]
    of_each = np.bincount(key, weight[close], count * slots)
    mean = np.bincount(key, weight[close] * turn, count * slots) / np.where(of_each > 0.0, of_each, 1.0)
    fused = wrap_bearing(peaks + mean.reshape(count, slots))
    best = np.lexsort((fused, np.where(np.isfinite(peaks), -share, np.inf)))  # places are rows: each is sorted alone
    rank = np.argsort(best, axis=1)
    fused = np.sort(np.where((share >= support - _SURE) | (rank < 3), fused, np.nan), axis=1)
    nearest, apart = _nearest(seen.bearing_deg, place, fused)
    wide = np.flatnonzero((apart <= separation_deg / 2) & np.isfinite(seen.width_m))
    key = place[wide] * slots + nearest[wide]
    order = np.lexsort((seen.width_m[wide], key))
    key, width, mass = key[order], seen.width_m[wide[order]], weight[wide[order]]
    before = np.cumsum(mass) - mass
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1])[: len(key)])
    half = np.add.reduceat(mass, first) / 2 if len(first) else mass
    group = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(key))))
    is_below = before - before[first][group] + mass < (1.0 - _SURE) * half[group]
    median = first + np.bincount(group, is_below, len(first)).astype(np.int64)  # the lower one of two
    widths = np.full(count * slots, np.nan)
    widths[key[first]] = width[median]
    return FusedBranches(fused, widths.reshape(count, slots), nearest, apart)


def _peaks(
    bearing_deg: FloatArray, weight: FloatArray, place: IntArray, count: int, spread_deg: float, apart_deg: float
) -> FloatArray:
    """Return the peaks of the density of the bearings of each place, (count, B) degrees, highest first, then NaN."""
    degree = np.arange(360)
    around = np.minimum(degree, 360 - degree)
    cells = place * 360 + np.round(bearing_deg).astype(np.int64) % 360
    density: FloatArray = np.bincount(cells, weight, count * 360).astype(np.float64).reshape(count, 360)
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


def _nearest(bearing_deg: FloatArray, place: IntArray, branches: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return for each bearing which branch of its place is the nearest, and how far away; infinite if there is none."""
    nearest, apart = np.zeros(len(bearing_deg), dtype=np.int64), np.full(len(bearing_deg), np.inf)
    for number, of in enumerate(branches.T):
        away = np.abs(bearing_deg - of[place])
        np.minimum(away, 360.0 - away, out=away)
        closer = away < apart  # not where there is none
        nearest[closer], apart[closer] = number, away[closer]
    return nearest, apart
