"""The layouts of drives: where their scans, labels, poses, times, calibration and georeference lie, and their names.

A new layout of folders is a function here, and its line in `_LAYOUTS`.
"""

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Literal

from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError
from interloc.drives.formats import FORMATS, find_format, installed_formats
from interloc.drives.options import LABEL_FILES, DriveOptions, LabelFolder
from interloc.wording import counted, printable

INDEXED_LENGTHS = (13, 17)
"""How many numbers a pose line holds that starts with a frame number."""

PoseOwner = Literal["camera", "lidar", "imu", "oxts"]
"""Whose poses a drive has; those of OXTS are the LiDAR's, taken from the georeference."""

SCAN_FOLDERS = ("velodyne", "velodyne_points/data")
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
    """The files and folders of a drive, as its layout names them; they are not looked into yet."""

    layout: str
    """A name of `interloc.drives.formats`."""
    root: Path
    scans: Path
    poses: Path | None
    """None where the poses come from OXTS."""
    times: Path | None
    """Seconds, or date and time, one line per frame."""
    calibration: tuple[Path, ...]
    """Calibration files, or folders that they may lie in, the nearest first."""
    oxts: Path | None
    """Folder of OXTS files, or file of OXTS rows."""
    geo: Path | None
    name: str = ""
    """Of the drive, where it is not that of the folder."""
    pose_frame: tuple[PoseOwner, str] | None = None
    """Whose poses the pose file holds, and why, where that was found out before."""

    @classmethod
    def inside(cls, layout: str, root: Path, scans: Path, poses: Path | None) -> "DriveParts":
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
        return printable(self.name or os.fsencode(self.root.absolute().name).decode(errors="replace"))

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
    return DriveParts.inside("semantickitti", root, root / "velodyne", _poses_in(root))


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
    first = b"" if pose_file is None else SourceFile(pose_file, root).head().partition(b"\n")[0]
    if len(first.split()) not in INDEXED_LENGTHS:
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
    """Return the root of a KITTI-360 data set and the one drive in it that a folder stands for; None for others."""
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


def _pcd(root: Path, scan_folders: Collection[str]) -> DriveParts | None:
    """PCD files: in pcd/, clouds/, velodyne/ or the folder itself, with the poses beside."""
    folders = (root / folder for folder in scan_folders or _PCD_FOLDERS)  # beside scans, a cloud is a map
    there = filter(Path.is_dir, folders)
    scans = next((folder for folder in there if any(pcd_ending(path.name) for path in folder.iterdir())), None)
    if scans is None:
        return None
    return DriveParts.inside("pcd", root, scans, _poses_in(root))


def _poses_in(root: Path) -> Path:
    return _existing(*(root / name for name in POSE_FILES)) or root / POSE_FILES[0]


def pcd_ending(name: str) -> str:
    """Return the ending of the name of a PCD file; "" for any other file."""
    return next((ending for ending in PCD_ENDINGS[::-1] if name.endswith(ending)), "")


def _existing(*paths: Path) -> Path | None:
    return next((path for path in paths if path.exists()), None)


_LAYOUTS: dict[str, Callable[[Path, Collection[str]], DriveParts | None]] = {  # the first that fits, in this order
    "pcd": _pcd,
    "kitti360": _kitti360,  # the others know nothing of frame numbers in pose lines
    "semantickitti": _semantickitti,
    "kitti_raw": _kitti_raw,
}

