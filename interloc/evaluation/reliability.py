"""Whether what an intersection says of itself is true: its uncertainty against errors, its confidence against facts.

Counted over intersections of the map, not over their sightings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.evaluation.map_level import MapLevel
from interloc.evaluation.matching import UNMATCHED
from interloc.geometry import enu_from_lonlat
from interloc.results import IntersectionTable

BOUND_95 = 5.991464547107979
"""Squared distance in sigmas that holds 95 % of a normal distribution in the plane: -2 ln 0.05, 2.45 squared."""

BINS = 10
_RESAMPLES = 1000
_MAP_STD_M = np.arange(0.0, 10.0, 0.05)
_MIN_PLACES = 5  # fewer say nothing of their map
_INTERVAL = (2.5, 97.5)

Statistic = Callable[..., float]


@dataclass(frozen=True)
class Interval:
    """A figure with its bootstrap interval of 95 %."""

    value: float | None
    low: float | None
    high: float | None
    """None where there is nothing to count."""
    count: int
    """Number of places behind it."""


@dataclass(frozen=True)
class Bin:
    """Places of about the same confidence."""

    confidence: float
    right: float
    """Mean confidence; share that is right."""
    count: int


def map_std_m(intersections: IntersectionTable, level: MapLevel, node_lonlat: FloatArray) -> float | None:
    """Estimate what the nodes of the map, (N, 2) degrees, are off: one standard deviation along each axis, metres.

    The covariance of an intersection is that of the place where its roads meet; the node was drawn somewhere near it.
    Of largest likelihood, where errors are normal with these covariances and this variance on top; 0 where the
    covariances explain the errors alone. None for fewer than `_MIN_PLACES` nodes.
    """
    costs = _costs(*_errors_at_nodes(intersections, level, node_lonlat)[1:])
    return float(_MAP_STD_M[costs.sum(axis=0).argmin()]) if len(costs) >= _MIN_PLACES else None


def squared_errors(intersections: IntersectionTable, level: MapLevel, node_lonlat: FloatArray) -> FloatArray:
    """Return the error of each intersection in units of its covariance, squared: e^T (C + s^2 I)^-1 e, (M,) float64.

    s is `map_std_m` of the other intersections, so that no error excuses itself. NaN for those that no node is assigned
    to. Of errors as large as said, the mean is 2 (the dimensions of the plane) and 95 % are at most `BOUND_95`.
    """
    rows, variance, error = _errors_at_nodes(intersections, level, node_lonlat)
    costs = _costs(variance, error)
    others = _MAP_STD_M[(costs.sum(axis=0) - costs).argmin(axis=1)] if len(rows) > _MIN_PLACES else np.zeros(len(rows))
    squared = np.full(len(intersections), np.nan)
    squared[rows] = (error**2 / (variance + others[:, None] ** 2)).sum(axis=1)
    return squared


def _errors_at_nodes(
    intersections: IntersectionTable, level: MapLevel, node_lonlat: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the (P,) rows that have a node, and variances and errors along the axes of their ellipses, (P, 2) each."""
    rows = np.flatnonzero(level.node != UNMATCHED)
    if not len(rows):
        return rows, np.zeros((0, 2)), np.zeros((0, 2))
    assert intersections.lonlat is not None
    lonlat = intersections.lonlat[rows]
    error = enu_from_lonlat(lonlat[:, 1], lonlat[:, 0], node_lonlat[level.node[rows]])
    variance, axes = np.linalg.eigh(intersections.covariances[rows])
    return rows, variance + 1e-12, np.einsum("nji,nj->ni", axes, error)


def _costs(variance: FloatArray, error: FloatArray) -> FloatArray:
    """Return minus twice the log likelihood of each error for each of `_MAP_STD_M`, but for a constant."""
    total = variance[:, None] + _MAP_STD_M[:, None] ** 2
    costs: FloatArray = (np.log(total) + error[:, None] ** 2 / total).sum(axis=2)
    return costs


def share_within(squared: FloatArray) -> float:
    """Return the share of squared errors within the ellipse of 95 %."""
    return float(np.mean(squared <= BOUND_95))


def squared_per_dimension(squared: FloatArray) -> float:
    """Return the normalised estimation error squared per degree of freedom (Bar-Shalom et al. 2001, 5.4): 1 if true."""
    return float(np.mean(squared)) / 2.0


def calibration_error(confidence: FloatArray, right: BoolArray) -> float:
    """Return the expected calibration error over `BINS` bins of equal width (Naeini et al. 2015; Guo et al. 2017)."""
    # Count times difference of the means is the sum of the differences; the bootstrap asks for this thousands of times.
    return float(np.abs(np.bincount(_numbers(confidence), confidence - right)).sum()) / len(confidence)


def bins_of(confidence: FloatArray, right: BoolArray) -> list[Bin]:
    """Return the bins of a reliability diagram that hold any place."""
    number = _numbers(confidence)
    members = [np.flatnonzero(number == each) for each in range(BINS)]
    return [Bin(float(confidence[m].mean()), float(right[m].mean()), len(m)) for m in members if len(m)]


def _numbers(confidence: FloatArray) -> IntArray:
    return np.minimum((confidence * BINS).astype(np.int64), BINS - 1)


def with_interval(statistic: Statistic, *columns: FloatArray | BoolArray) -> Interval:
    """Return a figure of some places with the interval of its bootstrap: places drawn anew, with replacement."""
    count = len(columns[0])
    if not count:
        return Interval(None, None, None, 0)
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(_RESAMPLES):
        rows = rng.integers(0, count, count)
        drawn.append(statistic(*(column[rows] for column in columns)))
    low, high = np.percentile(drawn, _INTERVAL)
    return Interval(statistic(*columns), float(low), float(high), count)


def calibration_error_by_chance(confidence: FloatArray) -> Interval:
    """Return mean and middle 95 % of the calibration error of places whose confidence would be exactly true.

    Few places do not fall out in the shares that they should: whether each is right is drawn by its confidence, many
    times (consistency resampling, Broecker and Smith 2007). An error within the interval says nothing against it.
    """
    count = len(confidence)
    if not count:
        return Interval(None, None, None, 0)
    rng = np.random.default_rng(0)
    drawn = [calibration_error(confidence, rng.random(count) < confidence) for _ in range(_RESAMPLES)]
    low, high = np.percentile(drawn, _INTERVAL)
    return Interval(float(np.mean(drawn)), float(low), float(high), count)
