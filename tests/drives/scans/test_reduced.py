"""A reduced drive is read like the drive that it was made of, and refused in words where it cannot be."""

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from interloc.config import KeyframeConfig, preset
from interloc.detection.keyframes import select_keyframes
from interloc.drive import Drive
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.errors import DriveError, GeoreferenceError
from interloc.pipeline import detect


def same_points(first: Drive, second: Drive, index: int) -> bool:
    a, b = first.ground_points(index), second.ground_points(index)
    return a.xyz.tobytes() == b.xyz.tobytes() and a.road_count == b.road_count and a.xyz.dtype == b.xyz.dtype


def test_it_is_the_same_drive(drive: Path, reduced: Path) -> None:
    before, after = open_drive(drive), open_drive(reduced)
    assert isinstance(after, Drive)
    assert (after.name, after.layout, after.scheme) == ("07", "semantickitti", before.scheme)
    assert (after.pose_frame, after.pose_frame_reason) == (before.pose_frame, before.pose_frame_reason)
    assert after.frames.tolist() == list(range(12))
    assert after.T_world_lidar.tobytes() == before.T_world_lidar.tobytes()
    assert after.times_s.tobytes() == before.times_s.tobytes()
    assert after.georeference.lat_deg.tobytes() == before.georeference.lat_deg.tobytes()
    assert after.georeference.source == before.georeference.source
    kept = select_keyframes(before.T_world_lidar, KeyframeConfig())
    assert kept.tolist() == [0, 3, 6, 9]
    assert all(same_points(before, after, int(index)) for index in kept)


def test_it_travels_to_other_processes(reduced: Path) -> None:
    drive = open_drive(reduced)
    data = pickle.dumps(drive)
    assert len(data) < 20_000
    assert same_points(pickle.loads(data), drive, 3)  # noqa: S301


def test_it_is_recognised_wherever_it_lies(reduced: Path, tmp_path: Path) -> None:
    (tmp_path / "velodyne").mkdir()
    shutil.move(reduced, tmp_path / "velodyne" / "00")
    assert open_drive(tmp_path / "velodyne" / "00").name == "07"


def test_nothing_above_it_is_looked_at(reduced: Path) -> None:
    """A calibration beside the folder is another drive's."""
    (reduced / "calib.txt").rename(reduced.parent / "calib.txt")
    with pytest.raises(DriveError, match=r"poses\.txt: holds camera poses .* there is no calib\.txt"):
        open_drive(reduced)


def test_a_scan_that_was_not_kept(reduced: Path) -> None:
    drive = open_drive(reduced)
    for index in (1, 11):
        with pytest.raises(DriveError, match=f"keyframes of 2 m, 5 degrees when it was reduced, and scan {index} was"):
            drive.ground_points(index)
    finer = preset("default").model_copy(update={"keyframes": KeyframeConfig(distance_m=1.0)})
    with pytest.raises(DriveError, match=r"keyframes\.distance_m.*reduce the drive again .* --all-scans"):
        detect(drive, finer)


def test_the_report_is_that_of_the_drive(drive: Path, reduced: Path) -> None:
    before, after = inspect_drive(drive, thorough=True), inspect_drive(reduced, thorough=True)
    assert after.ok
    assert (after.reduced.kept_scans, after.reduced.distance_m, after.reduced.angle_deg) == (4, 2.0, 5.0)
    assert after.reduced.ground_bytes == sum(path.stat().st_size for path in (reduced / "ground").rglob("*.ground"))
    assert before.label_ids[40] == pytest.approx(after.label_ids[40], abs=1e-12)
    assert (before.looked_into, after.looked_into) == (12, 4)
    differing = {"path", "reduced", "looked_into", "flatness_m", "label_ids", "road_share"}
    assert before.model_dump(exclude=differing) == after.model_dump(exclude=differing)


def test_a_report_without_facts_of_the_scans(reduced: Path, edit: Callable[..., None]) -> None:
    labels = [{"folder": "labels", "scheme": "semantickitti", "road": [40, 60], "confusable": [44, 48, 49]}]
    edit(source=None, labels=labels)
    report = inspect_drive(reduced)
    assert report.ok
    assert (report.scans, report.scan_bytes, report.points_per_scan, report.road_share) == (12, 0, None, None)
    assert open_drive(reduced).scheme.name == "semantickitti"


