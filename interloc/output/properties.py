"""The properties of the layers of a result, each described once: title, meaning, unit, printed decimals.

Files, exports, the API, the page and docs/attributes.md take all of it from the models below. Bearings and headings are
degrees clockwise from north, or from +y of W without georeference. W is the frame of the first LiDAR pose, L that of
the LiDAR at a keyframe, levelled.
"""

import types
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetJsonSchemaHandler
from pydantic_core import CoreSchema

from interloc.arrays import JsonObject
from interloc.osm.policies import FindingKind
from interloc.roadmap.network import NodeKind


@dataclass(frozen=True)
class Decimals:
    """How many decimals of a number are printed (NaN and infinity become null), and its unit."""

    places: int
    unit: str | None = None

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonObject:
        """Add the unit to the JSON schema of a number, under the key that OGC API - Features, part 5, has for it."""
        made = handler(schema)
        return made if self.unit is None else {**made, "x-ogc-unit": self.unit}


@dataclass(frozen=True)
class Moment:
    """Marks a text as a time of the day, RFC 3339."""


Metres = Annotated[float, Decimals(4, "m")]
MetresOrNone = Annotated[float | None, Decimals(4, "m")]
Seconds = Annotated[float | None, Decimals(6, "s")]
Ratio = Annotated[float, Decimals(6)]
Time = Annotated[str | None, Moment()]

WorldX = Annotated[Metres, Field(title="x in W", description="Position in W, metres forward of the first scan.")]
WorldY = Annotated[Metres, Field(title="y in W", description="Position in W, metres to the left of the first scan.")]
BranchCount = Annotated[int, Field(title="Branches", description="Number of branches.")]
BranchBearings = Annotated[
    list[float],
    Decimals(3, "degree"),
    Field(title="Bearings of branches", description="Bearing of each branch, leaving the intersection, degrees."),
]
BranchWidths = Annotated[
    list[float | None],
    Decimals(2, "m"),
    Field(
        [],
        title="Widths of branches",
        description="Width of the road across each branch, metres, in the order of the bearings: from kerb to kerb as "
        "far as it was seen, 8 to 20 m from the intersection; null where it could not be measured.",
    ),
]
PositionCovariance = Annotated[
    list[float] | None,
    Decimals(6, "m2"),
    Field(
        title="Covariance",
        description="Covariance of the position, square metres: variance to the east, covariance of east and north, "
        "variance to the north (of x and y of W without georeference); null in results of versions before.",
    ),
]
_AS_TEXT = BeforeValidator(lambda value: str(value) if type(value) is int else value)
OsmId = Annotated[str, _AS_TEXT, Field(pattern=r"^-?\d+$")]
"""Id of OpenStreetMap: text, since programs guess the width of numbers; versions before 0.3.0 wrote numbers."""
OsmIdOrNone = Annotated[str | None, _AS_TEXT]
OsmNode = Annotated[OsmId, Field(title="OSM node", description="Id of the OpenStreetMap node.")]
Scan = Annotated[int, Field(title="Scan", description="Scan number of the keyframe.")]
Reason = Annotated[
    str | None, Field(title="Reason", description="Why it is wrong or unscored; null where it is right.")
]
KeyframeTime = Annotated[
    Time, Field(title="Time", description="Time of the keyframe, RFC 3339; null where the drive has no times of day.")
]
DriveName = Annotated[str | None, Field(title="Drive", description="Name of the drive.")]
Streets = Annotated[
    str | None,
    Field(
        title="Streets",
        description="Names of the streets that meet there on the map, as A / B; of an intersection without a node, of "
        "the streets within 10 m. Null where none has a name, and before `evaluate`.",
    ),
]
NODE_KINDS = (
    "intersection: one of the result, or several in one place. fork: three or more lines of the road meet where the "
    "result has no intersection. place: an open place without one. dead_end: the road ends, and the drive came near. "
    "end_of_view: the road was not seen farther."
)
Verdict = Literal["right", "wrong", "unscored"]
"""Of a detection; unscored before an evaluation, and where the map cannot tell."""
PlaceVerdict = Literal["right", "wrong", "not_counted", "unscored"]
"""Of an intersection; not_counted at a junction that the policy leaves out."""


