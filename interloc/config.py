"""Configuration of the method: one frozen model per concern, two presets.

Lengths are metres, angles degrees (the suffix says so). A configuration is saved with every result and is the body of
a request to the service.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BaseModel, Field, ValidationError, model_validator

from interloc.errors import ConfigError

_MAX_FAULTS_SHOWN = 20  # in one message
_MAX_VALUE_CHARS = 100  # of each value in a message


class _Config(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    of_older_versions: ClassVar[frozenset[str]] = frozenset()

    @model_validator(mode="before")
    @classmethod
    def _without_those_of_older_versions(cls, values: object) -> object:
        """Open what an older version saved: settings that have gone since have no effect."""
        if isinstance(values, dict) and not cls.of_older_versions.isdisjoint(values):
            return {name: value for name, value in values.items() if name not in cls.of_older_versions}
        return values


class KeyframeConfig(_Config):
    """Which scans are used, and how many of them make one image (paper, section III-B.2)."""

    distance_m: float = Field(
        default=2.0, ge=0, le=1000, description="A scan is a keyframe if it lies farther than this from the last one."
    )
    angle_deg: float = Field(default=5.0, ge=0, le=180, description="A scan is a keyframe if turned by more than this.")
    window: int = Field(default=20, ge=0, le=500, description="n: keyframes before the current one, accumulated.")
    lookahead: int | None = Field(
        default=None,
        ge=0,
        le=500,
        description="Keyframes after the current one that are accumulated; without a value as many as before it. "
        "0 is causal.",
    )

    @property
    def after(self) -> int:
        """Keyframes after the current one that are accumulated."""
        return self.window if self.lookahead is None else self.lookahead


class BevConfig(_Config):
    """The binary image of the region of interest (paper, section III-B.3)."""

    of_older_versions = frozenset({"pool_votes"})

    size_m: float = Field(default=120.0, ge=20, le=400, description="S: side of the region of interest.")
    resolution_m: float = Field(default=0.16, ge=0.05, le=2.0, description="r: side of a cell.")
    min_points: int = Field(default=5, ge=1, le=10000, description="m: points that make a cell road, in a full window.")
    adaptive: bool = Field(
        default=True, description="Lower m where fewer keyframes than a full window lie in the region of interest."
    )
    vote: bool = Field(
        default=False,
        description="Each point of sidewalk, parking or other ground in a cell cancels one of its road points. Where "
        "less than half of a full window's keyframes lie in the region of interest, the votes of the eight cells "
        "around a road cell count too: a quarter each, and up to as much as its own where labels err from point to "
        "point.",
    )
    turn: bool = Field(
        default=False,
        description="The image of each keyframe is turned by an angle of its own, so that what the grid of its cells "
        "does to axes and edges differs from keyframe to keyframe, and the fusion takes it out.",
    )
    max_range_m: float = Field(default=150.0, ge=10, le=1000, description="Points farther from the sensor are ignored.")

    @property
    def cells(self) -> int:
        """Cells along a side of the region of interest."""
        return int(self.size_m / self.resolution_m + 1e-9)

    @model_validator(mode="after")
    def _bounded(self) -> BevConfig:
        if not 64 <= self.cells <= 4096:
            raise ValueError(
                f"size_m / resolution_m makes {self.cells} cells per side; expected 64 to 4096. "
                "Raise resolution_m or lower size_m."
            )
        if (reach := self.max_range_m / self.resolution_m) > 6250:
            raise ValueError(f"max_range_m / resolution_m makes {reach:.0f} cells; expected at most 6,250.")
        return self


class OccupancyConfig(_Config):
    """Closing, then opening, by discs (paper, section III-B.4)."""

    closing_m: float = Field(default=2.4, ge=0, le=20, description="Diameter of the disc that closes gaps of the road.")
    opening_m: float = Field(default=2.4, ge=0, le=20, description="Diameter of the disc that removes small patches.")
    island_m2: float = Field(
        default=0.0,
        ge=0,
        le=10000,
        description="Gaps enclosed by road count as road up to this area: traffic islands, lay-bys; 0 keeps all gaps.",
    )
    edge_m: float = Field(
        default=0.0,
        ge=0,
        le=10,
        description="Depth from its edges to which road is taken back where other ground was seen; 0 takes none back, "
        "half of opening_m or more cuts narrow roads.",
    )


class CenterlineConfig(_Config):
    """The centerline, and what of it is not road (paper, section III-B.5)."""

    of_older_versions = frozenset({"max_width_share"})

    spur_widths: float = Field(
        default=0.0, ge=0, le=10, description="Dead ends shorter than this many local widths are removed; 0 keeps all."
    )


class HarrisCandidates(_Config):
    """Candidates by the Harris corner score on the centerline (paper, section III-B.6)."""

    kind: Literal["harris"] = Field(default="harris", description="How candidates are found: harris or crossing.")
    block_px: int = Field(default=9, ge=3, le=63, description="Side of the window in which gradients are summed; odd.")
    k: float = Field(default=0.04, gt=0, lt=0.25, description="Harris' k.")
    peak_px: int = Field(default=21, ge=3, le=199, description="Side of the window whose maximum a candidate is; odd.")
    min_score: float = Field(
        default=0.3, ge=0, le=1, description="Minimum score of a candidate, as a share of the best one in the image."
    )
    merge_m: float = Field(
        default=10.0, ge=0, le=50, description="Candidates closer together than this are averaged, until none are."
    )

    @model_validator(mode="after")
    def _odd(self) -> HarrisCandidates:
        for name in ("block_px", "peak_px"):
            if getattr(self, name) % 2 == 0:
                raise ValueError(f"{name} is a window around a pixel, so it must be odd, not {getattr(self, name)}")
        return self


class CrossingCandidates(_Config):
    """Candidates where lines of the centerline meet; those joined within about a road width are one."""

    of_older_versions = frozenset({"merge_min_m"})

    kind: Literal["crossing"] = Field(default="crossing", description="How candidates are found: harris or crossing.")
    merge_widths: float = Field(
        default=1.0, ge=0, le=5, description="Junctions of the centerline joined within this many local widths are one."
    )
    merge_max_m: float = Field(
        default=20.0, ge=0, le=100, description="Junctions joined by more than this are two, however wide the road."
    )


class BranchConfig(_Config):
    """Branches around a candidate, and the point where they meet (paper, section III-C)."""

    of_older_versions = frozenset(
        {"end_at_rejected", "follow_deg", "fork_std_m", "full_fit_m", "min_fit_m", "straight_m", "trim_m"}
        | {"unseen_share"}
    )

    inner_radius_m: float = Field(
        default=10.0,
        ge=1e-6,
        le=100,
        description="a_i: radius of the inner circle, where branches start and which the refined point does not leave.",
    )
    inner_widths: float | None = Field(
        default=None,
        gt=0,
        le=5,
        description="Radius of the inner circle in local road widths; a_i is then its upper bound. Without a value the "
        "radius is a_i.",
    )
    outer_radius_m: float = Field(default=40.0, gt=0, le=200, description="a_o: outer radius, where branches end.")
    margin_m: float = Field(
        default=0.0, ge=0, le=50, description="Candidates closer than this to the border of the image are left out."
    )
    min_branches: int = Field(default=3, ge=2, le=8, description="Number of branches that make an intersection.")
    min_reach_m: float = Field(
        default=14.0,
        ge=0,
        le=200,
        description="Distance from its candidate that a branch must reach, unless it ends at another candidate.",
    )
    min_surface_m2: float = Field(
        default=0.0,
        ge=0,
        le=10000,
        description="Road surface outside of the inner circle that a branch must show, unless it ends at another "
        "candidate: what is short must be wide. In proportion less where fewer keyframes than a full window lie in the "
        "region of interest.",
    )
    stop_m: float = Field(
        default=1.0,
        gt=0,
        le=50,
        description="A branch ends this far before another candidate; no line is fitted to what lies so near to a dead "
        "end or to the border of the image.",
    )
    line: Literal["start_and_mean", "least_squares"] = Field(
        default="start_and_mean",
        description="The line of a branch: through its start and its mean (the paper), or fitted by least squares.",
    )
    fit_length_m: float = Field(
        default=30.0,
        gt=0,
        le=200,
        description="Longest part of a branch that is used for the line fit. Half of it makes a line that counts in "
        "full, and is surely a road.",
    )
    fit_least_m: float = Field(
        default=8.0,
        gt=0,
        le=200,
        description="Shortest part of a branch that the line fit takes where the branch is straight; half of that "
        "where it bends.",
    )
    candidate_std_m: float | None = Field(
        default=None,
        ge=1e-6,
        le=50,
        description="Standard deviation of the candidate's own position, which counts beside the lines; twice that "
        "beside one side road. The place of a fork counts by how well its edges tell it. Without a value only the "
        "lines count.",
    )
    straight_deg: float = Field(
        default=25.0,
        gt=0,
        le=60,
        description="Two branches of a through road differ in direction by at most this angle; roads cross at a larger "
        "one.",
    )
    square_std_deg: float | None = Field(
        default=None,
        gt=0,
        le=45,
        description="Standard deviation from the right angle of streets that end at others: a branch that ends at a "
        "through road is turned towards it, by how badly its direction is known. Without a value none is turned.",
    )

    @model_validator(mode="after")
    def _ordered(self) -> BranchConfig:
        if self.outer_radius_m <= self.inner_radius_m:
            raise ValueError(
                f"outer_radius_m ({self.outer_radius_m}) must be larger than inner_radius_m ({self.inner_radius_m})"
            )
        return self


class CompoundConfig(_Config):
    """Intersections side by side in one blob of road (beyond the paper: its section V-D)."""

    of_older_versions = frozenset({"crossing_deg", "offset_m", "straight_deg"})

    separation_m: float = Field(
        default=7.0,
        gt=0,
        le=50,
        description="Intersections closer together than this are one; branches of a through road pass each other by at "
        "most half of it.",
    )


class ScoreConfig(_Config):
    """How sure the detector is of an intersection, 0 to 1: its lines meet in a point, and each branch is a road."""

    of_older_versions = frozenset({"agreement_share", "full_length_m", "rated_branch"})

    spread_m: float = Field(
        default=2.0,
        ge=1e-6,
        le=50,
        description="Distance at which lines pass the point (root mean square) for an agreement of 1/e; 0 m gives 1.",
    )


class FusionConfig(_Config):
    """How the detections of all keyframes become one map of intersections (beyond the paper)."""

    of_older_versions = frozenset({"range_scale_m"})

    bandwidth_m: float = Field(
        default=2.0,
        ge=0.1,
        le=50,
        description="Scatter of the detections of one intersection; also the scale of the robust position.",
    )
    merge_radius_m: float = Field(
        default=10.0,
        gt=0,
        le=100,
        description="Detections farther apart are never one intersection; closer ones are, unless seen side by side.",
    )
    together: float = Field(
        default=0.15,
        ge=0,
        lt=1,
        description="Two places are two intersections if more than this share of the keyframes that saw the rarer one "
        "saw both.",
    )
    visible_radius_m: float = Field(
        default=20.0, gt=0, le=1000, description="Distance within which an intersection should be seen."
    )
    visible_limit_m: float = Field(
        default=50.0, gt=0, le=1000, description="Distance beyond which not seeing an intersection says nothing."
    )
    prior_seen: float = Field(
        default=0.5, gt=0, le=1000, description="Sightings that an intersection starts with (Beta prior of confidence)."
    )
    prior_missed: float = Field(
        default=1.5, gt=0, le=1000, description="Misses that an intersection starts with (Beta prior of confidence)."
    )
    score_influence: float = Field(default=0.3, ge=0, le=1, description="Part of confidence that a score of 0 takes.")
    min_observations: int = Field(
        default=2,
        ge=1,
        le=10000,
        description="Number of detections that make an intersection, where that many keyframes were within reach.",
    )
    min_confidence: float = Field(
        default=0.3, ge=0, le=1, description="Intersections below it are dropped, before its calibration or after."
    )
    correlation_length_m: float = Field(
        default=80.0,
        gt=0,
        le=10000,
        description="Distance driven after which two windows share no scan, so that their errors are independent.",
    )
    prior_std_m: float = Field(
        default=0.7,
        gt=0,
        le=100,
        description="Typical error of one independent sighting (prior of the scatter); has no effect "
        "with a calibration.",
    )
    branch_spread_deg: float = Field(default=8.0, gt=0, le=90, description="Scatter of the bearing of a branch.")
    branch_separation_deg: float = Field(
        default=25.0, gt=0, lt=120, description="Smallest angle between branches; half of that where else two are left."
    )
    branch_support: float = Field(
        default=0.4, ge=0, le=1, description="Share of the sightings, by weight, that must have seen a branch."
    )

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> FusionConfig:
        if self.visible_limit_m <= self.visible_radius_m:
            raise ValueError(
                f"visible_limit_m ({self.visible_limit_m:g}) must be greater than visible_radius_m "
                f"({self.visible_radius_m:g})"
            )
        return self


class CalibrationConfig(_Config):
    """Uncertainty and confidence of an intersection of the map, as fitted to drives whose truth is known.

    The covariance is the sum of `shape_covariance`, `scatter_variance` and `fix_variance`, the confidence is
    `junction_probability`, all of `interloc.mapping.estimation`. All but `fix_std_m` and `log_odds_doubtful` are fitted
    by tests/performance/calibrate.py, for preset `default`.
    """

    fix_std_m: float = Field(
        default=0.3,
        ge=0,
        le=1000,
        description="Standard deviation of the georeference along each axis, where it states none of its own.",
    )
    line_std_m: float = Field(
        default=0.06, gt=0, le=100, description="Standard deviation of the line of a branch across it, at a score of 1."
    )
    unclear_line_std_m: float = Field(
        default=9.89,
        ge=0,
        le=1000,
        description="Further standard deviation of that line at a score of 0; in proportion less at higher scores.",
    )
    coarse_line_std_m: float = Field(
        default=10.41,
        ge=0,
        le=1000,
        description="Further standard deviation of that line where the median score of all detections of the drive "
        "is 0 since its labels are coarse; in proportion less at higher ones.",
    )
    shape_limit_m: float = Field(
        default=3.23, ge=1e-6, le=100, description="Standard deviation of a position that no line of a branch fixes."
    )
    log_odds: float = Field(
        default=-1.72,
        ge=-50,
        le=50,
        description="Log odds of a road junction that no keyframe saw and whose lines leave an uncertainty of 1 m.",
    )
    log_odds_seen: float = Field(
        default=5.82, ge=0, le=50, description="Log odds gained if all keyframes in reach of the intersection saw it."
    )
    log_odds_per_doubling: float = Field(
        default=0.6, ge=0, le=50, description="Log odds lost each time the uncertainty that the lines leave doubles."
    )
    log_odds_doubtful: float = Field(
        default=0.9,
        ge=0,
        le=50,
        description="Log odds lost where all sightings come from stretches in which labels by geometry are doubtful.",
    )


class DetectorConfig(_Config):
    """All settings of the method, in the order of its steps; `interloc.preset` has those to start from.

    ``print(config.model_dump_json(indent=2))`` shows every setting, ``DetectorConfig.model_json_schema()`` what each
    means and allows.
    """

    preset: str = Field(default="custom", max_length=100, description="Name of the preset that this started from.")
    keyframes: KeyframeConfig = KeyframeConfig()
    bev: BevConfig = BevConfig()
    occupancy: OccupancyConfig = OccupancyConfig()
    centerline: CenterlineConfig = CenterlineConfig()
    candidates: Annotated[HarrisCandidates | CrossingCandidates, Field(discriminator="kind")] = CrossingCandidates()
    branches: BranchConfig = BranchConfig()
    compound: CompoundConfig | None = Field(
        default=None, description="Without a value a candidate is one intersection, as in the paper."
    )
    score: ScoreConfig = ScoreConfig()
    fusion: FusionConfig = FusionConfig()
    calibration: CalibrationConfig | None = Field(
        default=None,
        description="Without a value the position of an intersection is as uncertain as its sightings scatter, and its "
        "confidence is how often it was seen when it could have been.",
    )

    def __repr__(self) -> str:
        started_from = dict(flatten(PRESETS.get(self.preset, DetectorConfig()).model_dump(exclude={"preset"})))
        changed = [
            f"{name}={value}"
            for name, value in flatten(self.model_dump(exclude={"preset"}))
            if (name, value) not in started_from.items()
        ]
        return f"<DetectorConfig {', '.join([self.preset, *changed])}>"

    __str__ = __repr__

    @model_validator(mode="after")
    def _fits(self) -> DetectorConfig:
        if 2 * self.branches.outer_radius_m >= self.bev.size_m:
            raise ValueError(
                f"branches.outer_radius_m ({self.branches.outer_radius_m}) must be less than half of bev.size_m "
                f"({self.bev.size_m}): the relevant zone of the evaluation is what lies between them"
            )
        return self


PAPER = DetectorConfig(preset="paper", bev=BevConfig(adaptive=False), candidates=HarrisCandidates())

DEFAULT = DetectorConfig(
    preset="default",
    bev=BevConfig(min_points=2, vote=True, turn=True),
    occupancy=OccupancyConfig(closing_m=4.0, opening_m=2.4, island_m2=80.0, edge_m=0.8),
    centerline=CenterlineConfig(spur_widths=1.0),
    candidates=CrossingCandidates(merge_widths=1.6, merge_max_m=24.0),
    branches=BranchConfig(
        inner_radius_m=15.0,
        inner_widths=0.85,
        min_reach_m=14.0,
        min_surface_m2=24.0,
        stop_m=2.0,
        line="least_squares",
        fit_least_m=12.0,
        margin_m=15.0,
        candidate_std_m=0.7,
        square_std_deg=7.0,
    ),
    compound=CompoundConfig(),
    calibration=CalibrationConfig(),
)

PRESETS: dict[str, DetectorConfig] = {"default": DEFAULT, "paper": PAPER}


GONE = {
    f"{section}.{name}"
    for section, of in DetectorConfig.model_fields.items()
    for config in (of.annotation, *get_args(of.annotation))
    for name in getattr(config, "of_older_versions", ())
}


def preset(name: str, *settings: str) -> DetectorConfig:
    """Return a preset by its name, with some settings replaced.

    Parameters
    ----------
    name : {"default", "paper"}
    *settings
        ``section.name=value`` each, for example ``"bev.resolution_m=0.25"`` or ``"keyframes.lookahead=0"``.

    Raises
    ------
    ConfigError
        There is no preset of that name, a setting does not exist, or its value is refused.
    """
    try:
        return with_settings(PRESETS[name], settings) if settings else PRESETS[name]
    except (KeyError, TypeError):  # the latter of a list
        raise ConfigError(f"preset: there is no '{name}'; choose one of {', '.join(PRESETS)}") from None


def with_settings(config: DetectorConfig, settings: Iterable[str]) -> DetectorConfig:
    """Return a configuration with some settings replaced, each given as ``section.name=value``.

    The value is JSON, or else text. A new ``kind`` sets its section back to the defaults of that kind, whatever the
    order of the settings; ``section=null`` leaves out a step that may be left out. What is refused is a ConfigError.
    """
    values = config.model_dump(mode="json")
    for setting in sorted(settings, key=lambda setting: ".kind=" not in setting):
        path, separator, text = setting.partition("=")
        value = _json_or_text(text)
        *sections, name = path.strip().split(".")
        if not separator or not (sections or value is None):
            raise ConfigError(f"--set {setting}: expected section.name=value, for example bev.resolution_m=0.25")
        target: Any = values
        for section in sections:
            if isinstance(target, dict) and section in target and target[section] is None:
                target[section] = {}  # a step that was left out comes back with its defaults
            target = target.get(section) if isinstance(target, dict) else None
        if not isinstance(target, dict):
            section = ".".join(sections)
            raise ConfigError(f"--set {setting}: there is no section '{section}'{_nearest(f'{section}.{name}')}")
        if name == "kind" and target.get("kind") != value:
            target.clear()
        if ".".join((*sections, name)) in GONE:
            raise ConfigError(f"--set {setting}: there is no such setting any more")
        target[name] = value
    return parse_config(values)


def _json_or_text(text: str) -> Any:  # noqa: ANN401 - any JSON
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def parse_config(values: object, *, strict: bool = False) -> DetectorConfig:
    """Build a configuration from plain values (JSON); a ConfigError names each field that is refused, and why.

    `strict` refuses numbers and truth values that come as text, and one for the other.
    """
    try:
        return DetectorConfig.model_validate(values, strict=strict)
    except ValidationError as error:
        lines = []
        for item in error.errors():
            where = ".".join(str(part) for part in item["loc"] if part not in {"harris", "crossing"}) or "configuration"
            found = "" if isinstance(item["input"], dict) else f" (found {_shown(repr(item['input']))})"
            what = item["msg"]
            if item["type"] == "extra_forbidden":
                what = f"there is no such setting{_nearest(where)}"
            lines.append(f"{_shown(where)}: {what.removeprefix('Value error, ')}{found}")
        more = "; ..." if len(lines) > _MAX_FAULTS_SHOWN else ""
        raise ConfigError("; ".join(lines[:_MAX_FAULTS_SHOWN]) + more) from None


def flatten(value: object, name: str = "") -> list[tuple[str, Any]]:
    """Return the values within nested mappings under their dotted names: ("bev.resolution_m", 0.16)."""
    if isinstance(value, Mapping):
        return [row for key, each in value.items() for row in flatten(each, f"{name}.{key}" if name else str(key))]
    return [(name, value)]


def _nearest(name: str) -> str:
    """Return what was probably meant by the name of a setting that does not exist, for its message."""
    of_preset = {each: dict(flatten(config.model_dump())) for each, config in PRESETS.items()}
    for each, settings in of_preset.items():
        if name in settings:  # of another kind of candidates, or of a step that is left out
            section = name.split(".", maxsplit=1)[0]
            kind = f": {section}.kind={settings[f'{section}.kind']}" if f"{section}.kind" in settings else ""
            return f" here; it is one of the preset {each}{kind}"
    names = sorted({known for settings in of_preset.values() for known in settings})
    last = name.rpartition(".")[2]
    near = [known for known in names if known.rpartition(".")[2] == last] or get_close_matches(name[:100], names, n=3)
    meant = f"; did you mean {' or '.join(near)}?" if near else "."
    return f"{meant} `interloc info --settings` describes all settings"


def _shown(text: str) -> str:
    """Shorten what somebody gave for a message."""
    return text if len(text) <= _MAX_VALUE_CHARS else f"{text[:_MAX_VALUE_CHARS]}..."
