"""Which sightings of several drives are of the same place, and how far the drives are off.

GNSS puts each drive a metre or several off. Before sightings of several drives can be told to be of one place, these
offsets must be known roughly; they are found by voting, which needs no such assignment: the shift at which most of what
two drives saw falls together.

Then the offsets of drives along their tracks and the positions of places follow from one least squares adjustment.
Unknown are the places, and the offset of each drive at knots along its track, linear between them. What a drive saw at
x is x = place + offset(along) + noise. The prior of the knots is an Ornstein-Uhlenbeck process: zero on average, as
uncertain as the georeference states, and forgotten after `drift_length_m`. Its mean of zero is the only thing that
fixes the map as a whole: what all drives have in common stays in the map. Places are eliminated, so that a system over
the knots is left, which conjugate gradients solve from where the knots were before; x and y are independent.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray, distinct
from interloc.city.models import CityConfig
from interloc.geometry import linked_groups, tree_of
from interloc.mapping.clustering import cells_of, find_peaks, join_peaks

LINK_M = 8.0
"""Sightings farther apart than this, and not linked by others between them, have no say about each other."""

CELL_M = 1.0
"""Sightings in one cell of this side are linked as one, and not told apart where their density is looked at."""

_SIMPLE_M = 3.0  # radius within which sightings are one place whatever their density

Votes = Mapping[tuple[str, str], tuple[float, float, float]]
"""Two drives -> x and y of the first minus the second, metres, and how many pairs of sightings say so."""

_CELLS_PER_KERNEL = 3
_OFF_M = 3.0  # votes that contradict the others by more hardly count
_ROUNDS = 3


def linked(xy: FloatArray) -> IntArray:
    """Return the neighbourhood of each of (N, 2) sightings, (N,) from 0: what is linked by steps of `LINK_M`."""
    if not len(xy):
        return np.zeros(0, dtype=np.int64)
    cell = cells_of(xy, CELL_M)
    corner = np.zeros((int(cell.max()) + 1, 2))
    corner[cell] = np.floor(xy / CELL_M) * CELL_M
    i, j = tree_of(corner).query_pairs(LINK_M, output_type="ndarray").T
    return linked_groups(i, j, len(corner))[cell]


def group(xy: FloatArray, drive: IntArray, neighbourhood: IntArray, config: CityConfig) -> IntArray:
    """Return the place of each of (N, 2) sightings, metres, roughly without the offsets of their drives: (N,) from 0.

    `neighbourhood` is of `linked`, whole ones. A neighbourhood that no drive saw twice, and that is small, is one
    place. In all others the peaks of the density of the sightings are joined, closest first, unless drives saw them
    side by side: the steps by which the detections of one drive are fused, with drives instead of keyframes. Nothing
    depends on the order.
    """
    count = int(neighbourhood.max(initial=-1)) + 1
    if not count:
        return neighbourhood.copy()
    size = np.bincount(neighbourhood, minlength=count)
    middle = np.stack([np.bincount(neighbourhood, xy[:, i], count) / size for i in (0, 1)], axis=-1)
    reach = np.zeros(count)
    np.maximum.at(reach, neighbourhood, np.hypot(*(xy - middle[neighbourhood]).T))
    drives = int(drive.max()) + 1
    seen_once = np.bincount(distinct(neighbourhood * drives + drive) // drives, minlength=count) == size
    simple = (seen_once & (reach <= _SIMPLE_M))[neighbourhood]
    place = neighbourhood.copy()
    rest = np.flatnonzero(~simple)
    peaks = find_peaks(xy[rest], bandwidth_m=config.bandwidth_m, cell_m=CELL_M)
    joined = join_peaks(peaks, xy[rest], drive[rest], radius_m=config.gate_m, together=config.together)
    place[rest] = count + joined
    return np.unique(place, return_inverse=True)[1].reshape(-1).astype(np.int64)


def vote(
    xy: FloatArray, others: FloatArray, drive: IntArray, count: int, config: CityConfig
) -> tuple[FloatArray, FloatArray]:
    """Find the offset of a drive that saw (M, 2) places against each of `count` others, metres in one plane.

    They saw (N, 2) places; `drive`, (N,) from 0, says which of them. Returns the mode of the differences, (count, 2),
    and how many pairs of sightings agree with it, (count,); 0: the drives share nothing.

    Differences up to `vote_radius_m` are counted in a grid and smoothed by a Gaussian kernel. A shift of nothing is
    preferred to a large one by a wide prior, which decides where two drives share two places or fewer.
    """
    from scipy.ndimage import gaussian_filter  # noqa: PLC0415 - slow to import

    offset: FloatArray = np.zeros((count, 2))
    pairs: FloatArray = np.zeros(count)
    if not len(xy) or not len(others):
        return offset, pairs
    near = tree_of(xy).sparse_distance_matrix(tree_of(others), config.vote_radius_m, output_type="ndarray")
    difference, of = xy[near["i"]] - others[near["j"]], drive[near["j"]]
    cell = config.vote_kernel_m / _CELLS_PER_KERNEL
    half = math.ceil(config.vote_radius_m / cell)
    side = 2 * half + 1
    index = np.rint(difference / cell).astype(np.int64) + half
    grid = np.bincount((of * side + index[:, 0]) * side + index[:, 1], minlength=count * side * side)
    smooth = gaussian_filter(
        grid.reshape(count, side, side).astype(np.float64), (0, _CELLS_PER_KERNEL, _CELLS_PER_KERNEL), mode="constant"
    )
    axis = (np.arange(side) - half) * cell
    far = (axis[:, None] ** 2 + axis[None] ** 2) / config.vote_radius_m**2
    best = np.argmax((smooth * np.exp(-2.0 * far)).reshape(count, -1), axis=1)
    offset = np.stack([axis[best // side], axis[best % side]], axis=-1)
    for _ in range(_ROUNDS):
        pull = np.exp(-0.5 * np.sum((difference - offset[of]) ** 2, axis=1) / config.vote_kernel_m**2)
        pairs = np.bincount(of, pull, count).astype(np.float64)
        moved = np.stack([np.bincount(of, pull * difference[:, i], count) for i in (0, 1)], axis=-1)
        offset = np.where(pairs[:, None] > 0, moved / np.maximum(pairs, 1e-12)[:, None], offset)
    return offset, pairs


def offsets_of(keys: Sequence[str], votes: Votes) -> FloatArray:
    """Return the offset of each drive that its votes agree on, (N, 2) metres, by least squares.

    Of drives that overlap, directly or through others, the one with the smallest key has none: the offsets depend on
    which drives there are, not on their order.
    """
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import

    count = len(keys)
    row = {key: number for number, key in enumerate(keys)}
    rows = np.array([(row[a], row[b]) for a, b in votes], dtype=np.int64).reshape(-1, 2)
    said = np.array(list(votes.values()), dtype=np.float64).reshape(-1, 3)
    a, b = rows.T
    part = linked_groups(a, b, count)
    first = {int(group): number for number, group in reversed([(i, part[i]) for i in np.argsort(keys)])}
    offset: FloatArray = np.zeros((count, 2))
    weight, pinned = said[:, 2].copy(), list(first.values())
    signs, each = np.tile([1.0, -1.0], len(rows)), np.repeat(np.arange(len(rows)), 2)
    minus: Any = coo_array((signs, (each, rows.reshape(-1))), shape=(len(rows), count)).tocsr()
    for _ in range(_ROUNDS if len(rows) else 0):
        system = (minus.T @ minus.multiply(weight[:, None])).toarray()
        system[pinned, pinned] += 1.0
        offset = np.linalg.solve(system, minus.T @ (weight[:, None] * said[:, :2]))
        rest = np.sum((minus @ offset - said[:, :2]) ** 2, axis=1)
        weight = said[:, 2] * np.maximum(np.exp(-0.5 * rest / _OFF_M**2), 1e-3)
    return offset


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
    def of(cls, std_m: float, spacing_m: float, count: int, drift_length_m: float) -> "Prior":
        """Return that of one drive."""
        kept = min(np.exp(-spacing_m / drift_length_m), 1.0 - 1e-6)
        unit = 1.0 / (std_m**2 * (1.0 - kept**2))
        diagonal = np.full(count, (1.0 + kept**2) * unit)
        diagonal[[0, -1]] = unit
        beside = np.append(np.full(count - 1, -kept * unit), 0.0)
        return cls(diagonal, beside)

    @classmethod
    def joined(cls, priors: "Sequence[Prior]") -> "Prior":
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
        return (1.0 - share) * knots[self.knot] + share * knots[self.knot + 1]

    def positions(self, knots: FloatArray) -> FloatArray:
        """Return where the places are, (P, 2): the weighted mean of what was seen, offsets taken away."""
        values, total = self.xy - self.offsets(knots), np.bincount(self.place, self.weight)
        return np.stack([np.bincount(self.place, self.weight * each) / total for each in values.T], axis=-1)


def adjust(sightings: Sightings, prior: Prior, start: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the (K, 2) knots of least squares, and how far each would move if it alone were free, metres.

    Only those that are `free`, (K,), move. Where to `start`, (K, 2), changes the result by tenths of a millimetre.
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
        return cho_solve_banded((bands, True), may_move * rest)

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
