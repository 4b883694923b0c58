"""Where the bytes are kept: a folder behind a small interface, so that a storage of objects can follow.

Keys are paths below one root: ``drives/<id>/files/...`` (as uploaded), ``drives/<id>/reduced/...`` (what jobs read),
``jobs/<id>/scratch/...`` (checkpoints, progress), ``jobs/<id>/result/...``. The library reads and writes folders, so a
storage can show a key as one (`Storage.folder`); a storage of objects would do so by a local copy.
"""

from __future__ import annotations

import os
import secrets
import shutil
from contextlib import suppress
from pathlib import Path

from interloc.errors import InterLocError


class Storage:
    """A folder on this machine, or on a file system that all servers and workers mount at the same place."""

    def __init__(self, root: Path) -> None:
        self.root = Path(os.path.realpath(root))

    def folder(self, key: str) -> Path:
        """Return the folder of a key, for code that works on folders; it need not exist."""
        path = Path(os.path.normpath(self.root / key))
        if not path.is_relative_to(self.root) or path == self.root:
            raise InterLocError(f"{key!r} leads out of the data folder")
        return path

    def delete(self, key: str) -> None:
        """Remove a file or a folder with all that is in it; nothing happens where there is none."""
        path = self.folder(key)
        if path.is_dir() and not path.is_symlink():
            # Renamed first: what is half deleted must not be found under its name.
            doomed = self.root / "incoming" / secrets.token_hex(12)
            doomed.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileNotFoundError):
                path.replace(doomed)
                shutil.rmtree(doomed, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def free_bytes(self) -> int:
        """Return the space that is left."""
        self.root.mkdir(parents=True, exist_ok=True)
        return shutil.disk_usage(self.root).free
