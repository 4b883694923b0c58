"""Several intersections in one blob of road: what the paper's method merges into one point (its section V-D).

Branches that continue each other across the candidate form a through axis, and so does a single branch beside one, or
beside another one that leads the same way: a carriageway that is not seen farther, or ends there. Axes that run side by
side (a dual carriageway) or branches that meet an axis at distinct places (a staggered junction) are intersections of
their own. The short road that joins two of them is a branch of both: in a wide blob the junctions of the centerline say
on which line it lies, but not where on it. Where a dual carriageway ends, the road across it is that line.
"""

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from interloc.arrays import FloatArray
from interloc.detection.branches import Branches
from interloc.detection.lines import LINE, SIDE_BY_SIDE_RAD
from interloc.detection.refinement import Junction

LINK_STD_M = 1.0  # how well the line through the junctions of two intersections is known


@dataclass(frozen=True)
class _Axis:
    """A line through the blob and the branches that it is made of."""

    point: FloatArray
    direction: FloatArray
    branches: frozenset[int] = frozenset()

    def meets(self, other: "_Axis", angle_rad: float) -> FloatArray | None:
        """Return where two axes cross, None where they run too much alike."""
        cross = _cross(self.direction, other.direction)
        if abs(cross) < math.sin(angle_rad):
            return None
        return self.point + _cross(other.point - self.point, other.direction) / cross * self.direction

    def nearest(self, place: FloatArray) -> FloatArray:
        """Return its point that is nearest to a place."""
        return self.point + self.direction * ((place - self.point) @ self.direction)


_Node = tuple[FloatArray, frozenset[int]]
"""A place and the branches that meet there."""


def _cross(a: FloatArray, b: FloatArray) -> float:
    (a_row, a_col), (b_row, b_col) = a.tolist(), b.tolist()  # quicker than their items
    return float(a_row * b_col - a_col * b_row)


def split_compound(branches: Branches, separation_m: float, straight_deg: float) -> list[Branches]:
    """Split the branches of a candidate into those of the intersections that it is made of.

    Parameters
    ----------
    branches
        Of one candidate. Three make two intersections only where two lead the same way and end, fewer never.
    separation_m, straight_deg : float
        See `interloc.config.CompoundConfig` and `interloc.config.BranchConfig`.

    Returns
    -------
    list of Branches
        One for each intersection, around its own place; the given ones where there is just one.
    """
    angle_rad, separation = math.radians(straight_deg), separation_m / branches.resolution_m
    directions, alike = branches.lines["direction"], math.cos(SIDE_BY_SIDE_RAD)
    if branches.count < 3 or (branches.count == 3 and (directions * directions[[1, 2, 0]]).sum(axis=1).max() <= alike):
        return [branches]
    axes, stems = _axes(branches, angle_rad, separation)
    nodes: list[_Node] = []
    # Ends of carriageways: no branch continues an axis.
    if axes and all(len(a.branches) == 1 and (directions @ a.direction).min() > -math.cos(angle_rad) for a in axes):
        nodes = _ends(branches, axes, stems, angle_rad, separation)
    elif branches.count > 3:
        nodes = _crossings(branches, axes, stems, angle_rad, separation)
    if len(nodes) < 2:
        return [branches]
    places = [place for place, _ in nodes]
    parts = [branches.select(sorted(members), place) for place, members in nodes]
    return [replace(_connected(part, places, angle_rad), is_part=True) for part in parts]


def _axes(branches: Branches, angle_rad: float, separation: float) -> tuple[list[_Axis], list[_Axis]]:
    """Pair the branches that continue each other; return axes, with what runs beside them, and all other branches."""
    points, directions, weights = (branches.lines[name] for name in ("point", "direction", "weight"))
    single = {i: _Axis(points[i], directions[i], frozenset({i})) for i in np.flatnonzero(branches.has_line).tolist()}
    near = {i: axis.nearest(branches.candidate) for i, axis in single.items()}
    alike = (directions @ directions.T).tolist()
    costs = []
    for i, j in combinations(single, 2):
        turn = math.acos(min(max(-alike[i][j], -1.0), 1.0))
        if turn < angle_rad:
            along = directions[i] - directions[j]
            offset = abs(_cross(along, near[i] - near[j])) / math.hypot(*along)
            if offset < 0.5 * separation:
                costs.append((turn / angle_rad + offset / (0.5 * separation), i, j))
    axes: list[_Axis] = []
    for _, i, j in sorted(costs):
        if i in single and j in single:
            point = (weights[i] * points[i] + weights[j] * points[j]) / (weights[i] + weights[j])
            span = points[i] - points[j]
            span = span if span.any() else directions[i]  # both lie on one curve, at one point
            axes.append(_Axis(point, span / math.hypot(*span), frozenset({i, j})))
            del single[i], single[j]
    halves: list[_Axis] = []
    stems: list[_Axis] = []
    for i, one in single.items():
        same_way = [j for j in single if j != i and alike[i][j] > math.cos(SIDE_BY_SIDE_RAD)]
        is_half = any(
            abs(one.direction @ axis.direction) > math.cos(angle_rad)
            and abs(_cross(axis.direction, near[i] - axis.point)) > separation
            for axis in [*axes, *(single[j] for j in same_way)]
        )
        (halves if is_half else stems).append(one)
    return [*axes, *halves], stems


