"""The range image of a scan, and what a network is given of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import BoolArray, Float32Array, Int32Array
from interloc.kernels.projection import fill_image, normalise_image, project_points

CHANNELS = ("range", "x", "y", "z", "remission", "mask")
"""What a network can be given, in the order of the range image; the mask is 1 where a pixel has a point."""


@dataclass(frozen=True)
class Projection:
    """Which point is seen in which pixel.

    Attributes
    ----------
    index : (H, W) int32
        Row of the nearest point of each pixel; -1 in empty pixels.
    pixel : (N,) int32
        Pixel of each point, row * W + column; -1 for points without one.
    depth : (N,) float32
        Distance of each point from the sensor, metres; -1 for points without a pixel.
    """

    index: Int32Array
    pixel: Int32Array
    depth: Float32Array

    @property
    def filled(self) -> BoolArray:
        """(H, W) bool, true where a pixel has a point."""
        filled: BoolArray = self.index >= 0
        return filled

    @property
    def rows(self) -> Int32Array:
        """(N,) int32, row of each point; -1 for points without a pixel."""
        return np.where(self.pixel < 0, np.int32(-1), self.pixel // np.int32(self.index.shape[1]))

    @property
    def columns(self) -> Int32Array:
        """(N,) int32, column of each point; -1 for points without a pixel."""
        return np.where(self.pixel < 0, np.int32(-1), self.pixel % np.int32(self.index.shape[1]))


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
