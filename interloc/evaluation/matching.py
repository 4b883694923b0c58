"""Which detection belongs to which OSM node, keyframe by keyframe (paper, section IV-A)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import ecef_from_geodetic, enu_from_lonlat, rotate_2d
from interloc.results import DetectionTable, KeyframeTable

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
    assert keyframes.lonlat is not None
    assert detections.lonlat is not None
    fixes = keyframes.lonlat
    roi_keyframe, roi_node = pairs_in_square(keyframes, node_lonlat, roi_m)

    # Every detection meets the nodes of its keyframe's ROI: the pairs are ordered by keyframe, so these are slices.
    first = np.searchsorted(roi_keyframe, detections.keyframe, side="left")
    count = np.searchsorted(roi_keyframe, detections.keyframe, side="right") - first
    detection = np.repeat(np.arange(len(detections)), count)
    within_slice = np.arange(len(detection)) - np.repeat(np.cumsum(count) - count, count)
    node = roi_node[np.repeat(first, count) + within_slice]
    fix = fixes[detections.keyframe[detection]]
    offset = enu_from_lonlat(fix[:, 1], fix[:, 0], detections.lonlat[detection]) - enu_from_lonlat(
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
    assert keyframes.lonlat is not None
    assert keyframes.enu_yaw_rad is not None
    keyframe, point = pairs_within(keyframes.lonlat, lonlat, side_m / np.sqrt(2.0))
    fix = keyframes.lonlat[keyframe]
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
