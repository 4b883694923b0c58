"""What a run over a drive yields: keyframes, detections, fused intersections, as columns.

Bearings are degrees clockwise from north where the run is georeferenced, else clockwise from the +y axis of W.
"""

import platform
import zlib
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
from typing_extensions import TypedDict

from interloc.arrays import BoolArray, FloatArray, IntArray, JsonObject, UInt8Array
from interloc.wording import counted

EPOCH_S = 1e8
"""Times of a drive above this are seconds since 1970 (UTC); those below count from a start such as the first scan."""

_YEAR_10000_S = 253402300800.0


def moment(time_s: float) -> str | None:
    """Return a time of a drive in RFC 3339, as 2011-09-30T12:40:59.123Z; None where it is no time of the day."""
    if not EPOCH_S <= time_s < _YEAR_10000_S - 1.0:
        return None
    return datetime.fromtimestamp(round(time_s, 3), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class _Placed:
    """A table, a dataclass of columns, whose rows have places on Earth, in a run with a georeference."""

    lonlat: FloatArray | None

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))  # type: ignore[arg-type]

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name} {counted(len(self), name.removesuffix('Table').lower())}>"

    @property
    def degrees(self) -> FloatArray:
        """`lonlat` of a run that is known to have a georeference."""
        assert self.lonlat is not None
        return self.lonlat


class _Table(_Placed):
    """A dataclass of columns of one length: arrays, or lists; None where a column is not known."""

    def select(self, rows: IntArray) -> Self:
        """Return some of the rows."""

        def taken(column: Any) -> Any:  # noqa: ANN401 - of any type
            if column is None:
                return None
            return [column[row] for row in rows] if isinstance(column, list) else column[rows]

        return replace(self, **{each.name: taken(getattr(self, each.name)) for each in fields(self)})  # type: ignore[type-var,arg-type]


@dataclass(frozen=True, repr=False, eq=False)
class KeyframeTable(_Table):
    """The K keyframes of a run, in the order of the drive."""

    frame: IntArray
    """(K,) int64: scan numbers, ascending."""
    time_s: FloatArray
    """(K,) float64: as the drive gives them, see `moment`; NaN where it has none."""
    world_xy: FloatArray
    """(K, 2) float64: position of the LiDAR in W, metres."""
    world_yaw_rad: FloatArray
    """(K,) float64: heading of the LiDAR in W, counter-clockwise from +x."""
    lonlat: FloatArray | None = None
    """(K, 2) float64 or None: longitude, latitude of the LiDAR, degrees; None without georeference."""
    enu_yaw_rad: FloatArray | None = None
    """(K,) float64 or None: heading of the LiDAR, counter-clockwise from east; None without georeference."""
    position_std_m: FloatArray | None = None
    """(K,) float64 or None: one-sigma uncertainty of `lonlat` along each axis, as the georeference states it, NaN where
    it does not; None without georeference, and where the run was read from a folder."""
    is_doubtful: BoolArray | None = None
    """(K,) bool or None: where labels, made by geometry, may be wrong; None where the run was read from a folder."""

    @property
    def moments(self) -> list[str | None]:
        """K moments in RFC 3339, UTC, to the millisecond; None where the drive's times are not times of the day."""
        return [moment(seconds) for seconds in self.time_s.tolist()]


@dataclass(frozen=True, repr=False, eq=False)
class DetectionTable(_Table):
    """The D detections of a run, in the order of their keyframes."""

    keyframe: IntArray
    """(D,) int64: row of the keyframe table."""
    lidar_xy: FloatArray
    """(D, 2) float64: position in L of its keyframe (levelled), metres (paper, eq. 11)."""
    world_xy: FloatArray
    """(D, 2) float64: position in W, metres."""
    lonlat: FloatArray | None
    """(D, 2) float64 or None: longitude, latitude, degrees, from the fix of its own keyframe (paper, eq. 12)."""
    bearings_deg: list[FloatArray]
    """List of (B,) float64: bearing of each branch, leaving the intersection."""
    score: FloatArray
    """(D,) float64: 0..1, how sure the detector is."""
    intersection: IntArray
    """(D,) int64: row of the fused intersection that the detection belongs to, -1 for none."""
    widths_m: list[FloatArray]
    """List of (B,) float64: width of the road across each branch, metres; NaN where it is not known."""
    position_std_m: FloatArray
    """(D,) float64: standard deviation along each axis, metres, by how well the lines of its branches are known and
    meet."""

    @property
    def number(self) -> IntArray:
        """(D,) int64 number of each detection at its keyframe, from 1."""
        return np.arange(len(self)) - np.searchsorted(self.keyframe, self.keyframe) + 1

    def names(self, keyframes: KeyframeTable) -> list[str]:
        """Return the id of each detection: scan number of its keyframe and its number there, as 120-1."""
        frames = keyframes.frame[self.keyframe].tolist()
        return [f"{frame}-{number}" for frame, number in zip(frames, self.number.tolist(), strict=True)]


