"""Drives in object storage: found by listing a prefix, and fetched to be read like those in folders."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from interloc import storage
from interloc.errors import DriveError, InterLocError
from interloc.reduction.listing import ListedDrive, find_drives, reason_for_none
from interloc.storage import MAX_OBJECTS, Bucket, StoredObject

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
