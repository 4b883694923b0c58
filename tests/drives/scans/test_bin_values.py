"""How the values of .bin files stand: other numbers of values per point, row by row, and what is not float32."""

import numpy as np
import pytest

from interloc.drives.scans.bin_files import layout_of

RNG = np.random.default_rng(2)
POINTS = np.column_stack(
    [RNG.uniform(-40, 40, (3000, 2)), RNG.normal(-1.7, 0.2, 3000), RNG.uniform(0, 1, 3000)]
).astype(np.float32)
RING, TIME = np.arange(3000) % 64, np.linspace(-0.05, 0.05, 3000)
NONE = np.array([np.nan])


def layout(points: np.ndarray, labels: np.ndarray = NONE) -> tuple[int, str]:
    values = np.ascontiguousarray(points).view("<f4").ravel()
    return layout_of(values, np.full(len(labels), values.nbytes), labels)


@pytest.mark.parametrize(
    "more", [[], [RING], [RING, TIME], [TIME, RING, RING * 3 + 1.0], [np.zeros(3000)], [POINTS[:, 3], TIME]]
)
def test_columns_tell_the_values_per_point_and_no_order_is_needed(more: list[np.ndarray]) -> None:
    points = np.column_stack([POINTS, *more]).astype(np.float32)
    assert layout(points) == (4 + len(more), "")
    assert layout(RNG.permutation(points)) == (4 + len(more), "")
    assert "row by row" in layout(points.T)[1]


def test_labels_and_sizes_tell_where_values_do_not() -> None:
    alike = RNG.normal(size=(2400, 1)).astype(np.float32)
    assert layout(alike) == (4, "")
    assert layout(alike, np.array([400.0])) == (6, "")
    assert layout(alike[:2395]) == (5, "")  # a multiple of 20 bytes, not of 16
    assert layout(np.zeros((3000, 6), np.float32)) == (4, "")


def test_what_is_not_float32_is_named() -> None:
    assert "Usual cause: float64" in layout(POINTS.astype(np.float64) + 1e-9)[1]
    records = np.zeros((3000, 4), np.uint16)
    records[:, :3] = np.rint((POINTS[:, :3] + 100) / 0.005)
    records[:, 3] = RING << 8 | 30
    assert "as NCLT has them" in layout(records)[1]
