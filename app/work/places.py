"""Names of the files through which a worker hands its result to the server."""

import json
import os
import shutil
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from interloc.output.layout import file_names

REDUCED = "reduced"
"""Folder of the reduced drive in the result of a commit, and in the folder of a drive."""

TRAJECTORY = tuple(file_names(georeferenced=known)["trajectory"] for known in (True, False))
"""Names of the trajectory beside it, with and without georeference."""

UNPACKED = "unpacked"
"""Folder of unpacked files in the scratch folder."""

LISTING = "unpacked.json"
"""File beside it that lists their paths, sizes and SHA-256."""


def link(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no links."""
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:
        shutil.copyfile(source, target)


@dataclass(frozen=True)
class UnpackedFile:
    """A file below `UNPACKED`, as `LISTING` names it."""

    path: str
    size_bytes: int
    sha256: str


def read_listing(scratch: Path) -> list[UnpackedFile]:
    """Return the files that `place_unpacked` has placed."""
    return [UnpackedFile(**file) for file in json.loads((scratch / LISTING).read_text())]


def place_unpacked(files: Path, listing: Iterable[UnpackedFile], scratch: Path) -> None:
    """Move files and their list to where the server expects them; the list comes last and marks them as complete.

    Files without a list are those of an attempt that was killed in between.
    """
    listed = files.with_name("listing")
    listed.write_text(json.dumps([asdict(file) for file in listing]))
    os.sync()
    shutil.rmtree(scratch / UNPACKED, ignore_errors=True)
    files.rename(scratch / UNPACKED)
    listed.rename(scratch / LISTING)
