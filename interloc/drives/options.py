"""How a drive is to be read where its folder leaves it open: the same options for library, commands and service."""

import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypedDict

from pydantic import BaseModel, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError, field_validator
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from interloc.drives.formats import FORMATS, find_format, installed_formats
from interloc.drives.labels import named_scheme
from interloc.errors import ConfigError

LabelFolder = Literal["labels", "predictions", "geometry"]
"""Labels that a drive can have: in files of two folders, or made of its points."""

LABEL_FILES: tuple[LabelFolder, ...] = ("labels", "predictions")
"""Folders of label files."""

LabelChoice = Literal["auto", "labels", "predictions", "geometry"]
PoseFrame = Literal["auto", "camera", "lidar"]
Deskew = Literal["auto", "on", "off"]
ODOMETRY = "odometry"
"""In place of a file of poses: they are computed from the points."""

LABELS = (
    "Which labels: the files of labels/ or predictions/, or geometry, which finds the road by the points and the path "
    "driven; auto takes the first that there is, labels of the points themselves before geometry."
)
CRS_PATTERN = r"^[A-Za-z]+:[0-9]+$"
PART_PATTERN = r"^[0-9]{0,18}:[0-9]{0,18}$"


@dataclass(frozen=True)
class _AmongLayouts:
    """A name of the table of formats; those of other packages are looked up only where it comes to them."""

    besides: tuple[str, ...] = ()

    def _names(self) -> list[str]:
        return [*self.besides, *(each.name for each in (*FORMATS, *installed_formats()))]

    def _checked(self, name: object) -> object:
        if name in self.besides or find_format(name) is not None:
            return name
        *others, last = map(repr, self._names())
        expected = f"{', '.join(others)} or {last}"
        raise PydanticCustomError("literal_error", "Input should be {expected}", {"expected": expected})

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {**handler(schema), "enum": self._names()}


LayoutName = Annotated[str, _AmongLayouts()]
LayoutChoice = Annotated[str, _AmongLayouts(("auto",))]


class ReadingOptions(BaseModel, frozen=True, extra="forbid", defer_build=True):
    """How a drive is to be read, whichever its labels."""

    label_scheme: str = Field(
        default="auto",
        max_length=1000,
        description="auto, semantickitti, learning, kitti360, or the ids of road, as 40,60.",
        examples=["auto"],
    )
    pose_frame: PoseFrame = Field(
        default="auto", description="Sensor whose poses the pose file holds; auto finds it out from the motion."
    )
    layout: LayoutChoice = Field(default="auto", description="Layout of the folder.")
    oxts: Path | None = Field(
        default=None,
        description="Georeference from elsewhere: the folder of a KITTI raw drive, a file with one OXTS row per frame "
        "(or its .gz), or a geo.csv.",
        examples=["07.txt.gz"],
    )
    poses: str | None = Field(
        default=None,
        max_length=1000,
        description="Where the poses are, if not where the layout has them: the word odometry (they are "
        "computed from the points), a file of poses (KITTI or TUM), the trajectory of LAS files, or a topic of a bag.",
        examples=["/odometry"],
    )
    points: str | None = Field(
        default=None, max_length=1000, description="Topic of the scans in a bag.", examples=["/velodyne_points"]
    )
    fix: str | None = Field(
        default=None, max_length=1000, description="Topic of the GNSS fixes in a bag.", examples=["/fix"]
    )
    crs: str | None = Field(
        default=None,
        max_length=100,
        pattern=CRS_PATTERN,
        description="Coordinate system of LAS files that do not name theirs.",
        examples=["EPSG:25832"],
    )
    frames: str | None = Field(
        default=None,
        max_length=40,
        pattern=PART_PATTERN,
        description="Part of the drive to use, FROM:TO by the numbers of its scans: TO is the first that is left out; "
        "without FROM it begins with the first scan, without TO it ends with the last.",
        examples=["200:1400"],
    )
    deskew: Deskew = Field(
        default="auto",
        description="Take the motion within a scan out of points that carry times; auto does it where the points of a "
        "spinning LiDAR show that it is still in them.",
    )

    @classmethod
    def of(cls, given: "ReadingOptions | None" = None, /, **arguments: Any) -> Self:  # noqa: ANN401 - they are checked
        """Return the options of `given`, but for those that the arguments (`DriveArguments`) name."""
        scheme = arguments.get("label_scheme", "auto")
        if not isinstance(scheme, str):
            arguments["label_scheme"] = ",".join(str(label) for label in sorted(scheme))
        try:
            return cls.model_validate({**dict(given or {}), **arguments})
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            message = first["msg"].removeprefix("Value error, ")
            if not message.startswith("label scheme"):
                expected = first.get("ctx", {}).get("expected")
                if first["type"] == "string_pattern_mismatch":
                    expected = f"one such as {(cls.model_fields[str(first['loc'][0])].examples or [])[0]}"
                name = " ".join(map(str, first["loc"])).replace("_", " ")
                message = f"{name} {first['input']!r}: {f'expected {expected}' if expected else message}."
            raise ConfigError(message) from None

    @field_validator("label_scheme")
    @classmethod
    def _check_scheme(cls, scheme: str) -> str:
        try:
            named_scheme(scheme)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        return scheme


class DriveOptions(ReadingOptions):
    """Options of `open_drive` and `inspect_drive`."""

    labels: LabelChoice = Field(default="auto", description=LABELS)
    model: Path | None = Field(
        default=None,
        description="Folder of a network (model.onnx, arch_cfg.yaml, data_cfg.yaml) that labels the scans; label files "
        "do not count.",
    )
    provider: str = Field(default="cpu", max_length=100, description="What the network runs on: cpu, cuda, ...")
    name: str | None = Field(default=None, description="Name of the drive, where it is not that of the folder.")
    check: bool = Field(
        default=True,
        description="Check the sizes of all files, and look into a few scans to see whether labels, poses and "
        "georeference fit together.",
    )


class DriveArguments(TypedDict, total=False):
    """`DriveOptions` as keyword arguments."""

    labels: LabelChoice
    label_scheme: str | Collection[int]
    pose_frame: PoseFrame
    layout: LayoutChoice
    oxts: str | os.PathLike[str] | None
    poses: str | None
    points: str | None
    fix: str | None
    crs: str | None
    frames: str | None
    deskew: Deskew
    model: str | os.PathLike[str] | None
    provider: str
    name: str | None
    check: bool
