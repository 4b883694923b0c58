"""What is accepted and what is not."""

from __future__ import annotations

from interloc.localization.evidence import MARGIN, MIN_ROAD, Evidence, decide, too_short


def evidence(road: float, seen: int = 0, at_nodes: int = 0, missed: int = 0) -> Evidence:
    return Evidence(road, seen, at_nodes, at_nodes + missed, missed, 1.0, 0.0)


def test_a_good_place_far_ahead_is_found() -> None:
    assert decide(evidence(0.9), 0.5, 0.5, 1000.0).outcome == "found"


def test_a_runner_up_close_by_makes_it_ambiguous() -> None:
    decision = decide(evidence(0.9), 0.9 - MARGIN / 2, 0.3, 1000.0)
    assert decision.outcome == "ambiguous"
    assert "longer drive" in decision.advice


def test_a_short_drive_needs_a_larger_lead_above_all_by_its_trajectory_alone() -> None:
    assert decide(evidence(0.9), 0.9 - 1.5 * MARGIN, 0.3, 1000.0).found
    assert not decide(evidence(0.9), 0.9 - 1.5 * MARGIN, 0.3, 500.0).found
    assert decide(evidence(0.9, seen=4, at_nodes=4), 1.4 - 1.5 * MARGIN, 0.3, 500.0).found
    assert not decide(evidence(0.9, seen=4, at_nodes=4), 1.4 - 1.2 * MARGIN, 0.3, 500.0).found
    assert decide(evidence(0.9, seen=4, at_nodes=4), 1.4 - 1.2 * MARGIN, 0.3, 700.0).found


def test_no_better_than_chance_is_not_found() -> None:
    decision = decide(evidence(0.9), 0.3, 0.9 - MARGIN / 2, 1000.0)
    assert decision.outcome == "not_found"
    assert "chance" in decision.reason


def test_a_track_beside_the_roads_is_not_found() -> None:
    assert decide(evidence(MIN_ROAD - 0.01), 0.0, 0.0, 1000.0).outcome == "not_found"
    assert decide(None, 0.0, 0.0, 1000.0).outcome == "not_found"


def test_intersections_at_the_wrong_places_speak_against_it() -> None:
    assert decide(evidence(0.9, seen=6, at_nodes=6), 0.5, 0.5, 1000.0).outcome == "found"
    decision = decide(evidence(0.9, seen=6, at_nodes=1, missed=5), 0.5, 0.5, 1000.0)
    assert decision.outcome == "not_found"
    assert "1 of the 6 intersections" in decision.reason


def test_intersections_count_for_both_sides() -> None:
    assert evidence(1.0, seen=4, at_nodes=4).score == 1.5
    assert evidence(1.0, seen=4, at_nodes=2, missed=2).intersections == 0.5
    assert evidence(1.0).score == 1.0


def test_a_short_drive_is_told_what_would_help() -> None:
    assert "longer drive" in too_short(12.0).advice
