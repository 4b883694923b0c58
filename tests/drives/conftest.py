"""Small drives on disk, whole and reduced."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from interloc.config import KeyframeConfig
from interloc.reduction.reduce import reduce_drive
from tests import small_drives


@pytest.fixture(scope="session")
def make() -> ModuleType:
    """Functions that write small drives."""
    return small_drives


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """A sound SemanticKITTI sequence of 12 scans."""
    return small_drives.write_semantickitti(tmp_path / "07")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A sequence of 12 scans, 0.9 m apart and turning little: the scans 0, 3, 6 and 9 are keyframes."""
    return small_drives.write_slow_drive(tmp_path / "07")


@pytest.fixture
def reduced(drive: Path, tmp_path: Path) -> Path:
    """The drive, reduced to its keyframes."""
    reduce_drive(drive, tmp_path / "reduced", keyframes=KeyframeConfig())
    return tmp_path / "reduced"


@pytest.fixture
def edit(reduced: Path) -> Callable[..., None]:
    """Change fields of the manifest."""

    def change(**fields: Any) -> None:
        path = reduced / "reduced.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))

    return change
