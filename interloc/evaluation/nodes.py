"""What became of each ground truth node over the whole drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.evaluation.matching import Matching
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M


@dataclass(frozen=True)
class NodeTable:
    """The N nodes of the map under a policy.

    Attributes
    ----------
    in_zone : (N,) bool
        In the relevant zone of some keyframe: a node that the drive should have found.
    found : (N,) bool
        Matched by a detection under 5 m at some keyframe.
    zone_keyframes, missed_keyframes : (N,) int64
        Keyframes with the node in their relevant zone; those of them without a detection matched to it.
    detections : (N,) int64
        Detections matched to the node.
    best_error_m, median_error_m : (N,) float64
        Over these detections; NaN where there is none.
    """

    in_zone: BoolArray
    found: BoolArray
    zone_keyframes: IntArray
    missed_keyframes: IntArray
    detections: IntArray
    best_error_m: FloatArray
    median_error_m: FloatArray


def tabulate_nodes(matching: Matching, node_count: int) -> NodeTable:
    """Gather the matched pairs and the zone memberships a node."""
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
