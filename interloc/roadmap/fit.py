"""Centrelines and widths to a fraction of a cell: both edges of the road, every half metre along each street.

The edge of a road is where the count falls to half of that in its middle, a threshold that moves with the place. Parked
cars hide the kerb and nothing adds to it, so a side is a high quantile along the road; yards, bays and lay-bys add to
it for less than 50 m, so the narrower line on both sides of them is held.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray
from interloc.geometry import travelled
from interloc.kernels.streets import nearest, ranked, solve_banded
from interloc.mapping.mosaic import Raster
from interloc.roadmap.graph import Edge, Graph

STEP_M = 0.5
"""Between the stations of a street."""

_REACH_M, _ACROSS_M = 14.0, 0.25
_MIDDLE_M = 1.5
_SHARE = 0.5  # of the count in the middle of the road, at its edge
_MIN_LEVEL = 2.0
_ROUNDS = 3
_SMOOTH_M = 25.0  # bends that are shorter are noise
_FIRST_SMOOTH_M = 12.0
_HINT, _FAINT = 0.02, 1e-4  # weights of the line before: where no edges were measured, where they mislead
_STEADY_M, _ODD_M, _ODD_SHARE = 15.0, 1.0, 0.2  # widths that leave the median around them are not believed
_QUANTILE, _QUANTILE_M, _MEAN_M = 80, 20.0, 10.0
_HELD_M, _HELD_SHARE = 100.0, 0.4  # but not more than this share of the street
_MOST = 85
_WIDER_M = 1.5  # than the line that is held
_MOUTH_M = 5.0  # beyond the edge of the other street
_BESIDE_M, _PARALLEL_COS = 8.0, 0.9  # of the track and a line that it follows
_LANE_M = 3.0  # from the track to the middle of the road
_PIECE = 400  # stations whose counts are looked up at once


@dataclass
class Street:
    """One edge or several that go straight on, as stations every half metre."""

    nodes: list[int]
    """That it passes, in its direction."""
    rows: list[int]
    """The station at each of them."""
    xy: FloatArray
    """(N, 2) float64: the centreline."""
    is_seen: BoolArray
    """(N,) bool."""
    is_free: BoolArray
    """(N,) bool: away from the mouths of other streets."""
    track: FloatArray
    """(N, 2) float64: the vehicle where it went beside the line; else NaN."""
    is_used: BoolArray
    """(N,) bool: both edges of the road were measured there."""
    left_m: FloatArray
    right_m: FloatArray
    """(N,) float64: from the centreline to the edges."""
    level: FloatArray
    """(N,) float64: count in the middle."""
    scatter_m: float = float("nan")
    """One sigma of a single station's middle around the line."""


def fit(raster: Raster, graph: Graph, chains: Sequence[Sequence[tuple[int, Edge]]], track: FloatArray) -> list[Street]:
    """Fit the streets of a graph, edges by street (`interloc.roadmap.topology.strokes`), to the counts of a mosaic.

    `track`, (K, 2), holds the places of the vehicle in their order.
    """
    mouths: dict[int, dict[int, float]] = {node: {} for node in graph.nodes}  # half the width of each arm some way out
    for node, arms in mouths.items():
        for number, edge in graph.arms(node):
            arms[number] = float(np.median(edge.half_m[16:60] if len(edge.half_m) > 20 else edge.half_m))
    streets = [_street(chain, mouths, track) for chain in chains]
    if not streets:
        return []
    stations = np.concatenate([street.xy[::8] for street in streets])
    owner = np.repeat(np.arange(len(streets)), [len(street.xy[::8]) for street in streets])
    for number, street in enumerate(streets):
        for _ in range(_ROUNDS):
            _measure(raster, street, stations, owner, number)
    return streets


def _street(chain: Sequence[tuple[int, Edge]], mouths: Mapping[int, Mapping[int, float]], track: FloatArray) -> Street:
    whole = chain[0][1]
    for _, edge in chain[1:]:
        whole = whole.then(edge)
    along = travelled(whole.xy)
    count = max(3, round(along[-1] / STEP_M) + 1)
    at = np.linspace(0.0, along[-1], count)
    xy = np.stack([np.interp(at, along, whole.xy[:, k]) for k in (0, 1)], axis=-1)
    rows = np.minimum(np.searchsorted(along, at), len(along) - 1)
    ends = np.cumsum([edge.length_m for _, edge in chain])
    is_free = np.ones(count, np.bool_)
    own = {number for number, _ in chain}
    nodes = [chain[0][1].start, *(edge.end for _, edge in chain)]
    for node, where in zip(nodes, [0.0, *ends.tolist()], strict=True):
        others = [half for number, half in mouths[node].items() if number not in own]
        reach = max(others) + _MOUTH_M if others else 2.0
        here, apart = xy[round(where / along[-1] * (count - 1))], np.abs(at - where)
        is_near = np.linalg.norm(xy - here, axis=1) <= reach  # the skeleton of a fork leads there and back
        is_free &= (apart > reach) & ~(is_near & (apart < 4.0 * reach))
    none = np.full(count, np.nan)
    stops = [0, *(round(end / along[-1] * (count - 1)) for end in ends.tolist())]
    beside, is_seen, zero = _beside(xy, track), whole.is_seen[rows], np.zeros(count)
    street = Street(nodes, stops, xy, is_seen, is_free, beside, is_free.copy(), none, none.copy(), zero)
    street.xy = _smoothed(np.where(np.isnan(street.track), xy, street.track), np.ones(count), _FIRST_SMOOTH_M)
    return street


