"""The range image of a scan, and what a network is given of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from interloc.arrays import BoolArray, Float32Array, Int32Array
from interloc.kernels.projection import fill_image, normalise_image, project_points

CHANNELS = ("range", "x", "y", "z", "remission", "mask")
"""What a network can be given, in the order of the range image; the mask is 1 where a pixel has a point."""

_SCALES = (1.0, 255.0, 65535.0)
_TOLERANCE = 1.5


@dataclass(frozen=True)
class Projection:
    """Which point is seen in which pixel."""

    index: Int32Array
    """(H, W) int32: row of the nearest point of each pixel; -1 in empty pixels."""
    pixel: Int32Array
    """(N,) int32: pixel of each point, row * W + column; -1 for points without one."""
    depth: Float32Array
    """(N,) float32: distance of each point from the sensor, metres; -1 for points without a pixel."""

    @property
    def filled(self) -> BoolArray:
        """(H, W) bool, true where a pixel has a point."""
        filled: BoolArray = self.index >= 0
        return filled


def project(points: Float32Array, height: int, width: int, fov_up_rad: float, fov_down_rad: float) -> Projection:
    """Project a scan onto a sphere around the sensor (RangeNet++, section III-A).

    Parameters
    ----------
    points : (N, 4) float32
        x (ahead), y (left), z (up) in L, metres, and remission. Points that are not finite, or at the origin, get no
        pixel.
    height, width : int
        Of the image, pixels.
    fov_up_rad, fov_down_rad : float
        Upper and lower edge of the image, radians above and below the horizon; as in the published code the signs do
        not matter. Points outside go to the first or last row.
    """
    index, pixel, depth = project_points(points, height, width, abs(fov_up_rad), abs(fov_down_rad))
    return Projection(index, pixel, depth)


def range_image(points: Float32Array, projection: Projection) -> Float32Array:
    """Return the (5, H, W) float32 image of range, x, y, z (metres, L) and remission; -1 in empty pixels."""
    return fill_image(points, projection.index, projection.depth)


def normalise(
    image: Float32Array,
    projection: Projection,
    channels: tuple[str, ...],
    means: tuple[float, ...],
    stds: tuple[float, ...],
) -> Float32Array:
    """Return what a network expects: each channel less its mean, over its standard deviation, empty pixels zero.

    Parameters
    ----------
    image : (5, H, W) float32
        Of `range_image`.
    projection
    channels : tuple of str
        Of `CHANNELS`, in the network's order.
    means, stds : tuple of float
        One per channel.

    Returns
    -------
    (C, H, W) float32
        Empty pixels are set to zero *after* the normalisation, as in training: before it they would be far below any
        measurement.
    """
    rows = np.array([CHANNELS.index(name) for name in channels], np.int32)
    return normalise_image(image, projection.index, rows, np.array(means, np.float32), np.array(stds, np.float32))


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
