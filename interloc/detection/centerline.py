"""Extraction of the road centerline (paper, section III-B.5)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array
from interloc.config import CenterlineConfig
from interloc.detection.image import BinaryImage
from interloc.kernels import skeleton
from interloc.kernels.thinning import thin

BORDER_PX = 12  # a line that ends this near to the border of the window was cut by it


@dataclass(frozen=True)
class Centerline:
    """The one pixel wide axis of the road, as an image and as a graph of its pixels.

    Attributes
    ----------
    image
        The axis, packed.
    rows, cols : (P,) int32
        Its pixels in row-major order.
    neighbours : (P, 4) int32
        The pixels that each one is joined to, as positions in ``rows``; -1 for none.
    occupancy
        The road that it is the axis of; gives the local width.
    max_width : int
        Pixels; a wider road counts as this wide.
    spurs : (S, 2) int32
        Row and column of the pixels of dead ends that were removed.
    """

    image: BinaryImage
    rows: Int32Array
    cols: Int32Array
    neighbours: Int32Array
    occupancy: BinaryImage
    max_width: int
    spurs: Int32Array = field(default_factory=lambda: np.empty((0, 2), np.int32))

    @classmethod
    def of(cls, image: BinaryImage, occupancy: BinaryImage, max_width: int | None = None) -> Centerline:
        """Build the graph of a thinned image; roads are measured up to half the image's side by default."""
        rows, cols = image.pixels()
        neighbours = skeleton.neighbours_of(image.words, rows, cols)
        return cls(image, rows, cols, neighbours, occupancy, image.height // 2 if max_width is None else max_width)

    @cached_property
    def degrees(self) -> Int32Array:
        """(P,) int32: 1 at a tip, 2 on a line, 3 or 4 at a junction."""
        return skeleton.degrees_of(self.neighbours)

    @cached_property
    def border_distance(self) -> Int32Array:
        """(P,) int32: pixels between each one and the border of the image."""
        last = self.image.height - 1
        inward: Int32Array = np.minimum(np.minimum(self.rows, self.cols), last - np.maximum(self.rows, self.cols))
        return inward

    @cached_property
    def is_tip(self) -> BoolArray:
        """(P,) bool: whether the centerline ends there, and not because the border cuts it."""
        tips: BoolArray = (self.degrees <= 1) & (self.border_distance >= BORDER_PX)
        return tips

    def widths(self, pixels: Int32Array) -> FloatArray:
        """Return the local road width in pixels, (N,) float64, at some pixels given by their positions."""
        return skeleton.widths_at(
            self.occupancy.words,
            self.rows[pixels],
            self.cols[pixels],
            self.occupancy.height,
            self.max_width // 2,
        )


def extract_centerline(occupancy: BinaryImage, config: CenterlineConfig) -> Centerline:
    """Thin the road to its axis by Zhang and Suen's algorithm; then drop dead ends that are no roads, if asked to.

    Parameters
    ----------
    occupancy
        Set where the ground is road.
    config
        Longest dead end to drop, and widest road to measure.

    Notes
    -----
    Paper, eq. 5.
    """
    image = BinaryImage(occupancy.words.copy(), occupancy.height, occupancy.width)
    thin(image.words)
    centerline = Centerline.of(image, occupancy, int(config.max_width_share * occupancy.height))
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
        centerline.max_width // 2,
        BORDER_PX,
    )
    if keep.all():
        return centerline
    spurs = np.column_stack([centerline.rows[~keep], centerline.cols[~keep]])
    skeleton.clear_pixels(centerline.image.words, centerline.rows[~keep], centerline.cols[~keep])
    return replace(Centerline.of(centerline.image, centerline.occupancy, centerline.max_width), spurs=spurs)