class Strict(BaseModel):
    """A part of a file as it was written, and nothing else."""

    # A command uses few of them: each is built when it is used.
    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False, defer_build=True)


class Properties(Strict):
    """Properties of the features of a layer, or the details that its GeoJSON has beside them."""


class Origin(Properties):
    """What tells one result from others: in the head of its files, and beside each feature where several are served."""

    drive: DriveName = None
    job: str | None = Field(
        None, title="Job", description="Id of the job of the service that made it; null from the command line."
    )
    preset: str | None = Field(None, title="Preset", description="Preset of its settings: default or paper.")
    labels: str | None = Field(
        None, title="Labels", description="Where the labels of the points came from; null where that is not known."
    )


def origin_of(run: Mapping[str, Any], drive: str | None) -> dict[str, str | None]:
    """Return the values of `Origin` of a result, by its `run.json` and the name of its drive."""
    preset, labels = (run.get("config") or {}).get("preset"), run.get("labels")
    return {"drive": drive, "job": run.get("job"), "preset": preset, "labels": labels or None}


class IntersectionProperties(Properties):
    """A physical intersection, fused from all detections of it."""

    id: int = Field(title="Number", description="Number of the intersection, from 1 in the order of first sight.")
    uid: str | None = Field(
        None,
        title="Name of the place",
        description="Name of the place, the same in other runs that were scored: n and the id of the OpenStreetMap "
        "node where there is a junction. Else the cell of a grid of about 22 m, which small moves can change.",
    )
    names: Streets = None
    outcome: PlaceVerdict = Field(
        "unscored",
        title="Verdict",
        description="right: assigned to an OpenStreetMap node, one to one, within 10 m. wrong: to none. "
        "not_counted: to none, and at a junction that the policy leaves out, such as that of a service road. unscored: "
        "before `evaluate`, beyond the map, or in the relevant zone of no keyframe.",
    )
    reason: Reason = None
    error_m: MetresOrNone = Field(None, title="Error", description="Distance to that node, metres; null for none.")
    osm_id: OsmIdOrNone = Field(
        None, title="OSM node", description="Id of the OpenStreetMap node that it is assigned to; null for none."
    )
    confidence: Ratio = Field(
        title="Confidence",
        description="0 to 1: probability that a road junction of the map lies within 10 m, calibrated on drives whose "
        "truth is known. Without a calibration (preset paper): the share of the keyframes near enough to see it that "
        "did, lowered by up to 30 % where the scores of its detections are low.",
    )
    position_std_m: Metres = Field(
        title="Uncertainty",
        description="One-sigma uncertainty of the position along each axis, metres: root of the mean of the two "
        "variances of its covariance.",
    )
    branch_count: BranchCount
    branch_bearings_deg: BranchBearings
    branch_widths_m: BranchWidths
    first_time: Time = Field(
        None,
        title="First seen",
        description="Time of the first keyframe that saw it, RFC 3339; null where the drive has no times of day.",
    )
    last_time: Time = Field(
        None,
        title="Last seen",
        description="Time of the last keyframe that saw it, RFC 3339; null where the drive has no times of day.",
    )


class IntersectionDetails(Properties):
    """How well an intersection is known, and where it is for InterLoc itself."""

    observations: int = Field(title="Observations", description="Number of detections fused.")
    position_cov_m2: PositionCovariance = None
    fix_std_m: MetresOrNone = Field(
        None,
        title="Uncertainty of the fixes",
        description="Part of the uncertainty along each axis, metres, that the georeference brings: all intersections "
        "of a drive share it. The covariance is the sum of the squares of this and `scatter_std_m`, and of "
        "`shape_cov_m2`. The three are null without a calibration (preset paper).",
    )
    shape_cov_m2: Annotated[list[float] | None, Decimals(6, "m2")] = Field(
        None,
        title="Covariance of the shape",
        description="Part of the covariance, square metres, that the shape of the intersection brings, in the order of "
        "`position_cov_m2`: all drives share it, so more drives do not make it smaller.",
    )
    scatter_std_m: MetresOrNone = Field(
        None,
        title="Uncertainty of the scatter",
        description="Part of the uncertainty along each axis, metres, that the scatter between sightings leaves: "
        "nothing shares it.",
    )
    first_frame: int = Field(title="First scan", description="Scan number of the first keyframe that saw it.")
    last_frame: int = Field(title="Last scan", description="Scan number of the last keyframe that saw it.")
    world_x_m: WorldX
    world_y_m: WorldY


