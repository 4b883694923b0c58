"""The scale of remission, which networks expect from 0 to 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_SCALES = (1.0, 255.0, 65535.0)
_TOLERANCE = 1.5


def remission_scale(values: ArrayLike) -> float:
    """Guess what remission has to be divided by.

    A network of the family that is given 0..255 instead of 0..1 finds no road at all. To be decided once per drive,
    from some of its scans: a single scan may be dark.

    Parameters
    ----------
    values : array of float
        Remission (intensity, reflectivity) of some scans; what is not finite does not count.

    Returns
    -------
    float
        1.0, 255.0 or 65535.0: the smallest scale that holds all but the brightest 0.1 % of the values, which may be
        single wrong ones. 1.0 too where there are no values, or only zeros (then remission is missing).

    Notes
    -----
    The scales are [0, 1] (KITTI, SemanticKITTI, KITTI-360), 8 bits (Velodyne, Hesai, RoboSense, Livox, nuScenes) and
    16 bits (Ouster's signal, LAS). Values of the first may exceed 1 by half: no sensor of 8 bits is that dark.
    """
    array = np.asarray(values, dtype=np.float64).ravel()
    array = array[np.isfinite(array)]
    if not array.size:
        return _SCALES[0]
    high = float(np.quantile(array, 0.999, method="lower"))
    if high <= _TOLERANCE:
        return _SCALES[0]
    return _SCALES[1] if high <= _SCALES[1] else _SCALES[2]
