"""Which folder of an archive is the drive."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import PurePosixPath

from app.paths import is_map
from app.work.archive_files import ArchiveError

_SIGNS = re.compile(
    r"(?P<root>(?:.*/)?)"
    r"(?:velodyne/[^/]+\.bin|velodyne_points/data/[^/]+\.bin|(?:labels|predictions)/[^/]+\.label|reduced\.json)"
)
_PARTS = frozenset(
    ["velodyne", "velodyne_points", "labels", "predictions", "oxts", "ground", "georeference", "image_2", "image_3"]
)


def drive_paths(names: Collection[str]) -> dict[str, str]:
    """Find the drive among the files of an archive.

    Parameters
    ----------
    names
        Paths in the archive.

    Returns
    -------
    dict of str to str
        Path in the archive -> path in the drive, of the files that belong to it: those in its folder, and calibration
        files and maps that lie above it.

    Raises
    ------
    ArchiveError
        There are two drives.
    """
    root = _root(names)
    paths = {name: name[len(root) :] for name in names if name.startswith(root)}
    taken = set(paths.values())
    for name in names:
        place = PurePosixPath(name)
        above = root.startswith(f"{place.parent}/") or place.parent == PurePosixPath()
        is_shared = is_map(name) or re.fullmatch(r"calib\w*\.txt", place.name)
        if name not in paths and above and is_shared and place.name not in taken:
            paths[name] = place.name
            taken.add(place.name)
    return paths


def _root(names: Collection[str]) -> str:
    """Return the folder of the drive, with a slash at its end, or nothing."""
    roots = sorted({match["root"] for name in names if (match := _SIGNS.fullmatch(name))})
    if len(roots) > 1:
        raise ArchiveError(
            f"the archive holds {len(roots)} drives: {roots[0] or './'} and {roots[1]}"
            f"{' and more' if len(roots) > 2 else ''}. Pack one drive an archive, and make a drive for each."
        )
    if roots:
        return roots[0]
    first = {name.split("/", 1)[0] for name in names}
    folder = first.pop() if len(first) == 1 else ""
    is_packed = folder not in _PARTS and all("/" in name for name in names)
    return f"{folder}/" if folder and is_packed else ""
