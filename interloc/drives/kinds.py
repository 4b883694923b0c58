"""What the files of a drive are, by their names: the one table of it.

Looks at listings, archives, uploads and the page read it; what a folder means once it is there, and what is in its
files, is for `layouts` and the readers of the formats.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from interloc.drives.formats import FORMATS
from interloc.drives.layouts import KITTI360_POSES, POSE_FILES, SCAN_FOLDERS
from interloc.drives.options import LABEL_FILES

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
    "bin": FileNames(rf"(?:{_SCAN_FOLDERS})/[^/]+\.bin", "(?!)"),
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
