"""What is accepted and what is not."""

import pytest

from interloc.localization.evidence import MARGIN, MIN_ROAD, Evidence, decide, too_short


def evidence(road: float, seen: int = 0, at_nodes: int = 0, missed: int = 0) -> Evidence:
    return Evidence(road, seen, at_nodes, at_nodes + missed, missed, 1.0, 0.0)


SEEN = evidence(0.9, seen=4, at_nodes=4)


@pytest.mark.parametrize(
    ("best", "runner_up", "by_chance", "length_m", "outcome"),
    [
        (evidence(0.9), 0.5, 0.5, 1000.0, "found"),
        (evidence(0.9), 0.9 - MARGIN / 2, 0.3, 1000.0, "ambiguous"),
        (evidence(0.9), 0.9 - 1.5 * MARGIN, 0.3, 1000.0, "found"),
        (evidence(0.9), 0.9 - 1.5 * MARGIN, 0.3, 500.0, "ambiguous"),  # a short drive needs a larger lead
        (SEEN, 1.4 - 1.5 * MARGIN, 0.3, 500.0, "found"),  # above all by its trajectory alone
        (SEEN, 1.4 - 1.2 * MARGIN, 0.3, 500.0, "ambiguous"),
        (SEEN, 1.4 - 1.2 * MARGIN, 0.3, 700.0, "found"),
        (evidence(0.9), 0.3, 0.9 - MARGIN / 2, 1000.0, "not_found"),  # no better than chance
        (evidence(MIN_ROAD - 0.01), 0.0, 0.0, 1000.0, "not_found"),  # beside the roads
        (None, 0.0, 0.0, 1000.0, "not_found"),
        (evidence(0.9, seen=6, at_nodes=6), 0.5, 0.5, 1000.0, "found"),
        (SEEN, 0.49, 1.33, 650.0, "found"),  # nothing but its own mirror image comes near
        (SEEN, 1.1, 1.33, 650.0, "not_found"),
        (SEEN, 0.49, 1.36, 650.0, "not_found"),
        (evidence(0.75, seen=4, at_nodes=4), 0.1, 1.18, 650.0, "not_found"),
        (evidence(0.99), 0.1, 0.92, 1000.0, "not_found"),  # without intersections
        (evidence(0.9, seen=6, at_nodes=1, missed=5), 0.5, 0.5, 1000.0, "not_found"),
        (evidence(0.8, seen=6, at_nodes=3, missed=4), 0.5, 0.5, 1000.0, "found"),  # far ahead of both
        (evidence(0.8, seen=6, at_nodes=3, missed=4), 0.5, 0.8, 1000.0, "not_found"),
        (evidence(0.8, seen=6, at_nodes=3, missed=4), 0.8, 0.5, 1000.0, "not_found"),
    ],
)
def test_a_place_must_lead_by_enough(
    best: Evidence | None, runner_up: float, by_chance: float, length_m: float, outcome: str
) -> None:
    assert decide(best, runner_up, by_chance, length_m).outcome == outcome


def test_reasons_and_advice_are_said() -> None:
    assert "longer drive" in too_short(12.0).advice
    assert "longer drive" in decide(evidence(0.9), 0.9 - MARGIN / 2, 0.3, 1000.0).advice
    assert "chance" in decide(evidence(0.9), 0.3, 0.9 - MARGIN / 2, 1000.0).reason
    wrong = evidence(0.9, seen=6, at_nodes=1, missed=5)
    assert "1 of the 6 intersections" in decide(wrong, 0.5, 0.5, 1000.0).reason


def test_intersections_count_for_both_sides() -> None:
    assert evidence(1.0, seen=4, at_nodes=4).score == 1.5
    assert evidence(1.0, seen=4, at_nodes=2, missed=2).intersections == 0.5
    assert evidence(1.0).score == 1.0
