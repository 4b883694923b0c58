"""reduced.json: what a reduced drive holds, and what it was made of."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from interloc.arrays import IntArray
from interloc.drives.faults import DriveFileError
from interloc.drives.files import os_reason
from interloc.drives.labels import SCHEMES, LabelScheme
from interloc.drives.options import LabelFolder
from interloc.drives.parts import LayoutName, PoseOwner
from interloc.drives.reduction.runs import Run, from_runs

MANIFEST = "reduced.json"
MAX_SCANS = 1_000_000
MAX_MANIFEST_BYTES = 32 * 1024 * 1024
GROUND_FOLDER = "ground"


def _runs_in_order(runs: list[Run]) -> list[Run]:
    if any(first + count > after for (first, count), (after, _) in pairwise(runs)):
        raise ValueError("scan numbers must ascend, and none may come twice")
    if sum(count for _, count in runs) > MAX_SCANS:
        raise ValueError(f"more than {MAX_SCANS:,} scans")
    return runs


def _path_inside(path: str) -> str:
    parts = path.split("/")
    odd = any(ord(char) < 32 or char in "\\:" for char in path)
    if odd or any(part in {"", ".", ".."} for part in parts):
        raise ValueError("expected a plain path inside the folder, such as poses.txt or oxts/data")
    return path


def _plain_name(name: str) -> str:
    if any(ord(char) < 32 for char in name) or "/" in name:
        raise ValueError("expected the name of a drive, such as 07")
    return name


_Number = Annotated[int, Field(ge=0, le=10**15)]
_Count = Annotated[int, Field(ge=1, le=MAX_SCANS)]
_Runs = Annotated[
    list[tuple[_Number, _Count]], Field(min_length=1, max_length=MAX_SCANS // 2), AfterValidator(_runs_in_order)
]
_PathInside = Annotated[str, Field(min_length=1, max_length=255), AfterValidator(_path_inside)]
_Label = Annotated[int, Field(ge=0, le=65535)]
_Total = Annotated[int, Field(ge=0, le=2**62)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Thinning(_Model):
    """Keyframe settings by which scans were left out."""

    distance_m: float = Field(ge=0, le=1000, description="A scan was kept after more than this way ...")
    angle_deg: float = Field(ge=0, le=180, description="... or this turn since the last one.")

    def __str__(self) -> str:
        return f"keyframes of {self.distance_m:g} m, {self.angle_deg:g} degrees"


class SmallFiles(_Model):
    """The other files of the drive, as paths inside the folder."""

    poses: _PathInside | None = Field(None, description="Pose lines; none where the poses are those of OXTS.")
    times: _PathInside | None = Field(None, description="A time a line.")
    calibration: list[_PathInside] = Field([], max_length=8, description="calib.txt, calib_imu_to_velo.txt, ...")
    oxts: _PathInside | None = Field(
        None, description="Folder with one OXTS file a frame, or file with one row a frame."
    )
    geo: _PathInside | None = Field(None, description="geo.csv.")

    @property
    def paths(self) -> list[str]:
        """All that are there."""
        single = (self.poses, self.times, self.oxts, self.geo)
        return [*(path for path in single if path is not None), *self.calibration]


class ReducedLabels(_Model):
    """By which labels the ground points of a folder were chosen."""

    folder: LabelFolder = Field(description="Folder of the labels, and of the points under ground/.")
    scheme: str = Field(min_length=1, max_length=64, description="Name of the label scheme.")
    road: list[_Label] = Field(min_length=1, max_length=65536, description="Ids of road.")
    confusable: list[_Label] = Field([], max_length=65536, description="Ids of sidewalk, parking and other ground.")
    counts: dict[_Label, _Total] = Field(
        {}, max_length=65536, description="How many points of the scans looked into carry each id."
    )
    label_bytes: _Total | None = Field(None, description="Size of all label files.")

    @classmethod
    def of(
        cls, folder: LabelFolder, scheme: LabelScheme, counts: dict[int, int], label_bytes: int | None = None
    ) -> ReducedLabels:
        """Describe the labels of a folder."""
        return cls(
            folder=folder,
            scheme=scheme.name,
            road=sorted(scheme.road),
            confusable=sorted(scheme.confusable),
            counts={label: counts[label] for label in sorted(counts)},
            label_bytes=label_bytes,
        )

    @property
    def label_scheme(self) -> LabelScheme:
        """What the ids mean."""
        scheme = LabelScheme(self.scheme, frozenset(self.road), frozenset(self.confusable))
        known = SCHEMES.get(self.scheme)
        return known if known is not None and known.means_the_same(scheme) else scheme


class SourceScans(_Model):
    """The scans that a reduced drive was made of."""

    scan_bytes: _Total
    points_per_scan: _Total = Field(description="Median.")
    least_points: _Total
    most_points: _Total


class ReducedManifest(_Model):
    """A reduced drive."""

    format: Literal["interloc-reduced-drive"] = "interloc-reduced-drive"
    format_version: Literal[1] = 1
    name: Annotated[str, Field(min_length=1, max_length=255), AfterValidator(_plain_name)] = Field(
        description="Name of the drive that it was made of."
    )
    layout: LayoutName = Field(description="Layout of that drive.")
    scans: _Runs = Field(description="Numbers of all its scans, as runs: [first, count].")
    kept: _Runs = Field(description="Numbers of the scans whose ground points are here.")
    keyframes: Thinning | None = Field(None, description="Settings by which they were chosen; none: every scan.")
    pose_frame: PoseOwner = Field(description="Whose poses the pose file holds.")
    pose_frame_reason: str = Field("", max_length=2000, description="Why that is thought.")
    files: SmallFiles = SmallFiles()
    labels: list[ReducedLabels] = Field([], max_length=2)
    source: SourceScans | None = None

    @model_validator(mode="after")
    def _consistent(self) -> ReducedManifest:
        if not np.isin(self.kept_frames, self.frames).all():
            raise ValueError("kept: holds numbers that are not among the scans")
        if (self.files.poses is None) != (self.pose_frame == "oxts"):
            raise ValueError("files.poses: expected a file, or pose_frame 'oxts' where there is none")
        if len({labels.folder for labels in self.labels}) < len(self.labels):
            raise ValueError("labels: a folder comes twice")
        return self

    @property
    def frames(self) -> IntArray:
        """(N,) int64 numbers of all scans."""
        return from_runs(self.scans)

    @property
    def kept_frames(self) -> IntArray:
        """(K,) int64 numbers of the scans whose ground points are here."""
        return from_runs(self.kept)

    def with_labels(self, labels: Iterable[ReducedLabels], source: SourceScans | None = None) -> ReducedManifest:
        """Complete a plan once it is known what the labels mean."""
        return ReducedManifest.model_validate({**dict(self), "labels": list(labels), "source": source})

    def to_bytes(self) -> bytes:
        """Write it as JSON, a field a line."""
        fields = self.model_dump(mode="json")
        lines = [f" {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in fields.items()]
        return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def ground_path(folder: LabelFolder, frame: int) -> str:
    """Return the file of a scan, relative to the reduced drive."""
    return f"{GROUND_FOLDER}/{folder}/{frame:06d}.ground"


def is_reduced(root: Path) -> bool:
    """Tell a reduced drive by its manifest."""
    return (root / MANIFEST).is_file()


def read_manifest(root: Path) -> ReducedManifest:
    """Read the manifest of a reduced drive; nothing in it is trusted.

    Raises
    ------
    DriveError
        It cannot be read, is not of this format or version, or names files outside the folder.
    """
    path = root / MANIFEST
    try:
        with path.open("rb") as file:
            data = file.read(MAX_MANIFEST_BYTES + 1)
    except OSError as error:
        raise DriveFileError(MANIFEST, f"cannot be read: {os_reason(error)}.") from error
    if len(data) > MAX_MANIFEST_BYTES:
        raise DriveFileError(MANIFEST, f"is larger than {MAX_MANIFEST_BYTES // 1024**2} MB, which no manifest is.")
    manifest = parse_manifest(data)
    inside = root.resolve()
    for name in manifest.files.paths:
        if not (root / name).resolve().is_relative_to(inside):
            raise DriveFileError(name, "is a link that leads out of the folder. Expected the file itself.")
    return manifest


def parse_manifest(data: bytes) -> ReducedManifest:
    """Read the text of a manifest.

    Raises
    ------
    DriveError
        It is not of this format or version.
    """
    with _refusals():
        return ReducedManifest.model_validate_json(data)


def make_manifest(fields: dict[str, Any]) -> ReducedManifest:
    """Make a manifest of its fields.

    Raises
    ------
    DriveError
        One of them cannot be, such as a name with line breaks.
    """
    with _refusals():
        return ReducedManifest.model_validate(fields)


@contextmanager
def _refusals() -> Iterator[None]:
    """Say in words what is wrong with a manifest."""
    try:
        yield
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"])
        what = first["msg"].removeprefix("Value error, ")
        raise DriveFileError(
            MANIFEST,
            f"{place + ': ' if place else ''}{what}. Expected the manifest of a reduced drive, format "
            "interloc-reduced-drive version 1. Usual cause: a file of another program or of a later InterLoc, or one "
            "edited by hand.",
        ) from None