class DetectionProperties(Properties):
    """An intersection as one keyframe saw it, georeferenced by the fix of that keyframe."""

    frame: Scan
    branch_count: BranchCount
    branch_bearings_deg: BranchBearings
    branch_widths_m: BranchWidths
    score: Ratio = Field(
        title="Score",
        description="0 to 1, how sure the detector is: half of it says how well the lines of the branches meet in one "
        "point, half how long the third longest branch is, up to 15 m (settings `score`).",
    )
    intersection: int | None = Field(
        title="Intersection", description="Id of the fused intersection that it belongs to; null for none."
    )
    id: str | None = Field(
        None,
        title="Detection",
        description="Scan number of the keyframe and, from 1, the number of the detection at it, as 120-1.",
    )
    time: KeyframeTime = None
    outcome: Verdict = Field(
        "unscored",
        title="Verdict",
        description="right: within 5 m of the nearest OpenStreetMap node of the region of interest. wrong: not. "
        "unscored: before `evaluate`, or beyond the map.",
    )
    osm_id: OsmIdOrNone = Field(
        None,
        title="OSM node",
        description="Id of the nearest OpenStreetMap node in the region of interest, however far; null for none.",
    )
    error_m: MetresOrNone = Field(None, title="Error", description="Distance to that node, metres; null for none.")
    reason: Reason = None


class DetectionDetails(Properties):
    """Where the keyframe saw it."""

    x_m: Metres = Field(title="Forward", description="Position in L, metres forward.")
    y_m: Metres = Field(title="To the left", description="Position in L, metres to the left.")
    position_std_m: MetresOrNone = Field(
        None,
        title="Uncertainty",
        description="Standard deviation of the position along each axis, metres, by how well the lines of its branches "
        "are known and meet. It counts in the intersection by the inverse of its square.",
    )
    world_x_m: WorldX
    world_y_m: WorldY


class TrajectoryProperties(Properties):
    """The track of the LiDAR as one line; beside its geometry `world_xy_m`, the same line in W."""

    scans: int = Field(title="Scans", description="Number of scans of the drive.")


class KeyframeProperties(Properties):
    """The LiDAR at a keyframe."""

    frame: int = Field(title="Scan", description="Scan number.")
    heading_deg: Annotated[float, Decimals(6, "degree")] = Field(
        title="Heading", description="Heading of the LiDAR, degrees."
    )
    detections: int = Field(title="Detections", description="Number of detections.")
    time: KeyframeTime = None


class KeyframeDetails(Properties):
    """The pose of the LiDAR for InterLoc itself."""

    time_s: Seconds = Field(
        title="Seconds",
        description="Time of the scan in seconds, as the drive counts them: since its start, or since 1970; null if "
        "unknown.",
    )
    world_x_m: WorldX
    world_y_m: WorldY
    world_yaw_rad: Annotated[float, Decimals(9, "rad")] = Field(
        title="Heading in W",
        description="Heading in W, radians counter-clockwise from +x. "
        "The region of interest is aligned with W, not with the heading.",
    )


RoadWidth = Annotated[float | None, Decimals(2, "m")]
RoadLength = Annotated[float, Decimals(2, "m")]


class RoadProperties(Properties):
    """A road between two nodes, as the LiDAR saw it: its centreline, and its width from edge to edge."""

    id: int = Field(title="Road", description="Number of the road, from 1.")
    start_node: int = Field(title="From node", description="Number of the node where the line begins; see `junctions`.")
    end_node: int = Field(title="To node", description="Number of the node where it ends.")
    length_m: RoadLength = Field(title="Length", description="Length of the line, metres.")
    width_m: RoadWidth = Field(
        title="Width",
        description="Width from edge to edge, metres: median along the road; null where it is too short to be "
        "measured between the mouths of others.",
    )
    is_driven: bool = Field(
        title="Driven",
        description="Whether the drive went along it. Of other roads one side may have been hidden: they are at least "
        "as wide as `width_m`.",
    )
    seen: Ratio = Field(
        title="Seen",
        description="0 to 1, share of its length that was seen as road; the rest are gaps of up to 25 m between two "
        "ends that face each other.",
    )
    offset_std_m: MetresOrNone = Field(
        title="Uncertainty",
        description="One-sigma uncertainty of the line across its direction, metres, without that of the georeference: "
        "0.13 m where it was driven, else 0.37 m, as on simulated drives, and its scatter; null where no width is "
        "known.",
    )


