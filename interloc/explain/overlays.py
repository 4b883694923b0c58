"""The steps of one keyframe as pictures to be laid on a map."""

from typing import Any, Literal, get_args

import numpy as np

from interloc.arrays import FloatArray
from interloc.drawing import PAPER
from interloc.drive import Georeference
from interloc.explain import steps
from interloc.explain.canvas import Canvas, Square
from interloc.explain.evidence import ExplainedKeyframe, record
from interloc.geometry import lonlat_from_enu, rotate_2d, yaw_of
from interloc.output.geojson import positions

OverlayLayer = Literal["bev", "occupancy", "centerline", "candidates", "branches", "all"]
OVERLAYS: tuple[OverlayLayer, ...] = get_args(OverlayLayer)

_SHARP_PX = 1500  # lines and marks are drawn on about so many pixels per side

_PARTS: dict[OverlayLayer, tuple[steps.Draw, ...]] = {
    "bev": (steps.bev,),
    "occupancy": (steps.occupancy,),
    "centerline": (steps.centerline,),
    "candidates": (steps.candidates,),
    "branches": (steps.branches, steps.refined_points),
    "all": (
        *(steps.road_cells, steps.faint_centerline, steps.branches),
        *(steps.refined_points, steps.rejected_candidates, steps.vehicle),
    ),
}


def draw_overlay(explained: ExplainedKeyframe, layer: OverlayLayer) -> bytes:
    """Draw one step as a square PNG of the region of interest, +x of W to the right, +y up.

    bev: the binary image. occupancy: road, and what closing added and opening took away. centerline, candidates,
    branches: lines and marks. All of these are transparent where there is nothing; "all", the steps in one picture, is
    opaque.
    """
    size = explained.roi.size
    cell_px = 1 if layer in {"bev", "occupancy"} else max(1, round(_SHARP_PX / size))
    canvas = Canvas(explained, size * cell_px, background=PAPER if layer == "all" else None)
    for draw in _PARTS[layer]:
        draw(canvas, explained)
    return canvas.png()


def describe_overlays(
    explained: ExplainedKeyframe, drive_name: str, georeference: Georeference | None
) -> dict[str, Any]:
    """Return where the pictures lie and the numbers behind them, as values that JSON can say.

    Longitudes and latitudes come from the keyframe's own fix (paper, eq. 12), as those of its detections do.
    """
    left, right, bottom, top = Square.of_region(explained).extent
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    config = explained.config
    numbers = record(explained, drive_name, None)
    for table in ("candidates", "detections"):
        for row in numbers[table]:
            around = np.array([row["world_x_m"], row["world_y_m"]]) - explained.vehicle
            row["lonlat"] = None if georeference is None else lonlat_of(explained, georeference, around[None])[0]
    return {
        "frame": explained.keyframe.frame,
        "time_s": explained.keyframe.time_s,
        "size_px": explained.roi.size,
        "resolution_m": explained.roi.resolution_m,
        "corners_lonlat": None if georeference is None else lonlat_of(explained, georeference, corners),
        "corners_world_m": positions(corners + explained.vehicle, local=True),
        "layers": list(OVERLAYS),
        "outer_radius_m": config.branches.outer_radius_m,
        "relevant_zone_m": max(0.0, config.bev.size_m - 2 * config.branches.outer_radius_m),
        "min_points": explained.steps.min_points,
        **{key: numbers[key] for key in ("keyframe", "keyframes_in_drive", "pose", "window", "points", "cells")},
        "candidates": numbers["candidates"],
        "detections": numbers["detections"],
    }


def lonlat_of(explained: ExplainedKeyframe, georeference: Georeference, around: FloatArray) -> list[list[float]]:
    """Return longitude, latitude of (N, 2) points given from the vehicle along the axes of W."""
    fix = explained.index
    turn = float(yaw_of(georeference.R_enu_lidar[fix])) - explained.yaw_rad
    enu = rotate_2d(around, turn)
    return positions(lonlat_from_enu(georeference.lat_deg[fix], georeference.lon_deg[fix], enu), local=False)
