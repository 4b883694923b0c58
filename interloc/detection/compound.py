"""Several intersections in one blob of road: what the paper's method merges into one point (its section V-D).

Branches that continue each other across the candidate form a through axis, and so does a single branch beside one, or
beside another one that leads the same way: a carriageway that is not seen farther, or ends there. Axes that run side by
side (a dual carriageway) or branches that meet an axis at distinct places (a staggered junction) are intersections of
their own. The short road that joins two of them is a branch of both: in a wide blob the junctions of the centerline say
on which line it lies, but not where on it. Where a dual carriageway ends, the road across it is that line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import CompoundConfig
from interloc.detection.branches import Branches
from interloc.detection.lines import LINE, SIDE_BY_SIDE_COS

SAME_ROAD_RAD = math.radians(30.0)  # two branches nearer than this in direction are one road
LINK_STD_M = 1.0  # how well the line through the junctions of two intersections is known


@dataclass(frozen=True)
class _Axis:
    """A line through the blob and the branches that it is made of."""

    point: FloatArray
    direction: FloatArray
    branches: list[int]

    def meets(self, other: _Axis, min_angle_rad: float) -> FloatArray | None:
        """Return where two axes cross, None where they run too much alike."""
        cross = self.direction[0] * other.direction[1] - self.direction[1] * other.direction[0]
        if abs(cross) < math.sin(min_angle_rad):
            return None
        delta = other.point - self.point
        along = (delta[0] * other.direction[1] - delta[1] * other.direction[0]) / cross
        crossing: FloatArray = self.point + along * self.direction
        return crossing


def split_compound(branches: Branches, config: CompoundConfig) -> list[Branches]:
    """Split the branches of a candidate into those of the intersections that it is made of.

    Parameters
    ----------
    branches
        Of one candidate. Three make two intersections only where a dual carriageway ends, fewer never.
    config
        Which branches continue each other, and how far apart intersections are.

    Returns
    -------
    list of Branches
        One for each intersection, around its own place; the given ones where there is just one.
    """
    axes, stems = _axes(branches, config)
    if branches.count < 3 or not axes:
        return [branches]
    if _nothing_leads_on(branches, axes, config):
        return _split_end(branches, axes, stems, config)
    if branches.count < 4:
        return [branches]
    crossing = _crossings(branches, axes, stems, config)
    separation = config.separation_m / branches.resolution_m
    reach = branches.inner + separation
    nodes = [(place, members) for place, members in crossing if math.dist(place, branches.candidate) < reach]
    groups = _group(nodes, separation)
    if len(groups) < 2 or not len(branches.core):
        return [branches]
    nearest = np.array([[math.dist(place, junction) for place, _ in groups] for junction in branches.core]).argmin(
        axis=1
    )
    if len(np.unique(nearest)) < len(groups):
        return [branches]  # without a junction of the centerline for itself a place was made up by a bent branch
    places = [branches.core[nearest == number].mean(axis=0) for number in range(len(groups))]
    return _parts(branches, [members for _, members in groups], places)


def _nothing_leads_on(branches: Branches, axes: list[_Axis], config: CompoundConfig) -> bool:
    """Return whether all axes are single branches that no branch continues: there a dual carriageway ends."""
    along = np.array([axis.direction for axis in axes]) @ branches.lines["direction"].T
    is_single = all(len(axis.branches) == 1 for axis in axes)
    return is_single and float(along.min()) > -math.cos(math.radians(config.straight_deg))


def _split_end(branches: Branches, halves: list[_Axis], stems: list[_Axis], config: CompoundConfig) -> list[Branches]:
    """Split the end of a dual carriageway at the best-known road that crosses all of its carriageways near by."""
    reach = branches.inner + config.separation_m / branches.resolution_m
    crossed: list[tuple[_Axis, list[FloatArray]]] = []
    for stem in stems:
        met = [half.meets(stem, math.radians(config.straight_deg)) for half in halves]
        places = [place for place in met if place is not None and math.dist(place, branches.candidate) < reach]
        if len(places) == len(halves):
            crossed.append((stem, places))
    if not crossed:
        return [branches]
    across, places = max(crossed, key=lambda each: branches.lines["weight"][each[0].branches[0]])
    members = [{*half.branches, *across.branches} for half in halves]
    for stem in stems:
        if stem is not across:
            nearest = min(range(len(places)), key=lambda number: math.dist(places[number], stem.point))
            members[nearest].update(stem.branches)
    return _parts(branches, members, places)


def _parts(branches: Branches, members: list[set[int]], places: list[FloatArray]) -> list[Branches]:
    """Return the branches of each place, joined by short roads."""
    parts = [branches.select(sorted(each), place) for each, place in zip(members, places, strict=True)]
    return [replace(_connected(part, places), is_part=True) for part in parts]


def _connected(part: Branches, places: list[FloatArray]) -> Branches:
    """Add the short road to the nearest other intersection of the blob, where no branch leads there already."""
    gaps = [place - part.candidate for place in places if place is not part.candidate]
    gap = min(gaps, key=lambda vector: math.hypot(*vector))
    length = math.hypot(*gap)
    toward = gap / max(length, 1e-9)
    if part.count and float((part.lines["direction"] @ toward).max()) > math.cos(SAME_ROAD_RAD):
        return part
    link = np.zeros(1, LINE)
    link["point"], link["direction"] = part.candidate, toward
    link["length"], link["weight"] = np.inf, LINK_STD_M**-2
    return replace(
        part,
        lines=np.append(part.lines, link),
        lengths=np.append(part.lengths, length),
        reaches=np.append(part.reaches, length),
    )


def _axes(branches: Branches, config: CompoundConfig) -> tuple[list[_Axis], list[_Axis]]:
    """Pair the branches that continue each other; return axes, with what runs beside them, and all other branches."""
    tolerance_rad = math.radians(config.straight_deg)
    offset_limit = 0.5 * config.separation_m / branches.resolution_m
    points, directions, weights = (branches.lines[name] for name in ("point", "direction", "weight"))
    usable = np.flatnonzero(branches.has_line).tolist()
    costs = []
    for i in usable:
        for j in usable:
            if j <= i:
                continue
            turn = math.acos(float(np.clip(-directions[i] @ directions[j], -1.0, 1.0)))
            offset = _offset(branches, i, j)
            if turn < tolerance_rad and offset < offset_limit:
                costs.append((turn / tolerance_rad + offset / offset_limit, i, j))
    paired: set[int] = set()
    axes = []
    for _, i, j in sorted(costs):
        if i in paired or j in paired:
            continue
        paired |= {i, j}
        span = points[i] - points[j]
        pair = weights[[i, j]]
        point = (pair[:, None] * points[[i, j]]).sum(axis=0) / pair.sum()
        axes.append(_Axis(point, span / max(math.hypot(*span), 1e-9), [i, j]))
    alone = [_Axis(points[i], directions[i], [i]) for i in usable if i not in paired]
    halves: list[_Axis] = []
    stems: list[_Axis] = []
    for each in alone:
        same_way = [
            other for other in alone if other is not each and each.direction @ other.direction > SIDE_BY_SIDE_COS
        ]
        is_half = any(_is_beside(branches, each, axis, config) for axis in [*axes, *same_way])
        (halves if is_half else stems).append(each)
    return [*axes, *halves], stems


def _is_beside(branches: Branches, one: _Axis, axis: _Axis, config: CompoundConfig) -> bool:
    """Return whether a single branch runs beside an axis, farther off than roads that are told apart."""
    along = abs(float(one.direction @ axis.direction))
    gap = _nearest(branches, one.branches[0]) - axis.point
    off = abs(float(axis.direction[0] * gap[1] - axis.direction[1] * gap[0])) * branches.resolution_m
    return along > math.cos(math.radians(config.straight_deg)) and off > config.separation_m


def _offset(branches: Branches, i: int, j: int) -> float:
    """Return how far two opposite lines pass each other by at the candidate, pixels."""
    a, b = (_nearest(branches, k) for k in (i, j))
    along = branches.lines["direction"][i] - branches.lines["direction"][j]
    along = along / max(math.hypot(*along), 1e-9)
    delta = a - b
    return abs(float(along[0] * delta[1] - along[1] * delta[0]))


def _nearest(branches: Branches, k: int) -> FloatArray:
    """Return the point of the line of a branch that is nearest to the candidate."""
    point, direction = branches.lines["point"][k], branches.lines["direction"][k]
    nearest: FloatArray = point + direction * ((branches.candidate - point) @ direction)
    return nearest


def _crossings(
    branches: Branches, axes: list[_Axis], stems: list[_Axis], config: CompoundConfig
) -> list[tuple[FloatArray, set[int]]]:
    """Return where roads meet in the blob, each with the branches that meet there."""
    least = math.radians(config.straight_deg)
    found: list[tuple[FloatArray, set[int]]] = []
    for i, axis in enumerate(axes):
        for other in axes[i + 1 :]:
            place = axis.meets(other, least)
            if place is not None:
                found.append((place, {*axis.branches, *other.branches}))
    for stem in stems:
        # A branch ends at the first axis that it meets.
        met = [(axis, place) for axis in axes if (place := axis.meets(stem, least)) is not None]
        if met:
            axis, place = min(met, key=lambda pair: math.dist(pair[1], stem.point))
            found.append((place, {*axis.branches, *stem.branches}))
    lone = [axis for axis in axes if not any(set(axis.branches) <= members for _, members in found)]
    link = _link(branches) if lone else None
    if link is not None:
        # Two carriageways joined by a road that is no longer than the blob is wide.
        for axis in lone:
            place = axis.meets(link, least)
            if place is not None:
                found.append((place, set(axis.branches)))
    return found


def _link(branches: Branches) -> _Axis | None:
    """Return the line through the junctions of the centerline inside of the blob."""
    if len(branches.core) < 2:
        return None
    middle = branches.core.mean(axis=0)
    _, spread, rows = np.linalg.svd(branches.core - middle, full_matrices=False)
    if spread[0] < 1e-9:
        return None
    return _Axis(middle, rows[0], [])


def _group(nodes: list[tuple[FloatArray, set[int]]], separation: float) -> list[tuple[FloatArray, set[int]]]:
    """Join the places that are too near to be told apart."""
    groups: list[tuple[list[FloatArray], set[int]]] = []
    for place, members in nodes:
        near = [g for g in groups if math.dist(np.mean(g[0], axis=0), place) < separation]
        if near:
            near[0][0].append(place)
            near[0][1].update(members)
        else:
            groups.append(([place], set(members)))
    return [(np.mean(places, axis=0), members) for places, members in groups]
