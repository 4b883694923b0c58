"""Scans as they were recorded, and their labels: label files, labels of the points, a network, or geometry."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from interloc.arrays import Float32Array, IntArray, UInt8Array, UInt32Array
from interloc.drive import GroundPoints
from interloc.drives.files import (
    LFS_POINTER,
    MAX_NAMED,
    POINTER,
    NumberedFiles,
    SourceFile,
    in_part,
    is_opening,
    list_numbered,
    others_like_it,
    scan_once,
)
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.labels import (
    CONFUSABLE,
    ROAD,
    SEMANTICKITTI,
    LabelJudgement,
    LabelScheme,
    check_below,
    ids_below,
    judge_labels,
)
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions, LabelFolder
from interloc.drives.scans.recording import (
    SECTOR_DEG,
    WIDE_VIEW_DEG,
    PointSource,
    Recording,
    ScanFacts,
    ScanPoints,
    sectors_seen,
)
from interloc.drives.trajectory import Trajectory, read_trajectory
from interloc.errors import DriveError
from interloc.wording import counted, listed

_BELOW = 5
"""How many scans are looked at for what lies under the vehicle."""

_GLANCE_BYTES = 4096

_SCANS_OF_TURN = 40
_TURN_DEG, _PARTS = 330, 2.5

LABEL_BYTES = 4
"""uint32, the label id in the lower half."""


@dataclass(frozen=True)
class LabelFiles:
    """One .label file per scan."""

    label_files: NumberedFiles
    scheme = None
    is_slow = False
    identity = ()

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.label_files.folder.name

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the file of a scan."""
        return (self.label_files.path(frame),)

    def of(self, frame: int, points: ScanPoints, scan: str) -> UInt32Array:
        """Read the labels of a scan."""
        file = self.label_files.file(frame)
        labels = read_labels(file)
        if len(labels) != len(points.values):
            raise file.fault(_label_count_complaint(len(labels), len(points.values), scan))
        return labels


@dataclass(frozen=True)
class PointLabels:
    """Labels that the points carry themselves."""

    name: str
    scheme: str | None = None
    is_slow = False
    identity = ()

    def files(self, frame: int) -> tuple[Path, ...]:  # noqa: ARG002 - as of `LabelFiles`
        """Return none: they are in the scans."""
        return ()

    def of(self, frame: int, points: ScanPoints, scan: str) -> UInt32Array:  # noqa: ARG002 - as of `LabelFiles`
        """Return the labels of the points."""
        if points.labels is None:
            raise DriveFileError(scan, "its points carry no labels, as those of the other scans do.")
        return points.labels


if TYPE_CHECKING:  # most drives need neither
    from interloc.drives.scans.made_labels import GeometryLabels, NetworkLabels

    LabelSource = LabelFiles | PointLabels | NetworkLabels | GeometryLabels