def test_the_pose_frame_is_not_guessed_again(reduced: Path, edit: Callable[..., None]) -> None:
    """A drive that was declared so stays so, whatever the motion suggests."""
    edit(pose_frame="lidar", pose_frame_reason="declared so")
    with pytest.raises(DriveError, match="Poses were read as lidar poses: declared so"):
        open_drive(reduced)
    assert open_drive(reduced, check=False).pose_frame == "lidar"


def test_options_that_contradict_it(reduced: Path) -> None:
    assert open_drive(reduced, pose_frame="camera", layout="semantickitti", label_scheme="semantickitti").name == "07"
    for option, value, words in (
        ("pose_frame", "lidar", r"^poses\.txt: declared as poses of the LiDAR .* reduced with them as those of the"),
        ("layout", "kitti_raw", r"^reduced\.json: is a drive of layout semantickitti, not kitti_raw"),
        ("label_scheme", "learning", r"^reduced\.json: its points were chosen by label scheme semantickitti"),
        ("label_scheme", "40,60", r"^reduced\.json: its points were chosen by label scheme semantickitti"),
        ("labels", "predictions", r"^ground/predictions: is missing: .*There is labels/: choose it"),
    ):
        with pytest.raises(DriveError, match=words):
            open_drive(reduced, **{option: value})
        report = inspect_drive(reduced, **{option: value})
        assert not report.ok


def test_a_georeference_from_elsewhere_comes_first(reduced: Path, tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses(step_m=0.9, turn_rad=0.01)
    (tmp_path / "geo.csv").write_text(make.geo_csv(poses).replace(",49", ",48"))
    drive = open_drive(reduced, oxts=tmp_path / "geo.csv")
    assert drive.georeference.lat_deg[0] == pytest.approx(48.0, abs=0.01)
    with pytest.raises(GeoreferenceError, match="does not exist"):
        open_drive(reduced, oxts=tmp_path / "gone.csv")


def test_what_is_missing_is_named(reduced: Path, tmp_path: Path) -> None:
    ground = reduced / "ground/labels/000003.ground"
    ground.rename(tmp_path / "000003.ground")
    words = r"^ground/labels/000003\.ground: is missing: 1 of 4 scans that were kept are not there \(3\)"
    with pytest.raises(DriveError, match=words):
        open_drive(reduced)
    report = inspect_drive(reduced, thorough=True)
    assert [problem.severity for problem in report.problems] == ["error"]
    assert report.looked_into == 3
    shutil.move(reduced / "ground", reduced / "elsewhere")
    with pytest.raises(DriveError, match=r"^ground/labels: cannot be read: no such file"):
        open_drive(reduced)
    shutil.move(reduced / "elsewhere", reduced / "ground")
    (tmp_path / "000003.ground").rename(ground)
    poses = (reduced / "poses.txt").read_text()
    (reduced / "poses.txt").write_text("1 0 0\n")
    with pytest.raises(DriveError, match=r"^poses\.txt: line 1: 3 numbers"):
        open_drive(reduced)
    (reduced / "poses.txt").write_text(poses)
    (reduced / "reduced.json").unlink()
    with pytest.raises(DriveError, match=r"It is a reduced drive without its reduced\.json"):
        open_drive(reduced)


def test_damaged_ground_is_named_before_any_work(reduced: Path) -> None:
    path = reduced / "ground/labels/000003.ground"
    whole = path.read_bytes()
    for data, words in (
        (b"", "is empty"),
        (whole[:20], "holds 20 bytes"),
        (whole[:-5], "is damaged"),
        (whole[:4] + b"\x02" + whole[5:], "is of version 2"),
    ):
        path.write_bytes(data)
        with pytest.raises(DriveError, match=rf"^ground/labels/000003\.ground: {words}"):
            open_drive(reduced)
        errors = [problem for problem in inspect_drive(reduced).problems if problem.severity == "error"]
        assert errors[0].path == "ground/labels/000003.ground"


def test_damage_while_running_is_named(reduced: Path) -> None:
    drive = open_drive(reduced)
    (reduced / "ground/labels/000006.ground").unlink()
    with pytest.raises(DriveError, match=r"^ground/labels/000006\.ground: cannot be read: no such file"):
        detect(drive)
