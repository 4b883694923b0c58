"""Offsets of drives along their tracks and positions of places, by one least squares adjustment.

Unknown are the places, and the offset of each drive at knots along its track, linear between them. What a drive saw at
x is x = place + offset(along) + noise. The prior of the knots is an Ornstein-Uhlenbeck process: zero on average, as
uncertain as the georeference states, and forgotten after `drift_length_m`. Its mean of zero is the only thing that
fixes the map as a whole: what all drives have in common stays in the map. Places are eliminated, so that a system over
the knots is left, which conjugate gradients solve from where the knots were before; x and y are independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray

_CONVERGED_M = 2e-5  # of a step of the steepest descent: of the knots some hundred times that
_MAX_ROUNDS = 1000


def knots_along(along_m: FloatArray, length_m: float, spacing_m: float) -> tuple[IntArray, FloatArray, int]:
    """Return for (N,) distances driven the knot before each, the share of the knot behind it, and how many there are.

    The knots lie evenly, at most `spacing_m` apart; a track without length has two in one place.
    """
    pieces = max(1, int(np.ceil(length_m / spacing_m)))
    place = np.clip(along_m / max(length_m / pieces, 1e-9), 0.0, pieces)
    knot = np.minimum(place.astype(np.int64), pieces - 1)
    return knot, place - knot, pieces + 1


@dataclass(frozen=True)
class Prior:
    """Inverse of the covariance of the knots of several drives, one after the other: its diagonal, and beside it."""

    diagonal: FloatArray
    """(K,) float64."""
    beside: FloatArray
    """(K,) float64: between a knot and the next one; 0 behind the last one of a drive."""

    @classmethod
    def of(cls, std_m: float, spacing_m: float, count: int, drift_length_m: float) -> Prior:
        """Return that of one drive."""
        kept = min(np.exp(-spacing_m / drift_length_m), 1.0 - 1e-6)
        unit = 1.0 / (std_m**2 * (1.0 - kept**2))
        diagonal = np.full(count, (1.0 + kept**2) * unit)
        diagonal[[0, -1]] = unit
        beside = np.append(np.full(count - 1, -kept * unit), 0.0)
        return cls(diagonal, beside)

    @classmethod
    def joined(cls, priors: Sequence[Prior]) -> Prior:
        """Return that of several drives."""
        return cls(np.concatenate([p.diagonal for p in priors]), np.concatenate([p.beside for p in priors]))

    def times(self, knots: FloatArray) -> FloatArray:
        """Return the product with (K, 2) knots."""
        product = self.diagonal[:, None] * knots
        between = self.beside[:-1, None]
        product[:-1] += between * knots[1:]
        product[1:] += between * knots[:-1]
        return product


@dataclass(frozen=True)
class Sightings:
    """N sightings of P places by drives with K knots in all."""

    xy: FloatArray
    """(N, 2) float64: where the drive saw it, metres."""
    weight: FloatArray
    """(N,) float64: one over the variance of its noise along each axis."""
    place: IntArray
    knot: IntArray
    """(N,) int64: place; knot before it."""
    share: FloatArray
    """(N,) float64: share of the knot behind it."""

    def offsets(self, knots: FloatArray) -> FloatArray:
        """Return the offset of the drive at each sighting, (N, 2)."""
        share = self.share[:, None]
        offset: FloatArray = (1.0 - share) * knots[self.knot] + share * knots[self.knot + 1]
        return offset

    def positions(self, knots: FloatArray) -> FloatArray:
        """Return where the places are, (P, 2): the weighted mean of what was seen, offsets taken away."""
        values, total = self.xy - self.offsets(knots), np.bincount(self.place, self.weight)
        return np.stack([np.bincount(self.place, self.weight * each) / total for each in values.T], axis=-1)


def adjust(sightings: Sightings, prior: Prior, start: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the knots of least squares.

    Parameters
    ----------
    sightings, prior
    start : (K, 2) float64
        Where to look first; the result does not depend on it but for some tenths of a millimetre.
    free : (K,) bool
        Knots that may move.

    Returns
    -------
    knots : (K, 2) float64
    pull : (K, 2) float64
        How far each knot would move if it alone were free, metres.
    """
    from scipy.linalg import cho_solve_banded, cholesky_banded  # noqa: PLC0415 - slow to import
    from scipy.sparse import csc_array, csr_array  # noqa: PLC0415

    seen, count = len(sightings.xy), len(start)
    two = np.stack([1.0 - sightings.share, sightings.share], axis=-1).reshape(-1)
    ends = np.stack([sightings.knot, sightings.knot + 1], axis=-1).reshape(-1)
    design = csr_array((two, ends, 2 * np.arange(seen + 1)), shape=(seen, count))
    places = int(sightings.place.max(initial=-1)) + 1
    total = np.bincount(sightings.place, sightings.weight, places)
    membership: Any = csc_array((sightings.weight, sightings.place, np.arange(seen + 1)), shape=(places, seen))
    back: Any = design.T

    def apart(values: FloatArray) -> FloatArray:
        """Take the mean of its place from each value, and weigh what is left."""
        mean = (membership @ values) / total[:, None]
        left: FloatArray = sightings.weight[:, None] * (values - mean[sightings.place])
        return left

    def system(knots: FloatArray) -> FloatArray:
        product: FloatArray = back @ apart(design @ knots) + prior.times(knots)
        return product

    alone = sightings.weight * (1.0 - sightings.weight / total[sightings.place])
    scale = (back.multiply(back) @ alone + prior.diagonal)[:, None]
    between = prior.beside + np.bincount(sightings.knot, alone * sightings.share * (1.0 - sightings.share), count)
    free_pairs = np.append(free[:-1] & free[1:], False)
    bands = cholesky_banded(np.stack([scale[:, 0], free_pairs * between]), lower=True)
    knots = start.copy()
    may_move = free[:, None]

    def stepped(rest: FloatArray) -> FloatArray:
        """Solve as if each drive were alone on the map, its places known."""
        step: FloatArray = cho_solve_banded((bands, True), may_move * rest)
        return step

    rest = back @ apart(sightings.xy) - system(knots)
    step = stepped(rest)
    direction, size = step, np.sum(rest * step, axis=0)
    for _ in range(_MAX_ROUNDS):
        if np.abs(step).max(initial=0.0) < _CONVERGED_M:
            break
        turned = system(direction)
        length = size / np.maximum(np.sum(direction * turned, axis=0), 1e-300)
        knots += length * direction
        rest = rest - length * turned
        step = stepped(rest)
        before, size = size, np.sum(rest * step, axis=0)
        direction = step + size / np.maximum(before, 1e-300) * direction
    return knots, rest / scale
