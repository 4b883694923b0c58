"""The road of a keyframe as an image: its occupancy (paper, section III-B.4), widths across it, and patches of it."""

import math
from dataclasses import replace

import numpy as np

from interloc.arrays import FloatArray, IntArray, StructuredArray, UInt8Array, UInt64Array
from interloc.config import OccupancyConfig
from interloc.detection.image import BinaryImage, Roi
from interloc.detection.islands import close_islands
from interloc.detection.lines import SIDE_BY_SIDE_RAD
from interloc.kernels.bits import count_pixels, median_runs_across
from interloc.kernels.morphology import dilate, disc_half_widths, erode, fill_islands
from interloc.results import RoadPatch

SEEN_GAP_M, SEEN_LEAST_M = 0.5, 0.8  # between places of other ground that are one; and less of it across is an error
MEDIAN_LEAST_M, MEDIAN_LEAST_M2 = 1.6, 110.0  # across, and in one piece: less is labels that err, or ends at a lay-by
MEDIAN_REST_M2 = 20.0  # of the other pieces, where one is as large


def infer_occupancy(bev: BinaryImage, config: OccupancyConfig, against: BinaryImage | None = None) -> BinaryImage:
    """Close the gaps between road cells, remove what is too small to be road, then fill small islands, if asked to.

    Parameters
    ----------
    bev
        Set where enough road points fell into the cell.
    config
        Disc diameters in metres, largest island in square metres.
    against
        Set where other ground was seen; None where that is not known.

    Returns
    -------
    BinaryImage
        Set where the ground is road.

    Notes
    -----
    Paper, eq. 4: closing by a disc, then opening by a disc. Islands are beyond it: the centerline runs round each, so a
    lay-by makes two intersections with a road that leads from one to the other, where no block of houses has room. And
    so are edges: labels that waver and the closing carry them beyond the kerb, on one side more than on the other, and
    the axis with them. So road is taken back to where other ground was seen, but for its middle: a cut leads nowhere.
    Other ground as large as the median of a dual carriageway is no road either, however narrow the gap that was closed;
    and where there is one, nor is what the closing joined between sparse points of it, as beyond a crossing.
    """
    words, width, resolution_m = bev.words, bev.width, bev.resolution_m

    def disc(diameter_m: float) -> IntArray:
        return disc_half_widths(odd_pixels(diameter_m, resolution_m))

    def opened(words: UInt64Array, diameter_m: float) -> UInt64Array:
        widths = disc(diameter_m)
        return dilate(erode(words, widths, width), widths, width)

    def closed(words: UInt64Array, diameter_m: float) -> UInt64Array:
        widths = disc(diameter_m)
        return erode(dilate(words, widths, width), widths, width)

    words = opened(closed(words, config.closing_m), config.opening_m)
    other = None if against is None else opened(closed(against.words, SEEN_GAP_M), SEEN_LEAST_M)
    if config.island_m2 > 0:
        close_islands(replace(bev, words=words), other, config.island_m2)
    if config.edge_m > 0 and other is not None:
        middle = erode(words, disc(2.0 * config.edge_m), width)
        if _large(middle & other, bev, MEDIAN_LEAST_M2).any():
            gaps = middle & (other | closed(other, config.closing_m) & ~bev.words)
            words &= ~_large(opened(gaps, MEDIAN_LEAST_M), bev, MEDIAN_REST_M2)
            middle = erode(words, disc(2.0 * config.edge_m), width)
        words = opened(words & ~other, config.opening_m) | middle
    return replace(bev, words=words)


def _large(words: UInt64Array, image: BinaryImage, minimum_m2: float) -> UInt64Array:
    """Return the pieces of more than an area, as far as it is seen within the image."""
    if count_pixels(words) * image.resolution_m**2 <= minimum_m2:
        return np.zeros_like(words)
    rest, last = ~words, image.width - 1
    rest[[1, -2]] = ~np.uint64(0)  # nothing lies beyond the border
    rest[:, 0] |= np.uint64(1)
    rest[:, last >> 6] |= np.uint64(1) << np.uint64(last & 63)
    fill_islands(rest, image.height, image.width, minimum_m2 / image.resolution_m**2, False)
    return ~rest


def odd_pixels(length_m: float, resolution_m: float) -> int:
    """Return the odd number of pixels nearest to a length; never less than 1 (no effect)."""
    return 2 * round((length_m / resolution_m - 1) / 2) + 1 if length_m > resolution_m else 1


# Widths across the branches (beyond the paper): main roads and driveways told apart


NEAR_M, FAR_M = 8.0, 20.0
"""Part of a branch that is measured, from the intersection: nearer the kerbs are round, farther little is seen."""

_DISTANCES_M = np.arange(NEAR_M, FAR_M + 0.5, 1.0)
MAX_WIDTH_M = 30.0
"""What is wider is no road across, but one along: that of the next intersection."""

MIN_STEPS = 3


def branch_widths(position: FloatArray, lines: StructuredArray, occupancy: BinaryImage) -> FloatArray:
    """Measure the road at right angles to the (B,) LINE of each branch, from a place (row, column) on.

    Returns (B,) medians along the branches, metres; NaN where too little of one is road, and where all of it that is
    measured lies in the mouth of the next branch.
    """
    pixel_m = occupancy.resolution_m
    return pixel_m * median_runs_across(
        occupancy.words,
        occupancy.height,
        occupancy.width,
        position,
        np.ascontiguousarray(lines["direction"]),
        _DISTANCES_M / pixel_m,
        MAX_WIDTH_M / pixel_m,
        math.cos(SIDE_BY_SIDE_RAD),
        MIN_STEPS,
    )


# Patches for the mosaic: what a keyframe knows of the road around it, coarse and packed


PATCH_STEP_M = 10.0
"""Distance between the keyframes whose road is kept: the windows of those between hold hardly more."""

CELL_M = 0.5
"""Side of the cells of a patch, about: a whole number of cells of the method."""


def road_patch(keyframe: int, occupancy: BinaryImage, roi: Roi, against: BinaryImage | None = None) -> RoadPatch:
    """Keep the road around a keyframe, its row among those of the drive: of each coarse cell the cell in its middle.

    ``roi`` is where the occupancy lies in W; ``against`` where other ground was seen, None where nobody can tell.
    """
    step = max(1, round(CELL_M / roi.resolution_m))
    size = roi.size // step

    def coarse(image: BinaryImage) -> UInt8Array:
        image = image.turned(roi.size, -roi.turn_rad)
        words = image.words  # the rows that are not needed are not unpacked
        rows = np.concatenate([words[:1], words[1 + step // 2 : -1 : step][:size], words[-1:]])
        return replace(image, words=rows, height=size).to_array()[:, step // 2 :: step][:, :size].copy()

    cells = coarse(occupancy)
    other = None if against is None else np.minimum(coarse(against), 1 - cells)
    corner_xy = np.array([roi.left * roi.resolution_m, (roi.top + 1) * roi.resolution_m])
    return RoadPatch.pack(keyframe, corner_xy, step * roi.resolution_m, cells, other)
