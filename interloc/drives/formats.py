"""The formats of scans: one table, which other packages add to by the entry point group ``interloc.recordings``.

An entry point is named as the layout that it adds, and leads to a function of the path, a `DriveOptions` and the
`Findings`, which returns a `Recording` (`interloc.drives.scans.recording`), or None where the path is something else.
"""

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from interloc.drives.findings import DriveFileError

GROUP = "interloc.recordings"


@dataclass(frozen=True)
class ScanFormat:
    """A format of scans, or a layout of folders with one file per scan."""

    name: str
    """Name of the layout in options and reports."""
    expected: str
    """What messages say that such a drive looks like."""
    opener: str
    """Where its function is, "module:function"; that of a layout of folders takes `DriveParts` in place of a path."""
    endings: tuple[str, ...] = ()
    is_folders: bool = False
    """`interloc.drives.layouts` knows its folders, and a scan is a file."""
    title: str = ""
    """What the page calls it."""

    def open(self, *arguments: Any) -> Any:  # noqa: ANN401 - loaded by its name
        """Call the function that opens a drive of this format."""
        try:
            opener: Any = EntryPoint(self.name, self.opener, GROUP).load()
        except (ImportError, AttributeError) as error:
            raise DriveFileError(f"format {self.name}", f"{self.opener} cannot be loaded: {error}.") from error
        return opener(*arguments)


_BIN_FILES = {
    "semantickitti": "velodyne/000000.bin, labels/000000.label, poses.txt, calib.txt (SemanticKITTI, KITTI odometry)",
    "kitti_raw": "velodyne_points/data/0000000000.bin, oxts/data/0000000000.txt (KITTI raw)",
    "kitti360": "velodyne/ or data_3d_raw/DRIVE/velodyne_points/ with pose lines that start with the frame number "
    "(KITTI-360)",
}
_BIN_TITLES = {"semantickitti": "SemanticKITTI / KITTI odometry", "kitti_raw": "KITTI raw", "kitti360": "KITTI-360"}
_BIN_OPENER = "interloc.drives.scans.bin_files:open_bin_files"

FORMATS = (
    *(ScanFormat(name, looks, _BIN_OPENER, (".bin",), True, _BIN_TITLES[name]) for name, looks in _BIN_FILES.items()),
    ScanFormat(
        "pcd",
        "000000.pcd, 000001.pcd, ... (directly in it, or in pcd/, clouds/, velodyne/) with poses.txt (PCD)",
        "interloc.drives.scans.pcd:open_pcd_files",
        (".pcd",),
        is_folders=True,
        title="PCD files",
    ),
    ScanFormat(
        "rosbag",
        "a ROS bag (.bag, .db3, .mcap)",
        "interloc.drives.scans.rosbag.open:open_rosbag",
        (".bag", ".db3", ".mcap"),
        title="ROS bag",
    ),
    ScanFormat(
        "las",
        "LAS or LAZ files with their trajectory",
        "interloc.drives.scans.las.mapping:open_las",
        (".las", ".laz"),
        title="LAS or LAZ files",
    ),
)
"""Those of this package, in the order in which messages name them; a new one is a module of `scans` and a line."""


@cache
def installed_formats() -> tuple[ScanFormat, ...]:
    """Return the formats that other packages bring (looked up once: it takes a tenth of a second)."""
    own = {each.name for each in FORMATS}
    return tuple(
        ScanFormat(point.name, f"{point.name} (read by {point.value.partition(':')[0]})", point.value, title=point.name)
        for point in entry_points(group=GROUP)
        if point.name not in own
    )


def find_format(name: object) -> ScanFormat | None:
    """Return the format of a name; None where there is none, as of "auto"."""
    own = next((each for each in FORMATS if each.name == name), None)
    if own or name == "auto":
        return own
    return next((each for each in installed_formats() if each.name == name), None)
