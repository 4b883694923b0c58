"""How wide the roads are that meet at an intersection (beyond the paper): main roads and driveways told apart."""

import numpy as np

from interloc.arrays import FloatArray, StructuredArray
from interloc.detection.image import BinaryImage
from interloc.detection.lines import SIDE_BY_SIDE_RAD
from interloc.kernels.bits import median_runs_across

NEAR_M, FAR_M = 8.0, 20.0
"""Part of a branch that is measured, from the intersection: nearer the kerbs are round, farther little is seen."""

_DISTANCES_M = np.arange(NEAR_M, FAR_M + 0.5, 1.0)
MAX_WIDTH_M = 30.0
"""What is wider is no road across, but one along: that of the next intersection."""

MIN_STEPS = 3


def branch_widths(position: FloatArray, lines: StructuredArray, occupancy: BinaryImage) -> FloatArray:
    """Measure the road across each branch, at right angles to its line.

    Parameters
    ----------
    position : (2,) float64
        Row and column of the intersection.
    lines : (B,) LINE
        Of the branches.
    occupancy
        Set where the ground is road.

    Returns
    -------
    (B,) float64
        Median width along the branch, metres; NaN where too little of it is road, and where all of it that is measured
        lies in the mouth of the next branch.
    """
    directions = np.ascontiguousarray(lines["direction"])
    return occupancy.resolution_m * median_runs_across(
        occupancy.words,
        occupancy.height,
        occupancy.width,
        position,
        directions,
        _DISTANCES_M / occupancy.resolution_m,
        _longest_m(directions) / occupancy.resolution_m,
        MIN_STEPS,
    )


def _longest_m(directions: FloatArray) -> FloatArray:
    """Return how wide the road of each branch can be at each distance, metres: else it runs into the next branch.

    The bisector of two branches is the border between their roads; those that run side by side share none.
    """
    alike = directions @ directions.T
    alike[alike > np.cos(SIDE_BY_SIDE_RAD)] = -1.0  # itself too
    cosine = alike.max(axis=1, initial=-0.9)  # roads that lie so far apart bound nothing
    tangent = np.sqrt((1.0 - cosine) / (1.0 + cosine))  # of half the angle
    longest_m: FloatArray = np.minimum(2.0 * tangent[:, None] * _DISTANCES_M, MAX_WIDTH_M)
    return longest_m
