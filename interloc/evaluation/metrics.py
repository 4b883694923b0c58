"""Which detection and intersection belongs to which OSM node, and the figures of that (paper, section IV)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import ecef_from_geodetic, enu_from_lonlat, linked_groups, rotate_2d
from interloc.results import DetectionTable, IntersectionTable, KeyframeTable

# Which detection belongs to which OSM node, keyframe by keyframe (paper, section IV-A).

UNMATCHED = -1


@dataclass(frozen=True)
class Matching:
    """The D detections of a run matched to nodes, and what the relevant zones held."""

    node: IntArray
    """(D,) int64: row of the nearest node of the ROI of the detection's keyframe, -1 where the ROI holds none."""
    error_m: FloatArray
    """(D,) float64: distance to that node, metres (paper: the center error d_k,j); infinite where there is none."""
    zone_keyframe: IntArray
    zone_node: IntArray
    """(Z,) int64: every occurrence of a node in the relevant zone of a keyframe, ordered by keyframe, then node."""
    zone_found: BoolArray
    """(Z,) bool: false for a false negative: no detection of the keyframe was matched to the node."""

    @property
    def is_matched(self) -> BoolArray:
        """(D,) bool: detections with a node in their ROI, however far."""
        matched: BoolArray = self.node != UNMATCHED
        return matched


def match(
    keyframes: KeyframeTable,
    detections: DetectionTable,
    node_lonlat: FloatArray,
    *,
    roi_m: float,
    relevant_zone_m: float,
) -> Matching:
    """Match every detection with the nearest node, (N, 2) degrees, in the ROI of its keyframe.

    ROI and relevant zone are squares around L_k, aligned with W: their sides are S and S - 2 a_o in the paper, metres.
    Distances are planar in the east-north-up frame at the fix of the detection's own keyframe.
    """
    fixes = keyframes.degrees
    roi_keyframe, roi_node = pairs_in_square(keyframes, node_lonlat, roi_m)

    # Every detection meets the nodes of its keyframe's ROI: the pairs are ordered by keyframe, so these are slices.
    first = np.searchsorted(roi_keyframe, detections.keyframe, side="left")
    count = np.searchsorted(roi_keyframe, detections.keyframe, side="right") - first
    detection = np.repeat(np.arange(len(detections)), count)
    within_slice = np.arange(len(detection)) - np.repeat(np.cumsum(count) - count, count)
    node = roi_node[np.repeat(first, count) + within_slice]
    fix = fixes[detections.keyframe[detection]]
    offset = enu_from_lonlat(fix[:, 1], fix[:, 0], detections.degrees[detection]) - enu_from_lonlat(
        fix[:, 1], fix[:, 0], node_lonlat[node]
    )
    distance = np.hypot(offset[:, 0], offset[:, 1])

    order = np.lexsort((node, distance, detection))
    detection, nearest = np.unique(detection[order], return_index=True)
    matched_node = np.full(len(detections), UNMATCHED, dtype=np.int64)
    error = np.full(len(detections), np.inf)
    matched_node[detection] = node[order][nearest]
    error[detection] = distance[order][nearest]

    zone_keyframe, zone_node = pairs_in_square(keyframes, node_lonlat, relevant_zone_m)
    width = max(len(node_lonlat), 1)
    is_matched = matched_node != UNMATCHED
    matched_key = detections.keyframe[is_matched] * width + matched_node[is_matched]
    zone_found = np.isin(zone_keyframe * width + zone_node, matched_key)
    return Matching(matched_node, error, zone_keyframe, zone_node, zone_found)


def pairs_in_square(keyframes: KeyframeTable, lonlat: FloatArray, side_m: float) -> tuple[IntArray, IntArray]:
    """Find the points, (N, 2) degrees, in the square around each keyframe that is aligned with the axes of W.

    Points on its edge are in it. Returns the rows of keyframes and points, ordered by keyframe, then point.
    """
    assert keyframes.enu_yaw_rad is not None
    keyframe, point = pairs_within(keyframes.degrees, lonlat, side_m / np.sqrt(2.0))
    fix = keyframes.degrees[keyframe]
    enu = enu_from_lonlat(fix[:, 1], fix[:, 0], lonlat[point])
    enu_yaw_of_world = keyframes.enu_yaw_rad - keyframes.world_yaw_rad
    world = rotate_2d(enu, -enu_yaw_of_world[keyframe])
    inside = np.abs(world).max(axis=-1, initial=0.0) <= side_m / 2.0
    return keyframe[inside], point[inside]


def pairs_within(centre_lonlat: FloatArray, lonlat: FloatArray, radius_m: float) -> tuple[IntArray, IntArray]:
    """Find all (centre, point) pairs within a radius and a little more, ordered by centre, then point."""
    empty = np.empty(0, dtype=np.int64)
    if len(centre_lonlat) == 0 or len(lonlat) == 0:
        return empty, empty
    # Straight lines through the Earth need no projection, so no drive is too long for it.
    tree = cKDTree(ecef_from_geodetic(lonlat[:, 1], lonlat[:, 0]))
    centres = ecef_from_geodetic(centre_lonlat[:, 1], centre_lonlat[:, 0])
    near: Any = tree.query_ball_point(centres, radius_m * 1.001 + 0.1, return_sorted=True)
    centre = np.repeat(np.arange(len(centre_lonlat)), [len(rows) for rows in near])
    point = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near])
    return centre, point


