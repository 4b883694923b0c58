"""The canvas of all pictures of a keyframe: a square of W, and beside it the key and the notes to write.

Drawn by OpenCV: somebody waits for the pictures of the service, and matplotlib takes about twenty times as long.
"""

import io
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from PIL import Image

from interloc.arrays import BoolArray, FloatArray, Int32Array, JsonObject, UInt8Array
from interloc.explain.evidence import ExplainedKeyframe

Marker = Literal["disc", "cross", "square", "star"]
Dashes = tuple[float, float]

PX_PER_M = 6.25
"""Of the sheets, where they show the whole region; the sizes of lines and marks are in these metres."""

_SHIFT = 4  # OpenCV's fixed point: sixteenths of a pixel
_ANGLES = np.arange(10) * np.pi / 5
_STAR = np.stack([np.sin(_ANGLES), np.cos(_ANGLES)], axis=-1) * np.array([1.0, 0.42] * 5)[:, None]
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_RING = np.linspace(0.0, 2.0 * np.pi, 601)
_SIGNS = {"disc": "o", "cross": "X", "square": "s", "star": "*"}  # of matplotlib
_PT_PER_M = PX_PER_M * 72.0 / 100.0  # at 100 dots per inch


class Square(NamedTuple):
    """A square along the axes of W: its middle and half of its side, metres from the vehicle."""

    x: float
    y: float
    half_m: float

    @classmethod
    def of_region(cls, explained: ExplainedKeyframe) -> "Square":
        """Return the region of interest, turned back where its image is turned: its corners are cut off then."""
        x, y = (explained.roi.centre_xy - explained.vehicle).tolist()
        return cls(x, y, explained.roi.size * explained.roi.resolution_m / 2)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top."""
        return self.x - self.half_m, self.x + self.half_m, self.y - self.half_m, self.y + self.half_m


class Canvas:
    """A square picture of a keyframe; its rows go down against +y of W.

    Places are given from the vehicle along the axes of W. It shows the region of interest; sizes of lines and marks are
    scaled by `px_per_m`, by default that of the picture. `key` says by name how matplotlib draws a sign in a legend;
    `notes` are texts beside (2,) places.
    """

    def __init__(
        self,
        explained: ExplainedKeyframe,
        size_px: int,
        *,
        px_per_m: float | None = None,
        background: str | None = None,
    ) -> None:
        self.square = Square.of_region(explained)
        self.key: dict[str, JsonObject] = {}
        self.notes: list[tuple[FloatArray, str]] = []
        self._scale = size_px / (2.0 * self.square.half_m)
        self._px_per_m = px_per_m or self._scale
        self._pixels = np.zeros((size_px, size_px), np.uint8)  # numbers of colours; 0 is the background
        self._is_opaque = background is not None
        self._colours = [background or "#ffffff"]

        left, _, _, top = self.square.extent
        roi, along = explained.roi, (np.arange(size_px) + 0.5) / self._scale
        x, y = np.meshgrid(left + along, top - along)
        # A margin around the image stands for all that is beyond.
        cells = np.clip(np.floor(roi.image(np.stack([x, y], axis=-1) + explained.vehicle) + 0.5), -1, roi.size) + 1
        self._cells = (cells @ [roi.size + 2, 1]).astype(np.intp)  # of the image with its margin, for each pixel

    def paint(self, numbers: UInt8Array, colours: Sequence[str]) -> None:
        """Paint the cells of a (H, W) image of the region that are not 0 in the colour of that number, from 1 on."""
        chosen = np.array([0, *map(self._number, colours)], np.uint8)
        shown = np.pad(chosen[numbers], 1).take(self._cells)
        np.copyto(self._pixels, shown, where=shown > 0)

    def fill(self, mask: BoolArray, colour: str, label: str = "") -> None:
        """Paint the cells of a (H, W) mask."""
        self.paint(mask.view(np.uint8), [colour])
        self.swatch(colour, label)

    def dots(self, xy: FloatArray, colour: str, width_m: float, label: str = "") -> None:
        """Draw (N, 2) points as small squares; many at once."""
        places = np.round(self._place(xy)).astype(np.int64)
        cols, rows = places[((places >= 0) & (places < len(self._pixels))).all(axis=1)].T
        width = self._width(width_m)
        mask = np.zeros_like(self._pixels)
        mask[rows, cols] = 1
        self._pixels[cv2.dilate(mask, np.ones((width, width), np.uint8)) > 0] = self._number(colour)
        self.swatch(colour, label)

    def lines(
        self, ends: FloatArray, colour: str, width_m: float, label: str = "", *, dashes: Dashes | None = None
    ) -> None:
        """Draw (N, 2, 2) straight pieces; `dashes`: lengths drawn and left out, metres."""
        places = self._place(ends)
        if dashes is not None:
            places = _dashed(places, *(each * self._px_per_m for each in dashes))
        self._draw_pieces(places, colour, width_m)
        style = "-" if dashes is None else (0, tuple(each / width_m for each in dashes))
        self._explain(label, color=colour, linewidth=max(width_m * _PT_PER_M, 1.2), linestyle=style)

    def circle(
        self, centre: FloatArray, radius_m: float, colour: str, width_m: float, label: str = "", *, dotted: bool = False
    ) -> None:
        """Draw a circle; its radius is one of the ground."""
        ring = self._place(centre + radius_m * np.stack([np.cos(_RING), np.sin(_RING)], axis=-1))
        pieces = np.stack([ring[:-1], ring[1:]], axis=1)
        self._draw_pieces(pieces[:: 2 if dotted else 1], colour, width_m)
        self._explain(label, color=colour, linewidth=1.2, linestyle=":" if dotted else "-")

    def disc(self, centre: FloatArray, radius_m: float, colour: str, *, edge: str) -> None:
        """Fill a circle whose radius is one of the ground."""
        for extra_px, each in ((0.12 * self._px_per_m, edge), (0.0, colour)):
            self._fill_disc(self._place(centre), radius_m * self._scale + extra_px, each)

    def mark(
        self, marker: Marker, places: FloatArray, colour: str, radius_m: float, label: str = "", *, edge: str
    ) -> None:
        """Draw a mark at each of (N, 2) places, with an edge that sets it off."""
        for place in self._place(places.reshape(-1, 2)):
            for extra_m, each in ((0.25, edge), (0.0, colour)):
                self._draw_mark(marker, place, (radius_m + extra_m) * self._px_per_m, each)
        sign = _SIGNS[marker]
        size = 2.0 * radius_m * _PT_PER_M
        self._explain(label, linestyle="none", marker=sign, markersize=size, color=colour, markeredgecolor=edge)

    def box(self, places: FloatArray, colour: str, radius_m: float, width_m: float, label: str = "") -> None:
        """Draw the outline of a square at each of (N, 2) places."""
        for place in self._place(places.reshape(-1, 2)):
            self._outline(place + _SQUARE * radius_m * self._px_per_m, colour, width_m)
        style = {"fillstyle": "none", "markeredgewidth": width_m * _PT_PER_M}
        self._explain(label, linestyle="none", marker="s", markersize=2.0 * radius_m * _PT_PER_M, color=colour, **style)

    def polygon(self, outline: FloatArray, colour: str, edge: str, width_m: float) -> None:
        """Fill a (N, 2) outline and draw its edge."""
        cv2.fillPoly(self._pixels, [_fixed(self._place(outline))], self._number(colour), cv2.LINE_8, _SHIFT)
        self._outline(self._place(outline), edge, width_m)

    def swatch(self, colour: str, label: str, marker: str = "s", **style: str) -> None:
        """Add a colour to the key."""
        self._explain(label, linestyle="none", marker=marker, markersize=9, color=colour, **style)

    def png(self) -> bytes:
        """Return the picture as a PNG file with a palette, much smaller and sooner packed than true colours."""
        picture = Image.fromarray(self._pixels)
        picture.putpalette(self._palette().ravel().tolist())
        file = io.BytesIO()
        transparency = {} if self._is_opaque else {"transparency": 0}
        picture.save(file, "PNG", bits=4 if len(self._colours) <= 16 else 8, **transparency)
        return file.getvalue()

    def smooth(self, size_px: int) -> UInt8Array:
        """Return the picture in a smaller size, (size_px, size_px, 3) uint8: red, green, blue."""
        full = self._palette()[self._pixels]
        return cv2.resize(full, (size_px, size_px), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)

    def _palette(self) -> UInt8Array:
        return np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in self._colours], np.uint8)

    def _number(self, colour: str) -> int:
        if colour not in self._colours[1:]:
            self._colours.append(colour)
        return self._colours.index(colour, 1)

    def _explain(self, label: str, **style: Any) -> None:  # noqa: ANN401 - matplotlib's
        if label:
            self.key.setdefault(label, style)

    def _width(self, width_m: float) -> int:
        return max(1, round(width_m * self._px_per_m))

    def _draw_pieces(self, pieces: FloatArray, colour: str, width_m: float) -> None:
        number, width = self._number(colour), self._width(width_m)
        for start, stop in _fixed(pieces).tolist():
            cv2.line(self._pixels, start, stop, number, width, cv2.LINE_8, _SHIFT)

    def _outline(self, places: FloatArray, colour: str, width_m: float) -> None:
        self._draw_pieces(np.stack([places, np.roll(places, -1, axis=0)], axis=1), colour, width_m)

    def _fill_disc(self, place: FloatArray, radius_px: float, colour: str) -> None:
        radius = round(radius_px * 2**_SHIFT)
        cv2.circle(self._pixels, _fixed(place).tolist(), radius, self._number(colour), cv2.FILLED, cv2.LINE_8, _SHIFT)

    def _draw_mark(self, marker: Marker, place: FloatArray, radius_px: float, colour: str) -> None:
        if marker == "disc":
            self._fill_disc(place, radius_px, colour)
        elif marker == "cross":
            arms = np.array([[[-1, -1], [1, 1]], [[-1, 1], [1, -1]]]) * radius_px * 0.8
            self._draw_pieces(place + arms, colour, radius_px * 0.7 / self._px_per_m)
        else:
            shape = _SQUARE * 0.85 if marker == "square" else -_STAR
            places = _fixed(place + shape * radius_px)
            cv2.fillPoly(self._pixels, [places], self._number(colour), cv2.LINE_8, _SHIFT)

    def _place(self, xy: FloatArray) -> FloatArray:
        """Return column, row of places; whole numbers are middles of pixels."""
        left, _, _, top = self.square.extent
        return (xy - (left, top)) * (self._scale, -self._scale) - 0.5


def _fixed(places: FloatArray) -> Int32Array:
    """Return places in OpenCV's fixed point; what lies far off the picture stays within its numbers."""
    fixed: Int32Array = np.round(np.clip(places, -(2**15), 2**15) * 2**_SHIFT).astype(np.int32)
    return fixed


def _dashed(pieces: FloatArray, drawn: float, left_out: float) -> FloatArray:
    found = [np.empty((0, 2, 2))]
    for start, stop in pieces:
        length = max(float(np.hypot(*(stop - start))), 1e-9)
        begin = np.arange(0.0, length, drawn + left_out)
        along = np.stack([begin, np.minimum(begin + drawn, length)], axis=1) / length
        found.append(start + along[..., None] * (stop - start))
    return np.concatenate(found)
