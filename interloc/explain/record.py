"""The numbers behind the pictures, as JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.detection.image import BinaryImage
from interloc.explain.evidence import ExplainedCandidate, ExplainedKeyframe, GroundTruth
from interloc.geometry import rotate_2d


def record(explained: ExplainedKeyframe, drive_name: str, truth: GroundTruth | None) -> dict[str, Any]:
    """Collect the numbers of a keyframe: positions in L (levelled) and W in metres, angles in degrees in W."""
    steps, keyframe = explained.steps, explained.keyframe
    x, y = explained.vehicle.tolist()
    return {
        "drive": drive_name,
        "frame_asked": explained.asked,
        "frame": keyframe.frame,
        "time_s": keyframe.time_s,
        "keyframe": explained.number,
        "keyframes_in_drive": explained.keyframe_count,
        "pose": {"world_x_m": x, "world_y_m": y, "heading_deg": math.degrees(explained.yaw_rad)},
        "window": {"keyframes": len(explained.window), "frames": [scan.frame for scan in explained.window]},
        "roi": {"cells": steps.roi.size, "resolution_m": steps.roi.resolution_m},
        "points": {
            "road": explained.points.road_count,
            "other_ground": len(explained.points.confusable),
            "road_in_window": sum(len(scan.cells) for scan in explained.window),
        },
        "min_points": steps.min_points,
        "cells": {
            "bev": pixels(steps.bev),
            "occupancy": pixels(steps.occupancy),
            "centerline": len(steps.centerline.rows),
        },
        "candidates": [_candidate(explained, candidate) for candidate in explained.candidates],
        "detections": [_detection(explained, v, i) for v in explained.candidates for i in v.detections],
        "ground_truth": None if truth is None else _ground_truth(explained, truth),
        "config": explained.config.model_dump(mode="json"),
    }


def pixels(image: BinaryImage) -> int:
    """Return the number of pixels that are set."""
    return int(image.to_array().sum())


def _candidate(explained: ExplainedKeyframe, candidate: ExplainedCandidate) -> dict[str, Any]:
    metre = explained.roi.resolution_m
    return {
        "number": candidate.number,
        **_place(explained, explained.around(candidate.position)),
        "road_width_m": candidate.width * metre,
        "merged_points": len(candidate.merged),
        "inner_radius_m": candidate.branches.inner * metre,
        "branches": candidate.branches.count,
        "pieces": [
            {"reach_m": piece.reach * metre, "ends_at_candidate": piece.at_candidate, "is_branch": piece.is_branch}
            for piece in candidate.pieces
        ],
        "kept": candidate.is_kept,
        "why_not": candidate.why_not,
    }


def _detection(explained: ExplainedKeyframe, candidate: ExplainedCandidate, i: int) -> dict[str, Any]:
    junction, found, metre = explained.steps.junctions[i], explained.detections, explained.roi.resolution_m
    return {
        "candidate": candidate.number,
        **_place(explained, found.world_xy[i] - explained.vehicle),
        "branch_count": junction.branches.count,
        "branch_angles_deg": np.degrees(found.branch_angles_rad[i]).tolist(),
        "moved_m": float(np.hypot(*(junction.position - candidate.position))) * metre,
        "residual_m": junction.residual * metre if math.isfinite(junction.residual) else None,
        "score": float(found.score[i]),
    }


def _ground_truth(explained: ExplainedKeyframe, truth: GroundTruth) -> dict[str, Any]:
    nodes = [
        {"osm_id": osm_id, **_place(explained, around)}
        for osm_id, around in zip(truth.osm_id.tolist(), truth.nodes, strict=True)
    ]
    return {"policy": truth.policy, "nodes": nodes}


def _place(explained: ExplainedKeyframe, around: FloatArray) -> dict[str, float]:
    """Return a point given from the vehicle along the axes of W, in L and in W."""
    x, y = rotate_2d(around, -explained.yaw_rad).tolist()
    world_x, world_y = (explained.vehicle + around).tolist()
    return {"x_m": x, "y_m": y, "world_x_m": world_x, "world_y_m": world_y}
