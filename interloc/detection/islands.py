"""Islands: ground that road encloses. Traffic goes round those that are round; others that were seen part roads.

A small round island is the middle of one intersection, so it is filled, as one that nobody saw: a lay-by, parked cars.
How large it is its ground tells where that was seen, since the closing takes some of it, the more the labels err.
Round a large one intersections lie on a ring, whose axis is a circle: where chords of it meet is beyond.
"""

import math
from collections.abc import Iterator

import numpy as np

from interloc.arrays import FloatArray, Int32Array, UInt64Array
from interloc.detection.edges import first_along
from interloc.detection.image import BinaryImage
from interloc.kernels import compiled
from interloc.kernels.bits import count_pixels
from interloc.kernels.morphology import fill_islands, set_runs

ROUND_SHARE = 0.7  # of the circle around it that a round island has, less by what labels err
PARTING_SHARE = 0.25, 0.85  # of that circle, with what the closing took of it: 0.29 in a right angle; medians less
PARTING_M2 = 40.0  # of other ground that was seen all around: of a gap in the labels at most 19, of labels that err 31
COVERED = 2.0  # islands up to a limit are as much larger than the gaps that the closing leaves of them
MAX_RING_M2, MAX_WIDTH_M = 1100.0, 12.0  # of the island in a roundabout, and of the ring around it
RAYS = 90  # that tell where the ring lies


def close_islands(road: BinaryImage, other: UInt64Array | None, limit_m2: float) -> None:
    """Set the islands up to an area, in place, but for those that part roads, if it is known where other ground is."""
    words, size, cell_m2 = road.words, (road.height, road.width), road.resolution_m**2
    limit, minimum = limit_m2 / cell_m2, PARTING_M2 / cell_m2
    parting = []
    if other is not None:
        for runs, _, share in _shapes(fill_islands(words & ~other, *size, COVERED * limit, False), minimum):
            if share <= PARTING_SHARE[0]:
                continue
            island = np.zeros_like(words)
            set_runs(island, runs)
            seen = island & other
            fill_islands(seen, *size, limit, False)  # with its middle: bushes, or too far above the road to look into
            if count_pixels(seen) > (minimum if share < PARTING_SHARE[1] else limit):
                parting.append(island)
    fill_islands(words, *size, limit, False)
    for island in parting:
        words &= ~island


def place_on_rings(places: FloatArray, road: BinaryImage) -> FloatArray:
    """Return where intersections are, (N, 2) rows and columns: those on a ring that is seen whole lie on its axis."""
    limit = MAX_RING_M2 / road.resolution_m**2
    islands = _shapes(fill_islands(road.words.copy(), road.height, road.width, limit, False))
    centres = np.array([middle for _, middle, share in islands if share >= ROUND_SHARE]).reshape(-1, 2)
    edges = _edges(road.words, centres, MAX_WIDTH_M / road.resolution_m)
    for centre, (inner, outer) in zip(centres, edges, strict=True):
        away = np.hypot(*(places - centre).T)[:, None]
        on_axis = centre + (places - centre) * (0.5 * (inner + outer) / np.maximum(away, inner))
        places = np.where((inner < away) & (away < outer), on_axis, places)
    return places


def _shapes(runs: Int32Array, minimum: float = 0.0) -> Iterator[tuple[Int32Array, FloatArray, float]]:
    """Yield of each island of more pixels its runs, its middle, and how much of the circle around that it has."""
    if not len(runs):
        return
    _, island = np.unique(runs[:, 3], return_inverse=True)
    for number in np.flatnonzero(np.bincount(island, runs[:, 2] - runs[:, 1]) > minimum).tolist():
        own = runs[island == number]
        row, begin, end = own[:, 0], own[:, 1], own[:, 2] - 1
        length = end - begin + 1
        middle = np.array([length @ row, length @ (begin + end) / 2]) / length.sum()
        reach = np.hypot(row - middle[0], np.maximum(middle[1] - begin, end - middle[1])).max()
        yield own, middle, length.sum() / (np.pi * (reach + 0.5) ** 2)


@compiled
def _edges(words: UInt64Array, centres: FloatArray, width: float) -> FloatArray:
    """Return how far the inner and the outer edge of each of C rings are from its centre, (C, 2)."""
    edges, inner, outer = np.empty((len(centres), 2)), np.empty(RAYS), np.empty(RAYS)
    for i in range(len(centres)):
        row, col = centres[i]
        for k in range(RAYS):
            d_row, d_col = math.sin(2.0 * math.pi * k / RAYS), math.cos(2.0 * math.pi * k / RAYS)
            inner[k] = first_along(words, row, col, d_row, d_col, 0.0, np.inf, True)
            outer[k] = first_along(words, row, col, d_row, d_col, inner[k], inner[k] + width, False)
        edges[i] = np.sort(inner)[RAYS // 2], np.sort(outer)[RAYS // 4]  # the rest of it is the mouths of its arms
    return edges
