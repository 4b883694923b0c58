"""The steps of one keyframe as pictures to be laid on a map, in the colours of the step pictures."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import HarrisCandidates
from interloc.drawing import BLUE, GREEN, INK, MUTED, PAPER, PURPLE, SKY, VERMILION, YELLOW
from interloc.drive import Georeference
from interloc.explain.canvas import Canvas
from interloc.explain.evidence import Evidence
from interloc.explain.panels import CLOSED, ROAD, segments
from interloc.explain.record import record
from interloc.explain.refinement_panel import BRANCH_COLOURS, branch_lines
from interloc.explain.sheet import extent, is_set, vehicle_outline
from interloc.geometry import lonlat_from_enu, rotate_2d, yaw_of
from interloc.output.geojson import positions

OverlayLayer = Literal["bev", "occupancy", "centerline", "candidates", "branches", "all"]
OVERLAYS: tuple[OverlayLayer, ...] = get_args(OverlayLayer)


def draw_overlay(evidence: Evidence, layer: OverlayLayer) -> bytes:
    """Draw one step over the region of interest.

    Parameters
    ----------
    evidence
        Of the keyframe.
    layer
        bev: the binary image. occupancy: road, and what closing added and opening took away. centerline, candidates,
        branches: lines and marks. All of these are transparent where there is nothing; "all", the steps in one
        picture, is opaque.

    Returns
    -------
    bytes
        A square PNG of the region of interest, +x of W to the right, +y up.
    """
    canvas = Canvas(evidence, sharp=layer not in {"bev", "occupancy"}, background=PAPER if layer == "all" else None)
    _DRAW[layer](canvas, evidence)
    return canvas.png()


def describe_overlays(evidence: Evidence, drive_name: str, georeference: Georeference | None) -> dict[str, Any]:
    """Return where the pictures lie and the numbers behind them, as values that JSON can say.

    Notes
    -----
    Longitudes and latitudes come from the keyframe's own fix (paper, eq. 13), as those of its detections do.
    """
    left, right, bottom, top = extent(evidence)
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    config = evidence.config
    numbers = record(evidence, drive_name, None)
    for table in ("candidates", "detections"):
        for row in numbers[table]:
            around = np.array([row["world_x_m"], row["world_y_m"]]) - evidence.vehicle
            row["lonlat"] = None if georeference is None else lonlat_of(evidence, georeference, around[None])[0]
    return {
        "frame": evidence.keyframe.frame,
        "time_s": evidence.keyframe.time_s,
        "size_px": evidence.roi.size,
        "resolution_m": evidence.roi.resolution_m,
        "corners_lonlat": None if georeference is None else lonlat_of(evidence, georeference, corners),
        "corners_world_m": positions(corners + evidence.vehicle, local=True),
        "layers": list(OVERLAYS),
        "outer_radius_m": config.branches.outer_radius_m,
        "relevant_zone_m": max(0.0, config.bev.size_m - 2 * config.branches.outer_radius_m),
        "min_points": evidence.steps.min_points,
        **{key: numbers[key] for key in ("keyframe", "keyframes_in_drive", "pose", "window", "points", "cells")},
        "candidates": numbers["candidates"],
        "detections": numbers["detections"],
    }


def lonlat_of(evidence: Evidence, georeference: Georeference, around: FloatArray) -> list[list[float]]:
    """Return longitude, latitude of (N, 2) points given from the vehicle along the axes of W."""
    fix = evidence.index
    turn = float(yaw_of(georeference.R_enu_lidar[fix])) - evidence.yaw_rad
    enu = rotate_2d(around, turn)
    return positions(lonlat_from_enu(georeference.lat_deg[fix], georeference.lon_deg[fix], enu), local=False)


def _bev(canvas: Canvas, evidence: Evidence) -> None:
    canvas.fill(is_set(evidence.steps.bev), INK)


def _occupancy(canvas: Canvas, evidence: Evidence) -> None:
    cells, road = is_set(evidence.steps.bev), is_set(evidence.steps.occupancy)
    for mask, colour in ((road, CLOSED), (road & cells, BLUE), (cells & ~road, VERMILION)):
        canvas.fill(mask, colour)


def _centerline(canvas: Canvas, evidence: Evidence) -> None:
    steps = evidence.steps
    if evidence.config.centerline.spur_widths > 0:
        gone = evidence.around(*steps.centerline.spurs.T.astype(np.float64))
        canvas.lines(np.stack([gone, gone], axis=1), VERMILION, 0.35)
    canvas.lines(_whole_line(evidence), INK, 0.35)


def _candidates(canvas: Canvas, evidence: Evidence) -> None:
    harris = isinstance(evidence.config.candidates, HarrisCandidates)
    for verdict in evidence.verdicts:
        place = evidence.around(verdict.position[0], verdict.position[1])
        merged = evidence.around(verdict.merged[:, 0], verdict.merged[:, 1])
        if len(merged) > 1:
            canvas.lines(np.stack([merged, np.broadcast_to(place, merged.shape)], axis=1), INK, 0.2)
        canvas.mark("disc" if harris else "square", merged, GREEN if harris else YELLOW, 0.5, edge=INK)
    for kept in (True, False):
        places = [evidence.around(v.position[0], v.position[1]) for v in evidence.verdicts if v.is_kept == kept]
        canvas.mark("disc" if kept else "cross", np.array(places), BLUE if kept else VERMILION, 1.5, edge=PAPER)


def _branches(canvas: Canvas, evidence: Evidence) -> None:
    inside = np.zeros(len(evidence.steps.centerline.rows), np.bool_)
    for verdict in evidence.verdicts:
        if not verdict.is_kept:
            continue
        here = evidence.around(verdict.position[0], verdict.position[1])
        canvas.circle(here, verdict.branches.inner * evidence.roi.resolution_m, MUTED, 0.2)
        for number, piece in enumerate(piece for piece in verdict.pieces if piece.is_branch):
            inside[:] = False
            inside[piece.pixels] = True
            canvas.lines(segments(evidence, inside), BRANCH_COLOURS[number % len(BRANCH_COLOURS)], 0.65)
        lines = branch_lines(evidence, verdict)
        canvas.lines(np.array(lines).reshape(-1, 2, 2), INK, 0.2)
        canvas.mark("disc", here, SKY, 0.7, edge=INK)
        refined = np.array([evidence.steps.junctions[i].position for i in verdict.detections])
        canvas.mark("star", evidence.around(refined[:, 0], refined[:, 1]), PURPLE, 2.0, edge=INK)


def _all(canvas: Canvas, evidence: Evidence) -> None:
    canvas.fill(is_set(evidence.steps.occupancy), ROAD)
    canvas.fill(is_set(evidence.steps.bev) & is_set(evidence.steps.occupancy), CLOSED)
    canvas.lines(_whole_line(evidence), MUTED, 0.25)
    _branches(canvas, evidence)
    rejected = [evidence.around(v.position[0], v.position[1]) for v in evidence.verdicts if not v.is_kept]
    canvas.mark("cross", np.array(rejected), VERMILION, 1.5, edge=PAPER)
    canvas.polygon(vehicle_outline(evidence), VERMILION)


def _whole_line(evidence: Evidence) -> FloatArray:
    return segments(evidence, np.ones(len(evidence.steps.centerline.rows), np.bool_))


_DRAW = {
    "bev": _bev,
    "occupancy": _occupancy,
    "centerline": _centerline,
    "candidates": _candidates,
    "branches": _branches,
    "all": _all,
}
