"""Inference of the road occupancy (paper, section III-B.4)."""

from dataclasses import replace

from interloc.config import OccupancyConfig
from interloc.detection.image import BinaryImage
from interloc.kernels.islands import fill_islands
from interloc.kernels.morphology import dilate, disc_half_widths, erode


def infer_occupancy(bev: BinaryImage, config: OccupancyConfig) -> BinaryImage:
    """Close the gaps between road cells, remove what is too small to be road, then fill small islands, if asked to.

    Parameters
    ----------
    bev
        Set where enough road points fell into the cell.
    config
        Disc diameters in metres, largest island in square metres.

    Returns
    -------
    BinaryImage
        Set where the ground is road.

    Notes
    -----
    Paper, eq. 4: closing by a disc, then opening by a disc. Islands are beyond it: the centerline runs round each, so a
    lay-by makes two intersections with a road that leads from one to the other, where no block of houses has room.
    """
    words, width, resolution_m = bev.words, bev.width, bev.resolution_m
    closing = disc_half_widths(odd_pixels(config.closing_m, resolution_m))
    opening = disc_half_widths(odd_pixels(config.opening_m, resolution_m))
    words = erode(dilate(words, closing, width), closing, width)
    words = dilate(erode(words, opening, width), opening, width)
    if config.island_m2 > 0:
        fill_islands(words, bev.height, width, config.island_m2 / resolution_m**2)
    return replace(bev, words=words)


def odd_pixels(length_m: float, resolution_m: float) -> int:
    """Return the odd number of pixels nearest to a length; never less than 1 (no effect)."""
    return 2 * round((length_m / resolution_m - 1) / 2) + 1 if length_m > resolution_m else 1
