"""The scale of remission."""

from __future__ import annotations

import numpy as np
import pytest

from interloc.labelling.networks import remission_scale


@pytest.mark.parametrize(
    ("highest", "scale"), [(1.0, 1.0), (0.3, 1.0), (1.2, 1.0), (20.0, 255.0), (255.0, 255.0), (3000.0, 65535.0)]
)
def test_smallest_scale_that_holds_the_values(highest: float, scale: float) -> None:
    assert remission_scale(np.random.default_rng(0).uniform(0, highest, 5000)) == scale


def test_single_wrong_values_do_not_matter() -> None:
    values = np.full(5000, 0.3, np.float32)
    values[:3] = 1e9, np.nan, np.inf
    assert remission_scale(values) == 1.0


@pytest.mark.parametrize("values", [[], [0.0, 0.0], [np.nan]])
def test_no_values_are_left_as_they_are(values: list[float]) -> None:
    assert remission_scale(values) == 1.0


def test_whole_numbers() -> None:
    assert remission_scale(np.arange(256, dtype=np.uint8)) == 255.0
    assert remission_scale(np.arange(0, 60000, 10, dtype=np.uint16)) == 65535.0
