"""What changed between the drives of a map: places and branches that came or went, with the drives that say so."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from interloc.arrays import FloatArray
from interloc.city.citymap import CityMap

ChangeKind = Literal["new_junction", "gone_junction", "new_branch", "gone_branch"]

_MIN_DRIVES = 2  # that saw it, and that did not, each
_BRANCH_DEG = 20.0
_SIDE_AT_M = np.arange(8.0, 20.1, 1.0)
_ROAD, _OTHER = 0.8, 0.5  # shares of a branch seen as road where it is there, and as other ground where it is not


@dataclass(frozen=True)
class Change:
    """A place, or a branch of it, that drives of one time saw and those of another did not."""

    kind: ChangeKind
    """new_junction, gone_junction, new_branch or gone_branch."""
    uid: str
    """The place."""
    xy: FloatArray
    """(2,) float64: in the plane of the map."""
    bearing_deg: float | None
    """Of the branch; None where it is the junction."""
    seen_by: tuple[str, ...]
    not_seen_by: tuple[str, ...]
    """Drives, in the order of their times."""
    between_s: tuple[float, float]
    """(float, float): the last drive before the change and the first one behind it, seconds since 1970."""


def changes_of(city: CityMap) -> list[Change]:
    """Find what came or went: all drives of two or more before a moment saw it and none of two or more behind it did.

    Only drives that should have seen it count, and only those with times of the day. A junction that was not seen is
    one that the drive passed within 20 m; a branch that was not seen is one along which it saw other ground instead.
    One drive of the same place that contradicts makes it no change.
    """
    table, found = city.places, []
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
            came, saw, missed, between = change
            kind: ChangeKind = "new_junction" if came else "gone_junction"
            found.append(Change(kind, table.uid[row], table.xy[row], None, saw, missed, between))
            continue
        own = {name: branches.get((name, table.uid[row]), np.zeros(0)) for name in near}
        for bearing in _all_bearings(own):
            saw_it, missed_it = _side_seen(city, table.xy[row], bearing, own)
            change = _switch(city, [name for name in near if name in saw_it | missed_it], saw_it)
            if change is not None:
                came, saw, missed, between = change
                kind = "new_branch" if came else "gone_branch"
                found.append(Change(kind, table.uid[row], table.xy[row], bearing, saw, missed, between))
    return found


def _switch(
    city: CityMap, names: list[str], saw: set[str]
) -> tuple[bool, tuple[str, ...], tuple[str, ...], tuple[float, float]] | None:
    """Return whether drives in time changed once from not seeing to seeing (came), or back, and which did what."""
    seen = [name in saw for name in names]
    turns = [i for i in range(1, len(seen)) if seen[i] != seen[i - 1]]
    if len(turns) != 1 or min(turns[0], len(seen) - turns[0]) < _MIN_DRIVES:
        return None
    first, second = tuple(names[: turns[0]]), tuple(names[turns[0] :])
    between = float(city.drives[first[-1]].data.span_s[1]), float(city.drives[second[0]].data.span_s[0])
    return (True, second, first, between) if seen[-1] else (False, first, second, between)


def _branches_of(city: CityMap) -> dict[tuple[str, str], FloatArray]:
    """Return the bearings of the branches that each drive saw at each place, by name of drive and place."""
    found: dict[tuple[str, str], FloatArray] = {}
    for name, drive in city.drives.items():
        for place, bearings in zip(drive.place.tolist(), drive.data.bearings_deg, strict=True):
            key = name, city.uid_of[place]
            found[key] = np.concatenate([found[key], bearings]) if key in found else bearings
    return found


def _all_bearings(own: dict[str, FloatArray]) -> list[float]:
    """Return the bearings of branches, 20 degrees apart or more, that two drives saw or more, and two did not."""
    said = np.sort(np.concatenate([np.zeros(0), *own.values()]))
    kept: list[float] = []
    for bearing in said.tolist():
        saw = sum(bool((_apart(each, bearing) <= _BRANCH_DEG).any()) for each in own.values())
        if _MIN_DRIVES <= saw <= len(own) - _MIN_DRIVES and all(_apart(k, bearing) > _BRANCH_DEG for k in kept):
            around = said[_apart(said, bearing) <= _BRANCH_DEG]
            kept.append(float((bearing + np.median((around - bearing + 180.0) % 360.0 - 180.0)) % 360.0))
    return kept


def _apart(a: Any, b: float) -> Any:  # noqa: ANN401 - a number, or an array of them
    return np.abs((a - b + 180.0) % 360.0 - 180.0)


def _side_seen(
    city: CityMap, xy: FloatArray, bearing_deg: float, own: dict[str, FloatArray]
) -> tuple[set[str], set[str]]:
    """Return the drives that saw a branch of a place, and those that saw other ground there; the rest cannot tell."""
    angle = np.radians(bearing_deg)
    side = xy + _SIDE_AT_M[:, None] * np.array([np.sin(angle), np.cos(angle)])
    saw, missed = set(), set()
    for name, bearings in own.items():
        if (_apart(bearings, bearing_deg) <= _BRANCH_DEG).any():
            saw.add(name)
            continue
        road, other = city.drives[name].ground_at(side, city.epsg)
        if road.mean() >= _ROAD:
            saw.add(name)
        elif other.mean() >= _OTHER:
            missed.add(name)
    return saw, missed
