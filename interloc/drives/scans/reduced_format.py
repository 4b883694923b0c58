"""Reduced drives: the ground points of the scans that the method looks at, and nothing else; how these are read.

The method needs the road points of keyframes, and the sidewalk, parking and other ground that is confused with road. A
*reduced drive* is a folder that holds just these and the small files of the drive. Every command reads it like the
drive that it was made of, with the same results, bit by bit. This is the format, version 1::

    reduced.json                          the manifest, which makes the folder a reduced drive: write it last
    ground/labels/NNNNNN.ground           the ground points of one scan by the labels in labels/
    ground/predictions/NNNNNN.ground      likewise by those in predictions/
    ground/geometry/NNNNNN.ground         likewise by those made of the points
    poses.txt calib.txt times.txt geo.csv oxts/data/*.txt ...
                                          the small files of the drive, as they were

``NNNNNN`` is the scan number, with zeros in front to at least six digits.

**A .ground file** begins with 16 bytes: the letters ``ILGP``, then three unsigned 32-bit numbers, the lowest byte
first: the version (1, or 257 where the labels of the scan may be wrong), the count n of points (at most 4,000,000), and
how many of them are road. The rest of the file is one zlib stream (RFC 1950; in a browser
``CompressionStream("deflate")``) of exactly 12 n bytes.

Points come in the order of the scan, those of road first, then sidewalk, parking and other ground. To make the bytes,

1. take the float32 coordinates x, y, z (L, metres) as their 32 bits;
2. replace each by its difference to the same coordinate of the point before, modulo 2^32 (the first point: to 0);
3. fold the sign, so that -1, 1, -2 become 1, 2, 3: ``(d << 1) ^ (d >> 31)``, d as a signed 32-bit number;
4. write the highest byte of x of all points, then those of y, then those of z; then the next lower bytes of x, ...:
   twelve planes of n bytes.

**reduced.json** is JSON of the model `ReducedManifest`, whose fields are described there. Scan numbers are written as
runs, ``[first, count]``. An example, 1101 scans of which three were kept::

    {
      "format": "interloc-reduced-drive", "format_version": 1,
      "name": "07", "layout": "semantickitti",
      "scans": [[0, 1101]], "kept": [[0, 1], [19, 1], [31, 1]],
      "keyframes": {"distance_m": 2.0, "angle_deg": 5.0},
      "pose_frame": "camera", "pose_frame_reason": "it moves along its z axis ...",
      "files": {"poses": "poses.txt", "times": "times.txt", "calibration": ["calib.txt"], "oxts": null, "geo": null},
      "labels": [{"folder": "labels", "scheme": "semantickitti", "road": [40, 60], "confusable": [44, 48, 49],
                  "counts": {"0": 12, "40": 98765}, "label_bytes": 539000000}],
      "source": {"scan_bytes": 2156000000, "points_per_scan": 122515, "least_points": 118000, "most_points": 125000}
    }
"""

import json
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from interloc.arrays import IntArray, UInt32Array
from interloc.drive import GroundPoints
from interloc.drives.files import SourceFile, list_numbered
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.labels import SCHEMES, LabelJudgement, LabelScheme, check_labels, named_scheme
from interloc.drives.layouts import DriveParts, PoseOwner
from interloc.drives.options import LABEL_FILES, DriveOptions, LabelFolder, LayoutName
from interloc.drives.scans.recording import ReducedReport, ScanFacts
from interloc.drives.trajectory import Trajectory, read_trajectory
from interloc.files import reason_of
from interloc.wording import first_fault, listed

MANIFEST = "reduced.json"
MAX_SCANS = 1_000_000
MAX_MANIFEST_BYTES = 32 * 1024 * 1024
GROUND_FOLDER = "ground"


Run = tuple[int, int]
"""First number and count."""


def to_runs(numbers: IntArray) -> list[Run]:
    """Write (N,) ascending numbers as runs."""
    if not len(numbers):
        return []
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 2) != 1)
    counts = np.diff(starts, append=len(numbers))
    return [(int(numbers[start]), int(count)) for start, count in zip(starts, counts, strict=True)]


def from_runs(runs: Sequence[Run]) -> IntArray:
    """Return the (N,) numbers of runs."""
    first, count = np.array(runs, dtype=np.int64).reshape(-1, 2).T
    begin = np.cumsum(count) - count
    return np.repeat(first - begin, count) + np.arange(count.sum(), dtype=np.int64)


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
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


