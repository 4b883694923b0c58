import math
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.evaluation.metrics import THRESHOLDS_M, UNMATCHED, Matching, score, summarize_errors


def matching(errors: list[float], zone_found: list[bool]) -> Matching:
    error = np.array(errors, dtype=np.float64)
    return Matching(
        node=np.where(np.isfinite(error), 0, UNMATCHED),
        error_m=error,
        zone_keyframe=np.arange(len(zone_found)),
        zone_node=np.zeros(len(zone_found), dtype=np.int64),
        zone_found=np.array(zone_found, dtype=np.bool_),
    )


def test_thresholds_are_those_of_the_paper() -> None:
    assert THRESHOLDS_M[:3] == (0.5, 1.0, 1.5)
    assert (6.9 in THRESHOLDS_M, 13.3 in THRESHOLDS_M, len(THRESHOLDS_M)) == (True, True, 22)


def test_counts_and_ratios_of_five_detections() -> None:
    made = matching([1.0, 2.0, 4.0, 20.0, math.inf], [True, True, False])
    scores = score(made, (1.5, 5.0))
    assert scores.tp.tolist() == [1, 3]
    assert scores.fp.tolist() == [4, 2]
    assert scores.fn == 1
    assert scores.precision == pytest.approx([1 / 5, 3 / 5])
    assert scores.recall == pytest.approx([1 / 2, 3 / 4])
    assert scores.f1 == pytest.approx([2 * 0.2 * 0.5 / 0.7, 2 * 0.6 * 0.75 / 1.35])


def test_a_pair_at_the_threshold_is_a_false_positive() -> None:
    assert score(matching([5.0], []), (5.0,)).tp.tolist() == [0]


def test_errors_are_averaged_over_all_pairs_and_over_the_near_ones() -> None:
    errors = summarize_errors(matching([1.0, 3.0, 8.0, 40.0, math.inf], []))
    assert errors.ace_m == pytest.approx(13.0)
    assert errors.ace_tp_m == pytest.approx(2.0)
    assert errors.ace_under_10_m == pytest.approx(4.0)
    assert errors.median_m == pytest.approx(5.5)
    assert errors.rmse_m == pytest.approx(math.sqrt((1 + 9 + 64 + 1600) / 4))


def test_what_cannot_be_divided_is_undefined() -> None:
    nothing = score(matching([], []), (5.0,))
    assert nothing.at(5.0, nothing.precision) is None
    assert nothing.at(5.0, nothing.recall) is None
    assert nothing.at(5.0, nothing.f1) is None
    assert set(asdict(summarize_errors(matching([math.inf], []))).values()) == {None}


def test_detecting_nothing_where_something_is_scores_zero() -> None:
    scores = score(matching([], [False]), (5.0,))
    assert scores.at(5.0, scores.precision) is None
    assert scores.at(5.0, scores.recall) == 0.0
    assert scores.at(5.0, scores.f1) == 0.0


distances = st.one_of(st.floats(0, 80), st.just(math.inf))


@given(errors=st.lists(distances, max_size=30), found=st.lists(st.booleans(), max_size=30))
def test_figures_hang_together(errors: list[float], found: list[bool]) -> None:
    scores = score(matching(errors, found))
    assert (scores.tp + scores.fp == len(errors)).all()
    assert scores.fn == found.count(False)
    assert (np.diff(scores.tp) >= 0).all()
    for ratio in (scores.precision, scores.recall, scores.f1):
        defined = ratio[~np.isnan(ratio)]
        assert ((defined >= 0) & (defined <= 1)).all()
        assert (np.diff(defined) >= 0).all()
    both = scores.precision + scores.recall > 0  # false where one of them is NaN
    harmonic = 2 * scores.precision[both] * scores.recall[both] / (scores.precision + scores.recall)[both]
    assert scores.f1[both] == pytest.approx(harmonic)
