"""Patches of the road for the mosaic: what a keyframe knows of the road around it, coarse and packed."""

from dataclasses import replace

import numpy as np

from interloc.arrays import FloatArray, IntArray, UInt8Array
from interloc.detection.image import BinaryImage, Roi
from interloc.geometry import thin
from interloc.results import RoadPatch

PATCH_STEP_M = 10.0
"""Distance between the keyframes whose road is kept: the windows of those between hold hardly more."""

CELL_M = 0.5
"""Side of the cells of a patch, about: a whole number of cells of the method."""


def patch_keyframes(T_world_lidar: FloatArray) -> IntArray:
    """Return the rows of the keyframes whose road is kept, from the (K, 4, 4) poses of all keyframes."""
    return thin(T_world_lidar[:, :2, 3], PATCH_STEP_M)


def road_patch(keyframe: int, occupancy: BinaryImage, roi: Roi, against: BinaryImage | None = None) -> RoadPatch:
    """Keep the road around a keyframe, of each coarse cell the cell in its middle.

    Parameters
    ----------
    keyframe : int
        Its row among the keyframes of the drive.
    occupancy
        Of the keyframe (paper, III-B.4).
    roi
        Where it lies in W.
    against
        Where other ground was seen; None where nobody can tell.
    """
    step = max(1, round(CELL_M / roi.resolution_m))
    size = roi.size // step

    def coarse(image: BinaryImage) -> UInt8Array:
        words = image.words  # the rows that are not needed are not unpacked
        rows = np.concatenate([words[:1], words[1 + step // 2 : -1 : step][:size], words[-1:]])
        return replace(image, words=rows, height=size).to_array()[:, step // 2 :: step][:, :size]

    cells = coarse(occupancy)
    other = None if against is None else np.minimum(coarse(against), 1 - cells)
    corner_xy = np.array([roi.left * roi.resolution_m, (roi.top + 1) * roi.resolution_m])
    return RoadPatch.pack(keyframe, corner_xy, step * roi.resolution_m, cells, other)