_USUAL_MISTAKES = (
    (r"ground(/.*)?", "is a reduced drive without its reduced.json, which is written last: reduce or send it again"),
    (r"sequences", "is the root of a data set: give one sequence, such as sequences/00"),
    (r"\d\d", "holds sequences: give one of them, such as 00"),
    (r".*_sync", "holds drives: give one of them (..._sync)"),
    (r"[^/]+\.bin", "holds the scans themselves: give the folder above it"),
    (r"[^/]+\.label", "holds labels only: give the folder above it"),
    (
        r"(?i:.*\.(bag|db3|mcap)\.(zst|zstd|gz|bz2|xz|lz4))",
        "holds a bag compressed as a whole: unpack it first (zstd -d, gunzip)",
    ),
    (r".*\.bag\.active", "holds a recording that was not ended properly: make a bag of it with rosbag reindex"),
    (r"(?i:.*\.(zip|tar|tgz|tar\.\w+))", "holds an archive: give the archive itself, or unpack it first"),
    (
        r"(.*/)?data_poses/.*|\d{4}_\d\d_\d\d_drive_\d{4}_sync/(poses|cam0_to_world)\.txt",
        "holds poses but no scans: give the root of KITTI-360, with data_3d_raw/ in it",
    ),
    (
        rf"(?i:(.*/)?({'|'.join(SCAN_FOLDERS)})/[^/]+\.bin)",
        "holds scans under names in capitals: upper and lower case are told apart; rename them to velodyne/000000.bin",
    ),
    (r".*\.label", "holds labels but no scans: give the folder that has velodyne/ too"),
)
"""What a path in a folder that is no drive shows, the first that fits."""


def usual_mistake(paths: Collection[str]) -> str:
    """Return what is wrong with a folder that is no drive, by paths in it, in words that follow its name; or ""."""
    return next((text for sign, text in _USUAL_MISTAKES if any(re.fullmatch(sign, path) for path in paths)), "")


