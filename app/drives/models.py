"""Drives and their files."""

import base64
from datetime import datetime
from pathlib import Path
from typing import Annotated, Self

from pydantic import (
    Base64Encoder,
    BaseModel,
    ConfigDict,
    EncodedBytes,
    Field,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from app.http.fields import ID, NETWORK, Body, Flag, Name, Note, Whole, strictly
from app.jobs.webhooks import Subscriber
from app.paths import MAX_PATH, check_path
from app.states import DriveState
from app.work.requests import UploadOptions
from interloc.config import KeyframeConfig
from interloc.drives.inspect import DriveReport
from interloc.drives.options import LABELS, LabelChoice, LabelFolder

MAX_LISTED = 300_000
"""Files of a folder that is looked into."""

LabelCounts = Annotated[
    dict[Annotated[int, Field(ge=0, le=65535)], Annotated[Whole, Field(ge=1, le=2**62)]], Field(max_length=65536)
]
"""Label id -> number of points that carry it."""


class DriveOptionsModel(UploadOptions):
    """How the files are read; the same choices as on the command line."""

    oxts: Path | None = Field(
        None,
        description="Georeference among the files: a file of OXTS rows, a geo.csv, the folder of a KITTI raw drive.",
        examples=["07.txt.gz"],
        json_schema_extra={"maxLength": MAX_PATH},
    )

    poses: str | None = Field(
        None,
        max_length=MAX_PATH,
        description="Poses among the files (KITTI, TUM), the trajectory of LAS files, or the topic of a bag, which "
        "begins with a slash.",
        examples=["poses.tum", "/odometry"],
    )
    labels: LabelChoice = Field("auto", description=LABELS)
    model: str | None = Field(
        None,
        max_length=255,
        pattern=NETWORK,
        description="Network of the service (GET /models) that labels the scans; label files do not count.",
        examples=["salsanext"],
    )

    @field_validator("oxts", mode="before")
    @classmethod
    def _check_oxts(cls, oxts: object) -> object:
        return check_path(oxts.removesuffix("/")) if isinstance(oxts, str) else oxts

    @field_validator("poses")
    @classmethod
    def _check_poses(cls, poses: str | None) -> str | None:
        return poses if poses is None or poses.startswith("/") else check_path(poses)


class NewDrive(Body):
    """A drive to be uploaded."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"name": "2011_09_30_drive_0027"}]})

    name: Name = Field(description="Name shown in lists and results.")
    keep_raw: Flag = Field(
        False, description="Keep the scans as uploaded, in addition to what the method needs of them."
    )
    options: DriveOptionsModel = Field(default_factory=DriveOptionsModel)
    source: str | None = Field(
        None,
        max_length=MAX_PATH,
        description="Address in object storage that the commit reads the files from, below one that the operator "
        "allows; only a map is sent then.",
        examples=["s3://bucket/drives/07"],
    )

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        if self.source is not None and self.keep_raw:
            raise ValueError("keep_raw is for files that are sent: those of a source stay where they are")
        return self


class DriveChanges(Body):
    """What is to change of a drive; what is left out stays as it is."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"name": "town, second run", "note": "Wet road."}]})

    name: Name = Field(default_factory=str, description="Name shown in lists.")
    note: Note | None = Field(None, description="Some lines about it; null for none.")
    pinned_job: str | None = Field(
        None,
        pattern=ID,
        description="The successful job of the drive that is to stand for it on the map of all drives and at /ogc; "
        "null: the best one.",
    )


class DriveModel(BaseModel):
    """A drive."""

    id: str = Field(examples=["5f0c2b7d9a41e386"])
    name: str
    note: str | None = None
    state: DriveState = Field(
        description="uploading: takes files. checking: its commit runs. ready: jobs can use it, files are fixed."
    )
    owner: str
    keep_raw: bool
    options: DriveOptionsModel
    source: str | None = Field(None, description="Where in object storage its files are; null where they are sent.")
    files: int = Field(description="Number of uploaded files.")
    size_bytes: int = Field(description="Size of the files as uploaded.")
    stored_bytes: int = Field(description="Size of what is kept of them.")
    bbox: list[float] | None = Field(
        None,
        description="West, south, east, north of a ready drive, degrees; null without georeference.",
        examples=[[8.412, 49.001, 8.431, 49.014]],
    )
    scans: int | None = Field(None, description="Scans of a ready drive.")
    length_m: float | None = Field(None, description="How far a ready drive goes.")
    result_job: str | None = Field(
        None,
        description="The job that stands for the drive on the map of all drives and at /ogc: the pinned one, "
        "else the best of preset default, else of paper, by F1 of its intersections; null: none was successful.",
    )
    pinned_job: str | None = Field(None, description="The same, where it was pinned.")
    created_at: datetime
    expires_at: datetime | None = Field(None, description="When the upload goes to the trash if it is left alone.")
    report: DriveReport | None = Field(
        None, description="What the last commit found, in the form of `interloc info --json`."
    )
    label_folders: list[LabelFolder] | None = Field(
        None, description="Labels that jobs can take, of a ready drive; null in lists."
    )
    maps: list[str] | None = Field(
        None, description="Its OpenStreetMap files, by their paths, of a ready drive; null in lists."
    )


class DriveList(BaseModel):
    """A page of drives, the newest first."""

    drives: list[DriveModel]
    next: str | None = Field(None, description="Value of `after` for the next page; null on the last page.")


class UploadedFile(BaseModel):
    """A file of a drive."""

    path: str = Field(examples=["velodyne/000000.bin"])
    size_bytes: int
    sha256: str = Field(description="SHA-256 of its contents, hexadecimal.")


class FileList(BaseModel):
    """Files, a page of them in the order of their paths. Send what is missing here to resume an upload."""

    files: list[UploadedFile]
    next: str | None = Field(None, description="Value of `after` for the next page; null on the last page.")


class CommitRequest(Body):
    """How to read the drive; fields that are left out keep their values."""

    options: DriveOptionsModel | None = None
    keep_raw: Flag | None = None
    subscriber: Subscriber | None = Field(
        None, description="Who is told when the check begins and ends; it fails, too, where the drive has errors."
    )


class _StrictBase64(Base64Encoder):
    """Base64 in which nothing else stands."""

    @classmethod
    def decode(cls, data: bytes) -> bytes:
        try:
            return base64.b64decode(data, validate=True)
        except ValueError as error:
            raise PydanticCustomError("base64", "expected Base64: {reason}", {"reason": str(error)}) from error


class LookRequest(Body):
    """A folder of a client: all of its files by name and size, and the contents of the small ones."""

    name: Name = Field(description="Name of the folder.")
    files: dict[str, Annotated[Whole, Field(ge=0, le=2**50)]] = Field(
        max_length=MAX_LISTED, description="Path in the folder, with slashes -> size in bytes."
    )
    contents: dict[str, Annotated[bytes, EncodedBytes(encoder=_StrictBase64)]] = Field(
        {},
        description="Path in the folder -> contents, Base64: poses, times, calibration, georeference. `wanted` of an "
        "answer names those that were left out.",
    )
    root: str | None = Field(
        None, description="Path in the folder of the drive to look into; null: the first. Empty: the folder itself."
    )
    options: DriveOptionsModel = Field(
        default_factory=DriveOptionsModel,
        description="How the drive is to be read; paths are those in the drive, such as georeference/07.txt.",
    )
    keyframes: Annotated[KeyframeConfig | None, strictly(KeyframeConfig), WithJsonSchema({})] = Field(
        default_factory=KeyframeConfig,
        description="Scans that a job needs: the keyframes by these settings, those of the default preset if left out; "
        "null: every scan.",
    )
    label_counts: dict[LabelFolder, LabelCounts] = Field(
        {},
        description="For each label folder, how many points of the scans `frames_to_look_into` carry each label id.",
        examples=[{"labels": {"40": 90112, "48": 21004, "70": 333120}}],
    )


class UnpackedArchive(BaseModel):
    """An archive that was unpacked, or is being unpacked."""

    job_id: str = Field(description="The job that unpacks it.")
    state: str = Field(examples=["successful"])
    files: int | None = Field(None, description="Number of its files; null until it is unpacked.")
    size_bytes: int | None = Field(None, description="Total size of its files; null until it is unpacked.")
