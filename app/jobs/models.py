"""Jobs."""

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema

from app.http.fields import ID, TEXT, Body, Name, Note, Number, Yes, one_of
from app.http.problems import ProblemDocument
from app.jobs.webhooks import DeliveryModel, Subscriber
from app.paths import MAX_PATH
from app.states import JobKind, JobState
from interloc.arrays import JsonObject
from interloc.config import DetectorConfig
from interloc.drives.options import LabelFolder
from interloc.osm.policies import POLICY_HELP, TOLERANCE_HELP, Policy

MAX_COMPARED_JOBS = 8


class OsmFile(Body):
    """A map among the files of the drive."""

    file: str = Field(max_length=MAX_PATH, pattern=TEXT, examples=["map.osm.gz"])


class OsmOverpass(Body):
    """The current map from a public Overpass server."""

    overpass: Yes


class Near(Body):
    """Roughly where a drive was."""

    lat_deg: Number = Field(ge=-89, le=89)
    lon_deg: Number = Field(ge=-180, le=180)
    radius_km: Number = Field(3.0, ge=0.1, le=20, description="How far around it to search.")


class NewJob(Body):
    """Find the intersections of a drive, and score them where a map is given."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"drive_id": "5f0c2b7d9a41e386", "preset": "default", "osm": {"file": "map.osm.gz"}}]
        }
    )

    drive_id: str = Field(pattern=ID)
    preset: Literal["default", "paper"] = Field("default", description="Settings to start from.")
    config: JsonObject | None = Field(
        None,
        description="Settings that differ from the preset, in its shape (GET /api/v1/presets).",
        examples=[{"bev": {"resolution_m": 0.25}}],
    )
    labels: LabelFolder | None = Field(None, description="Folder of the labels; by default the one that exists.")
    osm: Annotated[
        OsmFile | OsmOverpass | None,
        Field(description="Map to score against; null: detect only."),
        one_of(
            '{"file": "map.osm.gz"} with one of the files of the drive, {"overpass": true} for the map as it is today, '
            "or null for none"
        ),
    ] = None
    georeference: Literal["drive", "map"] = Field(
        "drive",
        description="Where longitude and latitude come from: the GNSS of the drive, or the map, on which the drive is "
        "placed by its roads and intersections. A drive that has GNSS can be placed, too, for comparison.",
    )
    near: Near | None = Field(
        None, description="With georeference map: search only around here. Needed where the map is fetched."
    )
    policy: Policy = Field("drive", description=POLICY_HELP)
    tolerance_m: Number = Field(15.0, gt=0, le=100, description=TOLERANCE_HELP)
    name: Name | None = Field(None, description="Name shown in lists.")
    subscriber: Subscriber | None = Field(
        None, description="Who is told when it begins and ends, signed as Standard Webhooks says; see docs/api.md."
    )


class JobChanges(Body):
    """What is to change of a job; what is left out stays as it is."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"name": "coarse cells", "note": "For the table."}]})

    name: Name | None = Field(None, description="Name shown in lists; null for one by what was asked for.")
    note: Note | None = Field(None, description="Some lines about it; null for none.")


class Progress(BaseModel):
    """The progress of a job."""

    done: int
    total: int | None = Field(
        description="Number of keyframes (of scans for a commit, of files for an archive); null until known."
    )
    fraction: float = Field(ge=0, le=1)
    seconds_left: float | None = Field(description="Null before some seconds of steady work: it cannot be told yet.")


class JobModel(BaseModel):
    """A job."""

    id: str = Field(examples=["9b1e44f00c7a2d53"])
    kind: JobKind
    drive_id: str
    drive_name: str
    title: str = Field(
        description="Its name; or where it has none the preset, and the policy by which it is scored.",
        examples=["default, drive", "paper, no map"],
    )
    name: str | None = None
    note: str | None = None
    own_settings: JsonObject = Field(
        default_factory=dict,
        description="Settings that differ from those of its preset, by their dotted names.",
        examples=[{"bev.resolution_m": 0.25}],
    )
    owner: str
    state: JobState
    stage: str = Field(description="waiting, preparing, detecting, mapping, evaluating, ...", examples=["detecting"])
    message: str | None = Field(None, description="What it is waiting for.")
    progress: Progress
    request: JsonObject
    created_at: datetime
    started_at: datetime | None = Field(description="Put off by the time in which no server worked on it.")
    finished_at: datetime | None
    attempts: int
    error: ProblemDocument | None = None
    summary: JsonObject | None = Field(
        None,
        description="Outcome in figures: keyframes, detections, intersections, seconds, peak_memory_bytes, report, "
        "location.",
    )
    links: dict[str, str] = Field(
        default_factory=dict, description="Addresses of the results of a successful job, by name."
    )
    deliveries: list[DeliveryModel] = Field(
        default_factory=list, description="What the subscriber was told, or will be."
    )
    version: int = Field(description="Number of changes so far; the id of its events.")


class JobList(BaseModel):
    """A page of jobs, the newest first."""

    jobs: list[JobModel]
    next: str | None = Field(None, description="Value of `after` for the next page; null on the last page.")


class PresetModel(BaseModel):
    """Settings to start from."""

    name: str = Field(examples=["default"])
    description: str
    config: Annotated[DetectorConfig, WithJsonSchema({"description": "By `config_schema`."})]


class PresetList(BaseModel):
    """All presets."""

    presets: list[PresetModel]
    config_schema: JsonObject = Field(description="JSON schema of the settings, with units and ranges in words.")
