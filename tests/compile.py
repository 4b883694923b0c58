"""Run the kernels once: numba compiles them, and keeps what it has compiled for the processes to come."""

from __future__ import annotations

import tempfile
from pathlib import Path

from interloc.config import preset
from interloc.drives.open import open_drive
from interloc.pipeline import detect
from tests.app.street import write_street

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        drive = open_drive(write_street(Path(folder) / "street", 40))
        for name in ("default", "paper"):
            detect(drive, preset(name))
