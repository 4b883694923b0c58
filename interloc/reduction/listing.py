"""Which drives a folder holds, and which of its files belong to each, told from a listing: paths and sizes."""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from interloc import storage
from interloc.drives.formats import FORMATS
from interloc.drives.layouts import (
    CALIBRATION_BESIDE,
    KINDS,
    KITTI360_BESIDE,
    KITTI360_POSES,
    POSE_FILES,
    SIGNS,
    Kind,
    usual_mistake,
)
from interloc.errors import DriveError, InterLocError
from interloc.storage import MAX_OBJECTS, Bucket, StoredObject
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
    """Return the folders of the drives; one with .bin files or a manifest has what lies in it, and clouds around it."""
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
    around = {folder for root in roots for folder in _folders_above(root)}
    inside = set(roots)
    for root, sizes in recorded.items():
        kind = sizes.most_common(1)[0][0]  # a bag beside a map as a point cloud: the larger one
        if inside.isdisjoint((root, *_folders_above(root))) and (kind == "rosbag" or root not in around):
            roots[root] = kind
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


def reason_for_none(listing: Listing, name: str) -> str:
    """Return why there is no drive in a folder."""
    reason = usual_mistake(listing) or ("is not a drive" if listing else "holds no scans")
    if listing and all(".osm" in path.lower() for path in listing):
        reason = "is a map alone: give the folder of the drive, and choose the map with it"
    return f"{name} {reason}. Expected the folder of one drive: {', or '.join(each.expected for each in FORMATS)}."


# Drives in object storage: found by listing a prefix, and fetched to be read like those in folders


_RESULTS = ("run.json", "city.json")
_FOLDERS_BESIDE = ("calibration", "data_poses/{name}", "data_poses_oxts/{name}")


def find_stored(address: str, limit: int = MAX_OBJECTS) -> tuple[Bucket, dict[str, StoredObject], list[ListedDrive]]:
    """Find the drives below a prefix; return also the bucket, and what was listed, by path below the prefix."""
    bucket, key = Bucket.of(address)
    listing = {each.key[len(key) + 1 if key else 0 :]: each for each in bucket.below(key, limit)}
    if not listing:
        raise DriveError(f"{address} holds no objects. Expected the prefix of a drive. Usual cause: a mistyped name.")
    name = key.rpartition("/")[2] or bucket.url.rpartition("/")[2]
    return bucket, listing, find_drives({path: each.size for path, each in listing.items()}, name)


def fetch_drive(
    address: str,
    folder: Path | None = None,
    *,
    within: Sequence[str] = (),
    limit: int = MAX_OBJECTS,
    check_sizes: Callable[[dict[str, int]], None] = lambda _: None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Path:
    """Fetch a drive, a result, or a single file of object storage: what its listing says that it needs.

    The address is s3://bucket/prefix of a drive, or the key of a file; the folder a temporary one of this process by
    default. What was fetched there before is taken up again. Nothing beside the drive may be taken from outside of the
    prefixes `within`; `limit` is that of objects below the prefix; `check_sizes` refuses a drive by the sizes of its
    files before anything is read; `progress` is called with the bytes fetched, and with all of them. Returns the
    folder, or the file.
    """
    bucket, key = Bucket.of(address)
    single = bucket.head(key) if key else None
    name = key.rpartition("/")[2]
    objects = _drive_at(bucket, key, address, within, limit) if single is None else {name: single}
    check_sizes({path: each.size for path, each in objects.items()})
    place = folder or storage.temporary_folder()
    path = place / next(iter(objects)).partition("/")[0]
    if folder is None:
        storage.show_as(path, address.rstrip("/"))
    storage.fetch(bucket, objects, place, progress)
    return path


def _drive_at(bucket: Bucket, key: str, address: str, within: Sequence[str], limit: int) -> dict[str, StoredObject]:
    """Return the objects that belong to the drive at a prefix, by path in a folder above it."""
    _, below, drives = find_stored(address, limit)
    if not drives and any(marker in below for marker in _RESULTS):
        name = key.rpartition("/")[2] or "result"
        return {f"{name}/{path}": each for path, each in below.items()}
    if len(drives) != 1:
        names = ", ".join(drive.root or drive.name for drive in drives[:5])
        raise DriveError(
            f"{address}: {reason_for_none({path: each.size for path, each in below.items()}, 'it')}"
            if not drives
            else f"{address} holds {len(drives)} drives ({names}{', ...' if len(drives) > 5 else ''}). Give one of "
            "them, or all to `interloc batch`."
        )
    root = "/".join(filter(None, (key, drives[0].root)))
    listing = {each.key: each for each in (*_beside(bucket, root, within), *below.values())}
    (drive,) = (
        each
        for each in find_drives({path: each.size for path, each in listing.items()}, drives[0].name)
        if each.root == root
    )
    name = root.rpartition("/")[2] or drive.name
    return {f"{name}/{inside}": listing[path] for inside, path in drive.files.items()}


def _beside(bucket: Bucket, root: str, within: Sequence[str]) -> list[StoredObject]:
    """Return what the layouts keep beside a drive: calibration, and poses of a whole data set; what can be listed."""
    above, name = root.rpartition("/")[0], root.rpartition("/")[2]
    places = [place for place in dict.fromkeys((above, above.rpartition("/")[0])) if place != root]
    places = [place for place in places if not within or storage.is_within(f"{bucket.url}/{place}", within)]
    folders = [f"{place}/{each}".strip("/") for place in places for each in _FOLDERS_BESIDE]

    def below(folder: str) -> list[StoredObject]:
        with suppress(InterLocError):  # not everybody may list what lies beside
            return bucket.below(folder.format(name=name))
        return []

    def directly(place: str) -> list[StoredObject]:
        with suppress(InterLocError):
            there = [*bucket.directly_below(place), *bucket.directly_below(f"{place}/poses".strip("/"))]
            return [each for each in there if re.search(rf"(^|/)(calib[^/]*|poses/{re.escape(name)})\.txt$", each.key)]
        return []

    found = [*storage.in_parallel(below, folders), *storage.in_parallel(directly, places)]
    return [each for some in found for each in some]
