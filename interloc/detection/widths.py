"""How wide the roads are that meet at an intersection (beyond the paper): main roads and driveways told apart."""

from __future__ import annotations

import numpy as np

from interloc.arrays import FloatArray
from interloc.detection.image import BinaryImage
from interloc.kernels.bits import median_runs_across

NEAR_M, FAR_M = 8.0, 20.0
"""Part of a branch that is measured, from the intersection: nearer the kerbs are round, farther little is seen."""

_DISTANCES_M = np.arange(NEAR_M, FAR_M + 0.5, 1.0)
MAX_WIDTH_M = 30.0
"""What is wider is no road across, but one along: that of the next intersection."""

MIN_STEPS = 3


def branch_widths(
    position: FloatArray, directions: FloatArray, bends: FloatArray, occupancy: BinaryImage, resolution_m: float
) -> FloatArray:
    """Measure the road across each branch, at right angles to its line or, where the road bends, its circle.

    Parameters
    ----------
    position : (2,) float64
        Row and column of the intersection.
    directions, bends : (B, 2) float64
        Direction and bend of each branch, see `interloc.detection.lines.Lines`.
    occupancy
        Set where the ground is road.
    resolution_m : float
        Side of a cell.

    Returns
    -------
    (B,) float64
        Median width along the branch, metres; NaN where too little of it is road.
    """
    return resolution_m * median_runs_across(
        occupancy.words,
        occupancy.height,
        occupancy.width,
        position,
        directions,
        bends,
        _DISTANCES_M / resolution_m,
        MAX_WIDTH_M / resolution_m,
        MIN_STEPS,
    )