class Thinning(_Model):
    """Keyframe settings by which scans were left out."""

    distance_m: float = Field(ge=0, le=1000, description="A scan was kept after more than this distance, in metres.")
    angle_deg: float = Field(ge=0, le=180, description="A scan was kept after more than this turn, in degrees.")

    def __str__(self) -> str:
        return f"keyframes of {self.distance_m:g} m, {self.angle_deg:g} degrees"


class SmallFiles(_Model):
    """The other files of the drive, as paths inside the folder."""

    poses: _PathInside | None = Field(None, description="Pose lines; null where the poses are those of OXTS.")
    times: _PathInside | None = Field(None, description="One time per line.")
    calibration: list[_PathInside] = Field([], max_length=8, description="calib.txt, calib_imu_to_velo.txt, ...")
    oxts: _PathInside | None = Field(
        None, description="Folder with one OXTS file per frame, or file with one row per frame."
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
    ) -> "ReducedLabels":
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
    points_per_scan: _Total | None = Field(
        None, description="Median number of points per scan; null where it was not known without reading them."
    )
    least_points: _Total | None = None
    most_points: _Total | None = None


class SourceWarning(_Model):
    """What was odd about the drive, or was put right; the reduced drive may not show it any more."""

    path: str = Field(max_length=1000, description="File or folder.")
    message: str = Field(max_length=4000)


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
    keyframes: Thinning | None = Field(None, description="Settings by which they were chosen; null: every scan.")
    pose_frame: PoseOwner = Field(description="Whose poses the pose file holds.")
    pose_frame_reason: str = Field("", max_length=2000, description="Why that is thought.")
    files: SmallFiles = SmallFiles()
    labels: list[ReducedLabels] = Field([], max_length=3)
    source: SourceScans | None = None
    warnings: list[SourceWarning] = Field([], max_length=100, description="What was odd about that drive.")

    @model_validator(mode="after")
    def _consistent(self) -> "ReducedManifest":
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

    def with_labels(self, labels: Iterable[ReducedLabels], source: SourceScans | None = None) -> "ReducedManifest":
        """Complete a plan once it is known what the labels mean."""
        return ReducedManifest.model_validate({**dict(self), "labels": list(labels), "source": source})

    def to_bytes(self) -> bytes:
        """Write it as JSON, one field per line."""
        fields = self.model_dump(mode="json")
        lines = [f" {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in fields.items()]
        return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def ground_path(folder: LabelFolder, frame: int) -> str:
    """Return the file of a scan, relative to the reduced drive."""
    return f"{GROUND_FOLDER}/{folder}/{frame:06d}.ground"


def is_reduced(root: Path) -> bool:
    """Return whether a folder is a reduced drive: one with a manifest."""
    return (root / MANIFEST).is_file()


def read_manifest(root: Path) -> ReducedManifest:
    """Read the manifest of a reduced drive; nothing in it is trusted."""
    path = root / MANIFEST
    try:
        with path.open("rb") as file:
            data = file.read(MAX_MANIFEST_BYTES + 1)
    except OSError as error:
        raise DriveFileError(MANIFEST, f"cannot be read: {reason_of(error)}.") from error
    if len(data) > MAX_MANIFEST_BYTES:
        raise DriveFileError(MANIFEST, f"is larger than {MAX_MANIFEST_BYTES // 1024**2} MB, which no manifest is.")
    manifest = parse_manifest(data)
    inside = root.resolve()
    for name in manifest.files.paths:
        if not (root / name).resolve().is_relative_to(inside):
            raise DriveFileError(name, "is a link that leads out of the folder. Expected the file itself.")
    return manifest


def parse_manifest(data: bytes) -> ReducedManifest:
    """Read the text of a manifest."""
    with _refusals():
        return ReducedManifest.model_validate_json(data)


def make_manifest(fields: dict[str, Any]) -> ReducedManifest:
    """Make a manifest of its fields."""
    with _refusals():
        return ReducedManifest.model_validate(fields)


@contextmanager
def _refusals() -> Iterator[None]:
    """Turn what is wrong with a manifest into words."""
    try:
        yield
    except ValidationError as error:
        raise DriveFileError(
            MANIFEST,
            f"{first_fault(error)}. Expected the manifest of a reduced drive, format "
            "interloc-reduced-drive version 1. Usual cause: a file of another program or of a later InterLoc, or one "
            "edited by hand.",
        ) from None


MAX_POINTS = 4_000_000
"""A scan has 0.1 to 0.3 million; nothing larger is allocated."""

_HEADER = struct.Struct("<4sIII")
_MAGIC, _VERSION, _DOUBTFUL = b"ILGP", 1, 256
_POINT_BYTES = 12
MIN_BYTES = _HEADER.size + 8
MAX_BYTES = _HEADER.size + MAX_POINTS * _POINT_BYTES * 9 // 8 + 1024
"""No file is larger, however badly its maker compresses."""

_CUT = "Usual cause: an upload or copy that did not finish."


def encode_ground(points: GroundPoints) -> bytes:
    """Write the ground points of a scan."""
    xyz = np.ascontiguousarray(points.xyz)
    if xyz.dtype != np.float32 or xyz.ndim != 2 or xyz.shape[1] != 3 or not 0 <= points.road_count <= len(xyz):
        raise ValueError(f"expected (N, 3) float32 points, at most N of them road; got {xyz.shape} {xyz.dtype}")
    if len(xyz) > MAX_POINTS:
        raise ValueError(f"{len(xyz):,} ground points; no scan has more than {MAX_POINTS:,}")
    # Runs are all that deflate finds in the planes: looking for nothing else is as small, and five times as fast.
    deflate = zlib.compressobj(strategy=zlib.Z_RLE)
    header = _HEADER.pack(_MAGIC, _VERSION | _DOUBTFUL * points.is_doubtful, len(xyz), points.road_count)
    return b"".join((header, deflate.compress(to_planes(xyz.view(np.uint32))), deflate.flush()))


def decode_ground(data: bytes, name: str) -> GroundPoints:
    """Read what `encode_ground` wrote, from a file of this name; nothing in it is trusted."""
    count, road_count, is_doubtful = _head(data, name)
    size = count * _POINT_BYTES
    inflate = zlib.decompressobj()
    try:
        raw = inflate.decompress(memoryview(data)[_HEADER.size :], size + 1)  # never more than the header promises
    except zlib.error as error:
        raise DriveFileError(name, f"is damaged: {error}. {_CUT}") from None
    if len(raw) != size:
        found = f"more than {size:,}" if len(raw) > size else f"{len(raw):,} of {size:,}"
        raise DriveFileError(name, f"is damaged: its {count:,} points unpack to {found} bytes. {_CUT}")
    if not inflate.eof:
        raise DriveFileError(name, f"is damaged: the end of its {count:,} points is missing. {_CUT}")
    if inflate.unused_data:
        raise DriveFileError(
            name, f"{len(inflate.unused_data):,} bytes follow after its points. Expected nothing more."
        )
    xyz = from_planes(raw).view(np.float32)
    finite = np.isfinite(xyz)
    if not finite.all():
        bad_point = int(np.argmin(finite.all(axis=1)))
        x, y, z = xyz[bad_point]
        raise DriveFileError(
            name, f"point {bad_point:,} of {count:,} is not finite ({x:g}, {y:g}, {z:g}). Expected x y z in metres."
        )
    return GroundPoints(xyz, road_count, is_doubtful)


def to_planes(bits: UInt32Array) -> bytes:
    """Sort the bytes of (N, 3) uint32 differences along the rows by their weight (steps 2 to 4 of the format)."""
    steps = np.diff(bits, axis=0, prepend=np.zeros((1, 3), np.uint32)).view(np.int32)
    folded = ((steps << 1) ^ (steps >> 31)).astype(">i4")
    return folded.view(np.uint8).reshape(-1, 3, 4).transpose(2, 1, 0).tobytes()


def from_planes(planes: bytes) -> UInt32Array:
    """Return the (N, 3) uint32 of `to_planes`."""
    highest, *lower = np.frombuffer(planes, np.uint8).reshape(4, 3, len(planes) // 12)
    folded = highest.astype(np.uint32)
    for plane in lower:
        folded = (folded << np.uint32(8)) | plane
    bits = np.cumsum((folded >> 1) ^ -(folded & 1), axis=1, dtype=np.uint32)
    return np.ascontiguousarray(bits.T)


def _head(data: bytes, name: str) -> tuple[int, int, bool]:
    """Return the counts of points and of road points that the header promises, and whether labels may be wrong."""
    if not MIN_BYTES <= len(data) <= MAX_BYTES:
        raise DriveFileError(name, size_complaint(len(data)))
    magic, version, count, road_count = _HEADER.unpack_from(data)
    if magic != _MAGIC:
        raise DriveFileError(
            name, f"starts with {magic!r}; expected {_MAGIC!r}. Usual cause: another kind of file under this name."
        )
    if version & ~_DOUBTFUL != _VERSION:
        raise DriveFileError(
            name, f"is of version {version}; this InterLoc reads version {_VERSION}. Reduce the drive again with it."
        )
    if count > MAX_POINTS:
        raise DriveFileError(name, f"promises {count:,} points; no scan has more than {MAX_POINTS:,}.")
    if road_count > count:
        raise DriveFileError(name, f"promises {road_count:,} road points among {count:,} points.")
    return count, road_count, version != _VERSION


def size_complaint(size: int) -> str:
    """Return what is wrong with the size of a file."""
    if size == 0:
        return f"is empty. {_CUT}"
    if size < MIN_BYTES:
        return f"holds {size:,} bytes; expected at least {MIN_BYTES}. {_CUT}"
    return f"is larger than {MAX_BYTES // 1024**2} MB, which the ground points of one scan never are."


# A reduced drive as scans


def read_ground(root: Path, folder: LabelFolder, frame: int) -> GroundPoints:
    """Read the ground points of a scan of a reduced drive, chosen by the labels of a folder."""
    file = SourceFile(root / ground_path(folder, frame), root)
    try:
        with file.path.open("rb") as handle:
            data = handle.read(MAX_BYTES + 1)
    except OSError as error:
        raise file.unreadable(error) from error
    return decode_ground(data, file.name)


@dataclass(frozen=True)
class ReducedScans:
    """The scans of a reduced drive, by one of its label folders."""

    manifest: ReducedManifest
    parts: DriveParts
    frames: IntArray
    """(N,) int64: numbers of all scans, also of those that were not kept."""
    kept: IntArray
    """(K,) int64: numbers of the scans that are here."""
    usable: IntArray
    """(M,) int64: positions of those whose files are there, and of a size that can be."""
    labels: ReducedLabels
    """Of the label folder."""
    ground_bytes: int
    """Size of its ground files."""

    is_slow = False

    @classmethod
    def of(
        cls, manifest: ReducedManifest, root: Path, folder: LabelFolder, options: DriveOptions, findings: Findings
    ) -> "ReducedScans":
        """Choose the labels of a folder, and see whether all scans that were kept are there."""
        if options.layout not in {"auto", manifest.layout}:
            raise DriveFileError(
                MANIFEST, f"is a drive of layout {manifest.layout}, not {options.layout}. Give layout 'auto'."
            )
        if options.poses or options.model or options.deskew != "auto":
            usual = "is of a reduced drive, whose poses and labels are fixed. Leave --poses, --deskew and --model out,"
            raise DriveFileError(MANIFEST, f"{usual} or give the drive that it was made from.")
        for each in manifest.warnings:
            findings.warning(each.path, each.message)
        parts = replace(_parts_of(manifest, root, folder), name=options.name or manifest.name)
        frames, kept = manifest.frames, manifest.kept_frames
        labels = _choose_labels(manifest, folder, options)
        there, ground_bytes = _list_ground(kept, parts, findings, sizes=options.check)
        return cls(manifest, parts, frames, kept, np.searchsorted(frames, there), labels, ground_bytes)

    def judge_labels(self, _sample: list[int], options: DriveOptions, findings: Findings) -> LabelJudgement:
        """Take what the labels meant from the manifest."""
        judgement = LabelJudgement(self.labels.label_scheme, dict(self.labels.counts))
        if options.check:
            with findings.stage():
                check_labels(self.labels.folder, judgement, findings)
        return judgement

    def by_scheme(self, _scheme: LabelScheme) -> "ReducedScans":
        """Return the scans as they are: other points are not here."""
        return self

    @property
    def facts(self) -> ScanFacts:
        """What the scans were, and what is left of them."""
        by, source = self.manifest.keyframes, self.manifest.source
        facts = ScanFacts(
            scans=len(self.frames),
            first_frame=int(self.frames[0]),
            last_frame=int(self.frames[-1]),
            reduced=ReducedReport(
                kept_scans=len(self.kept),
                ground_bytes=self.ground_bytes,
                distance_m=None if by is None else by.distance_m,
                angle_deg=None if by is None else by.angle_deg,
            ),
        )
        labels = {"label_folder": self.labels.folder, "label_bytes": self.labels.label_bytes or 0}
        return facts.model_copy(update=labels | ({} if source is None else source.model_dump()))

    @property
    def scheme(self) -> LabelScheme:
        """Which label ids were road."""
        return self.labels.label_scheme

    @property
    def label_source(self) -> str:
        """Name of the label folder."""
        return self.labels.folder

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return ground_path(self.labels.folder, frame)

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan."""
        row = int(np.searchsorted(self.kept, frame))
        if row == len(self.kept) or self.kept[row] != frame:
            by = f"thinned to {self.manifest.keyframes}" if self.manifest.keyframes is not None else "thinned"
            raise DriveFileError(
                MANIFEST,
                f"it was {by} when it was reduced, and scan {frame} was not kept. Usual cause: --frames or other "
                "keyframes.distance_m or angle_deg. Leave them out, or reduce the drive again with --all-scans.",
            )
        return read_ground(self.parts.root, self.labels.folder, frame)


def reduced_trajectory(manifest: ReducedManifest, root: Path, options: DriveOptions, findings: Findings) -> Trajectory:
    """Read poses, times and georeference of a reduced drive from its small files."""
    return read_trajectory(_parts_of(manifest, root, LABEL_FILES[0]), manifest.frames, options, findings)


def _choose_labels(manifest: ReducedManifest, folder: LabelFolder, options: DriveOptions) -> ReducedLabels:
    chosen = next((labels for labels in manifest.labels if labels.folder == folder), None)
    if chosen is None:
        others = [labels.folder for labels in manifest.labels]
        if folder == "geometry":
            raise DriveFileError(
                MANIFEST,
                "is of a reduced drive, which holds ground points only: labels by geometry need all points of the "
                f"scans. Give the drive that it was made from, or its labels ({' or '.join(others)}).",
            )
        hint = f"There is {others[0]}/: choose it as the label folder." if others else "It has none at all."
        raise DriveFileError(f"{GROUND_FOLDER}/{folder}", f"is missing: the drive was reduced without {folder}. {hint}")
    asked = named_scheme(options.label_scheme)
    if asked is not None and not asked.means_the_same(chosen.label_scheme):
        raise DriveFileError(
            MANIFEST,
            f"its points were chosen by label scheme {chosen.scheme} (road {listed(chosen.road, 12)}), "
            f"which label scheme {options.label_scheme!r} contradicts. Other points are not here: give label "
            "scheme 'auto', or reduce the drive again with that scheme.",
        )
    return chosen


def _list_ground(kept: IntArray, parts: DriveParts, findings: Findings, *, sizes: bool) -> tuple[IntArray, int]:
    """Return the numbers of the kept scans whose files are there, and the size of all of these."""
    files = list_numbered(parts.file(parts.scans), ".ground")
    missing = np.setdiff1d(kept, files.numbers)
    if len(missing):
        findings.error(
            files.file(int(missing[0])).fault(
                f"is missing: {len(missing):,} of {len(kept):,} scans that were kept are not there "
                f"({listed(missing)}). Usual cause: an upload or copy that did not finish."
            )
        )
    there, _, at_file = np.intersect1d(kept, files.numbers, assume_unique=True, return_indices=True)
    file_sizes = files.sizes[at_file]
    total = int(file_sizes.sum())
    if not sizes:
        return there, total
    readable = (file_sizes >= MIN_BYTES) & (file_sizes <= MAX_BYTES)
    for row in np.flatnonzero(~readable):
        findings.error(files.file(int(there[row])).fault(size_complaint(int(file_sizes[row]))))
    return there[readable], total


def _parts_of(manifest: ReducedManifest, root: Path, labels: LabelFolder) -> DriveParts:
    """Return the parts of a reduced drive; nothing outside its folder is looked at."""

    def inside(name: str | None) -> Path | None:
        return None if name is None else root / name

    files = manifest.files
    return DriveParts(
        layout=manifest.layout,
        root=root,
        scans=root / GROUND_FOLDER / labels,
        poses=inside(files.poses),
        times=inside(files.times),
        calibration=tuple(root / name for name in files.calibration),
        oxts=inside(files.oxts),
        geo=inside(files.geo),
        name=manifest.name,
        pose_frame=(manifest.pose_frame, manifest.pose_frame_reason),
    )
