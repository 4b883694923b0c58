"""Which detections are sightings of the same intersection.

Four steps, none of which depends on the order of the detections: those left out that stand for two intersections at
once; the peaks of the density of all others; peaks that stand for one intersection (two passes with drift, an estimate
that jumps between two places) joined, unless they were seen side by side; each detection to its nearest centre, which
takes at most one detection per keyframe.
"""

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import near_pairs

_CELLS_PER_BANDWIDTH = 4
_MIDDLE = 0.5  # of the way from the middle between two places to either: what lies nearer is in the middle
_CELLS_PER_MIDDLE = 5


def cells_of(xy: FloatArray, side_m: float) -> IntArray:
    """Return which occupied cell of a grid each of (N, 2) points lies in, (N,) from 0, from west to east."""
    index = np.floor(xy / side_m).astype(np.int64)
    index -= index.min(axis=0)
    _, cell = np.unique(index[:, 0] * (index[:, 1].max() + 1) + index[:, 1], return_inverse=True)
    return cell.reshape(-1).astype(np.int64)


def _means(group: IntArray, xy: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return of each group the number of its points and their mean."""
    count = np.bincount(group)
    return count, np.stack([np.bincount(group, xy[:, axis]) / count for axis in (0, 1)], axis=-1)


def find_peaks(xy: FloatArray, *, bandwidth_m: float, cell_m: float | None = None) -> IntArray:
    """Group (D, 2) points, metres, by the peak of their density that they climb to: (D,) int64 from 0.

    Quick shift (Vedaldi and Soatto, 2008): each point points to the nearest one of higher density. It runs on the
    occupied cells of a grid, by default a quarter of the bandwidth wide, which bounds the number of neighbours however
    often a place was seen. The bandwidth is the standard deviation of the Gaussian kernel; peaks come out further apart
    than 2.5 times that.
    """
    if not len(xy):
        return np.zeros(0, dtype=np.int64)
    cell = cells_of(xy, cell_m or bandwidth_m / _CELLS_PER_BANDWIDTH)
    mass, centre = _means(cell, xy)
    pairs = near_pairs(centre, centre, 2.5 * bandwidth_m)
    i, j = pairs[:, pairs[0] < pairs[1]]
    distance = np.hypot(*(centre[i] - centre[j]).T)
    kernel = np.exp(-0.5 * (distance / bandwidth_m) ** 2)
    density = mass + np.bincount(i, kernel * mass[j], len(mass)) + np.bincount(j, kernel * mass[i], len(mass))

    rank = np.empty(len(mass), dtype=np.int64)  # of the density; ties by the order of the cells
    rank[np.argsort(density, kind="stable")] = np.arange(len(mass))
    upward = rank[i] < rank[j]
    low, high = np.where(upward, i, j), np.where(upward, j, i)
    nearest = np.full(len(mass), np.inf)
    np.minimum.at(nearest, low, distance)
    is_nearest = distance == nearest[low]
    parent = np.full(len(mass), len(mass))
    np.minimum.at(parent, low[is_nearest], high[is_nearest])
    parent = np.where(parent < len(mass), parent, np.arange(len(mass)))
    while True:  # let all jump to the parent of their parent until they are at the peak
        grandparent = parent[parent]
        if np.array_equal(grandparent, parent):
            break
        parent = grandparent
    _, peak = np.unique(parent, return_inverse=True)
    return peak.reshape(-1)[cell].astype(np.int64)


def join_peaks(labels: IntArray, xy: FloatArray, keyframe: IntArray, *, radius_m: float, together: float) -> IntArray:
    """Join groups, (D,) from 0, that lie close together and were not seen side by side.

    Places are metres in one plane. Groups whose means lie further apart than the radius are not joined; two are two
    intersections if more than the share `together` of the keyframes that saw the rarer one saw both. One keyframe is
    not enough: a false detection beside a real one must not separate two passes. Closest first: joined groups move to
    their common mean and keep the keyframes of both, so chains do not grow beyond the radius and a pair that was seen
    side by side in one pass stays apart in the next.
    """
    if not len(labels):
        return labels.copy()
    mass, mean = _means(labels, xy)
    pairs = near_pairs(mean, mean, radius_m)
    pairs = pairs[:, pairs[0] < pairs[1]]
    seen: list[set[int]] = [set() for _ in mass]
    rows = np.isin(labels, pairs)
    for label, k in zip(labels[rows].tolist(), keyframe[rows].tolist(), strict=True):
        seen[label].add(k)

    distance = np.hypot(*(mean[pairs[0]] - mean[pairs[1]]).T)
    group = list(range(len(mass)))

    def root(member: int) -> int:
        while group[member] != member:
            group[member] = group[group[member]]
            member = group[member]
        return member

    for one, other in pairs[:, np.argsort(distance, kind="stable")].T.tolist():
        a, b = sorted((root(one), root(other)))
        if a == b or np.hypot(*(mean[a] - mean[b])) > radius_m:
            continue
        if len(seen[a] & seen[b]) > together * min(len(seen[a]), len(seen[b])):
            continue
        mean[a] = (mass[a] * mean[a] + mass[b] * mean[b]) / (mass[a] + mass[b])
        mass[a] += mass[b]
        seen[a] |= seen[b]
        group[b] = a
    _, joined = np.unique([root(member) for member in range(len(group))], return_inverse=True)
    return joined.reshape(-1)[labels].astype(np.int64)


def stand_for_two(xy: FloatArray, keyframe: IntArray, *, radius_m: float) -> BoolArray:
    """Return which detections, (D,) bool, stand for two intersections at once.

    They are seen alone, in the middle between two that other keyframes saw side by side, within the radius; and at
    least as many keyframes saw two there as saw one.
    """
    order, pairs = np.argsort(keyframe, kind="stable"), [np.zeros((2, 0), dtype=np.int64)]
    for step in range(1, int(np.bincount(keyframe).max(initial=1))):
        same = np.flatnonzero(keyframe[order[step:]] == keyframe[order[:-step]])
        pairs.append(order[[same, same + step]])
    one, other = np.hstack(pairs)
    half_m = 0.5 * np.hypot(*(xy[other] - xy[one]).T)
    is_near = half_m <= 0.5 * radius_m
    one, other, half_m = one[is_near], other[is_near], half_m[is_near]
    alone = np.flatnonzero(~np.isin(np.arange(len(xy)), [one, other]))
    is_two = np.zeros(len(xy), dtype=np.bool_)
    if not len(one) or not len(alone):
        return is_two
    reach_m = _MIDDLE * 0.5 * radius_m
    between = 0.5 * (xy[one] + xy[other])
    pair, cell = (cells_of(each, reach_m / _CELLS_PER_MIDDLE) for each in (between, xy[alone]))
    (twos, middle), (ones, place) = _means(pair, between), _means(cell, xy[alone])
    limit_m = _MIDDLE * np.bincount(pair, half_m) / twos
    i, j = near_pairs(place, middle, reach_m)
    is_middle = np.hypot(*(place[i] - middle[j]).T) <= limit_m[j]
    saw_two = np.bincount(i[is_middle], twos[j[is_middle]], len(place))
    i, j = near_pairs(place, place, reach_m)
    is_two[alone] = ((saw_two > 0) & (saw_two >= np.bincount(i, ones[j])))[cell]
    return is_two


def assign(xy: FloatArray, keyframe: IntArray, centres: FloatArray, *, radius_m: float) -> IntArray:
    """Give each detection the row of a centre, -1 for none: nearest pairs first, one detection per keyframe and centre.

    Further than the radius from a centre nothing is assigned.
    """
    assignment = np.full(len(xy), -1, dtype=np.int64)
    if not len(xy) or not len(centres):
        return assignment
    detection, near = near_pairs(xy, centres, radius_m)
    order = np.lexsort((detection, np.hypot(*(xy[detection] - centres[near]).T)))
    taken: set[tuple[int, int]] = set()
    result = assignment.tolist()
    frames = keyframe.tolist()
    for d, c in zip(detection[order].tolist(), near[order].tolist(), strict=True):
        if result[d] < 0 and (frames[d], c) not in taken:
            result[d] = c
            taken.add((frames[d], c))
    return np.array(result, dtype=np.int64)
