"""What people say of findings, and how many of them are right.

A verdict is about a place, not only about the finding: what was marked wrong does not come back as a finding of another
kind. All verdicts are kept; the last one of a finding counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from interloc.city.settings import Kind

Verdict = Literal["right", "wrong", "cannot_tell", "fixed"]
"""The map is wrong there, as found; it is not; nobody can tell; it was wrong, and has been mended."""

_Z = 1.959964  # of a normal distribution: 95 % lie within


class Judgement(BaseModel):
    """What somebody said of a finding."""

    model_config = ConfigDict(frozen=True)

    finding: str
    kind: Kind
    verdict: Verdict
    by: str = Field(max_length=255)
    at: AwareDatetime
    note: str | None = None
    uid: str | None = None
    osm_id: int | None = None
    lon: float
    lat: float


@dataclass(frozen=True)
class Precision:
    """How many of the findings that people looked at are right, with an interval of 95 % (Wilson)."""

    right: int
    wrong: int
    cannot_tell: int
    """Findings; fixed ones are right ones."""
    share: float | None
    low: float | None
    high: float | None
    """Right ones among right and wrong ones; None without any."""

    @classmethod
    def of(cls, verdicts: Iterable[Verdict]) -> Precision:
        """Count the last verdict of each finding."""
        found = list(verdicts)
        right = found.count("right") + found.count("fixed")
        wrong = found.count("wrong")
        low, high = wilson(right, right + wrong)
        share = right / (right + wrong) if right + wrong else None
        return cls(right, wrong, found.count("cannot_tell"), share, low, high)


def wilson(right: int, count: int) -> tuple[float | None, float | None]:
    """Return the bounds of a share of `right` in `count`, with 95 % confidence (Wilson 1927); None without any."""
    if not count:
        return None, None
    share, square = right / count, _Z**2 / count
    middle = (share + square / 2) / (1 + square)
    half = _Z * math.sqrt(share * (1 - share) / count + square / (4 * count)) / (1 + square)
    return max(0.0, middle - half), min(1.0, middle + half)


def latest(judgements: Iterable[Judgement]) -> dict[str, Judgement]:
    """Return the last judgement of each finding."""
    return {each.finding: each for each in sorted(judgements, key=lambda each: each.at)}


def wrong_ones(judgements: Iterable[Judgement]) -> list[Judgement]:
    """Return those of findings whose last verdict is wrong."""
    return [each for each in latest(judgements).values() if each.verdict == "wrong"]


def judgement_of(
    feature: dict[str, object], verdict: Verdict, by: str, at: datetime, note: str | None = None
) -> Judgement:
    """Return a judgement of a feature of the layer `findings`."""
    facts: dict[str, object] = feature["properties"]  # type: ignore[assignment]
    lon, lat = feature["geometry"]["coordinates"]  # type: ignore[index]
    return Judgement.model_validate(
        {
            "finding": facts["id"], "kind": facts["kind"], "uid": facts["uid"], "osm_id": facts["osm_id"],
            "verdict": verdict, "by": by, "at": at, "note": note, "lon": lon, "lat": lat,
        }
    )  # fmt: skip
