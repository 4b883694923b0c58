"""Label schemes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.drives.labels import KITTI360, LEARNING, SCHEMES, SEMANTICKITTI, guess_scheme, named_scheme
from interloc.errors import ConfigError


def test_road_of_every_scheme() -> None:
    assert {name: sorted(scheme.road) for name, scheme in SCHEMES.items()} == {
        "semantickitti": [40, 60],
        "learning": [9],
        "kitti360": [7],
        "las": [11],
    }


def test_confusable_ground_of_every_scheme() -> None:
    """Parking, sidewalk, other ground."""
    assert {name: sorted(scheme.confusable) for name, scheme in SCHEMES.items()} == {
        "semantickitti": [44, 48, 49],
        "learning": [10, 11, 12],
        "kitti360": [6, 8, 9],
        "las": [2],
    }


@pytest.mark.parametrize("scheme", SCHEMES.values(), ids=lambda scheme: scheme.name)
def test_the_groups_of_a_scheme_are_known_and_apart(scheme) -> None:  # noqa: ANN001
    assert scheme.road | scheme.confusable <= scheme.known
    assert not scheme.road & scheme.confusable


@given(st.frozensets(st.integers(0, 65535), min_size=1, max_size=20))
def test_the_table_holds_the_custom_ids_and_no_others(ids: frozenset[int]) -> None:
    scheme = named_scheme(",".join(map(str, ids)))
    assert scheme is not None
    assert set(np.flatnonzero(scheme.groups() == 1).tolist()) == ids
    assert not (scheme.groups() == 2).any()


@pytest.mark.parametrize("choice", ["40,60", "40 60", " 60, 40 "])
def test_ids_as_text(choice: str) -> None:
    scheme = named_scheme(choice)
    assert scheme is not None
    assert scheme.road == {40, 60}


@pytest.mark.parametrize("choice", ["", "kitty", "40;60", "-1", "70000", "²"])
def test_choices_that_are_none(choice: str) -> None:
    with pytest.raises(ConfigError, match="label scheme"):
        named_scheme(choice)


def test_auto_is_left_to_the_ids() -> None:
    assert named_scheme("auto") is None
    assert named_scheme("learning") is LEARNING


@pytest.mark.parametrize(
    ("ids", "kitti360", "expected"),
    [
        ([0, 10, 40, 48, 70, 252], False, SEMANTICKITTI),
        ([0, 1, 9, 11, 15, 19], False, LEARNING),
        ([0, 1, 9, 11, 15, 19], True, LEARNING),
        ([0, 10, 11, 13], False, SEMANTICKITTI),  # cars only: no 9
        ([6, 7, 8, 11, 21, 26], True, KITTI360),
        ([6, 7, 8, 11, 21, 26, 65535], True, KITTI360),
        ([6, 7, 8, 11, 21, 26], False, SEMANTICKITTI),
        ([0, 10, 40, 48, 70], True, SEMANTICKITTI),  # a network trained on SemanticKITTI
    ],
)
def test_the_ids_tell_the_scheme(ids: list[int], kitti360: bool, expected: object) -> None:
    assert guess_scheme(np.array(ids), kitti360=kitti360) is expected
