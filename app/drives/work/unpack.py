"""Unpacking of an archive: nothing in it is trusted, and nothing of it is kept if anything is wrong."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from app.drives.work.archive_files import ArchiveError, Member, members, too_many_files
from app.paths import BadNameError, check_path
from app.work.documents import FilesOutcome, UnpackJob
from app.work.places import LISTING, UnpackedFile, place_unpacked, read_listing
from app.work.task import Part, Plan, Report, Task
from interloc.drives.kinds import is_recording
from interloc.errors import OutputError
from interloc.osm.container import is_map

_PIECE = 1 << 20
_MB = 1 << 20
_LOOK_BYTES = 64 * _MB
_FREE_RATIO_BYTES = 64 * _MB  # small archives may unpack to this much, whatever their ratio
_FREE_FILES = 10_000  # small archives may hold as many files, whatever their size
_BYTES_PER_FILE = 32  # each further file takes at least this much of an archive, however well it is packed

_SIGNS = re.compile(
    r"(?P<root>(?:.*/)?)"
    r"(?:velodyne/[^/]+\.bin|velodyne_points/data/[^/]+\.bin|(?:labels|predictions)/[^/]+\.label|reduced\.json)"
)
_PARTS = frozenset(
    ["velodyne", "velodyne_points", "labels", "predictions", "oxts", "ground", "georeference", "image_2", "image_3"]
)


def prepare(task: Task[UnpackJob]) -> Plan:
    """Return one part; its units are packed megabytes, because neither files nor contents can be counted before."""
    size = _archive(task).stat().st_size
    return Plan([Part(0, 0, max(1, size // _MB))], max(1, size // _MB))


def run(task: Task[UnpackJob], part: Part, report: Report) -> None:
    """Unpack all files to the scratch folder, with a list of them."""
    if (task.scratch / LISTING).is_file():
        return
    folder = task.scratch / f"unpacking-{task.attempt}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        unpacking = _Unpacking(task, folder, lambda: report(0))
        with members(_archive(task), unpacking.count, unpacking.max_files) as found:
            for member in found:
                unpacking.take(member)
        place_unpacked(folder / "drive", unpacking.sort(), task.scratch)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    report(part.stop - part.start)


def finish(task: Task[UnpackJob], plan: Plan) -> FilesOutcome:
    """Sum up what was unpacked; the server moves the files into the drive."""
    del plan
    listing = read_listing(task.scratch)
    return FilesOutcome(
        files=len(listing),
        size_bytes=sum(file.size_bytes for file in listing),
        archive_bytes=_archive(task).stat().st_size,
    )


def _archive(task: Task[UnpackJob]) -> Path:
    return task.drive / task.request.archive


class _Unpacking:
    """Files unpacked so far, stored under numbers instead of names."""

    def __init__(self, task: Task[UnpackJob], folder: Path, look_up: Callable[[], None]) -> None:
        self._folder = folder
        self._limits = task.settings
        packed_bytes = _archive(task).stat().st_size
        self._max_bytes = min(
            self._limits.max_drive_bytes,
            max(_FREE_RATIO_BYTES, int(packed_bytes * self._limits.max_archive_ratio)),
        )
        self.max_files = min(self._limits.max_drive_files, max(_FREE_FILES, packed_bytes // _BYTES_PER_FILE))
        self._look_up = look_up
        self._files: dict[str, tuple[Path, UnpackedFile]] = {}
        self._unpacked = 0
        self._streamed = 0
        self._looked_at = 0
        self._members = 0

    def count(self, size: int) -> None:
        """Count decompressed bytes, headers and padding included."""
        self._streamed += size
        self._check_size(self._streamed, "the archive")

    def take(self, member: Member) -> None:
        """Unpack a file.

        Raises
        ------
        ArchiveError
            Its name is not valid or comes twice, or there is too much.
        """
        self._members += 1
        if self._members > self.max_files:
            raise too_many_files(self.max_files)
        name = member.name.removeprefix("./")
        if _is_litter(name):
            return
        try:
            check_path(name)
        except BadNameError as error:
            raise ArchiveError(str(error)) from error
        if name in self._files:
            raise ArchiveError(f"{name}: comes twice in the archive. Pack it anew.")
        place = self._folder / str(len(self._files))
        digest = hashlib.sha256()
        size = 0
        with member.open() as source, ExitStack() as stack:
            target: BinaryIO | None = None  # of an empty file nothing is made before the whole archive is known
            while piece := source.read(_PIECE):
                size += len(piece)
                self._unpacked += len(piece)
                self._check_file(name, size)
                self._check_size(self._unpacked, name)
                target = target or stack.enter_context(place.open("xb"))
                target.write(piece)
                digest.update(piece)
        if size != member.size_bytes:
            raise ArchiveError(f"{name}: has {size:,} bytes, not {member.size_bytes:,} as the archive says.")
        self._files[name] = place, UnpackedFile(name, size, digest.hexdigest())

    def sort(self) -> list[UnpackedFile]:
        """Give the files of the drive their names, and return a list of them.

        Raises
        ------
        ArchiveError
            There is nothing in the archive, or two drives, or a name is both file and folder.
        """
        if not self._files:
            raise ArchiveError("the archive holds no files.")
        listing = []
        for name, path in drive_paths(self._files).items():
            place, file = self._files[name]
            target = self._folder / "drive" / path
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                if file.size_bytes:
                    place.rename(target)
                else:
                    target.touch(exist_ok=False)
            except OSError as error:
                raise ArchiveError(f"{name}: is a file and a folder in the archive. Pack it anew.") from error
            listing.append(replace(file, path=path))
        return listing

    def _check_file(self, name: str, size: int) -> None:
        limit = self._limits.max_recording_bytes if is_recording(name) else self._limits.max_file_bytes
        if size > limit:
            raise ArchiveError(f"{name}: is larger than {limit / _MB:,.0f} MB, the limit of a file.")

    def _check_size(self, size: int, name: str) -> None:
        """Refuse what unpacks to too much; check from time to time for free space and for a cancelled job."""
        if size > self._max_bytes:
            raise ArchiveError(
                f"{name}: the archive unpacks to more than {self._max_bytes / _MB:,.0f} MB, the limit for a drive or "
                f"{self._limits.max_archive_ratio:g} times its own size. Send the files one by one instead."
            )
        if self._unpacked + self._streamed - self._looked_at > _LOOK_BYTES:
            self._looked_at = self._unpacked + self._streamed
            self._look_up()
            if shutil.disk_usage(self._folder).free < self._limits.min_free_bytes:
                raise OutputError("the disk of the service is full. Nothing of the archive was kept.")


def _is_litter(name: str) -> bool:
    """Return whether a file was put into the archive by a file manager: hidden files, metadata of other systems."""
    segments = name.split("/")
    hidden = any(segment.startswith(".") and segment not in {".", ".."} for segment in segments)
    return (hidden and not {"", ".", ".."} & set(segments)) or segments[0] == "__MACOSX" or segments[-1] == "Thumbs.db"


def drive_paths(names: Collection[str]) -> dict[str, str]:
    """Find the drive among the files of an archive, by their paths.

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
            f"{' and more' if len(roots) > 2 else ''}. Pack one drive per archive, and make a drive for each."
        )
    if roots:
        return roots[0]
    first = {name.split("/", 1)[0] for name in names}
    folder = first.pop() if len(first) == 1 else ""
    is_packed = folder not in _PARTS and all("/" in name for name in names)
    return f"{folder}/" if folder and is_packed else ""
