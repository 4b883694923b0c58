"""A piece of a real drive, and what is found in it: made once, for tests that write it in other forms."""

from pathlib import Path

import pytest

from interloc.drives.folder import FolderDrive
from interloc.drives.open import open_drive
from interloc.pipeline import detect
from interloc.results import DriveResult

_SCANS = 22


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory) -> FolderDrive:
    """The beginning of a real drive, which passes intersections; nothing in it may be changed."""
    whole = Path(__file__).resolve().parents[2] / "shared" / "data" / "kitti360_0009"
    if not whole.exists():
        pytest.skip("real data not here: kitti360_0009")
    root = tmp_path_factory.mktemp("sample") / "beginning"
    for name in ("velodyne/{:06d}.bin", "labels/{:06d}.label"):
        (root / name).parent.mkdir(parents=True)
        for frame in range(_SCANS):
            (root / name.format(frame)).symlink_to(whole / name.format(frame))
    for name, lines in (("poses.txt", _SCANS), ("times.txt", _SCANS), ("geo.csv", _SCANS + 1)):
        text = (whole / name).read_text().splitlines(keepends=True)
        (root / name).write_text("".join(text[:lines]))
    return open_drive(root)


@pytest.fixture(scope="session")
def sample_result(sample: FolderDrive) -> DriveResult:
    """What is found in it."""
    result = detect(sample)
    assert len(result.detections) > 10
    return result
