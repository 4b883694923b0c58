"""Where the work on uploads leaves what it made, for the server that takes it from there."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

from interloc.output.layout import file_names

REDUCED = "reduced"
"""Folder of a reduced drive in the folder of the result of a commit."""

TRAJECTORY = tuple(file_names(georeferenced=known)["trajectory"] for known in (True, False))
"""Beside it: the trajectory, with and without georeference."""

UNPACKED = "unpacked"
"""Folder of the files of an archive in the scratch folder."""

LISTING = "unpacked.json"
"""Beside it: a list of their paths, sizes and SHA-256."""


def link(source: Path, target: Path) -> None:
    """Give a file a second name; where the file system cannot, a copy."""
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:
        shutil.copyfile(source, target)


def place_unpacked(files: Path, listing: list[dict[str, Any]], scratch: Path) -> None:
    """Give files and their list the places where the server looks for them; the list comes last, and says that all is.

    Files without a list are those of an attempt that was killed in between.
    """
    listed = files.with_name("listing")
    listed.write_text(json.dumps(listing))
    os.sync()
    shutil.rmtree(scratch / UNPACKED, ignore_errors=True)
    files.rename(scratch / UNPACKED)
    listed.rename(scratch / LISTING)
