"""What people say of findings."""

from datetime import UTC, datetime, timedelta

import pytest

from interloc.city.models import Judgement, Precision, Verdict, latest, wilson, wrong_ones

NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)


def judgement(finding: str, verdict: Verdict, minute: int) -> Judgement:
    at = NOON + timedelta(minutes=minute)
    return Judgement(finding=finding, kind="moved", verdict=verdict, by="Anna", at=at, lon=8.4, lat=49.0)


def test_wilsons_interval() -> None:
    assert wilson(0, 0) == (None, None)
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, table I
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    found = Precision.of(["right", "fixed", "wrong", "cannot_tell"])
    assert (found.right, found.wrong, found.cannot_tell) == (2, 1, 1)
    assert (found.share, found.low, found.high) == (2 / 3, *wilson(2, 3))


def test_the_last_verdict_of_a_finding_counts() -> None:
    first, second, other = judgement("a", "wrong", 0), judgement("a", "right", 5), judgement("b", "wrong", 1)
    assert latest([second, first, other]) == {"a": second, "b": other}
    assert wrong_ones([second, first, other]) == [other]
