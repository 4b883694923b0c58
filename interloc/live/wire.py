"""A scan as one binary message: ILS1, the length of a head, the head as JSON, then the points of the ground.

::

    0        4 bytes     "ILS1"
    4        uint32      H: length of the head, a multiple of 4
    8        H bytes     head: JSON in UTF-8, filled up with spaces
    8 + H    points x 3 float32    x y z in L, metres: those of road, then sidewalk, parking and other ground

All numbers are little-endian. The head is a `Head`.
"""

import struct
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from interloc.errors import DriveError
from interloc.live.scan import Fix, LiveScan
from interloc.wording import first_fault

MAGIC = b"ILS1"
_START = struct.Struct("<4sI")
_MAX_HEAD = 64 * 1024
_MAX_FRAME = 2**53

Matrix3 = Annotated[list[float], Field(min_length=9, max_length=9)]
Matrix4 = Annotated[list[float], Field(min_length=16, max_length=16)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class FixHead(_Message):
    """Where the LiDAR was on Earth: a `Fix`."""

    lat_deg: float = Field(ge=-90, le=90)
    lon_deg: float = Field(ge=-360, le=360)
    alt_m: float = 0.0
    R_enu_lidar: Matrix3 = Field(description="Axes of L in east, north, up; row by row.")
    position_std_m: float | None = Field(None, ge=0)


class Head(_Message):
    """What stands in front of the points of a scan."""

    frame: int = Field(ge=0, le=_MAX_FRAME, description="Scan number; ascending.")
    pose: Matrix4 = Field(description="T_world_lidar, row by row.")
    time_s: float | None = None
    fix: FixHead | None = None
    points: int = Field(ge=0, le=2**26)
    road_count: int = Field(ge=0, description="So many of the points are of road, those behind them of other ground.")


def encode_scan(scan: LiveScan) -> bytes:
    """Return the message of a scan, of its points those of the ground; a `DriveError` as of `LiveScan.ground`."""
    fix, ground = scan.fix, scan.ground
    head = Head(
        frame=scan.frame,
        pose=scan.T_world_lidar.ravel().tolist(),
        time_s=scan.time_s,
        fix=None if fix is None else FixHead(**vars(fix) | {"R_enu_lidar": fix.R_enu_lidar.ravel().tolist()}),
        points=len(ground.xyz),
        road_count=ground.road_count,
    )
    text = head.model_dump_json().encode()
    text += b" " * (-len(text) % 4)
    return _START.pack(MAGIC, len(text)) + text + np.ascontiguousarray(ground.xyz, "<f4").tobytes()


def decode_scan(data: bytes) -> LiveScan:
    """Read the message of a scan, else raise a `DriveError`; its points are not copied yet."""
    if len(data) < _START.size or data[:4] != MAGIC:
        raise DriveError(
            f"a message of {len(data):,} bytes does not begin with ILS1. Expected one binary message per scan, as "
            "docs/live.md describes it. Usual cause: points without their head, or another protocol."
        )
    _, length = _START.unpack_from(data)
    begin = _START.size + length
    if length % 4 or length > _MAX_HEAD or begin > len(data):
        raise DriveError(
            f"the head of a scan is said to have {length:,} bytes, in a message of {len(data):,}. Expected a multiple "
            f"of 4, up to {_MAX_HEAD:,}."
        )
    try:
        head = Head.model_validate_json(bytes(data[_START.size : begin]))
    except ValidationError as error:
        raise DriveError(f"the head of a scan: {first_fault(error)}.") from None
    count, expected = head.points, begin + 12 * head.points
    if len(data) != expected:
        raise DriveError(
            f"scan {head.frame}: the message has {len(data):,} bytes; its head announces {count:,} points of 12 bytes, "
            f"which make {expected:,}."
        )
    if head.road_count > count:
        raise DriveError(f"scan {head.frame}: road_count is {head.road_count:,} of {count:,} points.")
    fix = head.fix
    return LiveScan(
        frame=head.frame,
        T_world_lidar=np.array(head.pose).reshape(4, 4),
        points=np.frombuffer(data, "<f4", 3 * count, begin).reshape(count, 3),
        road_count=head.road_count,
        time_s=head.time_s,
        fix=None if fix is None else Fix(**dict(fix) | {"R_enu_lidar": np.array(fix.R_enu_lidar).reshape(3, 3)}),
    )