def _beside(xy: FloatArray, track: FloatArray) -> FloatArray:
    """Return the place of the vehicle beside each station of a line, (N, 2); NaN where it did not go along it."""
    if len(track) < 2:
        return np.full_like(xy, np.nan)
    distance, row = (each[:, 0] for each in nearest(xy, track, _BESIDE_M))
    way, track_way = np.gradient(xy, axis=0), np.gradient(track, axis=0)[row]
    parallel = np.abs(np.sum(way * track_way, axis=1))
    parallel /= np.maximum(np.linalg.norm(way, axis=1) * np.linalg.norm(track_way, axis=1), 1e-9)
    is_beside = np.isfinite(distance) & (parallel > _PARALLEL_COS)
    return np.where(is_beside[:, None], track[row], np.nan)


def _smoothed(xy: FloatArray, weight: FloatArray, length_m: float) -> FloatArray:
    """Return the line that bends least and keeps to (N, 2) positions (Whittaker 1923); waves of a length lose half.

    The weight is 0 where a position is not known.
    """
    stiff = (length_m / (2.0 * np.pi * STEP_M)) ** 4
    bands = np.zeros((len(xy), 3))  # of D'D, where D takes second differences
    for k, row in enumerate(([1.0, -2.0, 1.0], [4.0, -2.0, 0.0], [1.0, 0.0, 0.0])):
        bands[k : len(xy) - 2 + k] += stiff * np.array(row)
    bands[:, 0] += weight
    return np.asarray(xy[0] + solve_banded(bands, weight[:, None] * (xy - xy[0])))  # of 5,000 km few digits are left


def _measure(raster: Raster, street: Street, stations: FloatArray, owner: IntArray, number: int) -> None:
    """Measure the sides of a street around its line, then move the line to the middle."""
    tangent = np.gradient(street.xy, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-9)[:, None]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)  # to the left
    limit = _limits(street.xy, normal, stations, owner, number)
    left, right, level = _sides(raster, street.xy, normal, limit)
    is_known = street.is_free & street.is_seen & np.isfinite(left + right) & (level >= _MIN_LEVEL)
    is_known &= limit.min(axis=1) > _MIDDLE_M  # two lines in one middle: which side is whose cannot be told
    street.level, street.is_used = level, np.zeros_like(is_known)
    if np.count_nonzero(is_known) < 3:
        return
    left, right = (_filled(side, is_known) for side in (left, right))
    width = left + right
    steady = _quantile(width, 50, _STEADY_M)
    is_known &= np.abs(width - steady) <= np.maximum(_ODD_M, _ODD_SHARE * steady)
    if np.count_nonzero(is_known) < 3:
        return
    filled = [_filled(side, is_known) for side in (left, right)]
    unhidden = [np.minimum(side, _quantile(side, 50, _STEADY_M) + _ODD_M) for side in filled]  # what cars hide
    left, right = (_quantile(side, _QUANTILE, _QUANTILE_M) for side in unhidden)
    is_pulled = left + right > _held(left + right) + 2.0 * _WIDER_M
    if np.count_nonzero(is_pulled & is_known) > np.count_nonzero(is_known) / 2:
        is_pulled[:] = False
    narrowed = np.stack([_narrowed(left), _narrowed(right)])
    left, right = np.asarray(cv2.blur(narrowed, (_odd(_MEAN_M), 1), borderType=cv2.BORDER_REPLICATE), np.float64)
    # What would move the middle of the road too far away from the vehicle, which keeps to a lane of it, is cut.
    away = np.nan_to_num((left - right) / 2.0 - np.sum((street.track - street.xy) * normal, axis=1))
    street.left_m = left - 2.0 * np.maximum(away - _LANE_M, 0.0)
    street.right_m = right - 2.0 * np.maximum(-away - _LANE_M, 0.0)
    is_sure = is_known & ~is_pulled
    middle = street.xy + np.where(is_sure, (left - right) / 2.0, 0.0)[:, None] * normal
    weight = np.where(is_sure, 1.0, np.where(street.is_free & ~is_pulled, _HINT, _FAINT))
    smooth = _smoothed(middle, weight, _SMOOTH_M)
    residual = np.sum((middle - smooth) * normal, axis=1)[is_sure]
    street.scatter_m = float(1.4826 * np.median(np.abs(residual))) if len(residual) else float("nan")
    street.is_used = is_known
    street.xy = smooth


