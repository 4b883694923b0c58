"""The steps of one keyframe as pictures to be laid on a map, in the colours of the panels.

Drawn by OpenCV: somebody waits for them, and matplotlib takes about twenty times as long (1.1 instead of 0.06 s).
"""

from __future__ import annotations

import io
from typing import Any, Literal, get_args

import cv2
import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array
from interloc.config import HarrisCandidates
from interloc.drawing import BLUE, GREEN, INK, MUTED, PAPER, PURPLE, SKY, VERMILION, YELLOW
from interloc.drive import Georeference
from interloc.explain.evidence import Evidence
from interloc.explain.steps import (
    BRANCH_COLOURS,
    CLOSED,
    ROAD,
    branch_lines,
    extent,
    is_set,
    segments,
    vehicle_outline,
)
from interloc.explain.record import record
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
    Longitudes and latitudes come from the keyframe's own fix (paper, eq. 12), as those of its detections do.
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


Marker = Literal["disc", "cross", "square", "star"]

_SHARP_PX = 1500  # lines and marks are drawn on about so many pixels per side
_SHIFT = 4  # OpenCV's fixed point: sixteenths of a pixel
_ANGLES = np.arange(10) * np.pi / 5
_STAR = np.stack([np.sin(_ANGLES), np.cos(_ANGLES)], axis=-1) * np.array([1.0, 0.42] * 5)[:, None]


class Canvas:
    """A square picture; its edges are those of the region of interest, its rows go down against +y of W.

    Parameters
    ----------
    evidence
    sharp
        Several pixels per cell, for lines and marks; else one.
    background
        A colour; transparent by default.
    """

    def __init__(self, evidence: Evidence, *, sharp: bool = True, background: str | None = None) -> None:
        size = evidence.roi.size
        self._cell_px = max(1, round(_SHARP_PX / size)) if sharp else 1
        self._left_m, _, _, self._top_m = extent(evidence)
        self._px_per_m = self._cell_px / evidence.roi.resolution_m
        self.pixels = np.zeros((size * self._cell_px, size * self._cell_px), np.uint8)
        """Numbers of colours; 0 is the background."""
        self._is_opaque = background is not None
        self._colours = [background or "#ffffff"]

    def fill(self, mask: BoolArray, colour: str) -> None:
        """Paint the cells of a (H, W) mask."""
        enlarged = mask.repeat(self._cell_px, axis=0).repeat(self._cell_px, axis=1) if self._cell_px > 1 else mask
        self.pixels[enlarged] = self._number(colour)

    def lines(self, ends: FloatArray, colour: str, width_m: float) -> None:
        """Draw (N, 2, 2) straight pieces."""
        width = max(1, round(width_m * self._px_per_m))
        for start, stop in self._place(ends):
            cv2.line(self.pixels, _point(start), _point(stop), self._number(colour), width, cv2.LINE_8, _SHIFT)

    def circle(self, centre: FloatArray, radius_m: float, colour: str, width_m: float) -> None:
        """Draw a circle."""
        radius = round(radius_m * self._px_per_m * 2**_SHIFT)
        width = max(1, round(width_m * self._px_per_m))
        cv2.circle(self.pixels, _point(self._place(centre)), radius, self._number(colour), width, cv2.LINE_8, _SHIFT)

    def mark(self, marker: Marker, places: FloatArray, colour: str, radius_m: float, *, edge: str) -> None:
        """Draw a mark at each of (N, 2) places, with an edge that sets it off."""
        for place in places.reshape(-1, 2):
            for extra_m, each in ((0.25, edge), (0.0, colour)):
                self._draw(marker, place, radius_m + extra_m, each)

    def polygon(self, outline: FloatArray, colour: str) -> None:
        """Fill a (N, 2) outline."""
        cv2.fillPoly(self.pixels, [self._place(outline)], self._number(colour), cv2.LINE_8, _SHIFT)

    def png(self) -> bytes:
        """Return the picture as a PNG file with a palette, much smaller and sooner packed than true colours."""
        from PIL import Image  # noqa: PLC0415 - slow to import

        picture = Image.fromarray(self.pixels)
        picture.putpalette([int(colour[i : i + 2], 16) for colour in self._colours for i in (1, 3, 5)])
        file = io.BytesIO()
        transparency = {} if self._is_opaque else {"transparency": 0}
        picture.save(file, "PNG", bits=4 if len(self._colours) <= 16 else 8, **transparency)
        return file.getvalue()

    def _number(self, colour: str) -> int:
        if colour not in self._colours[1:]:
            self._colours.append(colour)
        return self._colours.index(colour, 1)

    def _draw(self, marker: Marker, place: FloatArray, radius_m: float, colour: str) -> None:
        if marker == "disc":
            cv2.circle(
                self.pixels,
                _point(self._place(place)),
                round(radius_m * self._px_per_m * 2**_SHIFT),
                self._number(colour),
                cv2.FILLED,
                cv2.LINE_8,
                _SHIFT,
            )
        elif marker == "cross":
            arms = np.array([[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]]) * radius_m * 0.8
            self.lines(place + arms, colour, radius_m * 0.7)
        elif marker == "square":
            self.polygon(place + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * radius_m * 0.85, colour)
        else:
            self.polygon(place + _STAR * radius_m, colour)

    def _place(self, xy: FloatArray) -> Int32Array:
        """Return the fixed point column, row of points around the vehicle; whole numbers are middles of pixels."""
        column = (xy[..., 0] - self._left_m) * self._px_per_m - 0.5
        row = (self._top_m - xy[..., 1]) * self._px_per_m - 0.5
        place: Int32Array = np.round(np.stack([column, row], axis=-1) * 2**_SHIFT).astype(np.int32)
        return place


def _point(place: Int32Array) -> tuple[int, int]:
    return int(place[0]), int(place[1])