@dataclass(frozen=True)
class PositionParts:
    """What the covariance of M positions is the sum of, since each part averages out over something else."""

    fix_std_m: FloatArray
    """(M,) float64: of the georeference along each axis: all intersections of a drive share it, drives do not. NaN: not
    known."""
    shape_cov_m2: FloatArray
    """(M, 3) float64: of the shape of the intersection, as `IntersectionTable.position_cov_m2`: all drives share it.
    NaN: not known."""
    scatter_std_m: FloatArray
    """(M,) float64: of the scatter between sightings along each axis, which nothing shares. NaN: not known."""

    @classmethod
    def unknown(cls, count: int) -> "PositionParts":
        """Return the parts of a result that does not tell them apart."""
        return cls(np.full(count, np.nan), np.full((count, 3), np.nan), np.full(count, np.nan))


@dataclass(frozen=True, repr=False, eq=False)
class IntersectionTable(_Placed):
    """The M physical intersections that the detections were fused into."""

    id: IntArray
    """(M,) int64: 1..M, in the order of first sight."""
    world_xy: FloatArray
    """(M, 2) float64: position in W, metres; with georeference the W of the first observation (drift makes W
    ambiguous)."""
    lonlat: FloatArray | None
    """(M, 2) float64 or None: longitude, latitude, degrees."""
    position_std_m: FloatArray
    """(M,) float64: one-sigma uncertainty of the position (root of the mean variance of x and y of the estimate)."""
    observations: IntArray
    """(M,) int64: number of detections fused."""
    confidence: FloatArray
    """(M,) float64: 0..1: probability that a road junction lies within 10 m where `DetectorConfig.calibration` is set,
    else how often it was seen when it could have been."""
    bearings_deg: list[FloatArray]
    """List of (B,) float64."""
    first_frame: IntArray
    last_frame: IntArray
    """(M,) int64: scan numbers of the first and the last keyframe that saw it."""
    widths_m: list[FloatArray]
    """List of (B,) float64: width of the road across each branch, metres; NaN where it is not known."""
    position_cov_m2: FloatArray | None = None
    """(M, 3) float64 or None: covariance of the position: variance to the east, covariance of east and north, variance
    to the north, square metres (of x and y of W without georeference). None in results of versions before: use
    `covariances`."""
    parts: PositionParts | None = None
    """What that is the sum of. None, or NaN, where it is not known: in results of versions before, and where
    `DetectorConfig.calibration` is not set."""
    bends: int = 0
    """Places that were left out, because all their detections together saw two branches only."""

    @property
    def covariances(self) -> FloatArray:
        """(M, 2, 2) covariance of each position; the same in all directions where only `position_std_m` is known."""
        if self.position_cov_m2 is None:
            return self.position_std_m[:, None, None] ** 2 * np.eye(2)
        return self.position_cov_m2[:, [[0, 1], [1, 2]]]


@dataclass(frozen=True)
class Verdicts:
    """What an evaluation says about each of the N rows of a table."""

    outcome: list[str]
    """List of N str: right, wrong, not_counted (intersections only) or unscored."""
    osm_id: list[int | None]
    """List of N int or None: OpenStreetMap node that the row was compared with."""
    error_m: FloatArray
    """(N,) float64: distance to it, metres; not finite where there is none."""
    reason: list[str | None]
    """List of N str or None: Why it is not right."""

    @classmethod
    def unscored(cls, count: int) -> "Verdicts":
        """Return the verdicts before an evaluation."""
        return cls(["unscored"] * count, [None] * count, np.full(count, np.nan), [None] * count)

    def __len__(self) -> int:
        return len(self.outcome)


