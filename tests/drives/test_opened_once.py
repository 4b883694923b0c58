"""The small files of a drive are opened once, however many steps look into them."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.drives.findings import Findings
from interloc.drives.open import open_drive, read_drive
from interloc.drives.options import DriveOptions
from tests.opens import counted_opens


def texts_in(root: Path) -> list[Path]:
    return sorted(path for path in root.rglob("*.txt") if path.name != "calib.txt")


@pytest.fixture
def with_oxts(sequence: Path, make: ModuleType) -> Path:
    """The sequence with a fix per scan and a second folder of labels."""
    (sequence / "oxts").mkdir()
    for frame, row in enumerate(make.oxts_lines(make.lidar_poses(), T_lidar_imu=np.eye(4))):
        (sequence / "oxts" / f"{frame:010d}.txt").write_text(row + "\n")
    (sequence / "labels").rename(sequence / "predictions")
    make.write_semantickitti(sequence)
    return sequence


def test_both_label_folders(with_oxts: Path) -> None:
    with counted_opens() as opens:
        readings = read_drive(
            with_oxts, DriveOptions(), Findings(stop_at_first=True), label_folders=("labels", "predictions")
        )
    assert {path.name: opens[path] for path in texts_in(with_oxts)} == dict.fromkeys(
        ["poses.txt", "times.txt", *(f"{frame:010d}.txt" for frame in range(12))], 1
    )
    by_labels, by_predictions = (reading.drive for reading in readings.values())
    assert by_labels.T_world_lidar is by_predictions.T_world_lidar
    assert (by_labels.label_source, by_predictions.label_source) == ("labels", "predictions")


def test_a_reduced_drive(reduced: Path) -> None:
    with counted_opens() as opens:
        open_drive(reduced)
    assert {opens[path] for path in texts_in(reduced)} == {1}


def test_a_file_that_changed_is_read_anew(sequence: Path, make: ModuleType) -> None:
    open_drive(sequence)
    (sequence / "poses.txt").write_text(make.pose_text(make.camera_poses(make.lidar_poses(step_m=1.0))))
    assert np.linalg.norm(open_drive(sequence).T_world_lidar[1, :3, 3]) == pytest.approx(1.0)
