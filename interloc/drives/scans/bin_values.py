"""How the values of .bin files stand: told by the labels that go with them, by the values themselves, and by sizes.

A column of a scan holds values of one kind, where a wrong number of values per point mixes them in every column. So the
right one is that whose columns are the least mixed (entropy, over bins that all values fill alike); that needs neither
an order of the points nor a kind of sensor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray

_COUNTS = (4, 3, 5, 6, 7, 8, 9, 10)  # values per point that are tried, the usual one first
_ROWS = (3, 4, 5, 6)
_BINS, _MIN_VALUES, _MAX_VALUES = 64, 2000, 2_000_000
_CLEAR, _TWICE_CLEAR = 0.2, 0.5  # nats; of 8 values, two points of 4 by turns differ a little, too
_FAR, _TINY, _MANY = 1e8, 1e-6, 0.05  # share of values that no coordinate in metres has
_ROW_BY_ROW = (
    "its values stand row by row (all x, then all y, z, ...), as Oxford RobotCar keeps them. Expected four float32 per "
    "point, one point after the other: np.fromfile(FILE, np.float32).reshape(4, -1).T.tofile(FILE) for every scan, "
    "with the number of values per point in place of 4."
)
_NO_FLOATS = (
    "its values are not float32: {share:.0%} of them are no metres. Expected four float32 per point (x y z remission). "
    "Usual cause: {cause}; write every scan anew as float32."
)
_NCLT = "eight bytes per point, as NCLT has them (uint16 x y z in steps of 5 mm from -100 m, uint8 intensity and laser)"


class BinLayout(NamedTuple):
    """How the values of a drive's scans stand."""

    values_per_point: int
    fault: str = ""
    """Why they cannot be read so, in words that follow the name of a file."""


def layout_of(values: Float32Array, sizes: IntArray, label_counts: FloatArray) -> BinLayout:
    """Find out how the (V,) values of one scan stand, given the (N,) bytes of all and the (L,) numbers of their labels.

    `label_counts` are NaN for scans without labels.
    """
    if (share := _share_of_no_metres(values)) > _MANY:
        cause = "float64" if _share_of_no_metres(values[: len(values) // 2 * 2].view("<f8")) < _MANY / 2 else "integers"
        if not (sizes % 8).any() and _looks_like_nclt(values):
            cause = _NCLT
        return BinLayout(4, _NO_FLOATS.format(share=share, cause=cause))
    values = values[:_MAX_VALUES]
    if len(values) >= _MIN_VALUES and np.isfinite(values).all():
        edges = np.quantile(values[::7], np.linspace(0, 1, _BINS + 1)[1:-1])
        bins = np.searchsorted(np.unique(edges), values)
        whole = {count: bins[: len(bins) // count * count] for count in _COUNTS}
        mixed = {count: _mixture(each.reshape(-1, count).T) for count, each in whole.items()}
        rows = [_mixture(whole[count].reshape(count, -1)) for count in _ROWS]
        least = next(count for count in _COUNTS if mixed[count] <= min(mixed.values()) + _CLEAR / 2)
        if min(rows) < mixed[least] - _CLEAR:
            return BinLayout(4, _ROW_BY_ROW)
        if mixed[least] < mixed[4] - (_TWICE_CLEAR if least == 8 else _CLEAR):
            return BinLayout(least)
        if mixed[4] < max(mixed.values()) - _CLEAR:
            return BinLayout(4)
    known = np.isfinite(label_counts) & (label_counts > 0)
    ratios = np.unique(sizes[known] / (4 * label_counts[known]))
    if len(ratios) == 1 and float(ratios[0]) in {4, 5, 6}:  # 8 may be labels of two bytes each
        return BinLayout(int(ratios[0]))
    fits_five = bool(sizes.all()) and not (sizes % 20).any() and bool((sizes % 16).any())
    return BinLayout(5 if fits_five else 4)


def _mixture(columns: IntArray) -> float:
    """Return the mean entropy of the bins in some columns, in nats."""
    total = 0.0
    for column in columns:
        share = np.bincount(column) / len(column)
        share = share[share > 0]
        total -= float((share * np.log(share)).sum())
    return total / len(columns)


def _share_of_no_metres(values: Float32Array | FloatArray) -> float:
    size = np.abs(values[np.isfinite(values)])
    return float(((size > _FAR) | ((size > 0) & (size < _TINY))).mean()) if len(size) else 0.0


def _looks_like_nclt(values: Float32Array) -> bool:
    return bool((np.abs(np.median(values.view("<u2").reshape(-1, 4)[:, :3], axis=0) - 20_000) < 10_000).all())