class RoadDetails(Properties):
    """More of a road: how its width changes, how well it was seen."""

    start_kind: NodeKind = Field(title="Begins at", description=f"What the node is where it begins. {NODE_KINDS}")
    end_kind: NodeKind = Field(title="Ends at", description="What the node is where it ends, in the same words.")
    width_p10_m: RoadWidth = Field(
        title="Width, 10 %", description="Width that 10 % of the road stay below, metres; null where none is known."
    )
    width_p90_m: RoadWidth = Field(
        title="Width, 90 %", description="Width that 90 % of the road stay below, metres; null where none is known."
    )
    width_profile_m: Annotated[list[float | None], Decimals(2, "m")] = Field(
        title="Widths along it",
        description="Width every 10 m from the start of the line, metres; null where it was not measured.",
    )
    keyframes: int = Field(
        title="Keyframes", description="Median number of keyframes, 10 m apart, that saw the middle of the road."
    )


class JunctionProperties(Properties):
    """The ground where roads meet, as far as their mouths; or an open place, on which no lines are drawn."""

    id: int = Field(title="Node", description="Number of the node, from 1: `start_node` and `end_node` of roads.")
    kind: NodeKind = Field(title="Kind", description=f"What the node is. {NODE_KINDS}")
    intersections: list[int] = Field(
        title="Intersections", description="Numbers of the fused intersections that it is; none for forks and places."
    )
    roads: int = Field(title="Roads", description="Number of roads that begin or end there.")
    area_m2: Annotated[float, Decimals(1, "m2")] = Field(title="Area", description="Area, square metres.")


class RoadSurfaceProperties(Properties):
    """The ground that was seen as road from two keyframes or more, cut at squares of 256 m."""

    id: int = Field(title="Piece", description="Number of the piece, from 1.")
    area_m2: Annotated[float, Decimals(1, "m2")] = Field(title="Area", description="Area, square metres.")


class OsmNodeProperties(Properties):
    """A ground truth intersection of OpenStreetMap."""

    osm_id: OsmNode
    degree: int = Field(title="Roads", description="Number of roads that meet there.")
    outcome: Literal["found", "missed", "outside"] = Field(
        "outside",
        title="Verdict",
        description="found: an intersection of the map is assigned to it, one to one, within 10 m. missed: none is. "
        "outside: in the relevant zone of no keyframe, so it cannot be missed.",
    )
    intersection: int | None = Field(
        None, title="Intersection", description="Id of the intersection assigned to it; null for none."
    )
    reason: str | None = Field(
        None,
        title="Reason",
        description="Why it was missed, and what of its branches was seen; of one that was found, what is odd about it "
        "on the map (levels, a road drawn twice). Else null.",
    )
    names: Streets = None


class OsmNodeDetails(Properties):
    """How the drive saw a node."""

    in_zone: bool = Field(
        title="In the zone", description="Whether it was in the relevant zone of a keyframe, so it should be found."
    )
    found: bool = Field(title="Found", description="Whether its verdict is found: by an intersection of the map.")
    detected: bool | None = Field(
        None,
        title="Detected",
        description="Whether a detection within 5 m was matched to it, the paper's measure; null in results of older "
        "versions.",
    )
    keyframes_in_zone: int = Field(
        title="Keyframes near", description="Number of keyframes with the node in their relevant zone."
    )
    keyframes_missed: int = Field(
        title="Keyframes missed", description="Number of these keyframes without a detection matched to it."
    )
    detections: int = Field(title="Detections", description="Number of detections matched to it.")
    median_error_m: MetresOrNone = Field(
        title="Median error", description="Median distance of these detections, metres; null if there are none."
    )


