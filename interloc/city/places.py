"""The places of a map of many drives as a table: where each is, how sure that is, who saw it, its branches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.city.drives import DriveOnMap, system_of
from interloc.city.settings import CityConfig
from interloc.config import FusionConfig
from interloc.mapping.estimation import fuse_bearings, fuse_widths, members_of

SAME_PASS_S = 600.0
"""Sightings of a place within this time are one pass: a drive that was cut in pieces passes it once."""

Branches = tuple[FloatArray, FloatArray, IntArray]
"""Bearings, widths, and how many drives saw each branch of a place."""

_BRANCH_DEG = 20.0  # a branch of a drive that lies within this of one of the place is that


@dataclass(frozen=True)
class PlaceTable:
    """The P physical intersections that several drives saw, from west to east.

    Attributes
    ----------
    uid : list of P str
        Name of the place: it stays when drives are added, and is never used again for another.
    xy, lonlat : (P, 2) float64
        In the plane of the map, metres; longitude, latitude, degrees.
    position_cov_m2 : (P, 3) float64
        Covariance on the Earth, as of `IntersectionTable`.
    relative_cov_m2 : (P, 3) float64
        The same against the places around: without what the fixes of all its drives leave.
    observations : (P,) int64
        Detections, of all drives.
    drives : list of P tuples of str
        Names of the drives that saw it.
    passes : (P,) int64
        How many times it was seen, sightings within ten minutes of each other counting as one.
    near : list of P tuples of str
        Drives that saw it, or came so near that they should have.
    confidence : (P,) float64
        0..1: mean over the drives that came near, 0 for those that did not see it.
    is_shown : (P,) bool
        Whether enough of the drives that came near saw it: 30 % and, of four or more, at least two.
    bearings_deg, widths_m : list of P (B,) float64
        Of the branches.
    branch_drives : list of P (B,) int64
        How many drives saw each branch.
    seen_s : (P, 2) float64
        First and last time seen, seconds since 1970; NaN where no drive has times of the day.
    """

    uid: list[str]
    xy: FloatArray
    lonlat: FloatArray
    position_cov_m2: FloatArray
    relative_cov_m2: FloatArray
    observations: IntArray
    drives: list[tuple[str, ...]]
    passes: IntArray
    near: list[tuple[str, ...]]
    confidence: FloatArray
    is_shown: BoolArray
    bearings_deg: list[FloatArray]
    widths_m: list[FloatArray]
    branch_drives: list[IntArray]
    seen_s: FloatArray

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
    """Return the places of a map.

    Parameters
    ----------
    drives
        Those of the map.
    uid_of
        Number of a place to its name.
    to_lonlat
        Of (N, 2) positions in the plane of the map.
    config
    branches_of
        Number of a place to its branches, where they were worked out before; changed in place.

    Notes
    -----
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
    sightings, _, knots = system_of(drives, config)
    numbers = np.unique(np.concatenate([d.place for d in drives]))
    place, count = sightings.place, len(numbers)
    xy = sightings.places(sightings.xy - sightings.offsets(knots))

    def joined(name: str) -> FloatArray:
        return np.concatenate([getattr(d.data, name) for d in drives])

    noise = 1.0 / sightings.weight
    total = np.bincount(place, sightings.weight, count)
    shape = np.stack(
        [np.bincount(place, sightings.weight * column, count) / total for column in joined("shape_cov_m2").T], axis=-1
    )
    axes = np.array([1.0, 0.0, 1.0])
    own = 1.0 / np.bincount(place, 1.0 / (joined("fix_std_m") ** 2 + noise), count)
    of = np.repeat(np.arange(len(drives)), [len(d.xy) for d in drives])
    groups = [rows for _, rows in members_of(place, count)]
    drives_of = [np.unique(of[rows]) for rows in groups]
    near = _near(drives, xy, config.near_m)
    near_of = [np.union1d(seen, passed) for seen, passed in zip(drives_of, near, strict=True)]
    said, seen_s = joined("confidence"), joined("seen_s")
    best = [np.bincount(of[rows], said[rows]) / np.maximum(np.bincount(of[rows]), 1) for rows in groups]
    seen_count, near_count = (np.array([len(each) for each in lists]) for lists in (drives_of, near_of))
    _work_out_branches(drives, dict(zip(numbers.tolist(), groups, strict=True)), of, config.min_share, branches_of)
    bearings, widths, supports = map(list, zip(*(branches_of[number] for number in numbers.tolist()), strict=True))
    shown = (seen_count >= config.min_share * near_count) & ((near_count < 4) | (seen_count >= 2))
    order = np.lexsort((xy[:, 1], xy[:, 0]))

    def sort(values: list[Any]) -> list[Any]:
        return [values[row] for row in order.tolist()]

    return PlaceTable(
        uid=sort([uid_of[number] for number in numbers.tolist()]),
        xy=xy[order],
        lonlat=to_lonlat(xy)[order],
        position_cov_m2=(shape + own[:, None] * axes)[order],
        relative_cov_m2=(shape + axes / total[:, None])[order],
        observations=np.bincount(place, joined("observations"), count).astype(np.int64)[order],
        drives=sort([tuple(names[row] for row in rows) for rows in drives_of]),
        passes=np.array([_passes(seen_s[rows], of[rows]) for rows in groups], dtype=np.int64)[order],
        near=sort([tuple(names[row] for row in rows) for rows in near_of]),
        confidence=(np.array([each.sum() for each in best]) / near_count)[order],
        is_shown=shown[order],
        bearings_deg=sort(bearings),
        widths_m=sort(widths),
        branch_drives=sort(supports),
        seen_s=np.array([[_earliest(seen_s[rows, 0]), -_earliest(-seen_s[rows, 1])] for rows in groups])[order],
    )


