"""The layouts of drives: where their scans, labels, poses, times, calibration and georeference lie.

A new layout of folders is a function here, and its line in `_LAYOUTS`.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Literal

from interloc.drives.data_sets import known_data_set
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError
from interloc.drives.formats import FORMATS, find_format, installed_formats
from interloc.drives.options import DriveOptions, LabelFolder
from interloc.wording import counted

INDEXED_LENGTHS = (13, 17)
"""How many numbers a pose line holds that starts with a frame number."""

PoseOwner = Literal["camera", "lidar", "imu", "oxts"]
"""Whose poses a drive has; those of OXTS are the LiDAR's, taken from the georeference."""

ScanFolder = Literal["velodyne", "velodyne_points/data"]
SCAN_FOLDERS: tuple[ScanFolder, ...] = ("velodyne", "velodyne_points/data")
"""Where the layouts have their scans."""

PCD_ENDINGS = (".pcd", ".pcd.bin")
"""Of scans in PCD files, and of nuScenes' (five float32 per point)."""

NUMBERED_ANYHOW = ("pcd", "las")
"""Layouts whose scans have numbers of any kind: their poses are one per scan."""

KITTI360_SCANS = "data_3d_raw"
"""Folder of the drives in KITTI-360 as it is published."""

KITTI360_POSES = "data_poses"
"""Folder of their poses there."""

_KITTI360_POSES = ("poses.txt", "cam0_to_world.txt")
_PCD_FOLDERS = ("pcd", "clouds", "velodyne", "velodyne_points/data", ".")
POSE_FILES = ("poses.txt", "poses.tum", "trajectory.tum", "trajectory.txt")


@dataclass(frozen=True)
class DriveParts:
    """Files and folders of a drive, as its layout names them; they are not looked into yet.

    Attributes
    ----------
    layout : str
        A name of `interloc.drives.formats`.
    root : Path
        Folder of the drive.
    scans : Path
        Folder of the scans.
    poses : Path or None
        Pose lines; None where the poses come from OXTS.
    times : Path or None
        Seconds, or date and time, one line per frame.
    calibration : tuple of Path
        Calibration files, or folders that they may lie in, the nearest first.
    oxts, geo : Path or None
        Georeference of the drive: folder of OXTS files or file of OXTS rows; geo.csv.
    name : str
        Of the drive, where it is not that of the folder.
    pose_frame : tuple of str and str, or None
        Whose poses the pose file holds, and why, where that was found out before.
    """

    layout: str
    root: Path
    scans: Path
    poses: Path | None
    times: Path | None
    calibration: tuple[Path, ...]
    oxts: Path | None
    geo: Path | None
    name: str = ""
    pose_frame: tuple[PoseOwner, str] | None = None

    @classmethod
    def inside(cls, layout: str, root: Path, scans: Path, poses: Path | None) -> DriveParts:
        """Return the parts of a drive whose other files lie in its folder: times.txt, calib.txt, oxts/, geo.csv."""
        times, oxts, geo = (_existing(root / name) for name in ("times.txt", "oxts", "geo.csv"))
        return cls(layout, root, scans, poses, times, (root,), oxts, geo)

    @property
    def has_poses(self) -> bool:
        """Whether there is a file of poses, or one of fixes that tell them."""
        return self.oxts is not None if self.poses is None else self.poses.exists()

    @property
    def in_kitti360_world(self) -> bool:
        """Whether the poses are in the world of KITTI-360: its pose file, where it is published."""
        return self.layout == "kitti360" and self.poses is not None and self.poses.parent.parent.name == KITTI360_POSES

    @property
    def drive_name(self) -> str:
        """Name of the drive."""
        return self.name or self.root.absolute().name

    def file(self, path: Path) -> SourceFile:
        """Return a file or folder under the name that messages give it."""
        return SourceFile(path, self.root)

    def label_folder(self, name: LabelFolder) -> Path:
        """Return the folder of label files: in that of the drive, beside a drive in one file."""
        return (self.root if self.root.is_dir() else self.root.parent) / name


