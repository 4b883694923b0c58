"""Answers as JSON: the same on the command line, from the service and in ROS."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import bearing_deg, lonlat_from_enu, rotate_2d, yaw_of
from interloc.live.growing_map import MapIntersection
from interloc.live.scan import LiveScan
from interloc.live.session import Answer
from interloc.results import DetectionTable, KeyframeTable

_ROAD_M = 30.0


def answer_document(answer: Answer, scan: LiveScan | None = None, *, dropped: int = 0) -> dict[str, Any]:
    """Return what is said to a scan (docs/live.md), with the place of the vehicle where the scan is given."""
    keyframe = None
    if answer.keyframes is not None and answer.detections is not None:
        keyframe = _keyframe_document(answer.keyframes, answer.detections)
    return {
        "type": "scan",
        "frame": answer.frame,
        "is_keyframe": answer.is_keyframe,
        "vehicle": None if scan is None else vehicle_document(scan),
        "keyframe": keyframe,
        "events": [{"kind": each.kind, **intersection_document(each.intersection)} for each in answer.events],
        "road": _road_document(answer),
        "processing_time_ms": round(1000.0 * answer.seconds, 3),
        "dropped": dropped,
    }


def vehicle_document(scan: LiveScan) -> dict[str, Any]:
    """Return where the vehicle is; its heading clockwise from north, or from +y of W without a fix."""
    place = _place(scan.T_world_lidar[:2, 3], None)
    R = scan.T_world_lidar[:3, :3]
    if scan.fix is not None:
        place |= {"lon_deg": scan.fix.lon_deg, "lat_deg": scan.fix.lat_deg}
        R = scan.fix.R_enu_lidar
    return place | {"heading_deg": float(bearing_deg(yaw_of(R)))}


def intersection_document(intersection: MapIntersection) -> dict[str, Any]:
    """Return an intersection of the growing map, named as in intersections.geojson."""
    return {
        "id": intersection.id,
        **_place(intersection.world_xy, intersection.lonlat),
        "position_std_m": intersection.position_std_m,
        "position_cov_m2": intersection.position_cov_m2.tolist(),
        "confidence": intersection.confidence,
        "confirmed": intersection.is_confirmed,
        "observations": intersection.observations,
        **_branches(intersection.bearings_deg, intersection.widths_m),
    }


def _keyframe_document(keyframes: KeyframeTable, detections: DetectionTable) -> dict[str, Any]:
    time_s = float(keyframes.time_s[0])
    yaw = keyframes.world_yaw_rad if keyframes.enu_yaw_rad is None else keyframes.enu_yaw_rad
    return {
        "frame": int(keyframes.frame[0]),
        "time_s": None if math.isnan(time_s) else time_s,
        **_place(keyframes.world_xy[0], None if keyframes.lonlat is None else keyframes.lonlat[0]),
        "heading_deg": float(bearing_deg(yaw[0])),
        "detections": [
            {
                "x_m": float(detections.lidar_xy[row, 0]),
                "y_m": float(detections.lidar_xy[row, 1]),
                **_place(detections.world_xy[row], None if detections.lonlat is None else detections.lonlat[row]),
                "score": float(detections.score[row]),
                **_branches(detections.bearings_deg[row], detections.widths_m[row]),
            }
            for row in range(len(detections))
        ],
    }


def _road_document(answer: Answer) -> list[list[list[list[float]]]] | None:
    """Return polygons of the road within some metres of the keyframe: rings of places, the outer one first."""
    patch, keyframes = answer.road, answer.keyframes
    if patch is None or keyframes is None:
        return None
    import shapely  # noqa: PLC0415 - slow to import

    from interloc.roadmap.surface import outlines  # noqa: PLC0415 - likewise

    here = keyframes.world_xy[0]
    around = shapely.Point(here).buffer(_ROAD_M)
    polygons = outlines(patch.cells(), patch.corner_xy, patch.resolution_m, around)
    return [
        [_ring(np.asarray(ring.coords), keyframes).tolist() for ring in (each.exterior, *each.interiors)]
        for each in map(shapely.orient_polygons, polygons)  # holes go the other way round
    ]


def _ring(world_xy: FloatArray, keyframes: KeyframeTable) -> FloatArray:
    """Return places of W as longitude and latitude, by the fix of a keyframe; in W where there is none."""
    if keyframes.lonlat is None or keyframes.enu_yaw_rad is None:
        return np.round(world_xy, 2)
    turn = keyframes.enu_yaw_rad[0] - keyframes.world_yaw_rad[0]
    lon, lat = keyframes.lonlat[0]
    return np.round(lonlat_from_enu(lat, lon, rotate_2d(world_xy - keyframes.world_xy[0], turn)), 7)


def _place(world_xy: FloatArray, lonlat: FloatArray | None) -> dict[str, Any]:
    place = {"world_x_m": float(world_xy[0]), "world_y_m": float(world_xy[1])}
    return place if lonlat is None else place | {"lon_deg": float(lonlat[0]), "lat_deg": float(lonlat[1])}


def _branches(bearings_deg: FloatArray, widths_m: FloatArray) -> dict[str, Any]:
    return {
        "branch_count": len(bearings_deg),
        "branch_bearings_deg": bearings_deg.tolist(),
        "branch_widths_m": [None if math.isnan(width) else width for width in widths_m.tolist()],
    }