def _near(drives: Sequence[DriveOnMap], xy: FloatArray, near_m: float) -> list[IntArray]:
    """Return which drives came so near to each place that they should have seen it."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

    found: list[list[int]] = [[] for _ in xy]
    tree = cKDTree(xy)
    for number, drive in enumerate(drives):
        track = drive.track_xy - drive.knots.mean(axis=0)
        for place in set().union(*tree.query_ball_point(track, near_m)):
            found[place].append(number)
    return [np.array(each, dtype=np.int64) for each in found]


def _work_out_branches(
    drives: Sequence[DriveOnMap],
    rows_of: Mapping[int, IntArray],
    of: IntArray,
    support: float,
    branches_of: dict[int, Branches],
) -> None:
    """Add the branches of new places, and forget those of places that are gone."""
    usual = FusionConfig()
    bearings = [each for d in drives for each in d.data.bearings_deg]
    widths = [each for d in drives for each in d.data.widths_m]
    for number in branches_of.keys() - rows_of.keys():
        del branches_of[number]
    for number in rows_of.keys() - branches_of.keys():
        rows = rows_of[number]
        own, weight = [bearings[row] for row in rows], np.ones(len(rows))
        apart = usual.branch_separation_deg
        angles = fuse_bearings(own, weight, spread_deg=usual.branch_spread_deg, separation_deg=apart, support=support)
        wide = fuse_widths(angles, own, [widths[row] for row in rows], weight, within_deg=apart / 2)
        saw = [
            len({int(of[row]) for row, each in zip(rows, own, strict=True) if _within(each, angle)}) for angle in angles
        ]
        branches_of[number] = angles, wide, np.array(saw, dtype=np.int64)


def _within(bearings_deg: FloatArray, angle_deg: float) -> bool:
    return bool((np.abs((bearings_deg - angle_deg + 180.0) % 360.0 - 180.0) <= _BRANCH_DEG).any())


def _passes(seen_s: FloatArray, drive: IntArray) -> int:
    """Return how many passes sightings are of; each drive without times is one."""
    timed = np.isfinite(seen_s).all(axis=1)
    order = np.argsort(seen_s[timed, 0])
    first, last = seen_s[timed][order].T
    apart = first[1:] > np.maximum.accumulate(last)[:-1] + SAME_PASS_S if len(first) else np.zeros(0)
    return int(np.sum(apart)) + bool(len(first)) + len(np.unique(drive[~timed]))


def _earliest(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else np.nan
