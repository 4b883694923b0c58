"""A transparent picture of the region of interest, drawn in metres of W around the vehicle."""

from __future__ import annotations

import io
from typing import Literal

import cv2
import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array
from interloc.explain.evidence import Evidence
from interloc.explain.sheet import extent

Marker = Literal["disc", "cross", "square", "star"]

_SHARP_PX = 1500  # lines and marks are drawn on about so many pixels a side
_SHIFT = 4  # OpenCV's fixed point: sixteenths of a pixel
_ANGLES = np.arange(10) * np.pi / 5
_STAR = np.stack([np.sin(_ANGLES), np.cos(_ANGLES)], axis=-1) * np.array([1.0, 0.42] * 5)[:, None]


class Canvas:
    """A square picture; its edges are those of the region of interest, its rows go down against +y of W.

    Parameters
    ----------
    evidence
    sharp
        Several pixels a cell, for lines and marks; else one.
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
