"""A bag: one file or several, and the topics in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.scans.rosbag import db3, mcap, ros1
from interloc.drives.scans.rosbag.chunks import MAX_MESSAGE_BYTES, ZSTD_MAGIC, unpacked
from interloc.drives.scans.rosbag.index import CHUNK_START, OFFSET, BagIndex, reading
from interloc.drives.scans.rosbag.wire import Encoding, WireError
from interloc.errors import install

SUFFIXES = (".bag", ".db3", ".mcap")

Decoded = TypeVar("Decoded")

_INDEX: dict[str, Callable[[SourceFile], BagIndex]] = {
    ".bag": ros1.index_ros1,
    ".db3": db3.index_db3,
    ".mcap": mcap.index_mcap,
}
_READ_MESSAGES: dict[str, Callable[[Path, IntArray, int], Iterator[bytes]]] = {
    ".bag": ros1.read_messages,
    ".db3": db3.read_messages,
    ".mcap": mcap.read_messages,
}
_COMPRESSED = re.compile(r".*\.(bag|db3|mcap)\.(zst|zstd|gz|bz2|xz|lz4)")
_ACTIVE = ".bag.active"
_PART = re.compile(r"(_\d{4}(-\d\d){5})?_\d+$")  # of a bag that was split while it was recorded
_METADATA = "metadata.yaml"
_MAX_METADATA_BYTES = 16 * 1024 * 1024
_HEAD_BYTES = 4096


@dataclass(frozen=True)
class BagTopic:
    """All messages of a topic, in the order in which they lie in the files."""

    name: str
    type: str
    encoding: Encoding | None
    """{"ros1", "cdr"} or None: none where it is not known."""
    log_ns: IntArray
    """(N,) int64: when each was recorded."""
    files: IntArray
    """(N,) int64: which file of the bag each lies in."""
    places: IntArray
    """(N, 4) int64: where it lies there."""

    def __len__(self) -> int:
        return len(self.log_ns)


@dataclass(frozen=True)
class Bag:
    """The files of a bag, and what is in them."""

    files: tuple[SourceFile, ...]
    topics: list[BagTopic]
    """By name."""

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.files[0].name if len(self.files) == 1 else f"{self.files[0].name} ... {self.files[-1].name}"

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.path.stat().st_size for file in self.files)

    def fault(self, message: str) -> DriveFileError:
        """Return the error to raise about it: what was found, what was expected, the usual cause."""
        return DriveFileError(self.name, message)

    def messages(self, topic: BagTopic) -> Iterator[bytes]:
        """Read the messages of a topic, in the order in which they lie in the files.

        Raises
        ------
        DriveError
            A file is damaged.
        """
        for number in np.unique(topic.files):
            yield from read_messages(self.files[number], topic.places[topic.files == number])

    def heads(self, topic: BagTopic) -> Iterator[bytes]:
        """Read only the beginning of every message of a topic; for the rest as `messages`."""
        for number in np.unique(topic.files):
            places = topic.places[topic.files == number]
            file = self.files[number]
            for place, head in zip(places, read_messages(file, places, _HEAD_BYTES), strict=True):
                if head.startswith(ZSTD_MAGIC):
                    yield next(read_messages(file, place[None]))
                else:
                    yield head

    def decoded(
        self, topic: BagTopic, decode: Callable[[bytes, Encoding], Decoded], *, heads: bool = False
    ) -> Iterator[Decoded]:
        """Yield what a function makes of every message of a topic, or of its beginning.

        Raises
        ------
        DriveError
            A file or a message is damaged.
        """
        assert topic.encoding is not None
        for number, message in enumerate((self.heads if heads else self.messages)(topic)):
            try:
                found = decode(message, topic.encoding)
            except WireError as error:
                raise self.fault(f"{topic.name}, message {number}: {error}.") from error
            yield found


def read_messages(file: SourceFile, places: IntArray, limit: int = MAX_MESSAGE_BYTES) -> Iterator[bytes]:
    """Read messages of one file of a bag, unpacked where they were compressed one by one.

    Raises
    ------
    DriveError
        The file is damaged.
    """
    with reading(file):
        for message in _READ_MESSAGES[file.path.suffix](file.path, places, limit):
            yield unpacked(message) if limit == MAX_MESSAGE_BYTES else message


def find_bag(root: Path, *, required: bool, findings: Findings) -> tuple[SourceFile, ...] | None:
    """Find the files of the bag that a path leads to; None where there is none.

    Parameters
    ----------
    root : Path
        A file of a bag; or a folder with one bag in it, in one file or in several.
    required : bool
        The user says that it is one.

    Raises
    ------
    DriveError
        There are several bags, or the one there is compressed as a whole.
    """
    if root.is_file():
        return _lone_file(root, findings, required=required)
    if not root.is_dir():
        return None
    found = _in_folder(root, findings)
    if not found:
        inner = [folder for folder in sorted(root.iterdir()) if (folder / _METADATA).is_file()]
        if len(inner) == 1:
            found = _in_folder(inner[0], findings)
    if not found and required:
        raise DriveFileError(str(root), "holds no bag. Expected a .bag, .db3 or .mcap file, or the folder of one.")
    return tuple(SourceFile(path, root) for path in found) or None


def _lone_file(path: Path, findings: Findings, *, required: bool) -> tuple[SourceFile, ...] | None:
    file = SourceFile(path, path.parent)
    _refuse_packed([path], path.parent)
    if path.suffix not in SUFFIXES:
        if required:
            raise file.fault("is not a bag by its name. Expected .bag (ROS 1), .db3 or .mcap (ROS 2).")
        return None
    stem = _PART.sub("", path.stem)
    others = [
        other for other in path.parent.glob(f"*{path.suffix}") if other != path and _PART.sub("", other.stem) == stem
    ]
    if others and _PART.search(path.stem):
        findings.note(
            file.name,
            f"is one of {len(others) + 1} files of a bag; only this one is read. Give the folder to read all.",
        )
    return (file,)


def _refuse_packed(paths: list[Path], root: Path) -> None:
    """Refuse bags that are compressed as a whole, or still open."""
    for path in paths:
        if _COMPRESSED.fullmatch(path.name):
            tool = {"zst": "zstd", "zstd": "zstd", "gz": "gzip"}.get(path.suffix[1:], path.suffix[1:])
            raise SourceFile(path, root).fault(
                f"is compressed as a whole, so that single messages cannot be read from it. Unpack it first: "
                f"`{tool} -d {path.name}`" + (f" (or `unzstd {path.name}`)." if tool == "zstd" else ".")
            )
        if path.name.endswith(_ACTIVE):
            raise SourceFile(path, root).fault(
                "is a recording of ROS 1 that was not ended properly. Make a bag of it with `rosbag reindex`, "
                "and give it a name that ends in .bag."
            )


def _in_folder(folder: Path, findings: Findings) -> list[Path]:
    """Return the files of the one bag in a folder, in order; none where there is no bag."""
    entries = sorted(entry for entry in folder.iterdir() if entry.is_file() and not entry.name.startswith("."))
    bags = [entry for entry in entries if entry.suffix in SUFFIXES]
    if (folder / _METADATA).is_file() and (named := _named_by_metadata(folder / _METADATA)):
        there = [folder / name for name in named if (folder / name).is_file()]
        if missing := [name for name in named if not (folder / name).is_file()]:
            if bags and not there:
                _refuse_packed([folder / name for name in missing if _COMPRESSED.fullmatch(name)], folder)
            findings.warning(
                _METADATA, f"names {len(named)} files, of which {len(missing)} are not here: {', '.join(missing[:5])}."
            )
        _refuse_packed(there, folder)
        bags = [path for path in there if path.suffix in SUFFIXES] or bags
    elif not bags:
        _refuse_packed(entries, folder)
    if len({(_PART.sub("", path.stem), path.suffix) for path in bags}) > 1:
        names = ", ".join(path.name for path in bags[:5])
        raise DriveFileError(
            str(folder),
            f"holds several bags ({names}{' ...' if len(bags) > 5 else ''}). Expected one drive: give one of them.",
        )
    return sorted(bags, key=_natural)


def _natural(path: Path) -> list[Any]:
    """Return what sorts part 10 after part 9."""
    return [int(piece) if piece.isdigit() else piece for piece in re.split(r"(\d+)", path.name)]


def _named_by_metadata(path: Path) -> list[str]:
    """Return the names of the files that a metadata.yaml lists, unpacked names where these are there; none if unread.

    Nothing else in it is needed, so a file of a newer or older version, or one that was cut short, does no harm.
    """
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_METADATA_BYTES).decode("utf-8", "replace")
    except OSError:
        return []
    block = re.search(r"relative_file_paths:[^\S\n]*\n((?:\s*-\s*[^\n]+\n?)+)", text)
    lines = block.group(1).splitlines() if block else []
    names = [
        line.strip().removeprefix("-").strip().strip("'\"").replace("\\", "/").rsplit("/", 1)[-1] for line in lines
    ]
    inside = path.parent
    return [
        bare
        if not (inside / name).is_file() and (inside / (bare := re.sub(r"\.(zst|zstd)$", "", name))).is_file()
        else name
        for name in names
        if name and not name.startswith(".")
    ]


def open_bag(files: tuple[SourceFile, ...], findings: Findings) -> Bag:
    """Read which topics are in a bag, and where their messages lie.

    Raises
    ------
    DriveError
        A file is damaged beyond use, or rosbags is missing.
    """
    if find_spec("rosbags") is None:
        raise files[0].fault(f"needs the package rosbags to be read. Install it with: {install('ros')}")
    parts: dict[tuple[str, str], list[tuple[int, Any]]] = {}
    undefined = 0
    for number, file in enumerate(files):
        index = _INDEX[file.path.suffix](file)
        if index.damage:
            last_ns = max((int(each.log_ns.max()) for each in index.channels if len(each.log_ns)), default=0)
            first_ns = min((int(each.log_ns.min()) for each in index.channels if len(each.log_ns)), default=0)
            count = sum(len(each.log_ns) for each in index.channels)
            findings.warning(
                file.name,
                f"is damaged: {index.damage}. {count:,} messages over {(last_ns - first_ns) / 1e9:.1f} s before that "
                "were found, and are used. Usual cause: a recording that was not ended properly.",
            )
        for channel in index.channels:
            undefined += not channel.defined
            parts.setdefault((channel.topic, channel.type), []).append((number, channel))
    if undefined:
        findings.note(
            files[0].name,
            "holds no definitions of its message types (usual for bags of before ROS 2 Iron); the standard ones are "
            "used, which are the same from ROS 2 Foxy to Kilted for all that is read.",
        )
    topics = []
    for (name, kind), channels in sorted(parts.items()):
        file_numbers = np.concatenate([np.full(len(each.log_ns), number) for number, each in channels])
        log_ns = np.concatenate([each.log_ns for _, each in channels])
        places = np.concatenate([each.places for _, each in channels])
        order = np.lexsort((places[:, OFFSET], places[:, CHUNK_START], file_numbers))
        encodings = {each.encoding for _, each in channels}
        topics.append(
            BagTopic(
                name,
                kind,
                encodings.pop() if len(encodings) == 1 else None,
                log_ns[order],
                file_numbers[order].astype(np.int64),
                places[order],
            )
        )
    return Bag(files, topics)