THRESHOLDS_M: tuple[float, ...] = tuple(sorted({*(0.5 * i for i in range(1, 21)), 6.9, 13.3}))
"""Values of the confidence threshold D: 0.5 to 10 m, and the two that compare with MMInsectDet (section V-B)."""

STANDARD_THRESHOLD_M = 5.0
"""The D of the paper's tables."""

NEAR_PAIR_M = 10.0
"""Pairs further apart than this are a missing node rather than an inaccurate detection."""


@dataclass(frozen=True)
class ErrorSummary:
    """Distribution of the center errors of the matched pairs, metres; None where there is no such pair."""

    ace_m: float | None
    """Average over all matched pairs: nearest node in the ROI, however far (the paper's ACE)."""
    ace_tp_m: float | None
    """Average over the pairs under 5 m."""
    ace_under_10_m: float | None
    """Average over the pairs under 10 m."""
    median_m: float | None
    p95_m: float | None
    rmse_m: float | None
    """Over all matched pairs."""


@dataclass(frozen=True)
class Scores:
    """Counts and ratios at each of the T thresholds."""

    threshold_m: FloatArray
    """(T,) float64: D, ascending."""
    tp: IntArray
    fp: IntArray
    """(T,) int64: detections closer than D to their node; all others."""
    fn: int
    """Nodes in a relevant zone without a detection matched to them; the same for every D."""
    precision: FloatArray
    recall: FloatArray
    f1: FloatArray
    """(T,) float64: NaN where nothing was there to count."""

    def at(self, threshold_m: float, values: FloatArray) -> float | None:
        """Return one of `precision`, `recall`, `f1` at a threshold of the table; None where it is undefined."""
        value = float(values[int(np.argmin(np.abs(self.threshold_m - threshold_m)))])
        return None if np.isnan(value) else value


def summarize_errors(matching: Matching) -> ErrorSummary:
    """Summarize the center errors of all matched pairs (paper, eq. 14)."""
    errors = matching.error_m[matching.is_matched]
    return ErrorSummary(
        ace_m=_mean(errors),
        ace_tp_m=_mean(errors[errors < STANDARD_THRESHOLD_M]),
        ace_under_10_m=_mean(errors[errors < NEAR_PAIR_M]),
        median_m=_percentile(errors, 50.0),
        p95_m=_percentile(errors, 95.0),
        rmse_m=None if len(errors) == 0 else float(np.sqrt(np.mean(errors**2))),
    )


def score(matching: Matching, thresholds_m: tuple[float, ...] = THRESHOLDS_M) -> Scores:
    """Count true and false positives at each threshold, and false negatives (paper, eq. 15 to 17).

    F1 = 2 TP / (2 TP + FP + FN), which is the harmonic mean of precision and recall wherever that exists.
    """
    threshold = np.array(sorted(thresholds_m), dtype=np.float64)
    # side="left" counts errors < D: the paper's circle is open.
    tp = np.searchsorted(np.sort(matching.error_m), threshold, side="left").astype(np.int64)
    fp = len(matching.error_m) - tp
    fn = int(np.count_nonzero(~matching.zone_found))
    return Scores(
        threshold_m=threshold,
        tp=tp,
        fp=fp,
        fn=fn,
        precision=_ratio(tp, tp + fp),
        recall=_ratio(tp, tp + fn),
        f1=_ratio(2 * tp, 2 * tp + fp + fn),
    )


@dataclass(frozen=True)
class NodeTable:
    """What became of the N nodes of the map over the whole drive."""

    in_zone: BoolArray
    """(N,) bool: in the relevant zone of some keyframe: a node that the drive should have found."""
    found: BoolArray
    """(N,) bool: matched by a detection under 5 m at some keyframe."""
    zone_keyframes: IntArray
    missed_keyframes: IntArray
    """(N,) int64: keyframes with the node in their relevant zone; those of them without a detection matched to it."""
    detections: IntArray
    """(N,) int64: detections matched to the node."""
    best_error_m: FloatArray
    median_error_m: FloatArray
    """(N,) float64: over these detections; NaN where there is none."""


def tabulate_nodes(matching: Matching, node_count: int) -> NodeTable:
    """Sum up matches and zone memberships per node."""
    zone_keyframes = np.bincount(matching.zone_node, minlength=node_count)
    missed = np.bincount(matching.zone_node[~matching.zone_found], minlength=node_count)
    node, error = matching.node[matching.is_matched], matching.error_m[matching.is_matched]
    detections = np.bincount(node, minlength=node_count)
    best = np.full(node_count, np.nan)
    median = np.full(node_count, np.nan)
    order = np.argsort(node, kind="stable")
    hit, first = np.unique(node[order], return_index=True)
    last = np.append(first[1:], len(node))[: len(hit)]
    for row, start, stop in zip(hit, first, last, strict=True):
        errors = error[order[start:stop]]
        best[row], median[row] = errors.min(), np.median(errors)
    return NodeTable(
        in_zone=zone_keyframes > 0,
        found=best < STANDARD_THRESHOLD_M,
        zone_keyframes=zone_keyframes.astype(np.int64),
        missed_keyframes=missed.astype(np.int64),
        detections=detections.astype(np.int64),
        best_error_m=best,
        median_error_m=median,
    )


