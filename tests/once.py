"""What many tests read and none changes, made once: also where several processes run the tests."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from filelock import FileLock

from interloc.arrays import IntArray
from interloc.drives import open as opening
from interloc.drives.findings import Finding, Findings
from interloc.drives.folder import FolderDrive


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a path of this name; the first who asks for it has it made, the others wait for that."""
    base = factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "once"
    root.mkdir(exist_ok=True)
    place, done = root / name, root / f"{name}.done"
    with FileLock(root / f"{name}.lock"):
        if not done.exists():
            make(place)
            done.touch()
    return place


@contextmanager
def motion_looked_at_once(*shared: Path) -> Iterator[None]:
    """Lay the scans of drives that nobody changes onto each other once: it takes most of the time to open them."""
    roots = {root.resolve() for root in shared}
    look, noted = opening.check_scan_motion, dict[tuple[Path, bytes, bytes], list[Finding]]()

    def check(drive: FolderDrive, usable: IntArray, pose_file: str, findings: Findings) -> None:
        key = drive.root.resolve(), drive.T_world_lidar.tobytes(), usable.tobytes()
        if key in noted:
            findings.found += [each for each in noted[key] if each not in findings.found]
            return
        before = list(findings.found)
        look(drive, usable, pose_file, findings)
        found = [each for each in findings.found if each not in before]
        if key[0] in roots and all(each.severity == "note" for each in found):  # others are logged, too
            noted[key] = found

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(opening, "check_scan_motion", check)
        yield