def _ends(
    branches: Branches, halves: list[_Axis], stems: list[_Axis], angle_rad: float, separation: float
) -> list[_Node]:
    """Return where a dual carriageway ends: at the best-known road that crosses all of its carriageways near by."""
    reach = branches.inner + separation
    crossed: list[tuple[_Axis, list[FloatArray]]] = []
    for stem in stems:
        met = [half.meets(stem, angle_rad) for half in halves]
        places = [place for place in met if place is not None and math.dist(place, branches.candidate) < reach]
        if len(places) == len(halves):
            crossed.append((stem, places))
    if not crossed:
        return []
    across, places = max(crossed, key=lambda each: branches.lines["weight"][min(each[0].branches)])
    members = [half.branches | across.branches for half in halves]
    for stem in stems:
        if stem is not across:
            nearest = min(range(len(places)), key=lambda number: math.dist(places[number], stem.point))
            members[nearest] |= stem.branches
    return list(zip(places, members, strict=True))


def _crossings(
    branches: Branches, axes: list[_Axis], stems: list[_Axis], angle_rad: float, separation: float
) -> list[_Node]:
    """Return where axes cross, and where single branches end at them, if junctions of the centerline lie there."""
    found: list[_Node] = []
    for axis, other in combinations(axes, 2):
        if (place := axis.meets(other, angle_rad)) is not None:
            found.append((place, axis.branches | other.branches))
    for stem in stems:
        # A branch ends at the first axis that it meets.
        met = [(axis, place) for axis in axes if (place := axis.meets(stem, angle_rad)) is not None]
        if met:
            axis, place = min(met, key=lambda pair: math.dist(pair[1], stem.point))
            found.append((place, axis.branches | stem.branches))
    for axis in axes:
        # Two carriageways joined by a road that is no longer than the blob is wide.
        is_lone = not any(axis.branches <= members for _, members in found)
        link = _link(branches) if is_lone else None
        if link is not None and (place := axis.meets(link, angle_rad)) is not None:
            found.append((place, axis.branches))
    reach = branches.inner + separation
    nodes = _joined([node for node in found if math.dist(node[0], branches.candidate) < reach], separation)
    if len(nodes) < 2 or not len(branches.core):
        return []
    gaps = np.array([[math.dist(place, junction) for place, _ in nodes] for junction in branches.core])
    nearest = gaps.argmin(axis=1)
    if len(np.unique(nearest)) < len(nodes):
        return []  # without a junction of the centerline for itself a place was made up by a bent branch
    return [(branches.core[nearest == number].mean(axis=0), members) for number, (_, members) in enumerate(nodes)]


def _link(branches: Branches) -> _Axis | None:
    """Return the line through the junctions of the centerline inside of the blob."""
    if len(branches.core) < 2:
        return None
    middle = branches.core.mean(axis=0)
    _, spread, rows = np.linalg.svd(branches.core - middle, full_matrices=False)
    return _Axis(middle, rows[0]) if spread[0] >= 1e-9 else None


def _joined(nodes: list[_Node], separation: float) -> list[_Node]:
    """Join the places that are too near to be told apart."""
    groups: list[tuple[list[FloatArray], frozenset[int]]] = []
    for place, members in nodes:
        for number, (places, others) in enumerate(groups):
            if math.dist(np.mean(places, axis=0), place) < separation:
                groups[number] = [*places, place], others | members
                break
        else:
            groups.append(([place], members))
    return [(np.mean(places, axis=0), members) for places, members in groups]


def _connected(part: Branches, places: list[FloatArray], angle_rad: float) -> Branches:
    """Add the short road to the nearest other intersection of the blob, where no branch leads there already."""
    gap = min((place - part.candidate for place in places if place is not part.candidate), key=lambda g: math.hypot(*g))
    length = math.hypot(*gap)
    toward = gap / max(length, 1e-9)
    if part.count and float((part.lines["direction"] @ toward).max()) > math.cos(angle_rad):
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


def join_halves(junctions: list[Junction], separation_m: float, straight_deg: float) -> list[Junction]:
    """Join the two candidates that an acute crossing has, one at each end of the surface that its roads share.

    Both are moved to where the roads cross: they come to lie too near to each other to be told apart, and less than
    half as far apart as they were. The road between them is none, and the crossing has the other branches of both.
    """
    joined = dict(enumerate(junctions))
    for i, j in combinations(range(len(junctions)), 2):
        one, other = junctions[i], junctions[j]
        apart, limit = math.dist(one.position, other.position), separation_m / one.branches.resolution_m
        between = math.dist(one.branches.candidate, other.branches.candidate)
        if apart < min(limit, 0.5 * between) and joined.get(i) is one and j in joined:
            crossing = _without_road_between(one.branches, other.branches, math.radians(straight_deg))
            if crossing is not None:
                weights = np.array([one.std_m, other.std_m]) ** -2
                position = np.average([one.position, other.position], axis=0, weights=weights)
                joined[i] = Junction(position, min(one.residual, other.residual), weights.sum() ** -0.5, crossing)
                del joined[j]
    return list(joined.values())


def _without_road_between(a: Branches, b: Branches, angle_rad: float) -> Branches | None:
    """Return the branches of two candidates but for the one of each that leads to the other; None if there is none."""
    toward = (b.candidate - a.candidate) / math.dist(a.candidate, b.candidate)
    of_a, of_b = (part.lines["direction"] @ way < math.cos(angle_rad) for part, way in ((a, toward), (b, -toward)))
    if of_a.all() or of_b.all():
        return None
    return replace(
        a,
        candidate=0.5 * (a.candidate + b.candidate),
        lines=np.append(a.lines[of_a], b.lines[of_b]),
        lengths=np.append(a.lengths[of_a], b.lengths[of_b]),
        reaches=np.append(a.reaches[of_a], b.reaches[of_b]),
        core=np.concatenate([a.core, b.core]),
        is_part=True,
    )
