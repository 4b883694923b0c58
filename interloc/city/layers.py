"""The layers of a map of many drives: its intersections, the tracks of its drives, its roads, and what changed.

What several drives saw of the road from one place is one road. A place or a branch came or went where drives of one
time saw it and those of another did not.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.city.citymap import CityMap
from interloc.city.drives import DriveOnMap
from interloc.geometry import thin, travelled, tree_of
from interloc.output.geojson import Feature, bearings, line_of, positions
from interloc.output.layers import CITY_LAYERS
from interloc.results import moment

_TRACK_STEP_M = 5.0


def city_features(city: CityMap) -> dict[str, list[Feature]]:
    """Return the features of each layer of a map; intersections that too few drives saw are left out."""
    table, drives = city.places, city.in_order
    rows = np.flatnonzero(table.is_shown).tolist()
    intersections = CITY_LAYERS["city"].features(
        positions(table.lonlat[rows], local=False),
        uid=[table.uid[row] for row in rows],
        observations=table.observations[rows],
        drives=[len(table.drives[row]) for row in rows],
        passes=table.passes[rows],
        drives_near=[len(table.near[row]) for row in rows],
        drive_names=[", ".join(table.drives[row]) for row in rows],
        position_std_m=table.position_std_m[rows],
        position_cov_m2=table.position_cov_m2[rows],
        relative_std_m=table.relative_std_m[rows],
        branch_count=[len(table.bearings_deg[row]) for row in rows],
        branch_bearings_deg=[bearings(table.bearings_deg[row]) for row in rows],
        branch_widths_m=[table.widths_m[row].tolist() for row in rows],
        branch_drives=[table.branch_drives[row].tolist() for row in rows],
        confidence=table.confidence[rows],
        first_time=[moment(seconds) for seconds in table.seen_s[rows, 0].tolist()],
        last_time=[moment(seconds) for seconds in table.seen_s[rows, 1].tolist()],
    )
    offsets = np.array([drive.knots.mean(axis=0) for drive in drives]).reshape(-1, 2)
    tracks = [drive.track_xy - offset for drive, offset in zip(drives, offsets, strict=True)]
    lines = CITY_LAYERS["drives"].features(
        [line_of(positions(city.lonlat(track[thin(track, _TRACK_STEP_M)]), local=False)) for track in tracks],
        drive=[drive.data.name for drive in drives],
        intersections=[len(drive.data) for drive in drives],
        offset_east_m=offsets[:, 0],
        offset_north_m=offsets[:, 1],
        offset_range_m=[drive.offset_range_m for drive in drives],
        fix_std_m=[float(np.median(drive.data.fix_std_m)) if len(drive.data) else np.nan for drive in drives],
        first_time=[moment(float(drive.data.span_s[0])) for drive in drives],
        last_time=[moment(float(drive.data.span_s[1])) for drive in drives],
    )
    return {"city": intersections, "drives": lines, "roads": _roads(city), "changes": changes(city)}


# roads ----------------------------------------------------------------------------------------------------------------

_AT_PLACE_M = 12.0  # a road that ends so near to what its drive saw as an intersection ends there
_HEADING_M = 15.0
_SAME_DEG = 25.0
_SHARES = np.linspace(0.0, 1.0, 33)


@dataclass(frozen=True)
class _Seen:
    """A road that one drive saw, in the plane of the map, from the place with the smaller name."""

    ends: tuple[str, str]
    heading_deg: float
    xy: FloatArray
    width_m: float
    drive: str
    is_driven: bool


def _roads(city: CityMap) -> list[Feature]:
    """Return the roads that begin at a place of the map.

    Roads of several drives are one that join the same places, or leave a place for none, in the same direction. Nothing
    depends on the order of drives.
    """
    shown = {uid for uid, is_shown in zip(city.places.uid, city.places.is_shown.tolist(), strict=True) if is_shown}
    seen = [each for drive in city.in_order for each in _seen_by(city, drive, shown)]
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
    lines = [_line_of(group) for group in groups]
    driven = [any(each.is_driven for each in group) for group in groups]
    widths = [
        [each.width_m for each in group if (each.is_driven or not is_driven) and np.isfinite(each.width_m)]
        for group, is_driven in zip(groups, driven, strict=True)
    ]
    names = [sorted({each.drive for each in group}) for group in groups]
    return CITY_LAYERS["roads"].features(
        [positions(city.lonlat(line), local=False) for line in lines],
        id=list(range(1, len(groups) + 1)),
        start_uid=[group[0].ends[0] for group in groups],
        end_uid=[group[0].ends[1] or None for group in groups],
        length_m=[float(travelled(line)[-1]) for line in lines],
        width_m=[float(np.mean(each)) if each else np.nan for each in widths],
        width_std_m=[float(np.std(each, ddof=1)) if len(each) > 1 else np.nan for each in widths],
        is_driven=driven,
        drives=[len(each) for each in names],
        drive_names=[", ".join(each) for each in names],
    )


def _seen_by(city: CityMap, drive: DriveOnMap, shown: set[str]) -> Iterator[_Seen]:
    data, offset = drive.data, drive.knots.mean(axis=0)
    if not data.roads_lonlat or not len(drive.xy):
        return
    places, uids = tree_of(drive.xy), [city.uid_of[place] for place in drive.place.tolist()]
    for lonlat, width, driven in zip(data.roads_lonlat, data.road_width_m, data.road_driven, strict=True):
        line = city.plane(lonlat)
        distance, row = (np.asarray(each).tolist() for each in places.query(line[[0, -1]]))
        ends = zip(distance, row, strict=True)
        at = [uids[k] if metres <= _AT_PLACE_M and uids[k] in shown else "" for metres, k in ends]
        if not any(at):
            continue
        if not at[0] or (at[1] and at[1] < at[0]):
            line, at = line[::-1], at[::-1]
        gone = travelled(line)
        ahead = [np.interp(min(_HEADING_M, gone[-1]), gone, line[:, axis]) for axis in (0, 1)] - line[0]
        heading = float(np.degrees(np.arctan2(*ahead)) % 360.0)
        yield _Seen((at[0], at[1]), heading, line - offset, float(width), data.name, bool(driven))


def _line_of(group: list[_Seen]) -> FloatArray:
    """Return the mean of the lines between two places, else the longest of them."""
    lines = [(travelled(each.xy), each.xy) for each in group]
    if not group[0].ends[1] or len(lines) == 1:
        return max(lines, key=lambda each: float(each[0][-1]))[1]
    sampled = [[np.interp(_SHARES * metres[-1], metres, line[:, k]) for k in (0, 1)] for metres, line in lines]
    mean: FloatArray = np.mean(sampled, axis=0).T
    return mean


# changes --------------------------------------------------------------------------------------------------------------

_MIN_DRIVES = 2  # that saw it, and that did not, each
_BRANCH_DEG = 20.0
_SIDE_AT_M = np.arange(8.0, 20.1, 1.0)
_ROAD, _OTHER = 0.8, 0.5  # shares of a branch seen as road where it is there, and as other ground where it is not


@dataclass(frozen=True)
class _Switch:
    """Drives of one time saw something and those of another did not."""

    came: bool
    saw: tuple[str, ...]
    missed: tuple[str, ...]
    """Drives, in the order of their times."""
    between_s: tuple[float, float]
    """The last drive before the change and the first one behind it, seconds since 1970."""


def changes(city: CityMap) -> list[Feature]:
    """Find what came or went: all drives of two or more before a moment saw it and none of two or more behind it did.

    Only drives that should have seen it count, and only those with times of the day. A junction that was not seen is
    one that the drive passed within 20 m; a branch that was not seen is one along which it saw other ground instead.
    One drive of the same place that contradicts makes it no change.
    """
    table, found = city.places, list[tuple[int, float | None, _Switch]]()
    start = {name: float(drive.data.span_s[0]) for name, drive in city.drives.items()}
    rank = {name: row for row, name in enumerate(sorted(start, key=lambda name: (start[name], name)))}
    timed = {name for name in start if np.isfinite(start[name])}
    branches = _branches_of(city) if len(timed) >= 2 * _MIN_DRIVES else {}
    for row in range(len(table)):
        near = sorted(timed.intersection(table.near[row]), key=rank.__getitem__)
        if len(near) < 2 * _MIN_DRIVES:
            continue
        change = _switch(city, near, set(table.drives[row]))
        if change is not None:
            found.append((row, None, change))
            continue
        own = {name: branches.get((name, table.uid[row]), np.zeros(0)) for name in near}
        for bearing in _all_bearings(own):
            saw_it, missed_it = _side_seen(city, table.xy[row], bearing, own)
            change = _switch(city, [name for name in near if name in saw_it | missed_it], saw_it)
            if change is not None:
                found.append((row, bearing, change))
    kinds = [f"{'new' if c.came else 'gone'}_{'junction' if bearing is None else 'branch'}" for _, bearing, c in found]
    uids = [table.uid[row] for row, _, _ in found]
    return CITY_LAYERS["changes"].features(
        positions(city.lonlat(table.xy[[row for row, _, _ in found]]), local=False) if found else [],
        id=[
            f"{kind}-{uid}" + ("" if bearing is None else f"-{round(bearing)}")
            for kind, uid, (_, bearing, _) in zip(kinds, uids, found, strict=True)
        ],
        kind=kinds,
        uid=uids,
        bearing_deg=[bearing for _, bearing, _ in found],
        seen_by=[", ".join(change.saw) for _, _, change in found],
        not_seen_by=[", ".join(change.missed) for _, _, change in found],
        after_time=[moment(change.between_s[0]) for _, _, change in found],
        before_time=[moment(change.between_s[1]) for _, _, change in found],
    )


def _switch(city: CityMap, names: list[str], saw: set[str]) -> _Switch | None:
    """Return how drives in time changed once from not seeing to seeing, or back."""
    seen = [name in saw for name in names]
    turns = [i for i in range(1, len(seen)) if seen[i] != seen[i - 1]]
    if len(turns) != 1 or min(turns[0], len(seen) - turns[0]) < _MIN_DRIVES:
        return None
    first, second = tuple(names[: turns[0]]), tuple(names[turns[0] :])
    ends = [float(city.drives[name].data.span_s[1]) for name in first]
    between = max(ends), float(city.drives[second[0]].data.span_s[0])
    if between[0] > between[1]:  # two drove at once
        return None
    return _Switch(True, second, first, between) if seen[-1] else _Switch(False, first, second, between)


def _branches_of(city: CityMap) -> dict[tuple[str, str], FloatArray]:
    """Return the bearings of the branches that each drive saw at each place, by name of drive and place."""
    found: dict[tuple[str, str], FloatArray] = {}
    for name, drive in city.drives.items():
        for place, seen in zip(drive.place.tolist(), drive.data.bearings_deg, strict=True):
            key = name, city.uid_of[place]
            found[key] = np.concatenate([found[key], seen]) if key in found else seen
    return found


def _all_bearings(own: dict[str, FloatArray]) -> list[float]:
    """Return the bearings of branches, 20 degrees apart or more, that two drives saw or more, and two did not."""
    said = np.sort(np.concatenate([np.zeros(0), *own.values()]))
    kept: list[float] = []
    drives: Any = sum((_apart(each[:, None], said) <= _BRANCH_DEG).any(axis=0) for each in own.values())
    for bearing, saw in zip(said.tolist(), drives.tolist(), strict=True):
        if _MIN_DRIVES <= saw <= len(own) - _MIN_DRIVES and all(_apart(k, bearing) > _BRANCH_DEG for k in kept):
            around = said[_apart(said, bearing) <= _BRANCH_DEG]
            kept.append(float((bearing + np.median((around - bearing + 180.0) % 360.0 - 180.0)) % 360.0))
    return kept


def _apart(a: Any, b: Any) -> Any:  # noqa: ANN401 - numbers, or arrays of them
    return np.abs((a - b + 180.0) % 360.0 - 180.0)


def _side_seen(
    city: CityMap, xy: FloatArray, bearing_deg: float, own: dict[str, FloatArray]
) -> tuple[set[str], set[str]]:
    """Return the drives that saw a branch of a place, and those that saw other ground there; the rest cannot tell."""
    angle = np.radians(bearing_deg)
    side = xy + _SIDE_AT_M[:, None] * np.array([np.sin(angle), np.cos(angle)])
    saw, missed = set(), set()
    for name, seen in own.items():
        if (_apart(seen, bearing_deg) <= _BRANCH_DEG).any():
            saw.add(name)
            continue
        road, other = city.drives[name].ground_at(side, city.epsg)
        if road.mean() >= _ROAD:
            saw.add(name)
        elif other.mean() >= _OTHER:
            missed.add(name)
    return saw, missed