class MatchProperties(Properties):
    """A detection and the OpenStreetMap node that it was matched to."""

    frame: Scan
    error_m: Metres = Field(title="Error", description="Length of the line, metres.")
    outcome: Literal["TP", "FP"] = Field(title="Verdict", description="TP within 5 m of the node, else FP.")
    osm_id: OsmNode
    detection: str | None = Field(
        None,
        title="Detection",
        description="The detection: its scan number and, from 1, its number at that keyframe, as 120-1.",
    )
    intersection: int | None = Field(
        None,
        title="Intersection",
        description="Id of the fused intersection that the detection belongs to; null for none.",
    )


class OsmRoadProperties(Properties):
    """A way of OpenStreetMap around the drive; one that leaves the surroundings and returns is several lines."""

    osm_id: OsmId = Field(title="OSM way", description="Id of the OpenStreetMap way.")
    highway: str = Field(title="Class of road", description="Value of its tag `highway`.")
    name: str | None = Field(title="Name", description="Name or else reference number; null if it has none.")
    is_drivable: bool = Field(title="Drivable", description="Whether it is a road under policy drive+service.")
    is_one_way: bool | None = Field(
        None,
        title="One-way",
        description="Whether people drive only in the direction of the line; null in results that do not say.",
    )
    seen_m: RoadWidth = Field(
        None,
        title="Seen",
        description="Length of the way, all its lines together, on ground that the drive saw as road, metres; null "
        "where none was seen.",
    )
    mapped: Annotated[float | None, Decimals(3)] = Field(
        None,
        title="Mapped",
        description="0 to 1, share of that within 3 m of one of `roads`; null where none was seen.",
    )
    offset_m: RoadWidth = Field(
        None,
        title="Offset",
        description="Median distance of the road that was seen from the way, metres, positive to the left of its "
        "direction; null where no road runs beside it.",
    )
    width_m: RoadWidth = Field(
        None, title="Width", description="Median width of the road that was seen beside it, metres; null for none."
    )
    is_driven: bool | None = Field(
        None,
        title="Driven",
        description="Whether the drive went along it; else the width is a minimum. Null where none was seen.",
    )


class OsmBuildingProperties(Properties):
    """A building of OpenStreetMap near the track."""

    osm_id: OsmId = Field(title="OSM id", description="Id of the OpenStreetMap way.")
    osm_type: Literal["way", "relation"] = Field(
        "way", title="OSM element", description="way; before 0.3.0 relation, too."
    )


class PlaceProperties(Properties):
    """The track of a drive at a place of the map that it fits; the first is where it was found to be."""

    rank: int = Field(title="Rank", description="1 for the best place; the others are those that came next.")
    score: Ratio = Field(title="Score", description="How well the place explains the drive; 1.5 is a perfect fit.")
    on_roads: Ratio = Field(title="On roads", description="0 to 1, how much of the track runs along roads.")
    intersections_seen: int = Field(
        title="Intersections seen", description="Number of passages of intersections that the drive saw."
    )
    intersections_at_nodes: int = Field(
        title="Intersections on the map", description="Number of these that lie at an intersection of the map."
    )
    heading_deg: Annotated[float, Decimals(1, "degree")] = Field(
        title="Heading", description="Heading at the first scan, degrees."
    )


class BranchProperties(Properties):
    """A branch of an intersection: a line of 20 m from its position along the bearing."""

    intersection: int = Field(title="Intersection", description="Id of the intersection.")
    bearing_deg: Annotated[float, Decimals(3, "degree")] = Field(
        title="Bearing", description="Bearing of the branch, leaving the intersection, degrees."
    )
    width_m: Annotated[float | None, Decimals(2, "m")] = Field(
        None, title="Width", description="Width of the road across it, metres; null where it could not be measured."
    )


