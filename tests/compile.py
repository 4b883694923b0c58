"""Run the kernels once: numba compiles them, and keeps what it has compiled for the processes to come."""

from __future__ import annotations

import tempfile
from pathlib import Path

from interloc.config import preset
from interloc.drives.open import open_drive
from interloc.pipeline import detect
from interloc.simulate.town import simulate_town

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        simulate_town(Path(folder) / "town", part="small")
        for name in ("default", "paper"):
            detect(open_drive(Path(folder) / "town"), preset(name))