_SINGLE_FILES = {
    ".pcd": "a PCD file is one scan, give the folder that holds them all",
    ".bin": "a .bin file is one scan, give the drive that holds them all, the folder above velodyne/",
    ".label": "labels are given with their drive, the folder above labels/",
    ".active": "a recording that was not ended properly, make a bag of it with rosbag reindex",
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

_MAX_LOOKED_AT, _MAX_TABLE_BYTES = 20_000, 16 * 1024 * 1024
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
        to_do = (
            ". Where every point is four float32 (x y z remission), put them into velodyne/, named 000000.bin, "
            "000001.bin, ..., with poses.txt and labels/ beside it; write other values per point anew"
        )
        if place.name == "velodyne" and place.parent.name:
            to_do = f": give the folder they belong to, {place.parent}"
        return f"{seen} in {place}{to_do}. "
    return (
        f"{seen} in {place}: give that folder; where its poses lie elsewhere, "
        f"`interloc convert {folder} --poses FILE -o DRIVE` writes a drive of all. "
    )


def find_layout(root: Path, options: DriveOptions) -> DriveParts:
    """Detect the layout of a drive folder, and find its parts."""
    parts = recognise_layout(root, options)
    if parts is None:
        raise not_a_drive(root, options)
    return parts


def recognise_layout(root: Path, options: DriveOptions) -> DriveParts | None:
    """Find the parts of a drive folder, as `find_layout`; None where it is not of a layout, or of the one asked for."""
    if not root.is_dir():
        return None
    inside = {entry.name for entry in root.iterdir()}
    scan_folders = {folder for folder in SCAN_FOLDERS if (root / folder).is_dir()}
    if options.layout == "auto" and {"velodyne", "velodyne_points"} <= inside:
        raise DriveFileError(
            str(root),
            "holds both velodyne/ (KITTI odometry) and velodyne_points/ (KITTI raw), so it could be two drives. "
            "Name the layout (semantickitti or kitti_raw), or remove one.",
        )
    if options.layout == "pcd":
        scan_folders = set()
    asked = [find for name, find in _LAYOUTS.items() if options.layout in {"auto", name}]
    parts = next((found for find in asked if (found := find(root, scan_folders)) is not None), None)
    has_none = parts is not None and not parts.has_poses and options.poses is None
    if has_none and (root / "pose").is_dir() and (seen := known_data_set(root)):
        raise DriveFileError(str(root), f"holds no poses.txt. {seen}")
    if parts is not None and options.poses is not None:
        parts = replace(parts, poses=Path(options.poses))
    return parts if parts is None or options.name is None else replace(parts, name=options.name)


def not_a_drive(root: Path, options: DriveOptions) -> DriveFileError:
    """Return the error to raise about a path that is no drive, or not of the layout asked for."""
    name, formats = str(root), (*FORMATS, *installed_formats())
    if not root.exists():
        return DriveFileError(name, "does not exist. Expected the folder of one drive.")
    if not root.is_dir():
        suffix = root.suffix.lower()
        hint = _FOREIGN.get(suffix) or _SINGLE_FILES.get(suffix, "unpack first what is packed (unzip, zstd -d)")
        return DriveFileError(name, f"is a file. Expected the folder of one drive, a ROS bag or a LAS file: {hint}.")
    inside = {entry.name for entry in root.iterdir()}
    if not inside:
        return DriveFileError(name, f"is an empty folder. Expected {formats[0].expected}.")
    if (asked := find_format(options.layout)) is not None:
        return DriveFileError(name, f"is not of layout {asked.name}. Expected {asked.expected}.")
    usual = usual_mistake(inside)
    if seen := known_data_set(root) or (f"It {usual}. " if usual else _seen_in(root)):
        return DriveFileError(name, f"is not a drive. {seen}docs/own-data.md lists all formats.")
    return DriveFileError(name, f"is not a drive. Expected {', or '.join(each.expected for each in formats)}.")


# Public data sets that are not read as they are unpacked


_WRITE = (
    "Write each scan as float32 x y z remission to velodyne/000000.bin, 000001.bin, ... (NumPy: tofile), and the pose "
    "of the LiDAR at each, 12 numbers per line, to poses.txt. "
)
_DATA_SETS = {
    r"lidar/\d+\.pkl(\.gz)?": (
        "PandaSet: pandas.read_pickle reads a scan, which lidar/poses.json brings to the sensor"
    ),
    r"lidar/\d+\.feather": ("Argoverse 2: pandas.read_feather reads a scan; poses are in city_SE3_egovehicle.feather"),
    r"[^/]+\.tfrecord|lidar\w*/[^/]+\.parquet": "Waymo: its package makes the points of a segment of range images",
    r"pose/\d+\.txt": (
        "Waymo in KITTI's form: take one segment. Its scans are read as they are, six values per point, from "
        "velodyne/; the first 12 numbers of each file in pose/ are a line of poses.txt"
    ),
    r"pose/\d+\.json": "View of Delft: take one drive; the pose of each scan is in pose/",
    r"(samples|sweeps)/LIDAR_TOP/[^/]+|v1\.0-\w+/(ego_pose|scene)\.json": (
        "nuScenes: the scans of all scenes lie together in samples/LIDAR_TOP and sweeps/LIDAR_TOP (.pcd.bin, which "
        "are read as they are). Put those of one scene into a folder, and their poses by nuscenes-devkit into "
        "poses.txt"
    ),
    r"frames/frame_\d+\.ply|full_poses_lidar\.txt": (
        "KITTI-CARLA: write frames/*.ply as PCD files (x y z label), with --label-scheme 7,6 for road; each line of "
        "full_poses_lidar.txt is a pose of 12 numbers and its time"
    ),
    r"velodyne_(left|right)/\d+\.(bin|png)|velodyne_(left|right)\.timestamps": (
        "Oxford RobotCar: its .bin hold all x, then all y, z and intensity (np.fromfile(FILE, np.float32).reshape(4, "
        "-1).T); poses are in gps/ins.csv and vo/"
    ),
    r"LiDAR/(Ouster|Velodyne|Avia|Aeva)/\d+\.bin|LiDAR_GT/[^/]+": (
        "HeLiPR: its .bin hold records of 22 to 29 bytes, by the sensor; poses are in LiDAR_GT/"
    ),
    r"Ouster/\d+\.bin|sensor_data/\w+\.csv": (
        "MulRan: its .bin are named by nanoseconds, and hold float32 x y z intensity; global_pose.csv has the poses "
        "of the vehicle at other times"
    ),
    r"lidar/\d+\.bin|applanix/lidar_poses\.csv": (
        "Boreas: its .bin hold six float32 (x y z intensity ring time); poses are in applanix/lidar_poses.csv"
    ),
    r"velodyne_sync/\d+\.bin|velodyne_hits\.bin|groundtruth_\d{4}-\d\d-\d\d\.csv": (
        "NCLT: its .bin hold eight bytes per point (uint16 x y z in steps of 5 mm from -100 m, z down; uint8 "
        "intensity and laser); poses are in groundtruth_*.csv"
    ),
    r"ouster_points/(data/.+|timestamps\.txt)|\.dtype\.pkl": (
        "VBR: its .bin hold records of 29 bytes, by .dtype.pkl; its bags are read as they are, with --poses"
    ),
}
"""The ends of paths, as regular expressions -> what it is."""


def known_data_set(root: Path) -> str:
    """Return which public data set lies in a folder, or around it, and the way out, in sentences; "" for none."""
    paths = (path for depth in range(1, 6) for path in root.absolute().glob("/".join("*" * depth)))
    for path in islice(paths, _MAX_LOOKED_AT):
        for sign, what in _DATA_SETS.items():
            if re.search(f"(^|/)({sign})$", path.as_posix()):
                return f"It looks like {what}. {_scenes(root)}{'' if 'as they are' in what else _WRITE}"
    return ""


def _scenes(root: Path) -> str:
    """Return which scenes the tables of nuScenes name; "" where there are none."""
    with suppress(OSError, ValueError, LookupError, TypeError):
        for path in islice(root.glob("v1.0-*/scene.json"), 1):
            names = sorted(str(each["name"]) for each in json.loads(path.read_bytes()[:_MAX_TABLE_BYTES]))
            more = ", ..." if len(names) > 3 else ""
            return f"{path.parent.name} names {len(names):,} scenes ({', '.join(names[:3])}{more}). " if names else ""
    return ""


# What the files of a drive are, by their names: looks at listings, archives, uploads and the page read this table


Kind = Literal["bin", "pcd", "rosbag", "las", "reduced"]
"""How the scans of a drive are kept; of "bin" the small files tell the layout."""

ENDINGS = {each.name: each.endings for each in FORMATS}
"""Of scans, by the format."""

RECORDING_ENDINGS = tuple(ending for each in FORMATS if not each.is_folders for ending in each.endings)
"""Endings of files that hold many scans, and are as large as a whole drive."""

TRACK_ENDINGS = (".csv", ".out", ".sbet", ".tum", ".txt")
"""Endings of trajectories, which clouds have beside them."""

SMALL_ENDINGS = (".csv", ".json", ".tum", ".txt", ".yaml")
"""Endings of small files that may tell more of a drive, also packed by gzip."""


@dataclass(frozen=True)
class FileNames:
    """The names that files of a kind of drive have, as paths in it."""

    scans: str
    """Of its scans, as a regular expression."""
    small: str
    """Of what else belongs to it, beside the small files that any drive may have."""
    has_labels: bool = True
    """Whether label files may lie beside the scans."""
    sign: str = ""
    """By which files such a drive is recognised, where that is not by its scans."""

    def is_scan(self, inside: str) -> bool:
        """Whether a file holds scans."""
        return re.fullmatch(self.scans, inside) is not None

    def is_label(self, inside: str) -> bool:
        """Whether a file holds the labels of a scan."""
        return self.has_labels and re.fullmatch(_LABELS, inside) is not None

    def is_small(self, inside: str) -> bool:
        """Whether a file tells poses, times, calibration or georeference, or may."""
        return re.fullmatch(f"{_SMALL}|{self.small}", inside) is not None


def _any(words: tuple[str, ...]) -> str:
    return "|".join(map(re.escape, words))


_FOLDERS = ("oxts", *LABEL_FILES, *(folder.partition("/")[0] for folder in SCAN_FOLDERS))
_LABELS = rf"(?:{_any(LABEL_FILES)})/[^/]+\.label"
_SMALL = (
    r"(?:poses|cam0_to_world|times|timestamps|calib[^/]*|calibration/[^/]+|velodyne_points/timestamps[^/]*)\.txt"
    r"|geo\.csv|dropped\.csv|oxts/(?:[^/]+/)?[^/]+\.txt(?:\.gz)?|georeference/.+"
    rf"|{KITTI360_POSES}/[^/]+/(?:poses|cam0_to_world|oxts/(?:[^/]+/)?[^/]+)\.txt"
)
_SCAN_FOLDERS = _any(SCAN_FOLDERS)

KINDS: dict[Kind, FileNames] = {
    "pcd": FileNames(rf"(?:(?:pcd|clouds|{_SCAN_FOLDERS})/)?[^/]+\.pcd(?:\.bin)?", _any(POSE_FILES)),
    "rosbag": FileNames(rf"[^/]+(?i:{_any(ENDINGS['rosbag'])})", r"metadata\.yaml"),
    "las": FileNames(
        rf"(?:(?:las|laz)/)?[^/]+(?i:{_any(ENDINGS['las'])})", rf"(?i:(?:(?:las|laz)/)?[^/]+(?:{_any(TRACK_ENDINGS)}))"
    ),
    "reduced": FileNames(
        r"ground/[^/]+/\d+\.ground", r".+\.(?:txt|csv)(?:\.gz)?|reduced\.json", False, r"reduced\.json"
    ),
    "bin": FileNames(rf"(?:{_SCAN_FOLDERS})/[^/]+\.bin", _any(POSE_FILES)),
}
"""In the order in which a name is tried."""

SIGNS = re.compile(
    "(?:(?P<root>.*?)/)??(?:"
    + "|".join(f"(?P<{kind}>{names.sign or names.scans})" for kind, names in KINDS.items())
    + ")"
)
"""By which files a drive is recognised, and in which folder (`root`) it is then: the last group is its kind."""

CALIBRATION_BESIDE = re.compile(r"(?:(?P<above>.*?)/)??(?P<place>(?:calibration/[^/]+|calib[^/]*)\.txt)")
"""Calibration that may lie in a folder above the drive: that of a day, or of a data set."""

KITTI360_BESIDE = re.compile(
    rf"(?:(?P<above>.*)/)?(?P<source>{KITTI360_POSES}(?:_oxts)?/(?P<drive>[^/]+))/"
    r"(?P<place>(?:poses|cam0_to_world|oxts/(?:[^/]+/)?[^/]+)\.txt)"
)
"""Poses and OXTS that KITTI-360 keeps in folders of their own."""


IN_CAPITALS = "is not read: upper and lower case are told apart. Rename it to {}."
"""Of files that came through Windows or a card reader."""


def misnamed(root: Path) -> Iterator[tuple[str, str]]:
    """Yield what in the folder of a drive would be a part of it but for capitals, and the names that they need."""
    for entry in root.iterdir():
        lower = entry.name.lower()
        is_known = lower in _FOLDERS if entry.is_dir() else is_part(lower) or lower in POSE_FILES
        if entry.name != lower and is_known and not is_part(entry.name) and not (root / lower).exists():
            yield entry.name, lower


def is_recording(path: str) -> bool:
    """Whether a file holds many scans."""
    return path.lower().endswith(RECORDING_ENDINGS)


def is_part(inside: str) -> bool:
    """Whether a file belongs to a drive of some kind by its path in it."""
    return any(
        names.is_scan(inside) or names.is_label(inside) or re.fullmatch(_SMALL, inside) for names in KINDS.values()
    )
