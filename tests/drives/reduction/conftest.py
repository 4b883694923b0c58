"""Small drives, reduced."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from interloc.config import KeyframeConfig
from interloc.drives.reduction.reduce import reduce_drive


@pytest.fixture
def drive(tmp_path: Path, make: ModuleType) -> Path:
    """A sequence of 12 scans, 0.9 m apart and turning little: the scans 0, 3, 6 and 9 are keyframes."""
    root: Path = make.write_semantickitti(tmp_path / "07", poses=make.lidar_poses(step_m=0.9, turn_rad=0.01))
    (root / "geo.csv").write_text(make.geo_csv(make.lidar_poses(step_m=0.9, turn_rad=0.01)))
    return root


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
