"""A look at a folder that is elsewhere: what is in it and wrong with it, and which of its scans to send.

It is told from a listing and the small files. The folder is laid out again: every file of the drive under its name and
with its size, but without contents, which takes no space on disk; only the small files have theirs. So the code that
reads a drive reads it here too, and a client that holds the files need not know the layouts.
"""

import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field

from interloc.arrays import IntArray
from interloc.config import KeyframeConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drives.checks import check_motion, sample_indices
from interloc.drives.files import EMPTY, NumberedFiles, SourceFile, each_read_once, list_numbered, rows_of_part
from interloc.drives.findings import Finding, Findings, by_severity
from interloc.drives.georeference.geodetic import check_against_poses
from interloc.drives.labels import LabelScheme, judge_labels
from interloc.drives.layouts import IN_CAPITALS, PCD_ENDINGS, POSE_FILES, DriveParts, Kind, find_layout, not_a_drive
from interloc.drives.open import NO_POSES, SAMPLED_SCANS
from interloc.drives.options import LABEL_FILES, ODOMETRY, DriveOptions, LabelFolder, LayoutName
from interloc.drives.scans.bin_files import BinScans, open_bin_files
from interloc.drives.scans.las.tracks import is_track
from interloc.drives.scans.pcd import PcdScans, open_pcd_files, read_pcd_header
from interloc.drives.scans.raw import RawScans, trajectory_of
from interloc.drives.scans.recording import LABEL_FIELDS, Recording
from interloc.drives.scans.reduced_format import (
    ReducedLabels,
    ReducedManifest,
    ReducedScans,
    SourceScans,
    from_runs,
    read_manifest,
    reduced_trajectory,
    to_runs,
)
from interloc.drives.scans.rosbag.bag import find_bag
from interloc.drives.trajectory import Trajectory
from interloc.reduction.listing import ListedDrive, Listing, find_drives, reason_for_none
from interloc.reduction.reduce import plan_of

HEAD_BYTES = 65_536
"""What is enough of a file to see what it is."""

_MEMORY = Path("/dev/shm")  # noqa: S108 - a folder of a random name is made there
_PAGE_BYTES = 4096
_MISNAMED = 5  # files that are named one by one
_MAX_POSITIONS = 20_000
_MAX_TRACK_BYTES = 4_000_000  # of what may be the trajectory of a cloud; of a longer one the head is enough

LabelCounts = Mapping[LabelFolder, Mapping[int, int]]
"""By folder, how many points of the scans `frames_to_look_into` carry each label id."""


class LookedNumbers(BaseModel):
    """The numbered files of a folder, as 000000.bin."""

    folder: str = Field(description="Path in the drive.", examples=["velodyne"])
    suffix: str = Field(examples=[".bin"])
    digits: int = Field(description="Width that the numbers are padded to with zeros.")
    runs: list[tuple[int, int]] = Field(description="Numbers, as runs: the first, and how many there are.")
    count: int
    size_bytes: int


class LookedLabels(LookedNumbers):
    """A folder of labels, and what their ids mean, where these were counted (`label_counts`)."""

    problems: list[Finding] = Field(description="What is wrong with them.")
    scheme: str | None = Field(None, description="Name of the label scheme; null: not known.")
    road: list[int] = Field([], description="Ids of road.")
    confusable: list[int] = Field([], description="Ids of sidewalk, parking and other ground.")
    road_share: float | None = Field(None, description="Share of road among the points counted.")
    ground_share: float | None = Field(
        None, description="Share of road, sidewalk, parking and other ground among them: what is to be sent."
    )


class LookedPlan(BaseModel):
    """What a client sends that reduces the scans itself: `ground/...` of these scans, the small files, reduced.json."""

    scans: int = Field(description="Number of all scans.")
    kept: list[tuple[int, int]] = Field(description="Scans to send, as runs: the first number, and how many there are.")
    files: dict[str, str] = Field(description="Small files to send: path in the reduced drive -> path in the folder.")
    manifest: ReducedManifest = Field(
        description="reduced.json; label folders that are not sent are to be left out of it."
    )


class LookedTrack(BaseModel):
    """Where the drive went; positions are longitude and latitude, or metres (x, y) where it has no georeference."""

    local: bool = Field(description="Whether the positions are metres.")
    positions: list[tuple[float, float]] = Field(description="Of the scans, or of some of very many.")
    length_m: float = Field(description="Distance driven in metres.")


