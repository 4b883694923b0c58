"""The roads of a map of many drives: what several drives saw of the road from one place is one road."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from interloc.arrays import FloatArray
from interloc.city.citymap import CityMap
from interloc.city.drives import DriveOnMap

_AT_PLACE_M = 12.0  # a road that ends so near to what its drive saw as an intersection ends there
_HEADING_M = 15.0
_SAME_DEG = 25.0
_SHARES = np.linspace(0.0, 1.0, 33)


@dataclass(frozen=True)
class FusedRoad:
    """A road from one place to another, or to where no drive saw farther."""

    start: str
    """Name of the place where it begins."""
    end: str | None
    """Name of the place where it ends."""
    xy: FloatArray
    """(N, 2) float64: centreline in the plane of the map."""
    width_m: float
    width_std_m: float
    """Mean of the widths that drives say, of those that went along it if any did, and standard deviation between them;
    NaN where none, or fewer than two, say one."""
    drives: tuple[str, ...]
    is_driven: bool
    """Whether any drive went along it."""

    @property
    def length_m(self) -> float:
        """Length of the centreline."""
        return float(np.hypot(*np.diff(self.xy, axis=0).T).sum())


@dataclass(frozen=True)
class _Seen:
    """A road that one drive saw, in the plane of the map, from the place with the smaller name."""

    ends: tuple[str, str]
    heading_deg: float
    xy: FloatArray
    width_m: float
    drive: str
    is_driven: bool


def fuse_roads(city: CityMap) -> list[FusedRoad]:
    """Return the roads that begin at a place of the map.

    Roads of several drives are one that join the same places, or leave a place for none, in the same direction. Between
    two places the line is the mean of theirs, else it is the longest of them. Nothing depends on the order of drives.
    """
    shown = {uid for uid, is_shown in zip(city.places.uid, city.places.is_shown.tolist(), strict=True) if is_shown}
    seen = [each for name in sorted(city.drives) for each in _seen_by(city, city.drives[name], shown)]
    seen.sort(key=lambda each: (each.ends, each.heading_deg, each.drive))
    groups: list[list[_Seen]] = []
    for _, alike in groupby(seen, key=lambda each: each.ends):
        first = len(groups)
        for each in alike:
            own = [
                group
                for group in groups[first:]
                if min(_apart(end.heading_deg, each.heading_deg) for end in (group[0], group[-1])) <= _SAME_DEG
            ]
            if own:
                own[0].append(each)
            else:
                groups.append([each])
    return [_fused(group) for group in groups]


def _apart(a: float, b: float) -> float:
    return abs((a - b + 180.0) % 360.0 - 180.0)


def _seen_by(city: CityMap, drive: DriveOnMap, shown: set[str]) -> Iterator[_Seen]:
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

    data, offset = drive.data, drive.knots.mean(axis=0)
    if not data.roads_lonlat or not len(drive.xy):
        return
    places, uids = cKDTree(drive.xy), [city.uid_of[place] for place in drive.place.tolist()]
    for lonlat, width, driven in zip(data.roads_lonlat, data.road_width_m, data.road_driven, strict=True):
        line = city.plane(lonlat)
        distance, row = (np.asarray(each).tolist() for each in places.query(line[[0, -1]]))
        ends = zip(distance, row, strict=True)
        at = [uids[k] if metres <= _AT_PLACE_M and uids[k] in shown else "" for metres, k in ends]
        if not any(at):
            continue
        if not at[0] or (at[1] and at[1] < at[0]):
            line, at = line[::-1], at[::-1]
        travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
        ahead = [np.interp(min(_HEADING_M, travelled[-1]), travelled, line[:, axis]) for axis in (0, 1)] - line[0]
        heading = float(np.degrees(np.arctan2(*ahead)) % 360.0)
        yield _Seen((at[0], at[1]), heading, line - offset, float(width), data.name, bool(driven))


def _fused(group: list[_Seen]) -> FusedRoad:
    start, end = group[0].ends
    lines = [each.xy for each in group]
    steps = [np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))) for line in lines]
    if end and len(lines) > 1:
        at = [_SHARES * metres[-1] for metres in steps]
        xy = np.mean(
            [[np.interp(a, m, line[:, k]) for k in (0, 1)] for a, m, line in zip(at, steps, lines, strict=True)], axis=0
        ).T
    else:
        xy = lines[int(np.argmax([metres[-1] for metres in steps]))]
    is_driven = any(each.is_driven for each in group)
    widths = np.array([each.width_m for each in group if each.is_driven or not is_driven])
    widths = widths[np.isfinite(widths)]
    return FusedRoad(
        start=start,
        end=end or None,
        xy=xy,
        width_m=float(widths.mean()) if len(widths) else np.nan,
        width_std_m=float(widths.std(ddof=1)) if len(widths) > 1 else np.nan,
        drives=tuple(sorted({each.drive for each in group})),
        is_driven=is_driven,
    )
