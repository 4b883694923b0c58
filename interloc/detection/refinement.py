"""Correction of the intersection point by its branches (paper, section III-C.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray
from interloc.detection.branches import Branches

# Lines are near-parallel, and their meeting point means nothing, when the smaller eigenvalue of the normal matrix is
# less than this share of their number: a fan of lines within about 10 degrees.
PARALLEL = math.sin(math.radians(10.0)) ** 2 / 2


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


def refine(branches: Branches, prior_weight: float = 0.0) -> Junction:
    """Move the candidate to the point of least squared distances to the lines of its branches, within the inner disc.

    Near-parallel lines do not fix a point: the candidate stays where it is and its residual is infinite.

    Parameters
    ----------
    branches
    prior_weight : float
        Weight of the candidate itself beside the lines; 0 as in the paper.

    Notes
    -----
    Paper, eq. 10. With unit normals n, points a and weights w (1 in the paper) of the lines, the minimum solves
    (sum w n n^T) p = sum w n n^T a.
    """
    candidate, normals, weights = branches.candidate, branches.normals, branches.weights
    counted = normals[weights > 0]
    # Whether lines are near-parallel is a matter of their directions, however unlike their weights.
    if len(counted) < 2 or _smaller_eigenvalue(counted.T @ counted) < PARALLEL * len(counted):
        return Junction(candidate, branches.directions, math.inf, branches)
    weighted = normals * weights[:, None]
    offsets = np.einsum("ij,ij->i", normals, branches.points - candidate)
    shift = np.linalg.solve(normals.T @ weighted + prior_weight * np.eye(2), weighted.T @ offsets)
    length = math.hypot(*shift)
    if length > branches.inner:
        shift = shift * (branches.inner / length)
    residual = float(np.sqrt(np.average((normals @ shift - offsets) ** 2, weights=weights)))
    return Junction(candidate + shift, branches.directions, residual, branches)


def _smaller_eigenvalue(matrix: FloatArray) -> float:
    a, b, d = matrix[0, 0], matrix[0, 1], matrix[1, 1]
    return float((a + d) / 2 - math.hypot((a - d) / 2, b))
