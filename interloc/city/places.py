"""The places of a map of many drives as a table: where each is, how sure that is, who saw it, its branches."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray, distinct
from interloc.city.drives import DriveOnMap, system_of
from interloc.city.models import CityConfig
from interloc.config import FusionConfig
from interloc.mapping.branches import SeenBranches, fuse_branches

Value = TypeVar("Value")

Branches = tuple[FloatArray, FloatArray, IntArray]
"""Bearings, widths, and how many drives saw each branch of a place."""

SAME_PASS_S = 600.0
"""Sightings of a place within this time are one pass: a drive that was cut in pieces passes it once."""

_SAME_DEG = 20.0  # a branch of a drive that lies within this of one of the place is that


@dataclass(frozen=True)
class PlaceTable:
    """The P physical intersections that several drives saw, from west to east."""

    uid: list[str]
    """Name of the place: it stays when drives are added, and is never used again for another."""
    xy: FloatArray
    lonlat: FloatArray
    """(P, 2) float64: in the plane of the map, metres; longitude, latitude, degrees."""
    position_cov_m2: FloatArray
    """(P, 3) float64: covariance on the Earth, as of `IntersectionTable`."""
    relative_cov_m2: FloatArray
    """(P, 3) float64: the same against the places around: without what the fixes of all its drives leave."""
    observations: IntArray
    """(P,) int64: detections, of all drives."""
    drives: list[tuple[str, ...]]
    """Names of the drives that saw it."""
    passes: IntArray
    """(P,) int64: how many times it was seen, sightings within ten minutes of each other counting as one."""
    near: list[tuple[str, ...]]
    """Drives that saw it, or came so near that they should have."""
    confidence: FloatArray
    """(P,) float64: 0..1: mean over the drives that came near, 0 for those that did not see it."""
    is_shown: BoolArray
    """(P,) bool: whether enough of the drives that came near saw it: 30 % and, of four or more, at least two."""
    bearings_deg: list[FloatArray]
    widths_m: list[FloatArray]
    """list of P (B,) float64: of the branches."""
    branch_drives: list[IntArray]
    """list of P (B,) int64: how many drives saw each branch."""
    seen_s: FloatArray
    """(P, 2) float64: first and last time seen, seconds since 1970; NaN where no drive has times of the day."""

    def __len__(self) -> int:
        return len(self.uid)

    @property
    def position_std_m(self) -> FloatArray:
        """(P,) one-sigma uncertainty on the Earth along each axis, metres."""
        std: FloatArray = np.sqrt(self.position_cov_m2[:, [0, 2]].mean(axis=1))
        return std

    @property
    def relative_std_m(self) -> FloatArray:
        """(P,) the same against the places around."""
        std: FloatArray = np.sqrt(self.relative_cov_m2[:, [0, 2]].mean(axis=1))
        return std


def tabulate(
    drives: Sequence[DriveOnMap],
    uid_of: Mapping[int, str],
    to_lonlat: Callable[[FloatArray], FloatArray],
    config: CityConfig,
    branches_of: dict[int, Branches],
) -> PlaceTable:
    """Return the places of a map of drives.

    `uid_of` has the name of a place by its number, `branches_of` its branches where they were worked out before, and
    is changed in place; `to_lonlat` takes (N, 2) positions in the plane of the map.

    The covariance of a place is the sum of what all drives share, the shape (mean of what they state, never divided),
    and of what they do not: fix and scatter, one over the sum of one over their variances. That other places tie the
    drives together is left out of it, which makes it a little too wide where a place was seen by few of many drives.
    """
    names = [drive.data.name for drive in drives]
    if not any(len(d.xy) for d in drives):
        none = np.zeros(0)
        empty = np.zeros((0, 2))
        integers = np.zeros(0, dtype=np.int64)
        return PlaceTable(
            [], empty, empty, np.zeros((0, 3)), np.zeros((0, 3)), integers, [], integers, [], none,
            none.astype(bool), [], [], [], empty,
        )  # fmt: skip
    sightings, numbers = system_of(drives, config)
    place, count = sightings.place, len(numbers)
    xy = sightings.positions(np.concatenate([d.knots for d in drives]))

    def joined(name: str) -> FloatArray:
        return np.concatenate([getattr(d.data, name) for d in drives])

    noise = 1.0 / sightings.weight
    total = np.bincount(place, sightings.weight, count)
    shape = np.stack(
        [np.bincount(place, sightings.weight * column, count) / total for column in joined("shape_cov_m2").T], axis=-1
    )
    axes = np.array([1.0, 0.0, 1.0])
    own = 1.0 / np.bincount(place, 1.0 / (joined("fix_std_m") ** 2 + noise), count)
    drive = np.repeat(np.arange(len(drives)), [len(d.xy) for d in drives])
    pair = place * len(drives) + drive  # of a place and a drive
    saw, which, times = np.unique(pair, return_inverse=True, return_counts=True)
    said = np.bincount(which.reshape(-1), joined("confidence")) / times
    near = distinct(np.append(saw, _passed(drives, xy, place, config.near_m)))
    seen_count, near_count = (np.bincount(each // len(drives), minlength=count) for each in (saw, near))
    shown = (seen_count >= config.min_share * near_count) & ((near_count < 4) | (seen_count >= 2))
    seen_s = joined("seen_s")
    first, last = np.full((2, count), np.inf)
    np.fmin.at(first, place, seen_s[:, 0])
    np.fmin.at(last, place, -seen_s[:, 1])
    bounds = np.stack([first, -last], axis=-1)
    _work_out_branches(drives, numbers, place, drive, config.min_share, branches_of)
    bearings, widths, supports = map(list, zip(*(branches_of[number] for number in numbers.tolist()), strict=True))
    order = np.lexsort((xy[:, 1], xy[:, 0]))

    def sort(values: Sequence[Value]) -> list[Value]:
        return [values[row] for row in order.tolist()]

    def named(pairs: IntArray, counts: IntArray) -> list[tuple[str, ...]]:
        found, ends = [names[row] for row in (pairs % len(drives)).tolist()], np.cumsum(counts).tolist()
        return sort([tuple(found[start:end]) for start, end in zip([0, *ends[:-1]], ends, strict=True)])

    return PlaceTable(
        uid=sort([uid_of[number] for number in numbers.tolist()]),
        xy=xy[order],
        lonlat=to_lonlat(xy)[order],
        position_cov_m2=(shape + own[:, None] * axes)[order],
        relative_cov_m2=(shape + axes / total[:, None])[order],
        observations=np.bincount(place, joined("observations"), count).astype(np.int64)[order],
        drives=named(saw, seen_count),
        passes=_passes(seen_s, place, pair, drives)[order],
        near=named(near, near_count),
        confidence=(np.bincount(saw // len(drives), said, count) / near_count)[order],
        is_shown=shown[order],
        bearings_deg=sort(bearings),
        widths_m=sort(widths),
        branch_drives=sort(supports),
        seen_s=np.where(np.isfinite(bounds), bounds, np.nan)[order],
    )


def _passed(drives: Sequence[DriveOnMap], xy: FloatArray, place: IntArray, near_m: float) -> IntArray:
    """Return the pairs of a place and a drive that came so near that it should have seen it, beside those that did."""
    found = []
    ends = np.cumsum([0, *(len(d.xy) for d in drives)]).tolist()
    for number, drive in enumerate(drives):
        there = xy + drive.knots.mean(axis=0)
        low, high = drive.track_xy.min(axis=0) - near_m, drive.track_xy.max(axis=0) + near_m
        may_be = ((there >= low) & (there <= high)).all(axis=1)
        may_be[place[ends[number] : ends[number + 1]]] = False
        rows = np.flatnonzero(may_be)
        if len(rows):
            distance, _ = drive.track.query(there[rows], distance_upper_bound=near_m)
            found.append(rows[np.isfinite(distance)] * len(drives) + number)
    return np.concatenate([np.zeros(0, dtype=np.int64), *found])


def _work_out_branches(
    drives: Sequence[DriveOnMap],
    numbers: IntArray,
    place: IntArray,
    drive: IntArray,
    min_share: float,
    branches_of: dict[int, Branches],
) -> None:
    """Add the branches of new places, and forget those of places that are gone."""
    there = set(numbers.tolist())
    for number in branches_of.keys() - there:
        del branches_of[number]
    is_new = np.isin(numbers, np.array(sorted(there - branches_of.keys()), dtype=np.int64), assume_unique=True)
    if not is_new.any():
        return
    bearing, width, branches = (np.concatenate(each) for each in zip(*(d.branches for d in drives), strict=True))
    rows = np.flatnonzero(is_new[place])
    used = is_new[np.repeat(place, branches)]
    sighting, own = np.repeat(np.arange(len(rows)), branches[rows]), (np.cumsum(is_new) - 1)[place[rows]]
    seen = SeenBranches(bearing[used], width[used], sighting, own, np.ones(len(rows)))
    usual = FusionConfig()
    spread, apart = usual.branch_spread_deg, usual.branch_separation_deg
    fused = fuse_branches(seen, spread_deg=spread, separation_deg=apart, support=min_share)
    saw = np.flatnonzero(fused.apart_deg <= _SAME_DEG)
    branch = own[sighting[saw]] * fused.bearing_deg.shape[1] + fused.nearest[saw]
    pairs = distinct(branch * len(drives) + drive[rows[sighting[saw]]])
    support = np.bincount(pairs // len(drives), minlength=fused.bearing_deg.size).reshape(fused.bearing_deg.shape)
    branches_of.update(zip(numbers[is_new].tolist(), zip(*fused.lists(support), strict=True), strict=True))


def _passes(seen_s: FloatArray, place: IntArray, pair: IntArray, drives: Sequence[DriveOnMap]) -> IntArray:
    """Return how many passes the sightings of each place are of; each drive without times is one, if it is whole."""
    count = int(place.max()) + 1
    whole = np.array([each.data.is_whole for each in drives])[pair % len(drives)]
    seen_s, place, pair = seen_s[whole], place[whole], pair[whole]
    timed = np.isfinite(seen_s).all(axis=1)
    passes = np.bincount(distinct(pair[~timed]) // len(drives), minlength=count)
    order = np.flatnonzero(timed)[np.lexsort((seen_s[timed, 0], place[timed]))]
    if len(order):
        first, last = seen_s[order].T - seen_s[order].min()
        lap = (float(last.max()) + 2 * SAME_PASS_S) * place[order]  # places one behind the other in time
        until = np.maximum.accumulate(last + lap)
        begins = np.append(True, (first + lap)[1:] > until[:-1] + SAME_PASS_S)
        passes += np.bincount(place[order][begins], minlength=count)
    return passes.astype(np.int64)
