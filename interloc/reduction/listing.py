"""Which drives a folder holds, and which of its files belong to each, told from a listing: paths and sizes."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import cast

from interloc.drives.kinds import CALIBRATION_BESIDE, KINDS, KITTI360_BESIDE, SIGNS, Kind
from interloc.drives.layouts import KITTI360_POSES, POSE_FILES, SCAN_FOLDERS
from interloc.wording import counted

Listing = Mapping[str, int]
"""Path in a folder -> bytes."""


@dataclass
class ListedDrive:
    """A drive in a listing; its files by their paths in the drive, each with its path in the folder."""

    root: str
    """Its folder; "" where it is the folder that was listed."""
    name: str
    kind: Kind
    scans: dict[str, str] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    """Files of scans (of ground points, of a reduced drive) and of labels."""
    small: dict[str, str] = field(default_factory=dict)
    """Poses, times, calibration and georeference; or what may be such."""
    misnamed: dict[str, str] = field(default_factory=dict)
    """What would be a part of it but for capitals: paths in the folder, and the names that they need."""
    borrowed: list[str] = field(default_factory=list)
    """What was taken from beside the drive, in words."""

    @property
    def files(self) -> dict[str, str]:
        """All files that reading it may need."""
        return {**self.scans, **self.labels, **self.small}

    def take(self, inside: str, path: str) -> None:
        """Note what a file is for."""
        names = KINDS[self.kind]
        if names.is_scan(inside):
            self.scans[inside] = path
        elif names.is_label(inside):
            self.labels[inside] = path
        elif names.is_small(inside):
            self.small[inside] = path
        elif inside != (lower := inside.lower()) and (
            names.is_scan(lower) or names.is_label(lower) or names.is_small(lower)
        ):
            self.misnamed[path] = lower


def find_drives(listing: Listing, name: str) -> list[ListedDrive]:
    """Find the drives in a folder, ordered by path: in itself (then of this name), or in folders below it."""
    kinds = _roots(listing)
    drives = {root: ListedDrive(root, root.rpartition("/")[2] or name, kinds[root]) for root in sorted(kinds)}
    beside = _Beside(listing)
    for path in listing:
        root = next((folder for folder in _folders_above(path) if folder in drives), None)
        if root is not None:
            drives[root].take(path[len(root) + 1 if root else 0 :], path)
    for drive in drives.values():
        if drive.kind in {"bin", "pcd"}:
            beside.lend(drive)
    return list(drives.values())


def _roots(listing: Listing) -> dict[str, Kind]:
    """Return the folders of the drives; what lies in, or around, one with .bin files or a manifest belongs to that."""
    roots: dict[str, Kind] = {}
    recorded: defaultdict[str, Counter[Kind]] = defaultdict(Counter)
    for path, size in listing.items():
        if (match := SIGNS.fullmatch(path)) is None:
            continue
        root, kind = match["root"] or "", cast("Kind", match.lastgroup)
        if kind not in {"bin", "reduced"}:
            recorded[root][kind] += size
        elif roots.get(root) != "reduced":
            roots[root] = kind
    around = {folder for root in roots for folder in (root, *_folders_above(root))}
    inside = set(roots)
    for root, sizes in recorded.items():
        if root not in around and inside.isdisjoint(_folders_above(root)):
            roots[root] = sizes.most_common(1)[0][0]  # a bag beside a map as a point cloud: the larger one
    return roots


def _folders_above(path: str) -> Iterator[str]:
    """Return the folders that a path lies in, the nearest first; "" is the last."""
    while path:
        path = path.rpartition("/")[0]
        yield path


class _Beside:
    """What the layouts keep beside a drive, not in it: calibration of the day, poses of an odometry data set."""

    def __init__(self, listing: Listing) -> None:
        self._listing = listing
        self._calibration: defaultdict[str, list[str]] = defaultdict(list)
        self._poses: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
        for path in listing:
            if match := CALIBRATION_BESIDE.fullmatch(path):
                self._calibration[match["above"] or ""].append(match["place"])
            elif match := KITTI360_BESIDE.fullmatch(path):
                self._poses[match["above"] or "", match["drive"]].append(path)

    def lend(self, drive: ListedDrive) -> None:
        """Give a drive what belongs to it."""
        for level, above in zip((1, 2), _folders_above(drive.root), strict=False):
            front = f"{above}/" if above else ""
            for place in self._calibration[above]:
                if level == 1 or "/" in place:
                    self._give(drive, front + place, place)
            if any(path.startswith("velodyne/") for path in drive.scans):
                self._give(drive, f"{front}poses/{drive.name}.txt", POSE_FILES[0])
            elif drive.kind == "bin":
                self._give_poses(drive, above, front)

    def _give(self, drive: ListedDrive, path: str, inside: str) -> None:
        if path in self._listing and inside not in drive.small:
            drive.small[inside] = path
            drive.borrowed.append(f"{path} is taken {'with it' if path == inside else f'as {inside}'}.")

    def _give_poses(self, drive: ListedDrive, above: str, front: str) -> None:
        """Give it the poses and OXTS that KITTI-360 keeps in folders of their own."""
        counts: Counter[str] = Counter()
        for path in self._poses[above, drive.name]:
            match = KITTI360_BESIDE.fullmatch(path)
            assert match is not None
            inside = f"{KITTI360_POSES}/{drive.name}/{match['place']}"
            if inside not in drive.small:
                drive.small[inside] = path
                counts[match["source"]] += 1
        drive.borrowed += [f"{front}{source}/ is taken with it: {counted(n, 'file')}." for source, n in counts.items()]


_REASONS = (
    (r"[^/]+\.bin", "holds the scans themselves: pick the folder above it"),
    (r"[^/]+\.label", "holds labels only: pick the folder above it"),
    (r"(?i:.*\.(bag|db3|mcap)\.(zst|zstd|gz|lz4))", "holds a bag that is compressed as a whole: unpack it first"),
    (r".*\.bag\.active", "holds a recording that was not ended properly: make a bag of it with rosbag reindex"),
    (r"(?i:.*\.(zip|tar|tgz|tar\.\w+))", "holds an archive: pick the archive itself, or unpack it first"),
    (
        r"(.*/)?data_poses/.*|\d{4}_\d\d_\d\d_drive_\d{4}_sync/(poses|cam0_to_world)\.txt",
        "holds poses but no scans: pick the root of KITTI-360, with data_3d_raw/ in it",
    ),
    (
        rf"(?i:(.*/)?({'|'.join(SCAN_FOLDERS)})/[^/]+\.bin)",
        "holds scans under names in capitals: upper and lower case are told apart; rename them to velodyne/000000.bin",
    ),
    (r".*\.label", "holds labels but no scans: pick the folder that has velodyne/ too"),
    (r"(?i:[^/]*\.osm(\.\w+)?)", "is a map alone: pick the folder of the drive, and choose the map with it"),
)
_EXPECTED = (
    "Expected the folder of one drive: velodyne/000000.bin, labels/000000.label, poses.txt, calib.txt (SemanticKITTI), "
    "velodyne_points/data/ and oxts/ (KITTI raw), PCD files with poses.txt, a ROS bag (.bag, .db3, .mcap), or LAS or "
    "LAZ files with their trajectory."
)


def reason_for_none(listing: Listing, name: str) -> str:
    """Return why there is no drive in a folder."""
    for pattern, reason in _REASONS:
        if any(re.fullmatch(pattern, path) for path in listing):
            return f"{name} {reason}. {_EXPECTED}"
    return f"{name} {'is not a drive' if listing else 'is empty'}. {_EXPECTED}"
