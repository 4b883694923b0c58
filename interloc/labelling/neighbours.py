"""Post-processing: classes of points from classes of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import Float32Array, UInt8Array
from interloc.kernels.neighbours import vote_of_neighbours
from interloc.labelling.projection import Projection


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

    Parameters
    ----------
    classes : (H, W) uint8
        Of the pixels.
    projection
    settings
    first_class : int
        Lower classes have no vote: 1 where class 0 means "no class", as published.

    Returns
    -------
    (N,) uint8
        Of the points; 0 for points without a pixel. What differs from the published code stands at
        `interloc.kernels.neighbours.vote_of_neighbours`.
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