class ListedName(BaseModel):
    """A drive in the folder."""

    root: str = Field(description="Its path in the folder; empty where it is the folder itself.")
    name: str
    kind: Kind = Field(description="How its scans are kept; `layout` says more.")
    files: int = Field(description="Number of its scans, or of its recordings.")


class DriveLook(ListedName, json_schema_serialization_defaults_required=True):
    """What is in a drive, and what is wrong with it."""

    layout: LayoutName | Literal["reduced"] | None = None
    scans: LookedNumbers | None = Field(None, description="Scans that the client can reduce itself.")
    points_per_scan: int | None = None
    labels: dict[LabelFolder, LookedLabels] = Field({}, description="Folders of label files.")
    unlabelled: list[Finding] = Field([], description="What is wrong where neither label files nor a network are used.")
    carries_labels: bool | None = Field(None, description="Whether the points have labels; null: that is not known.")
    has_poses: bool | None = Field(
        None, description="False: they are computed from the points, which needs the scans whole; null: not known."
    )
    whole: dict[str, str] = Field(
        {}, description="Recordings, or ground points, which are sent as they are: path in the drive -> in the folder."
    )
    small: dict[str, str] = Field({}, description="Small files to be sent: path in the drive -> path in the folder.")
    pose_files: list[str] = Field([], description="Files that may hold the poses of a recording.")
    borrowed: list[str] = Field([], description="Notes on files that are taken from beside the drive.")
    wanted: dict[str, int] = Field(
        {}, description="Files whose contents tell more: path in the folder -> how many of their first bytes to give."
    )
    georeference: str | None = Field(None, description="Where the georeference comes from.")
    georeference_reason: str | None = Field(None, description="Why there is none.")
    pose_frame: str | None = Field(None, description="Sensor whose poses the pose file holds.")
    pose_frame_reason: str | None = Field(None, description="Why that is thought.")
    track: LookedTrack | None = None
    keyframes: int | None = Field(None, description="Number of scans that a job needs.")
    frames_to_look_into: list[int] = Field(
        [], description="Numbers of the scans whose label ids, counted (`label_counts`), tell the label scheme."
    )
    plan: LookedPlan | None = Field(
        None, description="How to send it reduced; null where only the service can reduce it, or it has no poses."
    )
    problems: list[Finding] = []


class FolderLook(BaseModel):
    """What a folder holds."""

    drives: list[ListedName] = Field(description="All drives in it.")
    drive: DriveLook | None = Field(description="The one that was asked for.")
    reason: str | None = Field(None, description="Why there is no drive.")


def look_into(
    listing: Listing,
    contents: Mapping[str, bytes],
    name: str,
    root: str | None = None,
    options: Callable[[Path, str], DriveOptions] = lambda _, name: DriveOptions(name=name),
    *,
    keyframes: KeyframeConfig | None = KeyframeConfig(),  # noqa: B008 - frozen
    label_counts: LabelCounts = MappingProxyType({}),
    max_files: int = 1_000_000,
    place: Path | None = None,
) -> FolderLook:
    """Find the drives in a folder, and look into one of them (the first by default); a bad drive raises nothing.

    The listing and `contents` (of small files, or of the heads of others) are by path, relative and with slashes.
    `options` says how the drive is to be read that is laid out at a place; it is laid out in `place`, or where the
    system has temporary folders, unless it has more than `max_files`. `keyframes` says which scans a job needs, None
    all; `label_counts` is what was counted in the scans that an earlier look has named.
    """
    drives = find_drives(listing, name)
    names = [ListedName(root=drive.root, name=drive.name, kind=drive.kind, files=len(drive.scans)) for drive in drives]
    chosen = next((drive for drive in drives if root is None or drive.root == root), None)
    if chosen is None:
        roots = ", ".join(repr(each.root) for each in drives)
        reason = f"no drive is in {root!r}; they are in {roots}." if drives else reason_for_none(listing, name)
        return FolderLook(drives=names, drive=None, reason=reason)
    with TemporaryDirectory(dir=_quickest(place, chosen, contents), prefix="interloc-look-") as above:
        look = _Look(chosen, listing, contents, Path(above) / "drive", keyframes, label_counts)
        if len(chosen.files) > max_files:
            text = f"{len(chosen.files):,} are too many; expected at most {max_files:,}. Cut the drive."
            look.findings.refuse("files", text)
        else:
            look.read(options(look.place, chosen.name))
    return FolderLook(drives=names, drive=look.answer())