def _ratio(part: IntArray, whole: IntArray) -> FloatArray:
    ratio = np.full(len(part), np.nan)
    np.divide(part, whole, out=ratio, where=whole > 0)
    return ratio


def _mean(values: FloatArray) -> float | None:
    return None if len(values) == 0 else float(np.mean(values))


def _percentile(values: FloatArray, percent: float) -> float | None:
    return None if len(values) == 0 else float(np.percentile(values, percent))


# The fused map against the OSM nodes, one-to-one.

GATE_M = 10.0


@dataclass(frozen=True)
class MapLevel:
    """The M fused intersections assigned to the N nodes.

    All take part in the assignment, so an intersection at the rim of what was driven may claim a node just beyond it.
    Precision counts the intersections within the union of the relevant zones, recall the nodes within it.
    """

    node: IntArray
    """(M,) int64: row of the node assigned to each intersection, -1 for none."""
    error_m: FloatArray
    """(M,) float64: distance to it, infinite for none."""
    counts: BoolArray
    """(M,) bool: intersections in the relevant zone of some keyframe: those that precision is about."""
    node_in_zone: BoolArray
    node_found: BoolArray
    """(N,) bool: nodes in the relevant zone of some keyframe; nodes with an intersection assigned."""
    gate_m: float
    """Largest distance of an assigned pair."""

    @property
    def missed(self) -> BoolArray:
        """(N,) bool: nodes in the zones without an intersection."""
        return self.node_in_zone & ~self.node_found

    @property
    def recall(self) -> float | None:
        """Share of the nodes in the zones that have an intersection."""
        total = int(self.node_in_zone.sum())
        return int(self.node_found[self.node_in_zone].sum()) / total if total else None

    @property
    def errors_m(self) -> FloatArray:
        """Distances of the assigned pairs that count, metres."""
        errors: FloatArray = self.error_m[(self.node != UNMATCHED) & self.counts]
        return errors


def assign_intersections(
    keyframes: KeyframeTable,
    intersections: IntersectionTable,
    node_lonlat: FloatArray,
    node_in_zone: BoolArray,
    *,
    relevant_zone_m: float,
) -> MapLevel:
    """Assign fused intersections to nodes, one-to-one, with the smallest sum of distances, each cut off at the gate."""
    node = np.full(len(intersections), UNMATCHED, dtype=np.int64)
    error = np.full(len(intersections), np.inf)
    rows, columns, distance = assign_one_to_one(intersections.degrees, node_lonlat, GATE_M)
    node[rows], error[rows] = columns, distance
    counts = np.zeros(len(intersections), dtype=np.bool_)
    counts[pairs_in_square(keyframes, intersections.degrees, relevant_zone_m)[1]] = True
    found = np.zeros(len(node_lonlat), dtype=np.bool_)
    found[columns] = True
    return MapLevel(node, error, counts, node_in_zone, found, GATE_M)


def assign_one_to_one(
    a_lonlat: FloatArray, b_lonlat: FloatArray, gate_m: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Assign points to others, one-to-one, with the smallest sum of distances, each cut off at the gate.

    Points are (A, 2) and (B, 2) degrees, the gate metres. Returns the rows of the P pairs in both, and their distances
    in metres. Solved within each group of points that the gate connects: the groups are small.
    """
    empty = np.empty(0, dtype=np.int64)
    a, b = pairs_within(a_lonlat, b_lonlat, gate_m)
    offset = enu_from_lonlat(a_lonlat[a, 1], a_lonlat[a, 0], b_lonlat[b])
    distance = np.hypot(offset[:, 0], offset[:, 1])
    near = distance < gate_m
    a, b, distance = a[near], b[near], distance[near]
    if len(a) == 0:
        return empty, empty, np.empty(0)
    size = len(a_lonlat) + len(b_lonlat)
    group = linked_groups(a, len(a_lonlat) + b, size)
    found_a, found_b, found_distance = [], [], []
    group_of_pair = group[a]
    for each in np.unique(group_of_pair):
        pairs = np.flatnonzero(group_of_pair == each)
        rows, row = np.unique(a[pairs], return_inverse=True)
        columns, column = np.unique(b[pairs], return_inverse=True)
        cost = np.full((len(rows), len(columns)), gate_m)
        cost[row, column] = distance[pairs]
        i, j = linear_sum_assignment(cost)
        real = cost[i, j] < gate_m
        found_a.append(rows[i[real]])
        found_b.append(columns[j[real]])
        found_distance.append(cost[i[real], j[real]])
    return np.concatenate(found_a), np.concatenate(found_b), np.concatenate(found_distance)
