"""The numbers behind the pictures, as JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.detection.image import BinaryImage
from interloc.explain.evidence import Evidence, GroundTruth, Verdict
from interloc.geometry import rotate_2d


def record(evidence: Evidence, drive_name: str, truth: GroundTruth | None) -> dict[str, Any]:
    """Collect the numbers of a keyframe: positions in L (levelled) and W in metres, angles in degrees in W."""
    steps, keyframe = evidence.steps, evidence.keyframe
    x, y = evidence.vehicle.tolist()
    return {
        "drive": drive_name,
        "frame_asked": evidence.asked,
        "frame": keyframe.frame,
        "time_s": keyframe.time_s,
        "keyframe": evidence.number,
        "keyframes_in_drive": evidence.keyframe_count,
        "pose": {"world_x_m": x, "world_y_m": y, "heading_deg": math.degrees(evidence.yaw_rad)},
        "window": {"keyframes": len(evidence.window), "frames": [scan.frame for scan in evidence.window]},
        "roi": {"cells": steps.roi.size, "resolution_m": steps.roi.resolution_m},
        "points": {
            "road": evidence.points.road_count,
            "other_ground": len(evidence.points.confusable),
            "road_in_window": sum(len(scan.cells) for scan in evidence.window),
        },
        "min_points": steps.min_points,
        "cells": {
            "bev": pixels(steps.bev),
            "occupancy": pixels(steps.occupancy),
            "centerline": len(steps.centerline.rows),
        },
        "candidates": [_candidate(evidence, verdict) for verdict in evidence.verdicts],
        "detections": [_detection(evidence, v, i) for v in evidence.verdicts for i in v.detections],
        "ground_truth": None if truth is None else _ground_truth(evidence, truth),
        "config": evidence.config.model_dump(mode="json"),
    }


def pixels(image: BinaryImage) -> int:
    """Return the number of pixels that are set."""
    return int(image.to_array().sum())


def _candidate(evidence: Evidence, verdict: Verdict) -> dict[str, Any]:
    metre = evidence.roi.resolution_m
    return {
        "number": verdict.number,
        **_place(evidence, evidence.around(verdict.position[0], verdict.position[1])),
        "road_width_m": verdict.width * metre,
        "merged_points": len(verdict.merged),
        "inner_radius_m": verdict.branches.inner * metre,
        "branches": verdict.branches.count,
        "pieces": [
            {"reach_m": piece.reach * metre, "ends_at_candidate": piece.at_candidate, "is_branch": piece.is_branch}
            for piece in verdict.pieces
        ],
        "kept": verdict.is_kept,
        "why_not": verdict.why_not,
    }


def _detection(evidence: Evidence, verdict: Verdict, i: int) -> dict[str, Any]:
    junction, found, metre = evidence.steps.junctions[i], evidence.detections, evidence.roi.resolution_m
    return {
        "candidate": verdict.number,
        **_place(evidence, found.world_xy[i] - evidence.vehicle),
        "branch_count": junction.branches.count,
        "branch_angles_deg": np.degrees(found.branch_angles_rad[i]).tolist(),
        "moved_m": float(np.hypot(*(junction.position - verdict.position))) * metre,
        "residual_m": junction.residual * metre if math.isfinite(junction.residual) else None,
        "score": float(found.score[i]),
    }


def _ground_truth(evidence: Evidence, truth: GroundTruth) -> dict[str, Any]:
    nodes = [
        {"osm_id": osm_id, **_place(evidence, around)}
        for osm_id, around in zip(truth.osm_id.tolist(), truth.nodes, strict=True)
    ]
    return {"policy": truth.policy, "nodes": nodes}


def _place(evidence: Evidence, around: FloatArray) -> dict[str, float]:
    """Return a point given from the vehicle along the axes of W, in L and in W."""
    x, y = rotate_2d(around, -evidence.yaw_rad).tolist()
    world_x, world_y = (evidence.vehicle + around).tolist()
    return {"x_m": x, "y_m": y, "world_x_m": world_x, "world_y_m": world_y}
