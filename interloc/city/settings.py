"""Settings of the map of many drives."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class CityConfig(BaseModel):
    """How drives become one map."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    vote_radius_m: float = Field(
        15.0, gt=0, le=200, description="Largest offset between two drives that is looked for."
    )
    vote_kernel_m: float = Field(
        1.5, gt=0, le=50, description="Scatter of the differences between what two drives saw, once they are shifted."
    )
    gate_m: float = Field(
        6.0,
        gt=0,
        le=50,
        description="Sightings of several drives farther apart than this, offsets taken away, are never one place; two "
        "of one drive are two places unless they lie nearer.",
    )
    bandwidth_m: float = Field(
        2.0, gt=0, le=20, description="Scatter of the sightings of one place, offsets taken away."
    )
    together: float = Field(
        0.15,
        ge=0,
        lt=1,
        description="Two places are two if more than this share of the drives that saw the rarer one saw both.",
    )
    knot_spacing_m: float = Field(
        500.0, gt=0, le=100_000, description="Distance driven between two knots of the offset of a drive."
    )
    drift_length_m: float = Field(
        1440.0,
        gt=0,
        le=1e6,
        description="Distance driven after which the offset of a drive has mostly forgotten what it was (1/e).",
    )
    noise_std_m: float = Field(
        0.3,
        gt=0,
        le=50,
        description="Scatter between drives along each axis that the scatter within one drive does not show.",
    )
    min_share: float = Field(
        0.3, ge=0, le=1, description="Share of the passes that came near a place which must have seen it."
    )
    near_m: float = Field(
        20.0, gt=0, le=100, description="Distance of the track within which a drive should see an intersection."
    )
