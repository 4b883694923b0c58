"""Where the parts of a drive lie, and the choice among the layouts."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from interloc.drives import kitti360, kitti_raw, semantickitti
from interloc.drives.faults import DriveFileError
from interloc.drives.options import DriveOptions
from interloc.drives.parts import SCAN_FOLDERS, DriveParts, ScanFolder

_LAYOUTS = {
    "semantickitti": semantickitti.find_parts,
    "kitti_raw": kitti_raw.find_parts,
    "kitti360": kitti360.find_parts,
}

_EXPECTED = {
    "semantickitti": "velodyne/000000.bin, labels/000000.label, poses.txt, calib.txt (SemanticKITTI, KITTI odometry)",
    "kitti_raw": "velodyne_points/data/0000000000.bin, oxts/data/0000000000.txt (KITTI raw)",
    "kitti360": "velodyne/ or velodyne_points/data/ with pose lines that start with the frame number (KITTI-360)",
}


def find_layout(root: Path, options: DriveOptions, *, announced: ScanFolder | None = None) -> DriveParts:
    """Detect the layout of a drive folder and find its parts.

    Parameters
    ----------
    announced : str or None
        Folder of the scans where they are still to come.

    Raises
    ------
    DriveError
        There is no such folder, it is no drive, or it could be two.
    """
    name = str(root)
    if not root.exists():
        raise DriveFileError(name, "does not exist. Expected the folder of one drive.")
    if not root.is_dir():
        raise DriveFileError(
            name, "is a file. Expected the folder of one drive; unpack an archive first, and give the folder."
        )
    parts = _choose(root, options, announced)
    return parts if options.name is None else replace(parts, name=options.name)


def _choose(root: Path, options: DriveOptions, announced: ScanFolder | None) -> DriveParts:
    """Return the parts under the one layout that fits."""
    name = str(root)
    inside = {entry.name for entry in root.iterdir()}
    scan_folders = {folder for folder in SCAN_FOLDERS if folder == announced or (root / folder).is_dir()}
    if not inside and announced is None:
        raise DriveFileError(name, f"is an empty folder. Expected {_EXPECTED['semantickitti']}.")

    if options.layout != "auto":
        chosen = _LAYOUTS[options.layout](root, options.labels, scan_folders)
        if chosen is None:
            raise DriveFileError(name, f"is not of layout {options.layout}. Expected {_EXPECTED[options.layout]}.")
        return chosen

    if announced is None and "velodyne" in inside and "velodyne_points" in inside:
        raise DriveFileError(
            name,
            "holds both velodyne/ (KITTI odometry) and velodyne_points/ (KITTI raw), so it could be two drives. "
            "Name the layout (semantickitti or kitti_raw), or remove one.",
        )
    found: dict[str, DriveParts] = {}
    for layout, find in _LAYOUTS.items():
        if (parts := find(root, options.labels, scan_folders)) is not None:
            found[layout] = parts
    if "kitti360" in found:  # the others know nothing of frame numbers in pose lines
        return found["kitti360"]
    if found:
        return next(iter(found.values()))
    raise DriveFileError(name, f"is not a drive. {_usual_mistake(inside)}Expected {', or '.join(_EXPECTED.values())}.")


_MISTAKES: tuple[tuple[str, str], ...] = (
    (r"ground", "It is a reduced drive without its reduced.json, which is written last: reduce or send it again. "),
    (r"sequences", "It is the root of a data set: give one sequence, such as sequences/00. "),
    (r"\d\d", "It holds sequences: give one of them, such as 00. "),
    (r".*_sync", "It holds drives: give one of them (..._sync). "),
    (r".*\.bin", "It holds the scans themselves: give the folder above it. "),
    (r".*\.label", "It holds labels: give the folder above it. "),
    (r".*\.(zip|tar|tgz|tar\.\w+)", "It holds an archive: unpack it first. "),
)


def _usual_mistake(inside: set[str]) -> str:
    """Name what was given instead of a drive, where it can be told."""
    return next((text for pattern, text in _MISTAKES if any(re.fullmatch(pattern, name) for name in inside)), "")
