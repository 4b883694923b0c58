"""The scale of remission."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from interloc.labelling.networks import remission_scale

SPREAD = np.random.default_rng(0).uniform(0, 1, 5000)


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        *((highest * SPREAD, 1.0) for highest in (0.3, 1.0, 1.2)),
        *((highest * SPREAD, 255.0) for highest in (20.0, 255.0)),
        (3000.0 * SPREAD, 65535.0),
        (np.concatenate([[1e9, np.nan, np.inf], np.full(5000, 0.3)]), 1.0),  # single wrong values do not matter
        *((none, 1.0) for none in ([], [0.0, 0.0], [np.nan])),
        (np.arange(256, dtype=np.uint8), 255.0),
        (np.arange(0, 60000, 10, dtype=np.uint16), 65535.0),
    ],
)
def test_smallest_scale_that_holds_the_values(values: ArrayLike, scale: float) -> None:
    assert remission_scale(values) == scale  # type: ignore[arg-type]
