"""A street with one crossing, driven once: as a drive, georeferenced, and what `detect` finds on it."""

from contextlib import chdir

import pytest

from interloc.config import DetectorConfig, preset
from interloc.drives.folder import FolderDrive
from interloc.drives.open import open_drive
from tests.crossing import write_drive


@pytest.fixture(scope="session")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> FolderDrive:
    folder = tmp_path_factory.mktemp("live")
    with chdir(folder):
        write_drive(folder / "street", folder / "raw")
    return open_drive(folder / "street", oxts=folder / "raw", pose_frame="lidar", label_scheme="40")


@pytest.fixture(scope="session")
def config() -> DetectorConfig:
    return preset("default", "keyframes.lookahead=6")
