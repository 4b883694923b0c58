"""Labels by geometry as a source of labels of a drive; their quality on real scans."""

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.drives.findings import Findings
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive, read_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scans.made_labels import GeometryLabels
from interloc.drives.scans.raw import RawScans
from interloc.errors import DriveError
from tests.small_drives import write_semantickitti


def source_of(root: Path) -> GeometryLabels:
    scans = open_drive(root, labels="geometry", check=False).scans
    assert isinstance(scans, RawScans)
    labels = scans.sources[1]
    assert isinstance(labels, GeometryLabels)
    return labels


def road_iou(root: Path) -> float:
    """Return the intersection over union of the road points within 40 m with those of hand labels."""
    by_hand, scans = open_drive(root, check=False), open_drive(root, labels="geometry", check=False).scans
    assert isinstance(by_hand.scans, RawScans)
    assert isinstance(scans, RawScans)
    both = either = 0
    for frame in by_hand.frames.tolist():
        (points, true), (_, made) = by_hand.scans.sources, scans.sources
        read = points.read(frame)
        ids = true.of(frame, read, "") & 0xFFFF
        counts = (np.linalg.norm(read.values[:, :2], axis=1) < 40) & (ids > 1)
        road, found = np.isin(ids, (40, 60)) & counts, (made.of(frame, read, "") == 40) & counts
        both, either = both + np.count_nonzero(road & found), either + np.count_nonzero(road | found)
    return both / either


def test_real_scans_agree_with_hand_labels(data: Callable[[str], Path]) -> None:
    assert road_iou(data("semantickitti_mini/sequences/00")) > 0.8


def test_labels_need_poses(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")
    (root / "poses.txt").write_text("no poses\n")
    with pytest.raises(DriveError, match=r"poses\.txt"):
        open_drive(root, labels="geometry")
    assert any("need poses" in problem.message for problem in inspect_drive(root, labels="geometry").problems)


def test_missing_remission_and_doubts_are_told(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")  # a plain of one brightness
    told = [problem.message for problem in inspect_drive(root, labels="geometry").problems]
    assert any("no remission" in message for message in told)
    assert any("doubtful from 0 to 22 m" in message for message in told)
    assert open_drive(root, labels="geometry", check=False).ground_points(3).is_doubtful
    assert not open_drive(root, check=False).ground_points(3).is_doubtful


def test_the_source_is_cheap_to_send_and_says_what_it_depends_on(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")
    labels = source_of(root)
    made = labels.of(3, labels.points.read(3), "")
    sent = pickle.dumps(labels)
    assert len(sent) < 20_000
    np.testing.assert_array_equal(pickle.loads(sent).of(3, labels.points.read(3), ""), made)  # noqa: S301 - own
    assert {path.name for path in labels.files(3)} >= {"000000.bin", "000011.bin"}
    other = write_semantickitti(tmp_path / "other", poses=open_drive(root).T_world_lidar[:11])
    assert source_of(root).identity == labels.identity != source_of(other).identity


def test_by_geometry_and_by_files_at_once(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")
    readings = read_drive(root, DriveOptions(), Findings(stop_at_first=True), label_folders=("labels", "geometry"))
    by_files, by_geometry = (reading.drive for reading in readings.values())
    assert by_files.T_world_lidar is by_geometry.T_world_lidar
    assert by_geometry.label_source == "geometry"


def test_a_sensor_that_does_not_turn_is_told(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")
    for file in (root / "velodyne").iterdir():
        points = np.fromfile(file, np.float32).reshape(-1, 4)
        points[points[:, 0] > np.abs(points[:, 1])].tofile(file)
    told = [problem.message for problem in inspect_drive(root, labels="geometry").problems]
    assert any("sees 90 degrees" in message or "sees 100 degrees" in message for message in told)


def test_scans_of_a_window_belong_together(tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")
    made, written = (open_drive(root, labels=labels, check=False).scans for labels in ("geometry", "labels"))
    assert isinstance(made, RawScans)
    assert isinstance(written, RawScans)
    assert made.windows_of([0, 3, 11]).tolist() == [0, 0, 0]
    assert written.windows_of([0, 3, 11]).tolist() == [0, 1, 2]