def _semantickitti(root: Path, scan_folders: Collection[str]) -> DriveParts | None:
    """SemanticKITTI and KITTI odometry: velodyne/, labels/ or predictions/, poses.txt, calib.txt."""
    if "velodyne" not in scan_folders:
        return None
    return DriveParts.inside("semantickitti", root, root / "velodyne", root / "poses.txt")


def _kitti_raw(root: Path, scan_folders: Collection[str]) -> DriveParts | None:
    """KITTI raw: velodyne_points/data/, oxts/data/, calibration beside or one folder above."""
    if "velodyne_points/data" not in scan_folders:
        return None
    parts = DriveParts.inside("kitti_raw", root, root / "velodyne_points" / "data", _existing(root / "poses.txt"))
    times = _existing(root / "velodyne_points" / "timestamps.txt", root / "oxts" / "timestamps.txt")
    return replace(parts, times=times, calibration=(root, root.absolute().parent))


def _kitti360(root: Path, scan_folders: Collection[str]) -> DriveParts | None:
    """KITTI-360: pose lines that start with the frame number, those of the left camera or of the IMU (poses.txt).

    They lie beside the scans, or as published: scans in data_3d_raw/DRIVE, poses in data_poses/DRIVE, calibration/; of
    such a data set its root will do, where it holds one drive. A drive that was taken out of it may hold its own
    data_poses/DRIVE, as the page sends it.
    """
    scans: Path | None
    if (published := _published_kitti360(root)) is not None:
        dataset, root = published
        poses = dataset / KITTI360_POSES / root.name
        scans, pose_folders, calibration = root / "velodyne_points" / "data", [root, poses], [dataset / "calibration"]
        oxts = [root / "oxts", poses / "oxts", dataset / "data_poses_oxts" / root.name / "oxts"]
    else:
        above = root.absolute().parent
        scans = next((root / folder for folder in SCAN_FOLDERS if folder in scan_folders), None)
        pose_folders = [root, *islice((root / KITTI360_POSES).glob("*"), 1)]
        calibration = [above, above / "calibration", above.parent / "calibration"]
        oxts = [folder / "oxts" for folder in pose_folders]
    if scans is None or (published and not scans.is_dir()):
        return None
    pose_file = _existing(*(folder / name for folder in pose_folders for name in _KITTI360_POSES))
    if pose_file is None or _fields_of_first_line(SourceFile(pose_file, root)) not in INDEXED_LENGTHS:
        if published is None:
            return None
        pose_file = pose_folders[-1] / _KITTI360_POSES[0]  # its reader says that it is missing, or what is wrong
    return DriveParts(
        layout="kitti360",
        root=root,
        scans=scans,
        poses=pose_file,
        times=_existing(
            root / "times.txt", scans.parent / "timestamps.txt", *(folder / "timestamps.txt" for folder in oxts)
        ),
        calibration=(root, root / "calibration", *calibration),
        oxts=_existing(*oxts),
        geo=_existing(root / "geo.csv"),
    )


def _published_kitti360(root: Path) -> tuple[Path, Path] | None:
    """Return the root of a KITTI-360 data set and the drive in it that a folder stands for; None where it is neither.

    Raises
    ------
    DriveError
        It is the root of a data set with several drives, or none.
    """
    here = root.absolute()
    if here.parent.name == KITTI360_SCANS:
        return here.parent.parent, root
    scans = here if here.name == KITTI360_SCANS else here / KITTI360_SCANS
    if not scans.is_dir():
        return None
    drives = sorted(folder.name for folder in scans.iterdir() if (folder / "velodyne_points" / "data").is_dir())
    if len(drives) != 1:
        listed = f"the drives {', '.join(drives)}: give one of them" if drives else "no drive with velodyne_points/data"
        example = f", such as {KITTI360_SCANS}/{drives[0]}" if drives else ""
        raise DriveFileError(str(root), f"is the root of KITTI-360, and holds {listed}{example}.")
    return scans.parent, scans / drives[0]


