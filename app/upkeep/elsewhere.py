"""A copy of backups in object storage: what a folder of backups holds, brought to a prefix, and fetched from there."""

from __future__ import annotations

from pathlib import Path

from app.upkeep.backup import LOCK, RECORD
from app.upkeep.generations import find_generation
from app.upkeep.transfer import PARTIAL
from interloc import storage
from interloc.errors import ConfigError
from interloc.storage import Bucket, StoredObject


def bring(out: Path, address: str) -> tuple[int, int]:
    """Make a prefix hold what a folder of backups holds; return how many files and bytes were brought.

    An object counts as brought if it has the size of its file and is no older. Records of what changes go first and
    come last: what was brought half is no complete backup, and the next call goes on from there.

    Parameters
    ----------
    out
        A backup, or generations of them.
    address
        s3://bucket/prefix, gs://bucket/prefix or az://container/prefix.

    Raises
    ------
    ConfigError
        It is no such address, or something else lies there.
    NetworkError, OutputError
        It cannot be listed or written.
    """
    bucket, key, there = _list(address)
    if there and not any(map(_is_record, there)):
        raise ConfigError(
            f"{address} holds {len(there):,} objects, and no backup. They were not touched. Give a new prefix."
        )
    files = {
        name: path
        for path in out.rglob("*")
        if path.is_file() and not {LOCK, PARTIAL} & {*(name := path.relative_to(out).as_posix()).split("/")[:2]}
    }
    new = [name for name, path in files.items() if not _is_same(path, there.get(name))]
    gone = [name for name in there if name not in files]
    bucket.delete([f"{key}/{name}" for name in (*new, *gone) if _is_record(name) and name in there])
    for is_record in (False, True):
        chosen = [name for name in new if _is_record(name) is is_record]
        list(storage.in_parallel(lambda name: bucket.put(f"{key}/{name}", files[name]), chosen))
    bucket.delete([f"{key}/{name}" for name in gone if not _is_record(name)])
    return len(new), sum(files[name].stat().st_size for name in new)


def fetch(address: str, generation: str | None) -> Path:
    """Fetch a backup into a temporary folder, which goes when the process ends.

    Parameters
    ----------
    address
        As of `bring`.
    generation
        Which of several, or how its name begins; None is the newest.

    Raises
    ------
    ConfigError
        There is no such backup, or it is no such address.
    NetworkError
        It cannot be read.
    """
    bucket, _, there = _list(address)
    if not any(map(_is_record, there)):
        raise ConfigError(f"{address} holds no backup. Expected {RECORD} there. Usual cause: a mistyped prefix.")
    place = storage.temporary_folder() / "backup"
    storage.show_as(place, address.rstrip("/"))
    storage.fetch(bucket, {name: each for name, each in there.items() if _is_record(name)}, place)
    chosen = find_generation(place, generation)
    storage.fetch(bucket, {name: each for name, each in there.items() if (place / name).is_relative_to(chosen)}, place)
    return chosen


def _list(address: str) -> tuple[Bucket, str, dict[str, StoredObject]]:
    bucket, key = Bucket.of(address)
    if not key or bucket.url.startswith("https://"):
        raise ConfigError(f"{address}: backups lie in s3://bucket/prefix, gs://... or az://..., not there.")
    return bucket, key, {each.key[len(key) + 1 :]: each for each in bucket.below(key)}


def _is_record(name: str) -> bool:
    return name == RECORD or (name.count("/") == 1 and name.endswith(f"/{RECORD}"))


def _is_same(path: Path, there: StoredObject | None) -> bool:
    found = path.stat()
    return there is not None and there.size == found.st_size and there.modified_s > found.st_mtime + 1