@dataclass(frozen=True)
class RawScans:
    """The scans of a drive as it was recorded, with the labels of a folder, of the points, a network, or geometry."""

    recording: Recording
    labels: LabelSource | None
    """None where there are none, which was raised or listed."""
    usable: IntArray
    """(M,) int64: positions of the scans that have labels, of the size that fits."""
    labelled: IntArray | None = None
    """(N,) int64: rows of the whole recording, where scans whose labels are all 0 were left out."""
    scheme: LabelScheme = SEMANTICKITTI
    """Which label ids are road; known once they were judged."""

    def __getstate__(self) -> dict[str, object]:
        """Leave the selection table behind: it is made anew from the scheme."""
        return {name: value for name, value in self.__dict__.items() if name != "_groups"}

    @classmethod
    def of(
        cls,
        recording: Recording,
        folder: LabelFolder,
        options: DriveOptions,
        findings: Findings,
        trajectory: Callable[[], Trajectory],
        *,
        needs_labels: bool = True,
    ) -> RawScans:
        """Find the labels of a recording, and check that every scan has them; some need to know where the LiDAR was."""
        labels: LabelSource | None = None
        has_labels = recording.carries_labels or options.model is not None or folder == "geometry"
        with findings.stage():
            if needs_labels or has_labels or recording.parts.label_folder(folder).is_dir():
                labels = _labels_of(recording, folder, options, findings, trajectory)
        usable = np.empty(0, np.int64) if labels is None else recording.readable
        if isinstance(labels, LabelFiles):
            files = labels.label_files
            within = in_part(options.frames, files.numbers)
            files = replace(files, numbers=files.numbers[within], sizes=files.sizes[within])
            usable = _check_label_files(recording, usable, files, findings, sizes=options.check)
            blank = np.array([row for row in usable if _is_blank(files.path(int(recording.frames[row])))], np.int64)
            if 0 < len(blank) < len(usable):
                every = len(recording.frames)
                findings.warning(
                    labels.name,
                    f"{len(blank):,} of {every:,} scans have no label (all ids are 0) and are left out. Usual cause: a "
                    "data set of which some scans are labelled only.",
                )
                labelled = np.setdiff1d(np.arange(every), blank)
                usable = np.flatnonzero(np.isin(labelled, usable))
                return cls(recording.within(labelled), labels, usable, labelled=labelled)
        return cls(recording, labels, usable)

    @property
    def parts(self) -> DriveParts:
        """The files and folders of the drive."""
        return self.recording.parts

    @property
    def frames(self) -> IntArray:
        """(N,) int64 scan numbers."""
        return self.recording.frames

    def judge_labels(self, sample: list[int], options: DriveOptions, findings: Findings) -> LabelJudgement:
        """Count the ids of the scans at some positions, and find out what they mean."""
        source, frames, labels = self.recording.points, self.frames, self.labels
        if labels is None:
            return LabelJudgement()
        counts: Counter[int] = Counter()
        blank = 0
        for index in sample:
            frame = int(frames[index])
            with findings.stage():
                if isinstance(labels, LabelFiles):  # needs no points
                    ids = read_labels(labels.label_files.file(frame))
                else:
                    ids = labels.of(frame, self.points_of(frame), source.name(frame))
                by_id = np.bincount(ids & 0xFFFF)
                counts.update({int(each): int(by_id[each]) for each in np.flatnonzero(by_id)})
                blank += len(ids) > 0 and not ids.any()
        if 0 < blank < len(sample) and isinstance(labels, PointLabels):  # label files were left out before
            findings.warning(
                labels.name,
                f"{blank} of {len(sample)} scans looked at have no label (all ids are 0): they count as scans without "
                "road. Usual cause: a data set of which some scans are labelled only; leave the others out.",
            )
        chosen = options.label_scheme
        judgement = judge_labels(
            labels.name,
            dict(counts),
            labels.scheme if chosen == "auto" and labels.scheme is not None else chosen,
            kitti360=self.parts.layout == "kitti360",
            check=options.check,
            findings=findings,
        )
        if options.check and judgement.scheme is not None and isinstance(labels, LabelFiles | PointLabels):
            self._check_below(sample[:: -(-len(sample) // _BELOW)], judgement, findings)
        return judgement

    def _check_below(self, sample: list[int], judgement: LabelJudgement, findings: Findings) -> None:
        """Check that what lies under the vehicle is road."""
        (source, labels), below = self.sources, Counter[int]()
        assert judgement.scheme is not None
        for index in sample:
            with suppress(DriveError):  # which is said where the scan is read
                points = self.points_of(frame := int(self.frames[index]))
                below += ids_below(points.values, labels.of(frame, points, source.name(frame)))
        check_below(labels.name, below, judgement.scheme, set(judgement.counts), findings)

    def check_turns(self, findings: Findings) -> bool:
        """Warn, and return False, where a scan is a part of a turn, and those after it are the other parts."""
        if not len(self.usable):
            return True
        first = len(self.usable) // 2
        own, seen = self._sectors(int(self.usable[first])), set[int]()
        if len(own) * SECTOR_DEG >= WIDE_VIEW_DEG or not own:
            return True
        for index in self.usable[first : first + _SCANS_OF_TURN]:
            seen |= self._sectors(int(index))
        if len(seen) * SECTOR_DEG < min(_TURN_DEG, _PARTS * len(own) * SECTOR_DEG):
            return True  # a sensor that looks into one direction, or two
        findings.warning(
            self.parts.file(self.parts.scans).name,
            f"a scan sees {len(own) * SECTOR_DEG} degrees around the sensor, those after it see other parts, and "
            f"together they see {len(seen) * SECTOR_DEG}: each is a part of a turn, and roads are seen in pieces. "
            "Usual cause: packets of the sensor as messages. Have the driver publish whole turns, or join the points "
            "of each turn, moved by the poses.",
        )
        return False

    def _sectors(self, index: int) -> set[int]:
        """Return in which sectors around the sensor a scan has points."""
        with suppress(DriveError):  # which is said where the scan is read
            return sectors_seen(self.points_of(int(self.frames[index])))
        return set()

    def tell_doubts(self, findings: Findings) -> None:
        """Warn of labels that were made by geometry, where the checks have seen that they are doubtful."""
        if self.labels is not None and self.labels.name == "geometry":
            cast("GeometryLabels", self.labels).tell_doubts(self.parts.file(self.parts.scans).name, findings)

    def by_scheme(self, scheme: LabelScheme) -> RawScans:
        """Return the scans as a drive keeps them, which has its trajectory already."""
        return replace(self, scheme=scheme, recording=replace(self.recording, read_trajectory=None))

    @property
    def facts(self) -> ScanFacts:
        """Count and size of the files."""
        recording = self.recording
        facts: dict[str, object] = {
            "scans": len(recording.frames),
            "first_frame": int(recording.frames[0]),
            "last_frame": int(recording.frames[-1]),
            "scan_bytes": recording.scan_bytes,
            "topics": recording.topics,
        }
        if (points := recording.point_counts) is not None:
            facts |= {
                "points_per_scan": int(np.median(points)),
                "least_points": int(points.min()),
                "most_points": int(points.max()),
            }
        if self.labels is not None:
            facts["label_folder"] = self.labels.name
            if isinstance(self.labels, LabelFiles):
                facts["label_bytes"] = int(self.labels.label_files.sizes.sum())
        return ScanFacts.model_validate(facts)

    @property
    def sources(self) -> tuple[PointSource, LabelSource]:
        """What the points and their labels are read from, where both are there."""
        assert self.labels is not None
        return self.recording.points, self.labels

    @cached_property
    def _groups(self) -> UInt8Array:
        return self.scheme.groups()

    @property
    def label_source(self) -> str:
        """Where the labels come from, in words."""
        return self.sources[1].name

    def windows_of(self, frames: Sequence[int]) -> IntArray:
        """Return the windows of the track that scans, by (N,) ascending numbers, are labelled in; or a number each."""
        labels = self.sources[1]
        if labels.name != "geometry":
            return np.arange(len(frames), dtype=np.int64)
        return cast("GeometryLabels", labels).windows_of(frames)

    @property
    def is_slow(self) -> bool:
        """Whether labels are made from the scans: then several should be read at once."""
        return self.sources[1].is_slow

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return self.sources[0].name(frame)

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the files that the ground points of a scan are made of."""
        points, labels = self.sources
        return (*points.files(frame), *labels.files(frame))

    def points_of(self, frame: int) -> ScanPoints:
        """Read all points of a scan, once while the drive is opened."""
        source = self.sources[0]
        return scan_once((id(source), frame), lambda: source.read(frame), lambda points: points.nbytes)

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan."""
        source, labels = self.sources
        points, name = self.points_of(frame), source.name(frame)
        ids = labels.of(frame, points, name)
        select = select_plainly
        if not is_opening() or "numba" in sys.modules:
            from interloc.kernels.ground import select_points as select  # noqa: PLC0415 - slow to import
        xyz, road_count, bad_point = select(points.values, ids, self._groups)
        if bad_point >= 0:
            x, y, z, _ = points.values[bad_point]
            raise DriveFileError(
                name,
                f"point {bad_point:,} of {len(ids):,} is not finite ({x:g}, {y:g}, {z:g}). "
                "Expected x y z in metres. Usual cause: points without a return that were written as NaN; "
                "leave them out, with their labels.",
            )
        is_doubtful = labels.name == "geometry" and cast("GeometryLabels", labels).is_doubtful(frame)
        return GroundPoints(xyz, road_count, is_doubtful)


def select_plainly(points: Float32Array, labels: UInt32Array, group_of: UInt8Array) -> tuple[Float32Array, int, int]:
    """Do what `select_points` does without its compiler: three times as slow, but numba takes 0.25 s to load."""
    group = group_of[labels & 0xFFFF]
    roads, others = (np.flatnonzero(group == each) for each in (ROAD, CONFUSABLE))
    rows = np.concatenate([roads, others])
    xyz = np.stack([points[:, axis].take(rows) for axis in range(3)], axis=1)
    is_finite = np.isfinite(xyz)
    return xyz, len(roads), -1 if is_finite.all() else int(rows[~is_finite.all(axis=1)].min())


def trajectory_of(recording: Recording, options: DriveOptions, findings: Findings) -> Trajectory:
    """Read poses, times and georeference of a recording whose scans could be listed."""
    if recording.read_trajectory is not None:
        return recording.read_trajectory(recording.frames, options, findings)
    return read_trajectory(recording.parts, recording.frames, options, findings, times_s=recording.times_s)


_FLOAT_1 = 0x3F800000
"""The bits of 1.0: as uint32, every larger float32 is larger, and only the 16,256th instance of an id is."""

_OTHER_LABELS = {8.0: ("8 bytes", "int64"), 2.0: ("2 bytes", "uint16"), 1.0: ("1 byte", "uint8")}
_CONVERT = (
    "Usual cause: an array that was written in the type in which a tool holds it; convert every file first, such as "
    "np.fromfile(FILE, np.{type}).astype(np.uint32).tofile(FILE)."
)


def read_labels(file: SourceFile) -> UInt32Array:
    """Read the (N,) uint32 labels of a file."""
    octets = file.octets()
    labels: UInt32Array = octets[: len(octets) // LABEL_BYTES * LABEL_BYTES].view("<u4")
    if labels.max(initial=0) >= _FLOAT_1 and np.min(labels, initial=_FLOAT_1, where=labels > 0) >= _FLOAT_1:
        raise file.fault(
            f"holds floating-point numbers ({labels[labels > 0].view('<f4')[0]:g}, ...). Expected uint32 ids. "
            + _CONVERT.format(type="float32")
        )
    return labels


def _is_blank(path: Path) -> bool:
    """Return whether all labels of a file are 0; of other files the beginning is read only."""
    with suppress(OSError):  # their reader says why
        descriptor = os.open(path, os.O_RDONLY)  # a file object takes twice as long
        try:
            glance = os.read(descriptor, _GLANCE_BYTES)
        finally:
            os.close(descriptor)
        return not glance.strip(b"\0") and not np.fromfile(path, np.uint8).any()
    return False


def _labels_of(
    recording: Recording,
    label_folder: LabelFolder,
    options: DriveOptions,
    findings: Findings,
    trajectory: Callable[[], Trajectory],
) -> LabelSource:
    parts, folder = recording.parts, recording.parts.label_folder(label_folder)
    if options.model is not None:
        from interloc.drives.scans.made_labels import open_network  # noqa: PLC0415 - most drives need no network

        return open_network(options.model, options.provider, recording, findings)
    if label_folder == "geometry":
        from interloc.drives.scans.made_labels import open_geometry  # noqa: PLC0415 - most drives have labels

        return open_geometry(recording, trajectory(), findings)
    if folder.is_dir():
        return LabelFiles(list_numbered(parts.file(folder), ".label"))
    if recording.carries_labels:
        return PointLabels("labels of the points", recording.scheme)
    other = parts.root / ("predictions" if folder.name == "labels" else "labels")
    hint = (
        f"There is {other.name}/: choose it as the label folder (--labels {other.name})."
        if other.is_dir()
        else "--labels geometry does without; a network of the RangeNet++ family makes them: `interloc label DRIVE "
        "--model NETWORK`, or --model with any command, or the option model in the service; any other segmentation "
        "that writes SemanticKITTI .label files will do."
    )
    if parts.layout == "kitti360":
        hint = f"KITTI-360 publishes none per scan. {hint}"
    raise parts.file(folder).fault(f"is missing. Expected one .label file per scan, with one uint32 per point. {hint}")


def _check_label_files(
    recording: Recording, readable: IntArray, labels: NumberedFiles, findings: Findings, *, sizes: bool
) -> IntArray:
    """Return the positions of the scans whose labels are there and fit, by names and sizes, among `readable` ones."""
    frames, points = recording.frames, recording.points
    missing = np.setdiff1d(frames, labels.numbers)
    if len(missing):
        findings.error(
            labels.file(int(missing[0])).fault(
                f"is missing: {len(missing):,} of {len(frames):,} scans have no labels ({listed(missing)}). "
                "Expected one .label file per scan. Usual cause: an archive that was not unpacked to the end."
            )
        )
    extra = np.setdiff1d(labels.numbers, frames)
    if len(extra):
        findings.note(labels.folder.name, f"{counted(len(extra), 'file')} of scans that are not there: not used.")
    common, at_scan, at_label = np.intersect1d(frames, labels.numbers, assume_unique=True, return_indices=True)
    if not sizes:
        return at_scan
    is_readable = np.isin(at_scan, readable)
    fits = labels.sizes[at_label] % LABEL_BYTES == 0
    if recording.point_counts is not None:
        fits &= labels.sizes[at_label] == LABEL_BYTES * recording.point_counts[at_scan]
    bad = np.flatnonzero(is_readable & ~fits)
    for row in bad[: 1 if len(bad) > MAX_NAMED else None]:
        number = int(common[row])
        count, left = divmod(int(labels.sizes[at_label[row]]), LABEL_BYTES)
        if recording.point_counts is not None and (
            other := _OTHER_LABELS.get(int(labels.sizes[at_label[row]]) / int(recording.point_counts[at_scan[row]]))
        ):
            size, kind = other
            if kind == "int64" and np.fromfile(labels.path(number), "<f8").max() >= 1.0:  # that of int64 is next to 0
                kind = "float64"
            message = (
                f"{size} ({kind}) per point of {points.name(number)}. Expected one uint32 (4 bytes) per point, the id "
                f"in its lower half. {_CONVERT.format(type=kind)}"
            )
        elif (path := labels.path(number)).is_file() and path.read_bytes().startswith(LFS_POINTER):
            message = f"is {POINTER}"
        elif left or recording.point_counts is None:
            message = (
                f"{labels.sizes[at_label[row]]:,} bytes, which is no multiple of 4. Expected one uint32 per point."
            )
        else:
            count_of_points = int(recording.point_counts[at_scan[row]])
            message = _label_count_complaint(count, count_of_points, points.name(number))
        findings.error(labels.file(number).fault(message + others_like_it(common[bad], len(frames))))
    usable: IntArray = at_scan[is_readable & fits]
    return usable


def _label_count_complaint(labels: int, points: int, scan: str) -> str:
    return (
        f"{labels:,} labels for {points:,} points in {scan}. Every point needs one 4-byte label. "
        "Usual cause: labels of another sequence, or an archive that was not unpacked to the end."
    )