def _pcd(root: Path, scan_folders: Collection[str]) -> DriveParts | None:  # noqa: ARG001 - as the others
    """PCD files: in pcd/, clouds/, velodyne/ or the folder itself, with the poses beside."""
    folders = (root / folder for folder in _PCD_FOLDERS)
    scans = next((folder for folder in folders if folder.is_dir() and _holds_pcd(folder)), None)
    if scans is None:
        return None
    poses = _existing(*(root / name for name in POSE_FILES)) or root / POSE_FILES[0]
    return DriveParts.inside("pcd", root, scans, poses)


def pcd_ending(name: str) -> str:
    """Return the ending of the name of a PCD file; "" for any other file."""
    return next((ending for ending in PCD_ENDINGS[::-1] if name.endswith(ending)), "")


def _holds_pcd(folder: Path) -> bool:
    with os.scandir(folder) as entries:
        return any(pcd_ending(entry.name) for entry in entries)


def _existing(*paths: Path) -> Path | None:
    return next((path for path in paths if path.exists()), None)


def _fields_of_first_line(file: SourceFile) -> int:
    """Count the numbers of the first line; 0 where it cannot be read (its reader will say why)."""
    return len(file.head().partition(b"\n")[0].split())


_LAYOUTS: dict[str, Callable[[Path, Collection[str]], DriveParts | None]] = {  # the first that fits, in this order
    "pcd": _pcd,
    "kitti360": _kitti360,  # the others know nothing of frame numbers in pose lines
    "semantickitti": _semantickitti,
    "kitti_raw": _kitti_raw,
}

_USUAL_MISTAKES: tuple[tuple[str, str], ...] = (
    (r"ground", "It is a reduced drive without its reduced.json, which is written last: reduce or send it again. "),
    (r"sequences", "It is the root of a data set: give one sequence, such as sequences/00. "),
    (r"\d\d", "It holds sequences: give one of them, such as 00. "),
    (r".*_sync", "It holds drives: give one of them (..._sync). "),
    (r".*\.bin", "It holds the scans themselves: give the folder above it. "),
    (r".*\.label", "It holds labels: give the folder above it. "),
    (r".*\.(zip|tar|tgz|tar\.\w+)", "It holds an archive: unpack it first. "),
)


_SINGLE_FILES = {
    ".pcd": "a PCD file is one scan, give the folder that holds them all",
    ".bin": "a .bin file is one scan, give the drive that holds them all, the folder above velodyne/",
    ".label": "labels are given with their drive, the folder above labels/",
}

_FOREIGN = {
    ".pcap": "packets of the sensor are not read, have its driver write a ROS bag or PCD files",
    ".ply": "PLY is not read, write PCD files (x y z intensity label)",
    ".npy": "NumPy files are not read, write PCD files, or .bin (float32 x y z remission)",
    ".npz": "NumPy files are not read, write PCD files, or .bin (float32 x y z remission)",
    ".xyz": "text is not read, write PCD files, or LAS where it is a cloud of mobile mapping",
    ".e57": "E57 is not read, convert it to LAS, or to one PCD file per scan",
}
"""Formats of points that are not read -> what to do instead."""

_MAX_LOOKED_AT = 20_000
_FOLDERS_EACH = 2


def _seen_in(root: Path) -> str:
    """Return what scans a folder holds that is no drive, there or below, and what to do with them; "" for none."""
    counts: Counter[tuple[str, str]] = Counter()
    known = {ending for each in FORMATS for ending in each.endings}
    below = (each for pattern in ("*", "*/*", "*/*/*") for each in root.glob(pattern))
    for path in islice(below, _MAX_LOOKED_AT):
        if (suffix := path.suffix.lower()) in known or suffix in _FOREIGN:
            counts[str(path.parent), suffix] += 1
    if not counts:
        return ""
    (folder, suffix), count = counts.most_common(1)[0]
    alone = sorted(Path(parent).name for (parent, ending), number in counts.items() if number == 1 and ending == suffix)
    if count == 1 and len(alone) > _FOLDERS_EACH:
        return (
            f"It holds one {suffix} file in each of {len(alone):,} folders ({alone[0]}, {alone[1]}, ...), as "
            f"hdl_graph_slam dumps its keyframes: put them into one folder (000000{suffix}, 000001{suffix}, ...), and "
            "the pose of each (the matrix `estimate` in its file data), 12 or 16 numbers per line, into poses.txt. "
        )
    seen = f"It holds {counted(count, f'{suffix} file')}"
    if suffix in _FOREIGN:
        return f"{seen}: {_FOREIGN[suffix]}. "
    if folder == str(root):
        return f"{seen} without the files that go with them. "
    place = Path(folder).relative_to(root)
    if suffix == ".bin":
        return (
            f"{seen} in {place}. Where every point is four float32 (x y z remission), put them into velodyne/, named "
            "000000.bin, 000001.bin, ..., with poses.txt and labels/ beside it; write other values per point anew. "
        )
    return (
        f"{seen} in {place}: give that folder; where its poses lie elsewhere, "
        f"`interloc convert {folder} --poses FILE -o DRIVE` writes a drive of all. "
    )