def _held(values: FloatArray) -> FloatArray:
    """Return values without what is higher for a short way than before and after."""
    length_m = min(_HELD_M, _HELD_SHARE * len(values) * STEP_M)
    low = _quantile(values, 100 - _MOST, length_m)  # an opening that does not believe single dips
    return _quantile(low, _MOST, length_m)


def _narrowed(side: FloatArray) -> FloatArray:
    """Return a side without its yards, bays and lay-bys."""
    held = _held(side)
    return np.where(side > held + _WIDER_M, held, side)


def _odd(length_m: float) -> int:
    return 2 * round(length_m / STEP_M / 2) + 1


def _quantile(values: FloatArray, percent: int, length_m: float) -> FloatArray:
    return ranked(values, _odd(length_m), _odd(length_m) * percent // 100)


def _filled(values: FloatArray, is_known: BoolArray) -> FloatArray:
    rows = np.arange(len(values))
    return np.asarray(np.interp(rows, rows[is_known], values[is_known]), np.float64)


def _limits(xy: FloatArray, normal: FloatArray, stations: FloatArray, owner: IntArray, number: int) -> FloatArray:
    """Return how far to look to the left and to the right, (N, 2): half the way to the next street."""
    limits = np.full((len(xy), 2), _REACH_M)
    distance, other = nearest(xy, stations, 2.0 * _REACH_M, 12)
    rows, k = np.nonzero(np.isfinite(distance) & (owner[other] != number))
    across = np.sum((stations[other[rows, k]] - xy[rows]) * normal[rows], axis=1)
    beside = np.abs(across) > 0.7 * distance[rows, k]
    side = np.where(across > 0.0, 0, 1)
    np.minimum.at(limits, (rows[beside], side[beside]), np.abs(across[beside]) / 2.0)
    return limits


def _sides(
    raster: Raster, xy: FloatArray, normal: FloatArray, limit: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the distance to the left and to the right edge, NaN where none was found, and the count in the middle."""
    offsets = np.arange(-_REACH_M, _REACH_M + _ACROSS_M / 2, _ACROSS_M)
    zero, middle = len(offsets) // 2, np.flatnonzero(np.abs(offsets) <= _MIDDLE_M)
    sides, level = np.full((2, len(xy)), np.nan), np.zeros(len(xy))
    for begin in range(0, len(xy), _PIECE):
        part = slice(begin, begin + _PIECE)
        counts = _profiles(raster, xy[part], normal[part], offsets)
        inner = np.partition(counts[:, middle], len(middle) // 2, axis=1)
        level[part] = inner[:, len(middle) // 2]  # the median of an odd number
        threshold = _SHARE * level[part]
        for side, outward in ((0, counts[:, zero:]), (1, counts[:, zero::-1])):
            sides[side, part] = np.minimum(_first_fall(outward, threshold), limit[part, side])
    return sides[0], sides[1], level


def _first_fall(counts: Float32Array, threshold: FloatArray) -> FloatArray:
    """Return where counts outwards fall below a threshold, metres; infinite where they do not."""
    is_below = counts < threshold[:, None]
    first = np.argmax(is_below, axis=1)
    every = np.arange(len(counts))
    falls = is_below[every, first]
    rows = every[falls & (first > 0)]
    place = np.where(falls, np.nan, np.inf)  # NaN: below in the middle already
    here, before = (counts[rows, at].astype(np.float64) for at in (first[rows], first[rows] - 1))
    place[rows] = (first[rows] - 1 + (before - threshold[rows]) / np.maximum(before - here, 1e-9)) * _ACROSS_M
    return place


def _profiles(raster: Raster, xy: FloatArray, normal: FloatArray, offsets: FloatArray) -> Float32Array:
    """Return the counts across some stations, (N, S), between the middles of cells by bilinear look-up."""
    at, first, size = [], [], []
    for axis, sign in ((0, 1.0), (1, -1.0)):
        cells = (xy[:, axis, None] + offsets * normal[:, axis, None]) * sign / raster.cell_m - 0.5
        ends = cells[:, [0, -1]]  # a profile is straight
        first.append(int(np.floor(ends.min())))
        size.append(int(np.ceil(ends.max())) + 2 - first[-1])
        at.append((cells - first[-1]).astype(np.float32))
    window = raster.window(first[1], first[0], size[1], size[0])
    if window is None:
        return np.zeros((len(xy), len(offsets)), np.float32)
    return np.asarray(cv2.remap(window.astype(np.float32), at[0], at[1], cv2.INTER_LINEAR), np.float32)
