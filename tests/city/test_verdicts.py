"""What people say of findings."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from interloc.city.verdicts import (
    Judgement,
    Precision,
    Verdict,
    add_verdicts,
    latest,
    read_verdicts,
    wilson,
    wrong_ones,
)
from interloc.errors import DamagedResultError

NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)


def judgement(finding: str, verdict: Verdict, minute: int) -> Judgement:
    at = NOON + timedelta(minutes=minute)
    return Judgement(finding=finding, kind="moved", verdict=verdict, by="Anna", at=at, lon=8.4, lat=49.0)


def test_wilsons_interval() -> None:
    assert wilson(0, 0) == (None, None)
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, table I
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert Precision.of(["right", "fixed", "wrong", "cannot_tell"]) == Precision(2, 1, 1, 2 / 3, *wilson(2, 3))


def test_all_verdicts_are_kept_and_the_last_one_counts(tmp_path: Path) -> None:
    path = tmp_path / "verdicts.jsonl"
    assert read_verdicts(path) == []
    first, second, other = judgement("a", "wrong", 0), judgement("a", "right", 5), judgement("b", "wrong", 1)
    add_verdicts(path, [first, other])
    add_verdicts(path, [second])
    assert read_verdicts(path) == [first, other, second]
    assert latest([second, first, other]) == {"a": second, "b": other}
    assert wrong_ones(read_verdicts(path)) == [other]
    path.write_text("{}\n")
    with pytest.raises(DamagedResultError, match="line 1"):
        read_verdicts(path)