def find_layout(root: Path, options: DriveOptions, *, announced: ScanFolder | None = None) -> DriveParts:
    """Detect the layout of a drive folder and find its parts.

    Parameters
    ----------
    announced : str or None
        Folder of the scans where they are still to come.

    Raises
    ------
    DriveError
        There is no such folder, it is not a drive, or it could be two.
    """
    parts = recognise_layout(root, options, announced=announced)
    if parts is None:
        raise not_a_drive(root, options, announced=announced)
    return parts


def recognise_layout(root: Path, options: DriveOptions, *, announced: ScanFolder | None = None) -> DriveParts | None:
    """Find the parts of a drive folder, as `find_layout`; None where it is of no layout, or not of the one asked for.

    Raises
    ------
    DriveError
        It could be two drives.
    """
    if not root.is_dir():
        return None
    inside = {entry.name for entry in root.iterdir()}
    scan_folders = {folder for folder in SCAN_FOLDERS if folder == announced or (root / folder).is_dir()}
    if options.layout == "auto" and announced is None and {"velodyne", "velodyne_points"} <= inside:
        raise DriveFileError(
            str(root),
            "holds both velodyne/ (KITTI odometry) and velodyne_points/ (KITTI raw), so it could be two drives. "
            "Name the layout (semantickitti or kitti_raw), or remove one.",
        )
    asked = [find for name, find in _LAYOUTS.items() if options.layout in {"auto", name}]
    parts = next((found for find in asked if (found := find(root, scan_folders)) is not None), None)
    has_none = parts is not None and not parts.has_poses and options.poses is None
    if has_none and (root / "pose").is_dir() and (seen := known_data_set(root)):
        raise DriveFileError(str(root), f"holds no poses.txt. {seen}")
    if parts is not None and options.poses is not None:
        parts = replace(parts, poses=Path(options.poses))
    return parts if parts is None or options.name is None else replace(parts, name=options.name)


def not_a_drive(root: Path, options: DriveOptions, *, announced: ScanFolder | None = None) -> DriveFileError:
    """Return the error to raise about a path that is no drive, or not of the layout asked for."""
    name, formats = str(root), (*FORMATS, *installed_formats())
    if not root.exists():
        return DriveFileError(name, "does not exist. Expected the folder of one drive.")
    if not root.is_dir():
        suffix = root.suffix.lower()
        hint = _FOREIGN.get(suffix) or _SINGLE_FILES.get(suffix, "unpack an archive first, and give the folder")
        return DriveFileError(name, f"is a file. Expected the folder of one drive, a ROS bag or a LAS file: {hint}.")
    inside = {entry.name for entry in root.iterdir()}
    if not inside and announced is None:
        return DriveFileError(name, f"is an empty folder. Expected {formats[0].expected}.")
    if (asked := find_format(options.layout)) is not None:
        return DriveFileError(name, f"is not of layout {asked.name}. Expected {asked.expected}.")
    usual = next((text for pattern, text in _USUAL_MISTAKES if any(re.fullmatch(pattern, each) for each in inside)), "")
    if seen := known_data_set(root) or usual or _seen_in(root):
        return DriveFileError(name, f"is not a drive. {seen}docs/own-data.md lists all formats.")
    return DriveFileError(name, f"is not a drive. Expected {', or '.join(each.expected for each in formats)}.")
