"""Extraction of the road centerline (paper, section III-B.5)."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, StructuredArray
from interloc.config import CenterlineConfig
from interloc.detection.image import BinaryImage
from interloc.kernels import skeleton

BORDER_PX = 12  # a line that ends this near to the border of the window was cut by it

PIXEL = np.dtype(
    [
        ("row", np.int32),
        ("col", np.int32),
        ("border_distance", np.int32),  # pixels between it and the border of the image
        ("is_tip", np.bool_),  # the centerline ends there, and not because the border cuts it
    ],
    align=True,
)
"""A pixel of the centerline."""


@dataclass(frozen=True)
class Centerline:
    """The one pixel wide axis of the road, as an image and as a graph of its pixels."""

    image: BinaryImage
    """The axis, packed."""
    rows: Int32Array
    cols: Int32Array
    """(P,) int32: its pixels in row-major order."""
    neighbours: Int32Array
    """(P, 4) int32: the pixels that each one is joined to, as positions in ``rows``; -1 for none."""
    occupancy: BinaryImage
    """The road that it is the axis of; gives the local width."""
    spurs: Int32Array = field(default_factory=lambda: np.empty((0, 2), np.int32))
    """(S, 2) int32: row and column of the pixels of dead ends that were removed."""

    @classmethod
    def of(cls, image: BinaryImage, occupancy: BinaryImage) -> "Centerline":
        """Build the graph of a thinned image."""
        rows, cols = image.pixels()
        neighbours = skeleton.neighbours_of(image.words, rows, cols)
        return cls(image, rows, cols, neighbours, occupancy)

    @property
    def max_half_width(self) -> int:
        """Pixels; half of the widest road that is measured, a quarter of the image's side."""
        return self.image.height // 4

    @property
    def resolution_m(self) -> float:
        """Side of a pixel, metres."""
        return self.image.resolution_m

    @cached_property
    def degrees(self) -> Int32Array:
        """(P,) int32: 1 at a tip, 2 on a line, 3 or 4 at a junction."""
        return skeleton.degrees_of(self.neighbours)

    @cached_property
    def pixels(self) -> StructuredArray:
        """(P,) PIXEL: what is known of each pixel."""
        pixels = np.zeros(len(self.rows), PIXEL)  # the gaps between its fields too: equal lines are equal bytes
        pixels["row"], pixels["col"] = self.rows, self.cols
        last = self.image.height - 1
        inward = np.minimum(np.minimum(self.rows, self.cols), last - np.maximum(self.rows, self.cols))
        pixels["border_distance"] = inward
        pixels["is_tip"] = (self.degrees <= 1) & (inward >= BORDER_PX)
        return pixels

    def widths(self, pixels: Int32Array) -> FloatArray:
        """Return the local road width in pixels, (N,) float64, at some pixels given by their positions."""
        return skeleton.widths_at(
            self.occupancy.words, self.rows[pixels], self.cols[pixels], self.occupancy.height, self.max_half_width
        )


class Piece(NamedTuple):
    """A connected piece of centerline that starts at the inner circle of a candidate."""

    pixels: Int32Array
    """(P,) int32: positions among the pixels of the centerline."""
    reach: float
    """Greatest distance from the candidate, pixels."""
    at_candidate: bool
    """It ends before another candidate."""
    is_branch: bool
    """It counts as a branch; otherwise it is too short."""


@dataclass(frozen=True)
class Pieces:
    """All pieces around one candidate; those that are branches are in the order of its `Branches`."""

    inner: float
    """Radius of the circle that they start at, pixels."""
    traced: Int32Array
    is_main: BoolArray
    table: StructuredArray
    """See `interloc.kernels.skeleton.trace_branches`."""
    is_branch: BoolArray
    """(P,) bool."""

    def __iter__(self) -> Iterator[Piece]:
        for row, is_branch in zip(self.table, self.is_branch.tolist(), strict=True):
            pixels = self.traced[row["begin"] : row["end"]]
            yield Piece(pixels, float(row["reach"]), bool(row["at_candidate"]), is_branch)


def extract_centerline(occupancy: BinaryImage, config: CenterlineConfig) -> Centerline:
    """Thin the road to its axis by Zhang and Suen's algorithm (paper, eq. 5); then drop dead ends that are no roads."""
    image = replace(occupancy, words=occupancy.words.copy())
    skeleton.thin(image.words)
    centerline = Centerline.of(image, occupancy)
    if config.spur_widths > 0:
        centerline = _without_spurs(centerline, config.spur_widths)
    return centerline


def _without_spurs(centerline: Centerline, widths: float) -> Centerline:
    keep = skeleton.prune_spurs(
        centerline.rows,
        centerline.cols,
        centerline.neighbours,
        centerline.occupancy.words,
        centerline.image.height,
        widths,
        centerline.max_half_width,
        BORDER_PX,
    )
    if keep.all():
        return centerline
    spurs = np.column_stack([centerline.rows[~keep], centerline.cols[~keep]])
    skeleton.clear_pixels(centerline.image.words, centerline.rows[~keep], centerline.cols[~keep])
    return replace(Centerline.of(centerline.image, centerline.occupancy), spurs=spurs)
