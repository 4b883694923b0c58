"""Correction of the intersection point by its branches (paper, section III-C.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray
from interloc.detection.branches import Branches
from interloc.detection.image import BinaryImage
from interloc.detection.lines import to_edge

# Lines are near-parallel, and their meeting point means nothing, when the smaller eigenvalue of the normal matrix is
# less than this share of their number: a fan of lines within about 10 degrees.
PARALLEL = math.sin(math.radians(10.0)) ** 2 / 2

ROUNDS = 4  # the weights of the lines are those at the point of the round before
TOLERANCE = 1.6  # radii of the inner circle that a line may pass the point at before it counts a quarter
MAX_SHIFTS = 2.5  # radii of the inner circle by which a point may be moved along the road


@dataclass(frozen=True)
class Junction:
    """A refined intersection in the image.

    Attributes
    ----------
    position : (2,) float64
        Row and column, pixels.
    directions : (B, 2) float64
        Unit direction (row, column) of each branch.
    residual : float
        Root mean square distance of the point from the lines, pixels; infinite where the lines do not fix it.
    branches
        What it was computed from.
    """

    position: FloatArray
    directions: FloatArray
    residual: float
    branches: Branches


def refine(branches: Branches, prior_weight: float = 0.0, occupancy: BinaryImage | None = None) -> Junction:
    """Move the candidate to the point of least squared distances to the lines of its branches, within the inner disc.

    Near-parallel lines do not fix a point: the candidate stays where it is and its residual is infinite.

    Parameters
    ----------
    branches
    prior_weight : float
        Weight of the candidate itself beside the lines; 0 as in the paper.
    occupancy
        The road. With it each line counts by what is known of it at the point, not at the candidate, and the point may
        leave the inner disc, but not the road.

    Notes
    -----
    Paper, eq. 10. With unit normals n, points a and weights w (1 in the paper) of the lines, the minimum solves
    (sum w n n^T) p = sum w n n^T a. With the road it is found by iteratively reweighted least squares (Geman and
    McClure, "Statistical methods for tomographic image reconstruction", 1987): a line that passes far off, because its
    road bends before it comes to the intersection, counts little.
    """
    candidate, normals, weights = branches.candidate, branches.normals, branches.weights
    counted = normals[weights > 0]
    # Whether lines are near-parallel is a matter of their directions, however unlike their weights.
    if len(counted) < 2 or _smaller_eigenvalue(counted.T @ counted) < PARALLEL * len(counted):
        return Junction(candidate, branches.directions, math.inf, branches)
    offsets = np.einsum("ij,ij->i", normals, branches.points - candidate)
    if occupancy is None:
        shift = _within(_solve(normals, weights, offsets, prior_weight), branches.inner)
    else:
        prior_weight /= _spread(branches.directions[weights > 0]) ** 2
        shift = np.zeros(2, np.float64)
        for _ in range(ROUNDS):
            off = (normals @ shift - offsets) / (TOLERANCE * branches.inner)
            weights = (branches.weights_at(candidate + shift) / (1.0 + off**2) ** 2).astype(np.float64)
            shift = _within(_solve(normals, weights, offsets, prior_weight), MAX_SHIFTS * branches.inner)
            shift = _on_road(occupancy, candidate, shift, branches.inner)
    residual = float(np.sqrt(np.average((normals @ shift - offsets) ** 2, weights=weights)))
    return Junction(candidate + shift, branches.directions, residual, branches)


def _solve(normals: FloatArray, weights: FloatArray, offsets: FloatArray, prior_weight: float) -> FloatArray:
    weighted = normals * weights[:, None]
    shift: FloatArray = np.linalg.solve(normals.T @ weighted + prior_weight * np.eye(2), weighted.T @ offsets).astype(
        np.float64, copy=False
    )
    return shift


def _within(shift: FloatArray, limit: float) -> FloatArray:
    length = math.hypot(*shift)
    return shift * (limit / length) if length > limit else shift


def _spread(directions: FloatArray) -> float:
    """Return how much farther off its intersection a centerline branches than at a right angle; 1 at the least.

    The surfaces of roads at an angle t part at 1 / sin(t / 2) half widths.
    """
    cosines = directions @ directions.T - 2.0 * np.eye(len(directions))
    half = 0.5 * math.acos(float(np.clip(cosines.max(), -1.0, 1.0)))
    return max(1.0, math.sin(math.pi / 4) / max(math.sin(half), 0.1))


def _on_road(occupancy: BinaryImage, candidate: FloatArray, shift: FloatArray, free: float) -> FloatArray:
    """Return a shift up to where it leaves the road, if that is farther than ``free``."""
    length = math.hypot(*shift)
    if length <= free:
        return shift
    reach = to_edge(occupancy.words, candidate[0], candidate[1], shift[0] / length, shift[1] / length, length)
    return shift * (max(reach, free) / length)


def _smaller_eigenvalue(matrix: FloatArray) -> float:
    a, b, d = matrix[0, 0], matrix[0, 1], matrix[1, 1]
    return float((a + d) / 2 - math.hypot((a - d) / 2, b))
