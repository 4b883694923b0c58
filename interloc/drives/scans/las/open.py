"""Which LAS and LAZ files make a drive, and in which of the two ways."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.layouts import SCAN_FOLDERS, DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.las.clouds import CloudFile, read_cloud_header, require_laspy
from interloc.drives.scans.las.mapping import open_mapping
from interloc.drives.scans.las.scan_files import is_one_per_scan, open_scan_clouds
from interloc.drives.scans.recorded import Recording

SUFFIXES = frozenset({".las", ".laz"})
_FOLDERS = (".", "las", "laz")
_MAX_FILES = 100_000


def open_las(root: Path, options: DriveOptions, findings: Findings) -> Recording | None:
    """Open LAS or LAZ files: one per scan in sensor coordinates, or a cloud of mobile mapping with its trajectory.

    Parameters
    ----------
    root : Path
        A .las or .laz file, or a folder that holds such: directly, or in las/ or laz/.

    Returns
    -------
    Recording or None
        None where these are no LAS files.

    Raises
    ------
    DriveError
        laspy is not installed; a file is damaged; or there is no trajectory, time or coordinate system where one is
        needed, or these do not fit together.
    """
    other = any((root / folder).is_dir() for folder in SCAN_FOLDERS)  # a map may lie beside the scans
    if options.layout != "las" and (options.layout != "auto" or other):
        return None
    found = _find(root)
    if found is None:
        return None
    folder, paths = found
    home = root.absolute().parent if root.is_file() else root
    name = options.name or (root.stem if root.is_file() else "")
    parts = replace(DriveParts.inside("las", home, folder, None), name=name)
    require_laspy(parts.file(paths[0]).name)
    clouds = tuple(_not_empty(read_cloud_header(SourceFile(path, home))) for path in paths)
    if is_one_per_scan(clouds, parts, options):
        return open_scan_clouds(clouds, parts, options, findings)
    return open_mapping(clouds, parts, options, findings)


def _find(root: Path) -> tuple[Path, list[Path]] | None:
    if root.is_file():
        path = root.absolute()
        return (path.parent, [path]) if root.suffix.lower() in SUFFIXES else None
    for folder in (root / each for each in _FOLDERS):
        if not folder.is_dir():
            continue
        with os.scandir(folder) as entries:
            names = sorted(
                entry.name
                for entry in entries
                if Path(entry.name).suffix.lower() in SUFFIXES and not entry.name.startswith(".") and entry.is_file()
            )
        if len(names) > _MAX_FILES:
            raise DriveFileError(str(folder), f"holds {len(names):,} LAS files; at most {_MAX_FILES:,} are read.")
        if names:
            return folder, [folder / name for name in names]
    return None


def _not_empty(cloud: CloudFile) -> CloudFile:
    if not cloud.points:
        raise cloud.file.fault("holds no points. Usual cause: a tile that was cut where nothing was measured.")
    return cloud
