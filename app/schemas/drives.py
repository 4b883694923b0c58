"""Drives and their files."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, field_validator

from app.drives.names import BadNameError, check_path
from interloc.drives.inspect import DriveReport
from interloc.drives.labels import named_scheme
from interloc.drives.options import LayoutChoice, PoseFrame
from interloc.errors import ConfigError

Name = Annotated[
    str, StringConstraints(strip_whitespace=True, min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")
]
DriveState = Literal["uploading", "checking", "ready"]


class DriveOptionsModel(BaseModel):
    """How the files are to be read where they leave it open; the same choices as on the command line."""

    model_config = ConfigDict(extra="forbid")

    label_scheme: str = Field(
        "auto",
        max_length=200,
        description="auto, semantickitti, learning, kitti360, or the ids of road, as 40,60.",
        examples=["auto"],
    )
    pose_frame: PoseFrame = Field("auto", description="Whose poses the pose file holds.")
    layout: LayoutChoice = Field("auto", description="Layout of the folder.")
    oxts: str | None = Field(
        None,
        max_length=512,
        description="Georeference among the files: a file of OXTS rows, a geo.csv, the folder of a KITTI raw drive.",
        examples=["07.txt.gz"],
    )

    @field_validator("label_scheme")
    @classmethod
    def _check_scheme(cls, scheme: str) -> str:
        try:
            named_scheme(scheme)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        return scheme

    @field_validator("oxts")
    @classmethod
    def _check_oxts(cls, oxts: str | None) -> str | None:
        try:
            return None if oxts is None else check_path(oxts.removesuffix("/"))
        except BadNameError as error:
            raise ValueError(str(error)) from error


class NewDrive(BaseModel):
    """A drive to be uploaded."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"name": "2011_09_30_drive_0027"}]})

    name: Name = Field(description="Shown in lists and results.")
    keep_raw: bool = Field(False, description="Keep the scans as uploaded beside what the method needs of them.")
    options: DriveOptionsModel = Field(default_factory=DriveOptionsModel)


class DriveModel(BaseModel):
    """A drive."""

    id: str = Field(examples=["5f0c2b7d9a41e386"])
    name: str
    state: DriveState = Field(
        description="uploading: takes files. checking: its commit runs. ready: jobs can use it, files are fixed."
    )
    owner: str
    keep_raw: bool
    options: DriveOptionsModel
    files: int = Field(description="Files uploaded.")
    size_bytes: int = Field(description="Size of the files as uploaded.")
    stored_bytes: int = Field(description="Size of what is kept of them.")
    created_at: datetime
    expires_at: datetime | None = Field(None, description="When an upload that is left alone is removed.")
    report: DriveReport | None = Field(None, description="What the last commit found, as `interloc info` tells it.")


class DriveList(BaseModel):
    """A page of drives, the newest first."""

    drives: list[DriveModel]
    next: str | None = Field(None, description="Give it as `after` for the next page; null on the last.")


class UploadedFile(BaseModel):
    """A file of a drive."""

    path: str = Field(examples=["velodyne/000000.bin"])
    size_bytes: int
    sha256: str = Field(description="Of its contents, hexadecimal.")


class FileList(BaseModel):
    """A page of files, in the order of their paths. Send what is missing here to resume an upload."""

    files: list[UploadedFile]
    next: str | None = Field(None, description="Give it as `after` for the next page; null on the last.")


class CommitRequest(BaseModel):
    """How to read the drive; fields that are left out stay as they were at its creation."""

    model_config = ConfigDict(extra="forbid")

    options: DriveOptionsModel | None = None
    keep_raw: bool | None = None
    check_only: bool = Field(False, description="Check and report, but leave the drive open for more files.")
