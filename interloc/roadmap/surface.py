"""The ground that was seen as road, block by block: its mask, its skeleton, its outlines, open places.

A block is computed with a margin around it and gives only what lies within, so the memory does not grow with the drive
and the seams do not show.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import cv2
import numpy as np
import shapely
from contourpy import FillType, contour_generator

from interloc.arrays import Float32Array, FloatArray, IntArray, UInt8Array, UInt64Array
from interloc.kernels import bits
from interloc.kernels.morphology import dilate, erode, fill_islands
from interloc.kernels.skeleton import thin
from interloc.mapping.mosaic import TILE, Raster

BLOCK = 2 * TILE
"""Cells per side of a block."""

MARGIN_M = 64.0
"""Around a block: more than twice the half width of the widest road that is thinned."""

PLACE_HALF_M = 12.0
"""Ground that a disc of this radius fits into is an open place, not a road, unless it is as small as a junction."""

MIN_COUNT = 2  # sightings of a cell
_HOLE_M2 = 60.0  # shadows of cars; islands of roundabouts and medians are larger
_OPENING_M = 1.0
_PIECE_M2 = 150.0
_PLACE_M2 = 1200.0
_SIMPLIFIED_M = 0.25
_AROUND = 8  # cells: twice the reach of the blur


@dataclass
class Ground:
    """What all blocks found."""

    cell_m: float
    rows: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    cols: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    """(P,) int64: cells of the skeleton, in row-major order."""
    half_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(P,) float64: distance from each to the edge of the road, metres."""
    places: list[shapely.Polygon] = field(default_factory=list)
    """Open places, metres of the mosaic."""
    surface: list[shapely.Polygon] = field(default_factory=list)
    """The road, cut at the blocks."""

    @property
    def xy(self) -> FloatArray:
        """(P, 2) middles of the cells of the skeleton, metres of the mosaic."""
        return np.stack([self.cols + 0.5, -(self.rows + 0.5)], axis=-1) * self.cell_m


def survey(raster: Raster, block: int = BLOCK) -> Ground:
    """Find the road in a raster of counts; how it is cut into blocks decides only how the surface is cut."""
    ground = Ground(raster.cell_m)
    found, places = [], []
    side = block // TILE
    for row, col in sorted({(row // side * block, col // side * block) for row, col in raster.tiles}):
        margin = round(MARGIN_M / raster.cell_m)
        counts = raster.window(row - margin, col - margin, block + 2 * margin, block + 2 * margin)
        if counts is None or not (counts >= MIN_COUNT).any():
            continue
        part = _part_with_road(counts)
        mask = road_mask(counts[part], raster.cell_m)
        half_m = _distance(mask) * np.float32(raster.cell_m)
        place = _open_places(half_m, mask, raster.cell_m)
        lines = bits.pack(mask & ~place)
        thin(lines)
        rows, cols = (each.astype(np.int64) for each in bits.set_pixels(lines))
        down, across = rows + part[0].start - margin, cols + part[1].start - margin  # from the corner of the block
        inside = (down >= 0) & (down < block) & (across >= 0) & (across < block)
        found.append((down[inside] + row, across[inside] + col, half_m[rows[inside], cols[inside]]))
        corner = np.array([col - margin, -(row - margin)]) * raster.cell_m
        box = shapely.box(*(np.array([col, -(row + block), col + block, -row]) * raster.cell_m))
        ground.surface += outlines(mask, corner, raster.cell_m, box, part)
        places += outlines(place, corner, raster.cell_m, box, part)
    if found:
        rows, cols, half = (np.concatenate(each) for each in zip(*found, strict=True))
        order = np.lexsort((cols, rows))
        ground.rows, ground.cols, ground.half_m = rows[order], cols[order], half[order].astype(np.float64)
    ground.places = list(shapely.get_parts(shapely.union_all([each.buffer(raster.cell_m / 10) for each in places])))
    return ground


def _part_with_road(counts: UInt8Array) -> tuple[slice, slice]:
    """Return the rows and columns of a window that hold its road, and what filters around it reach of the rest."""
    is_road = counts >= MIN_COUNT
    ends = (np.flatnonzero(is_road.any(axis=1 - axis))[[0, -1]].tolist() for axis in (0, 1))
    rows, cols = (slice(max(first - _AROUND, 0), last + _AROUND + 1) for first, last in ends)
    return rows, cols


def road_mask(counts: UInt8Array, cell_m: float) -> UInt8Array:
    """Return 1 where a window of counts is road: holes filled, thin and small pieces gone."""
    height, width = counts.shape
    words = bits.pack(counts >= MIN_COUNT)
    fill_islands(words, height, width, _fewer(_HOLE_M2, cell_m), False)
    reach = int(_OPENING_M / cell_m)
    disc = np.rint(np.sqrt(reach**2 - np.arange(reach + 1) ** 2)).astype(np.int64)
    words = dilate(erode(words, disc, width), disc, width)
    return bits.unpack(_without_small(words, height, width, _fewer(_PIECE_M2, cell_m)), width)


def _fewer(area_m2: float, cell_m: float) -> float:
    """Return the largest number of cells that cover less than an area."""
    return math.ceil(area_m2 / cell_m**2) - 1.0


def _without_small(words: UInt64Array, height: int, width: int, limit: float) -> UInt64Array:
    """Return a packed mask without the pieces of at most so many cells that do not reach the border."""
    clear = ~words
    fill_islands(clear, height, width, limit, True)
    return ~clear


def _distance(mask: UInt8Array) -> Float32Array:
    """Return how far each cell of a mask is from the nearest one outside of it, cells."""
    return np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


def _open_places(half_m: Float32Array, mask: UInt8Array, cell_m: float) -> UInt8Array:
    core = half_m > PLACE_HALF_M
    if not core.any():
        return np.zeros_like(mask)
    away = _distance((~core).astype(np.uint8))
    height, width = mask.shape
    place = bits.pack((away * cell_m <= PLACE_HALF_M) & (mask == 1))
    return bits.unpack(_without_small(place, height, width, _fewer(_PLACE_M2, cell_m)), width)


def outlines(
    mask: UInt8Array,
    corner_xy: FloatArray,
    cell_m: float,
    box: shapely.Polygon,
    part: tuple[slice, slice] = (slice(0, None), slice(0, None)),
) -> list[shapely.Polygon]:
    """Return what of a mask lies in a box as polygons, whose edges lie between the cells and are not stepped.

    The mask is a part of a window with its upper left corner at `corner_xy`.
    """
    if not mask.any():
        return []
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0)
    y, x = (each.start + np.arange(size, dtype=np.float64) for each, size in zip(part, mask.shape, strict=True))
    generator = contour_generator(x, y, soft, fill_type=FillType.OuterOffset)
    polygons = []
    for points, offsets in zip(*generator.filled(0.5, 2.0), strict=True):
        xy = corner_xy + (points + 0.5) * [cell_m, -cell_m]
        rings = [xy[begin:end] for begin, end in pairwise(offsets)]
        polygons.append(shapely.Polygon(rings[0], rings[1:]))
    cut = shapely.intersection(shapely.make_valid(np.array(polygons)), box)
    parts = shapely.get_parts(shapely.simplify(cut, _SIMPLIFIED_M))
    return [each for each in parts if each.geom_type == "Polygon" and each.area > _OPENING_M**2]