class UncertaintyProperties(Properties):
    """The ellipse that holds the true position of an intersection with a probability of 95 %: 2.45 sigma."""

    intersection: int = Field(title="Intersection", description="Id of the intersection.")
    position_std_m: Metres = Field(
        title="Uncertainty", description="One-sigma uncertainty of the position along each axis, metres."
    )
    radius_m: Metres = Field(
        title="Radius", description="2.45 times that, metres: the radius of a circle of the same uncertainty."
    )
    semi_major_m: Metres = Field(title="Semi-major axis", description="Longer semi-axis of the ellipse, metres.")
    semi_minor_m: Metres = Field(title="Semi-minor axis", description="Shorter semi-axis of the ellipse, metres.")
    bearing_deg: Annotated[float, Decimals(3, "degree")] = Field(
        title="Bearing", description="Bearing of the longer axis, 0 to 180 degrees."
    )


class CityProperties(Properties):
    """A physical intersection on a map of many drives, fused from what each of them saw."""

    uid: str = Field(
        title="Name of the place",
        description="Name of the place on this map: it stays when drives are added, and is never used for another.",
    )
    observations: int = Field(title="Observations", description="Number of detections, of all drives.")
    drives: int = Field(title="Drives", description="Number of drives that saw it.")
    passes: int = Field(
        title="Passes",
        description="Number of times it was seen; sightings within ten minutes of each other count as one, since they "
        "may be pieces of one drive.",
    )
    drives_near: int = Field(
        title="Drives near", description="Number of drives that saw it, or came within 20 m of it."
    )
    drive_names: str = Field(title="Names of drives", description="The drives that saw it, separated by commas.")
    position_std_m: Metres = Field(
        title="Uncertainty",
        description="One-sigma uncertainty of the position on the Earth along each axis, metres. An offset that all "
        "drives have in common, as of one base station, is not in it.",
    )
    relative_std_m: Metres = Field(
        title="Uncertainty in its surroundings",
        description="The same against the intersections around, metres: without what the georeference leaves.",
    )
    branch_count: BranchCount
    branch_bearings_deg: BranchBearings
    branch_widths_m: BranchWidths
    branch_drives: list[int] = Field(
        title="Drives per branch", description="Number of drives that saw each branch, in the order of the bearings."
    )
    confidence: Ratio = Field(
        title="Confidence",
        description="0 to 1: mean confidence of the drives that came near, 0 for each that did not see it.",
    )
    first_time: Time = Field(
        title="First seen", description="When it was first seen, RFC 3339; null where no drive has times of day."
    )
    last_time: Time = Field(
        title="Last seen", description="When it was last seen, RFC 3339; null where no drive has times of day."
    )


class CityDetails(Properties):
    """More of an intersection of many drives."""

    position_cov_m2: PositionCovariance = None


class CityDriveProperties(Properties):
    """The track of a drive of a map of many drives, its offset taken away."""

    drive: str = Field(title="Drive", description="Name of the drive.")
    intersections: int = Field(title="Intersections", description="Number of intersections of its result.")
    offset_east_m: Metres = Field(
        title="Offset to the east",
        description="Mean offset of the drive to the east, metres: what it says minus what the map says.",
    )
    offset_north_m: Metres = Field(title="Offset to the north", description="The same to the north.")
    offset_range_m: Metres = Field(
        title="Drift", description="Largest distance between the offsets of two parts of the drive, metres."
    )
    fix_std_m: Metres = Field(
        title="Uncertainty of the fixes", description="As its georeference states it, metres along each axis."
    )
    first_time: Time = Field(
        title="Begin", description="Time of its first keyframe, RFC 3339; null where it has no times of day."
    )
    last_time: Time = Field(title="End", description="Time of its last keyframe, in the same form.")


class CityRoadProperties(Properties):
    """A road that leaves an intersection of many drives, as all drives that saw it say."""

    id: int = Field(title="Road", description="Number of the road, from 1, in this state of the map.")
    start_uid: str = Field(title="From", description="Name of the intersection in `city` where it begins.")
    end_uid: str | None = Field(
        title="To", description="That where it ends; null where no drive saw it as far as one of the map."
    )
    length_m: RoadLength = Field(title="Length", description="Length of the line, metres.")
    width_m: RoadWidth = Field(
        title="Width",
        description="Width from edge to edge, metres: mean over the drives that went along it, or over all where none "
        "did; null where none knows it.",
    )
    width_std_m: RoadWidth = Field(
        title="Spread of the width",
        description="Standard deviation between those drives, metres; null for fewer than two.",
    )
    is_driven: bool = Field(title="Driven", description="Whether any drive went along it.")
    drives: int = Field(title="Drives", description="Number of drives that saw it.")
    drive_names: str = Field(title="Names of drives", description="The drives that saw it, separated by commas.")


