"""The range image of a scan, what a network is given of it, and classes of points from classes of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import BoolArray, Float32Array, Int32Array, UInt8Array
from interloc.kernels.neighbours import vote_of_neighbours
from interloc.kernels.projection import fill_image, normalise_image, project_points

CHANNELS = ("range", "x", "y", "z", "remission", "mask")
"""What a network can be given, in the order of the range image; the mask is 1 where a pixel has a point."""


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
    """Project an (N, 4) scan onto a sphere around the sensor (RangeNet++, section III-A).

    Points that are not finite, or at the origin, get no pixel. `fov_up_rad` and `fov_down_rad` are the upper and lower
    edge of the image, above and below the horizon; as in the published code the signs do not matter, and points outside
    go to the first or last row.
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
    """Return the (C, H, W) that a network expects of a (5, H, W) range image: each channel less its mean, over its std.

    Empty pixels are set to zero *after* the normalisation, as in training: before it they would be far below any
    measurement.
    """
    rows = np.array([CHANNELS.index(name) for name in channels], np.int32)
    return normalise_image(image, projection.index, rows, np.array(means, np.float32), np.array(stds, np.float32))


@dataclass(frozen=True)
class KnnSettings:
    """How neighbours vote (``post.KNN.params`` of arch_cfg.yaml)."""

    neighbours: int = 5
    """How many vote (`knn`)."""
    search: int = 5
    """Side of the window in which they are looked for, pixels, odd."""
    sigma: float = 1.0
    """Standard deviation of the Gaussian that prefers pixels close by, pixels."""
    cutoff: float = 1.0
    """Neighbours whose weighted difference of range is larger do not vote, metres; 0 for no limit."""


def window_weights(search: int, sigma: float) -> Float32Array:
    """Return the (search, search) float32 factors of differences of range: 1 less a Gaussian of sum 1."""
    away = np.arange(search) - search // 2
    gaussian = np.exp(-(away**2) / (2 * sigma**2))
    window = np.outer(gaussian, gaussian)
    weights: Float32Array = (1 - window / window.sum()).astype(np.float32)
    return weights


def vote(classes: UInt8Array, projection: Projection, settings: KnnSettings, *, first_class: int = 1) -> UInt8Array:
    """Let the nearest neighbours of every point in the range image vote on its class (RangeNet++, section III-D).

    Points behind the nearest one of their pixel would else inherit its class: the wall behind a pole would be pole.
    Classes below `first_class` have no vote: 1 where class 0 means "no class", as published. Points without a pixel get
    class 0. What differs from the published code stands at `interloc.kernels.neighbours.vote_of_neighbours`.
    """
    weights = window_weights(settings.search, settings.sigma)
    cutoff = np.float32(settings.cutoff)
    limit = float(np.nextafter(cutoff, np.float32(np.inf))) if cutoff > 0 else np.inf
    return vote_of_neighbours(
        classes,
        projection.index,
        projection.pixel,
        projection.depth,
        weights,
        settings.neighbours,
        limit,
        first_class,
    )


def by_pixel(classes: UInt8Array, projection: Projection) -> UInt8Array:
    """Return the (N,) uint8 class of the pixel of every point; 0 for points without a pixel."""
    found: UInt8Array = classes.reshape(-1)[projection.pixel]
    return np.where(projection.pixel < 0, np.uint8(0), found)
