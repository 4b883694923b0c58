"""Settings of maps of many drives, and what people say of findings.

A verdict is about a place, not only about the finding: what was marked wrong does not come back as a finding of another
kind. All verdicts are kept; the last one of a finding counts.
"""

import math
from collections.abc import Iterable
from datetime import datetime
from typing import Literal, get_args

from pydantic import AwareDatetime, BaseModel, Field

from interloc.osm.policies import FindingKind
from interloc.output.geojson import Feature
from interloc.output.properties import OsmIdOrNone


class CityConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """How drives become one map."""

    vote_radius_m: float = Field(default=15.0, gt=0, le=200, description="Largest offset of two drives looked for.")
    vote_kernel_m: float = Field(
        default=1.5, gt=0, le=50, description="Scatter of the differences between what two drives saw, once shifted."
    )
    gate_m: float = Field(
        default=6.0,
        gt=0,
        le=50,
        description="Sightings of several drives farther apart than this, offsets taken away, are never one place; two "
        "of one drive are two places unless they lie nearer.",
    )
    bandwidth_m: float = Field(
        default=2.0, gt=0, le=20, description="Scatter of the sightings of one place, offsets taken away."
    )
    together: float = Field(
        default=0.15,
        ge=0,
        lt=1,
        description="Two places are two if more than this share of the drives that saw the rarer one saw both.",
    )
    knot_spacing_m: float = Field(
        default=500.0, gt=0, le=100_000, description="Distance driven between two knots of the offset of a drive."
    )
    drift_length_m: float = Field(
        default=1440.0,
        gt=0,
        le=1e6,
        description="Distance driven after which the offset of a drive has mostly forgotten what it was (1/e).",
    )
    noise_std_m: float = Field(
        default=0.3,
        gt=0,
        le=50,
        description="Scatter between drives along each axis that the scatter within one drive does not show.",
    )
    min_share: float = Field(
        default=0.3, ge=0, le=1, description="Share of the passes that came near a place which must have seen it."
    )
    near_m: float = Field(
        default=20.0, gt=0, le=100, description="Distance of the track within which a drive should see an intersection."
    )


class AuditConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """What it takes to say that OpenStreetMap is wrong."""

    kinds: tuple[FindingKind, ...] = Field(
        default=get_args(FindingKind),
        description="Kinds of findings: a junction that the map lacks; a branch that a junction of the map lacks; a "
        "junction that lies elsewhere; one whose roads come to one place and are not joined (not_joined), or cross "
        "without a node (no_node).",
    )
    min_passes: int = Field(default=2, ge=1, le=1000, description="Independent passes that must agree.")
    min_confidence: float = Field(default=0.8, ge=0, le=1, description="Confidence of a place.")
    junction_m: float = Field(
        default=15.0, gt=0, le=100, description="Distance within which a junction of the map is that of a place."
    )
    ray_m: float = Field(
        default=5.0, gt=0, le=50, description="A branch farther than this from every way of the map is not on it."
    )
    min_width_m: float = Field(default=3.0, ge=0, le=100, description="Branches that are narrower are paths.")
    max_width_m: float = Field(
        default=9.0, gt=0, le=100, description="Branches wider, or of no known width, are squares and car parks."
    )
    min_road: float = Field(
        default=0.65,
        ge=0,
        le=1,
        description="A branch must have been seen as a road so far, as a share of how far the same drive saw the side "
        "roads that the map has.",
    )
    moved_m: float = Field(default=6.0, gt=0, le=100, description="Distance from which on a junction lies elsewhere.")
    moved_sigma: float = Field(
        default=3.5, gt=0, le=100, description="The same in standard deviations of the position of the place."
    )
    kept: float = Field(
        default=0.7, gt=0, le=1, description="An old finding stays while it reaches this share of what a new one must."
    )


Verdict = Literal["right", "wrong", "cannot_tell", "fixed"]
"""The map is wrong there, as found; it is not; nobody can tell; it was wrong, and has been mended."""

_Z = 1.959964  # of a normal distribution: 95 % lie within


class Judgement(BaseModel, frozen=True):
    """What somebody said of a finding."""

    finding: str
    kind: FindingKind
    verdict: Verdict
    by: str = Field(max_length=255)
    at: AwareDatetime
    note: str | None = None
    uid: str | None = None
    osm_id: OsmIdOrNone = None
    lon: float
    lat: float


class Precision(BaseModel):
    """How many of the findings that somebody looked at are right; fixed ones were."""

    right: int
    wrong: int
    cannot_tell: int
    share: float | None = Field(description="Right ones among right and wrong ones; null without any.")
    low: float | None = Field(description="Lower bound of the share with 95 % confidence (Wilson).")
    high: float | None = Field(description="Upper bound.")

    @classmethod
    def of(cls, verdicts: Iterable[Verdict]) -> "Precision":
        """Count the last verdict of each finding."""
        found = list(verdicts)
        right = found.count("right") + found.count("fixed")
        wrong = found.count("wrong")
        low, high = wilson(right, right + wrong)
        share = right / (right + wrong) if right + wrong else None
        cannot_tell = found.count("cannot_tell")
        return cls(right=right, wrong=wrong, cannot_tell=cannot_tell, share=share, low=low, high=high)


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


def judgement_of(feature: Feature, verdict: Verdict, by: str, at: datetime, note: str | None = None) -> Judgement:
    """Return a judgement of a feature of the layer `findings`."""
    assert feature["geometry"] is not None
    facts, (lon, lat) = feature["properties"], feature["geometry"]["coordinates"]
    return Judgement.model_validate(
        {
            "finding": facts["id"], "kind": facts["kind"], "uid": facts["uid"], "osm_id": facts["osm_id"],
            "verdict": verdict, "by": by, "at": at, "note": note, "lon": lon, "lat": lat,
        }
    )  # fmt: skip
