"""A bag: one file or several, and the topics in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.scans.rosbag.files import (
    CHUNK_START,
    HEAD_BYTES,
    MAX_BYTES,
    OFFSET,
    Channel,
    channels_of,
    locate,
    read_messages,
)
from interloc.drives.scans.rosbag.messages import Encoding, WireError
from interloc.errors import install

SUFFIXES = (".bag", ".db3", ".mcap")

Decoded = TypeVar("Decoded")

_COMPRESSED = re.compile(r".*\.(bag|db3|mcap)\.(zst|zstd|gz|bz2|xz|lz4)")
_PART = re.compile(r"(_\d{4}(-\d\d){5})?_\d+$")  # of a bag that was split while it was recorded
_METADATA = "metadata.yaml"


@dataclass(frozen=True)
class BagTopic:
    """All messages of a topic, in the order in which they lie in the files; they are indexed when asked for."""

    name: str
    type: str
    bag_files: tuple[SourceFile, ...]
    channels: tuple[tuple[int, Channel], ...]
    """By the numbers of the files that they lie in."""

    def __len__(self) -> int:
        counts = [channel.count for _, channel in self.channels]
        return len(self.log_ns) if None in counts else sum(filter(None, counts))

    @property
    def encoding(self) -> Encoding | None:
        """Of the messages; None where it is not known."""
        encodings = {channel.encoding for _, channel in self.channels}
        return encodings.pop() if len(encodings) == 1 else None

    @cached_property
    def _index(self) -> IntArray:
        """(N, 6): file, time of recording and place of every message."""
        pieces = []
        for number, channel in self.channels:
            rows = locate(self.bag_files[number], channel)
            pieces.append(np.column_stack([np.full(len(rows), number), rows]))
        index = np.concatenate(pieces)
        return index[np.lexsort((index[:, 2 + OFFSET], index[:, 2 + CHUNK_START], index[:, 0]))]

    @property
    def files(self) -> IntArray:
        """(N,) int64: which file of the bag each lies in."""
        return self._index[:, 0]

    @property
    def log_ns(self) -> IntArray:
        """(N,) int64: when each was recorded, nanoseconds."""
        return self._index[:, 1]

    @property
    def places(self) -> IntArray:
        """(N, 4) int64: where it lies there."""
        return self._index[:, 2:]

    def messages(self, limit: int = MAX_BYTES) -> Iterator[bytes]:
        """Read the messages, or the beginning of each."""
        for number in np.unique(self.files):
            yield from read_messages(self.bag_files[number], self.places[self.files == number], limit)


@dataclass(frozen=True)
class Bag:
    """The files of a bag, and its topics by name."""

    files: tuple[SourceFile, ...]
    topics: list[BagTopic]

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

    def decoded(
        self, topic: BagTopic, decode: Callable[[bytes, Encoding], Decoded], *, heads: bool = False
    ) -> Iterator[Decoded]:
        """Yield what a function makes of every message of a topic, or of its beginning."""
        assert topic.encoding is not None
        for number, message in enumerate(topic.messages(HEAD_BYTES if heads else MAX_BYTES)):
            try:
                found = decode(message, topic.encoding)
            except WireError as error:
                raise self.fault(f"{topic.name}, message {number}: {error}.") from error
            yield found


def open_bag(files: tuple[SourceFile, ...], findings: Findings) -> Bag:
    """Read which topics are in a bag."""
    if missing := [name for name in ("rosbags", "mcap") if find_spec(name) is None]:
        raise files[0].fault(f"needs the package {missing[0]} to be read. Install it with: {install('ros')}")
    topics: dict[tuple[str, str], list[tuple[int, Channel]]] = {}
    for number, file in enumerate(files):
        for channel in channels_of(file):
            topics.setdefault((channel.topic, channel.type), []).append((number, channel))
    if not all(channel.defined for channels in topics.values() for _, channel in channels):
        findings.note(
            files[0].name,
            "holds no definitions of its message types (usual for bags of before ROS 2 Iron); the standard ones are "
            "used, which are the same from ROS 2 Foxy to Kilted for all that is read.",
        )
    return Bag(files, [BagTopic(*key, files, tuple(channels)) for key, channels in sorted(topics.items())])


def find_bag(root: Path, *, required: bool, findings: Findings) -> tuple[SourceFile, ...] | None:
    """Find the files of the bag that a path leads to, a file or a folder with one bag; None where there is none."""
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
    parts = [other for other in path.parent.glob(f"*{path.suffix}") if _whole_name(other) == _whole_name(path)]
    if len(parts) > 1 and _PART.search(path.stem):
        findings.note(
            file.name, f"is one of {len(parts)} files of a bag; only this one is read. Give the folder to read all."
        )
    return (file,)


def _whole_name(path: Path) -> str:
    return _PART.sub("", path.stem)


def _refuse_packed(paths: list[Path], root: Path) -> None:
    for path in paths:
        if _COMPRESSED.fullmatch(path.name):
            tool = {"zst": "zstd", "zstd": "zstd", "gz": "gzip"}.get(path.suffix[1:], path.suffix[1:])
            raise SourceFile(path, root).fault(
                f"is compressed as a whole, so that single messages cannot be read from it. Unpack it first: "
                f"`{tool} -d {path.name}`" + (f" (or `unzstd {path.name}`)." if tool == "zstd" else ".")
            )
        if path.name.endswith(".bag.active"):
            raise SourceFile(path, root).fault(
                "is a recording of ROS 1 that was not ended properly. Make a bag of it with `rosbag reindex`, "
                "and give it a name that ends in .bag."
            )


def _in_folder(folder: Path, findings: Findings) -> list[Path]:
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
    if len({(_whole_name(path), path.suffix) for path in bags}) > 1:
        names = ", ".join(path.name for path in bags[:5])
        raise DriveFileError(
            str(folder),
            f"holds several bags ({names}{' ...' if len(bags) > 5 else ''}). Expected one drive: give one of them.",
        )
    pieces = {path: re.split(r"(\d+)", path.name) for path in bags}  # part 10 comes after part 9
    return sorted(bags, key=lambda path: [int(piece) if piece.isdigit() else piece for piece in pieces[path]])


def _named_by_metadata(path: Path) -> list[str]:
    """Return the names of the files that a metadata.yaml lists, unpacked names where these are there; none if unread.

    Nothing else in it is needed, so a file of a newer or older version, or one that was cut short, does no harm.
    """
    try:
        with path.open("rb") as file:
            text = file.read(16 * 1024 * 1024).decode("utf-8", "replace")
    except OSError:
        return []
    block = re.search(r"relative_file_paths:[^\S\n]*\n((?:\s*-\s*[^\n]+\n?)+)", text)
    names = []
    for line in block.group(1).splitlines() if block else []:
        name = line.strip().removeprefix("-").strip().strip("'\"").replace("\\", "/").rsplit("/", 1)[-1]
        bare = re.sub(r"\.(zst|zstd)$", "", name)
        is_unpacked = not (path.parent / name).is_file() and (path.parent / bare).is_file()
        if name and not name.startswith("."):
            names.append(bare if is_unpacked else name)
    return names