class ChangeProperties(Properties):
    """An intersection, or a branch of one, that drives of one time saw and those of another did not."""

    id: str = Field(
        title="Change", description="Name of the change: its kind, the place and the bearing of the branch."
    )
    kind: Literal["new_junction", "gone_junction", "new_branch", "gone_branch"] = Field(
        title="Kind", description="What came or went: the intersection, or a branch of it."
    )
    uid: str = Field(title="Name of the place", description="The place in `city`.")
    bearing_deg: Annotated[float | None, Decimals(1, "degree")] = Field(
        title="Bearing", description="Bearing of the branch, degrees; null where it is the intersection."
    )
    seen_by: str = Field(title="Seen by", description="Drives that saw it, in time, separated by commas.")
    not_seen_by: str = Field(
        title="Not seen by",
        description="Drives that should have seen it and did not: they came within 20 m of an intersection, or saw "
        "other ground along a branch.",
    )
    after_time: Time = Field(title="After", description="End of the last drive before the change, RFC 3339.")
    before_time: Time = Field(title="Before", description="Begin of the first drive behind the change, RFC 3339.")


class FindingProperties(Properties):
    """A place where OpenStreetMap seems to be wrong, by several passes: a question to a person, not an edit."""

    id: str = Field(
        title="Finding", description="Name of the finding, of its kind and place or node; the same in later audits."
    )
    kind: FindingKind = Field(
        title="Kind",
        description="missing_junction: a junction that the map lacks. missing_branch: one that a junction lacks on "
        "the map. moved: a junction that lies elsewhere. not_joined: one whose roads come to one place and share "
        "no node. no_node: one whose roads cross without a node.",
    )
    text: str = Field(title="Question", description="What was found, for a person who looks at it.")
    uid: str | None = Field(
        title="Name of the place", description="The place in `city`; null for a node beside a track."
    )
    osm_id: OsmIdOrNone = Field(
        title="OSM node", description="The OpenStreetMap node that it is about; null where the map lacks something."
    )
    passes: int = Field(title="Passes", description="Number of independent passes that saw the place.")
    drive_names: str = Field(title="Names of drives", description="Drives that saw it, separated by commas.")
    distance_m: MetresOrNone = Field(
        title="Distance",
        description="Distance to the node of a moved junction, the nearest junction, or the slip; null for others.",
    )
    branch_bearings_deg: BranchBearings
    branch_widths_m: BranchWidths
    osm_ways: str = Field(
        title="Ways around", description="OpenStreetMap ways within 25 m with their tags, nearest first."
    )
    osm_link: str = Field(title="Link", description="The place on openstreetmap.org.")


@dataclass(frozen=True)
class Attribute:
    """A property of a layer, as files and documents describe it."""

    name: str
    title: str
    description: str
    kind: str
    """int, float, bool, text, time or list."""
    unit: str | None
    """m, m2, s, rad or degree."""
    decimals: int | None
    """How many are printed."""


def attributes_of(properties: type[Properties]) -> list[Attribute]:
    """Return the properties of a layer in their order."""
    attributes = []
    for name, field in properties.model_fields.items():
        number = next((each for each in field.metadata if isinstance(each, Decimals)), None)
        is_time = any(isinstance(each, Moment) for each in field.metadata)
        assert field.title is not None
        assert field.description is not None
        attributes.append(
            Attribute(
                name=name,
                title=field.title,
                description=field.description,
                kind="time" if is_time else _kind(field.annotation),
                unit=None if number is None else number.unit,
                decimals=None if number is None else number.places,
            )
        )
    return attributes


_KINDS = {bool: "bool", int: "int", float: "float", str: "text", Literal: "text", list: "list"}


def _kind(annotation: Any) -> str:  # noqa: ANN401
    """Return the kind of a property from its annotation, null aside."""
    alternatives = get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    return _KINDS[get_origin(alternatives[0]) or alternatives[0]]