def _quickest(place: Path | None, drive: ListedDrive, contents: Mapping[str, bytes]) -> Path | None:
    """Return the memory of this machine, where it has room: disks need a hundred times as long for many files."""
    needed = sum(len(contents[path]) + _PAGE_BYTES for path in drive.small.values() if path in contents)
    with suppress(OSError):
        if os.access(_MEMORY, os.W_OK) and shutil.disk_usage(_MEMORY).free > 2 * needed:
            return _MEMORY
    return place


@dataclass
class _Look:
    """What is found out about one drive."""

    drive: ListedDrive
    listing: Listing
    contents: Mapping[str, bytes]
    place: Path
    keyframes: KeyframeConfig | None
    counts: LabelCounts
    findings: Findings = field(default_factory=lambda: Findings(stop_at_first=False))
    schemes: dict[LabelFolder, LabelScheme] = field(default_factory=dict)

    def __post_init__(self) -> None:
        drive = self.drive
        listed = {"root": drive.root, "name": drive.name, "kind": drive.kind, "files": len(drive.scans)}
        self.found = DriveLook.model_validate({**listed, "small": drive.small, "borrowed": drive.borrowed})

    def answer(self) -> DriveLook:
        """Return it; messages do not tell where the drive was laid out."""
        found = self.found
        labels = {
            folder: each.model_copy(update={"problems": self._named(each.problems)})
            for folder, each in found.labels.items()
        }
        reason = found.georeference_reason
        update = {
            "problems": self._named(by_severity(self.findings.found)),
            "labels": labels,
            "unlabelled": self._named(found.unlabelled),
            "georeference_reason": None if reason is None else self._text(reason),
        }
        return found.model_copy(update=update)

    def _named(self, found: Iterable[Finding]) -> list[Finding]:
        own = {".": self.drive.name}
        return [
            Finding(each.severity, self._text(own.get(each.path, each.path)), self._text(each.message))
            for each in found
        ]

    def _text(self, text: str) -> str:
        return text.replace(f"{self.place}/", "").replace(str(self.place), self.drive.name)

    def read(self, options: DriveOptions) -> None:
        """Look into the drive as it is read when it is there."""
        found, drive = self.found, self.drive
        with each_read_once(), self.findings.stage():
            self._lay_out()
            for path, expected in islice(drive.misnamed.items(), _MISNAMED):
                self.findings.warning(path, IN_CAPITALS.format(expected))
            self._want(*drive.small)
            if drive.kind == "reduced":
                self._read_reduced(options)
            elif drive.kind in {"rosbag", "las"} and options.layout in {"auto", drive.kind}:
                self._read_recording(options)
            else:
                self._read_scan_files(options)
        if drive.kind != "bin":
            found.layout = drive.kind

    def _lay_out(self) -> None:
        """Make its files, each of its size; on disk they take no space."""
        made: set[str] = set()
        for inside, path in self.drive.files.items():
            target = f"{self.place}/{inside}"
            folder = target.rpartition("/")[0]
            if folder not in made:
                Path(folder).mkdir(parents=True, exist_ok=True)
                made.add(folder)
            file = os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
            try:
                os.write(file, self.contents.get(path, b""))
                os.truncate(file, self.listing[path])
            finally:
                os.close(file)

    def _want(self, *names: str, head: int | None = None) -> bool:
        """Ask for the contents of files of the drive; return whether all are there."""
        files, sizes = self.drive.files, self.listing
        missing = [path for path in map(files.__getitem__, names) if path not in self.contents and sizes[path]]
        for path in missing:
            is_long = self.drive.kind == "las" and sizes[path] > _MAX_TRACK_BYTES
            self.found.wanted[path] = min(sizes[path], head or (HEAD_BYTES if is_long else sizes[path]))
        return not missing

    def _read_scan_files(self, options: DriveOptions) -> None:
        """Look into a drive with one file per scan, and label files."""
        found = self.found
        parts = find_layout(self.place, options)
        found.layout = parts.layout
        if parts.layout == "pcd":
            recording = self._open_pcd(parts, options)
        else:
            recording = open_bin_files(parts, options, self.findings)
        self._read_labels(recording, options)
        frames = recording.frames
        is_bin = isinstance(recording.points, BinScans)
        if isinstance(recording.points, BinScans):
            files = recording.points.scan_files
            found.scans = LookedNumbers(**self._numbers(files))
            found.points_per_scan = int(np.median(files.sizes)) // recording.points.point_bytes
        found.frames_to_look_into = sample_indices(frames, SAMPLED_SCANS)
        if found.wanted:
            return
        found.has_poses = recording.has_poses and options.poses != ODOMETRY
        if not found.has_poses:
            self.findings.warning("poses", NO_POSES)
            return
        pose_file = "oxts" if parts.poses is None else parts.file(parts.poses).name
        trajectory = trajectory_of(recording, options, self.findings)
        if options.frames is not None:
            rows = rows_of_part(options.frames, frames, parts.file(parts.scans).name)
            frames, trajectory = frames[rows], trajectory.part(rows)
        if is_bin:
            self._plan(parts, recording, frames, trajectory, options)
        self._show(trajectory, pose_file, frames)

    def _plan(
        self, parts: DriveParts, recording: Recording, frames: IntArray, trajectory: Trajectory, options: DriveOptions
    ) -> None:
        """Say what a client sends that reduces the scans itself, with the labels whose ids were counted."""
        plan = plan_of(parts, frames, trajectory, options.oxts, self.keyframes, self.findings)
        if plan is None:
            return
        labels = [
            ReducedLabels.of(folder, scheme, dict(self.counts[folder]), self.found.labels[folder].size_bytes)
            for folder, scheme in self.schemes.items()
        ]
        kept = [(int(first), int(count)) for first, count in to_runs(plan.kept)]
        files = {
            name: self.drive.files[source.relative_to(self.place).as_posix()]
            for name, source in plan.copies.sources.items()
            if isinstance(source, Path) and source.is_relative_to(self.place)
        }
        points = recording.point_counts
        assert points is not None
        source = SourceScans(
            scan_bytes=recording.scan_bytes,
            points_per_scan=int(np.median(points)),
            least_points=int(points.min()),
            most_points=int(points.max()),
        )
        manifest = plan.manifest.with_labels(labels, source)
        self.found.plan = LookedPlan(scans=len(frames), kept=kept, files=files, manifest=manifest)

    def _open_pcd(self, parts: DriveParts, options: DriveOptions) -> Recording:
        """List PCD files; the header of the first tells whether they carry labels."""
        unheard = Findings(stop_at_first=False)
        recording = open_pcd_files(parts, options, unheard)
        scans = recording.points
        assert isinstance(scans, PcdScans)
        first = SourceFile(scans.files(int(scans.frames[0]))[0], parts.root)
        has_header = not first.path.name.endswith(PCD_ENDINGS[1])
        self._take_whole()
        self.found.pose_files = [name for name in POSE_FILES if (parts.root / name).is_file()]
        if has_header and not self._want(first.name, head=HEAD_BYTES):
            return recording
        self.findings.found += unheard.found
        self.found.carries_labels = recording.carries_labels
        if not recording.carries_labels and not any((parts.root / folder).is_dir() for folder in LABEL_FILES):
            names = ", ".join(read_pcd_header(first)[0].dtype.names or ()) if has_header else ""
            fault = first.fault(
                f"has no label: {f'its fields are {names}' if names else 'it holds no named fields'}. Expected one of "
                f"{', '.join(LABEL_FIELDS)} among them, or labels/ with a .label file per scan."
            )
            self.found.unlabelled.append(Finding("error", first.name, fault.args[-1]))
        return recording

    def _read_labels(self, recording: Recording, options: DriveOptions) -> None:
        """Check the label files of each folder; where there are none, say how they are made."""
        found = self.found
        there = [folder for folder in LABEL_FILES if (self.place / folder).is_dir()]
        for folder in there:
            self._list_labels(folder, recording, options)
        if not there and not recording.carries_labels and not found.unlabelled and found.carries_labels is None:
            findings = Findings(stop_at_first=False)
            RawScans.of(recording, "labels", options, findings, Trajectory)
            found.unlabelled += findings.found

    def _list_labels(self, folder: LabelFolder, recording: Recording | None, options: DriveOptions) -> None:
        findings = Findings(stop_at_first=False)
        files = None
        with findings.stage():
            files = list_numbered(SourceFile(self.place / folder, self.place), ".label")
        if files is None:
            self.findings.found += findings.found
            return
        if recording is not None:
            RawScans.of(recording, folder, options, findings, Trajectory)
        looked = LookedLabels(**self._numbers(files), problems=findings.found)
        if (counts := self.counts.get(folder)) is not None:
            is_kitti360 = self.found.layout == "kitti360"
            judged = judge_labels(
                folder, dict(counts), options.label_scheme, kitti360=is_kitti360, check=True, findings=findings
            )
            if judged.scheme is not None:
                self.schemes[folder] = judged.scheme
                looked.scheme, looked.road = judged.scheme.name, sorted(judged.scheme.road)
                looked.confusable = sorted(judged.scheme.confusable)
            looked.road_share, looked.ground_share = judged.road_share, judged.ground_share
            looked.problems = findings.found
        self.found.labels[folder] = looked

    def _numbers(self, files: NumberedFiles) -> dict[str, object]:
        runs = [(int(first), int(count)) for first, count in to_runs(files.numbers)]
        return {
            "folder": files.folder.name,
            "suffix": files.suffix,
            "digits": files.digits,
            "runs": runs,
            "count": len(files.numbers),
            "size_bytes": int(files.sizes.sum()),
        }

    def _take_whole(self) -> None:
        """Take the recordings as they are; none of them is empty."""
        self.found.whole = self.drive.scans
        for inside, path in self.drive.scans.items():
            if not self.listing[path]:
                self.findings.refuse(inside, EMPTY)

    def _read_recording(self, options: DriveOptions) -> None:
        """Look into what only the service reads: a bag, or LAS files."""
        self._take_whole()
        found, place = self.found, self.place
        for folder in LABEL_FILES:
            if (place / folder).is_dir():
                self._list_labels(folder, None, options)
                if folder in found.labels and not found.frames_to_look_into:
                    found.frames_to_look_into = sample_indices(from_runs(found.labels[folder].runs), SAMPLED_SCANS)
        if self.drive.kind == "las":
            self._read_clouds(options)
        elif find_bag(place) is None:  # by its name in capitals
            raise not_a_drive(place, options)

    def _read_clouds(self, options: DriveOptions) -> None:
        """Look for the trajectory of LAS files, or for the poses where each holds a scan."""
        found, place = self.found, self.place
        poses = [place / name for name in POSE_FILES if (place / name).is_file()]
        told = [name.rpartition("/") for name, path in self.drive.small.items() if path in self.contents]
        beside = [place / "".join(parts) for parts in sorted(told) if parts[0] in {"", "las", "laz"}]
        tracks = [path for path in beside if is_track(path)]
        found.pose_files = [path.relative_to(place).as_posix() for path in dict.fromkeys([*poses, *tracks])]
        if not found.pose_files and not found.wanted and options.poses is None:
            self.findings.refuse(
                "trajectory",
                "is missing. Expected a file with where the LiDAR was, beside the points: a table with a header "
                "(time,x,y,z or time,lat,lon,alt; .csv or .txt), or TUM.",
            )

    def _read_reduced(self, options: DriveOptions) -> None:
        """Look into a drive that is reduced already."""
        self._take_whole()
        if self.found.wanted:
            return
        manifest = read_manifest(self.place)
        for labels in manifest.labels:
            with self.findings.stage():
                ReducedScans.of(manifest, self.place, labels.folder, options, self.findings)
            if self.found.track is None:
                trajectory = reduced_trajectory(manifest, self.place, options, self.findings)
                self._show(trajectory, "poses", manifest.frames)

    def _show(self, trajectory: Trajectory, pose_file: str, frames: IntArray) -> None:
        """Tell where the drive went, and how poses and georeference fit together."""
        _, trajectory = trajectory.within_jumps(frames, pose_file, self.findings)
        found, poses, fixes = self.found, trajectory.poses, trajectory.georeference
        found.georeference = fixes.source if fixes else None
        found.georeference_reason = None if fixes else trajectory.georeference_reason
        if poses is None:
            return
        found.pose_frame, found.pose_frame_reason = poses.frame, poses.reason
        by = self.keyframes
        found.keyframes = len(poses.T_world_lidar if by is None else select_keyframes(poses.T_world_lidar, by))
        check_motion(poses.T_world_lidar, pose_file, self.findings)
        places = poses.T_world_lidar[:, :2, 3] if fixes is None else fixes.lonlat
        if fixes is not None and poses.frame != "oxts":
            with self.findings.stage():
                check_against_poses(poses.T_world_lidar, fixes, self.findings)
        step = -(-len(places) // _MAX_POSITIONS)
        digits = 3 if fixes is None else 8
        found.track = LookedTrack(
            local=fixes is None, positions=places[::step].round(digits).tolist(), length_m=poses.length_m
        )