@dataclass(frozen=True)
class RoadPatch:
    """The road around one keyframe, aligned with W: a square of cells, packed."""

    keyframe: int
    """Row of the keyframe table."""
    corner_xy: FloatArray
    """(2,) float64: upper left corner (least x, greatest y) in W, metres."""
    resolution_m: float
    """Side of a cell."""
    size: int
    """Cells per side."""
    packed: bytes
    """The cells row by row, top row first, eight per byte, deflated: 1 where the ground is road."""
    packed_other: bytes = b""
    """The same of other ground, such as a sidewalk: 1 where it was seen and is no road. Empty where nobody can tell."""

    @classmethod
    def pack(
        cls,
        keyframe: int,
        corner_xy: FloatArray,
        resolution_m: float,
        cells: UInt8Array,
        other: UInt8Array | None = None,
    ) -> "RoadPatch":
        """Pack (size, size) images of 0 and 1: the road, and other ground."""
        packed, packed_other = (
            b"" if each is None else zlib.compress(np.packbits(each).tobytes(), 1) for each in (cells, other)
        )
        return cls(keyframe, corner_xy, resolution_m, len(cells), packed, packed_other)

    def cells(self) -> UInt8Array:
        """Return the (size, size) uint8 image, 1 where the ground is road."""
        return self._inflated(self.packed)

    def other_cells(self) -> UInt8Array | None:
        """Return the (size, size) uint8 image, 1 where other ground was seen; None where nobody can tell."""
        return self._inflated(self.packed_other) if self.packed_other else None

    def _inflated(self, packed: bytes) -> UInt8Array:
        bits = np.frombuffer(zlib.decompress(packed), np.uint8)
        return np.unpackbits(bits, count=self.size**2).reshape(self.size, self.size)


class Dropped(TypedDict):
    """Scans that were lost before they came into the drive."""

    scans: int
    of: int
    stretches_m: list[tuple[float, float]]
    """From where to where along the track: from a scan to the next one that is there."""


class RunRecord(TypedDict, total=False):
    """What `run.json` holds; results of versions before have less, and those in memory have no `RUN_KEYS`."""

    format: str
    format_version: int
    drive_name: str
    georeferenced: bool
    files: list[str]
    first_time: str | None
    last_time: str | None
    drive: str
    config: JsonObject
    fusion: JsonObject
    versions: dict[str, str]
    scans: int
    keyframes: int
    labels: str | None
    road_ids: list[int]
    poses: str
    frames: list[int]
    """The first and the last."""
    doubtful_labels_m: list[tuple[float, float]]
    """From where to where along the track labels by geometry may be wrong."""
    georeference: str | None
    workers: int
    seconds: float
    stage_seconds: dict[str, float]
    peak_memory_bytes: int
    dropped: Dropped
    bends: int
    job: str
    location: JsonObject
    """Where a map placed it: `interloc.localization.locate.Location.record`."""
    missing: list[str]
    """What beside the tables could not be made."""


@dataclass(frozen=True, eq=False)
class DriveResult:
    """Everything that `detect` found on a drive."""

    drive: str
    """Name of the drive."""
    keyframes: KeyframeTable
    detections: DetectionTable
    intersections: IntersectionTable
    trajectory_world_xy: FloatArray
    """(N, 2) float64: the same in W, metres."""
    trajectory_lonlat: FloatArray | None
    """(N, 2) float64 or None: longitude, latitude of the LiDAR at every scan, degrees."""
    run: RunRecord = field(default_factory=RunRecord)
    road: tuple[RoadPatch, ...] = ()
    """The road around some of the keyframes, for the mosaic; empty where the run kept none or was read from a
    folder."""
    road_file: Path | None = None
    """The mosaic of a run that was read from a folder, where it has one."""

    @property
    def is_georeferenced(self) -> bool:
        """True where positions have longitude and latitude."""
        return self.keyframes.lonlat is not None

    def __repr__(self) -> str:
        return (
            f"<DriveResult {self.drive}: {counted(len(self.keyframes), 'keyframe')}, "
            f"{counted(len(self.detections), 'detection')}, {counted(len(self.intersections), 'intersection')}, "
            f"{'with' if self.is_georeferenced else 'without'} georeference>"
        )

    def geodataframe(self, layer: str = "intersections") -> Any:  # noqa: ANN401 - geopandas has no types
        """Return a layer as a GeoDataFrame: `interloc.geodataframe`."""
        import interloc  # noqa: PLC0415 - the public face stands above everything

        return interloc.geodataframe(self, layer)


@cache
def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    packages = {name: version(name) for name in ("interloc", "numpy", "numba", "scipy")}
    return {**packages, "python": platform.python_version()}
