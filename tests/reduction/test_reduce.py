"""Writing of reduced drives: what goes where, whole or not at all."""

import gzip
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from interloc.config import KeyframeConfig
from interloc.drives.folder import FolderDrive
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scans.reduced_format import decode_ground, read_manifest
from interloc.errors import DriveError, OutputError
from interloc.reduction.reduce import prepare_reduction, reduce_drive, reduce_scan


def inside(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def assert_same(before: FolderDrive, after: FolderDrive) -> None:
    assert (after.name, after.layout, after.scheme) == (before.name, before.layout, before.scheme)
    assert (after.pose_frame, after.pose_frame_reason) == (before.pose_frame, before.pose_frame_reason)
    for name in ("frames", "T_world_lidar", "times_s"):
        ours, theirs = getattr(before, name), getattr(after, name)
        assert (ours is None) == (theirs is None)
        assert ours is None or ours.tobytes() == theirs.tobytes()
    assert (before.georeference is None) == (after.georeference is None)
    if before.georeference is not None and after.georeference is not None:
        for name in ("lat_deg", "lon_deg", "alt_m", "R_enu_lidar"):
            assert getattr(before.georeference, name).tobytes() == getattr(after.georeference, name).tobytes()
    for index in range(len(before.frames)):
        ours, theirs = before.ground_points(index), after.ground_points(index)
        assert ours.xyz.tobytes() == theirs.xyz.tobytes()
        assert ours.road_count == theirs.road_count


def reduce_all(root: Path, out: Path, **options: Any) -> None:
    """Reduce a drive with every scan, and compare."""
    reduce_drive(root, out, DriveOptions.of(**options), keyframes=None)
    assert_same(open_drive(root, **options), open_drive(out))


def test_what_lies_in_a_reduced_drive(drive: Path, tmp_path: Path) -> None:
    done: list[tuple[int, int]] = []
    manifest = reduce_drive(
        drive, tmp_path / "out", keyframes=KeyframeConfig(), progress=lambda *counts: done.append(counts)
    )
    ground = [f"ground/labels/{frame:06d}.ground" for frame in (0, 3, 6, 9)]
    assert inside(tmp_path / "out") == sorted(
        ["calib.txt", "geo.csv", *ground, "poses.txt", "reduced.json", "times.txt"]
    )
    for name in ("poses.txt", "calib.txt", "times.txt", "geo.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (drive / name).read_bytes()
    assert manifest == read_manifest(tmp_path / "out")
    assert manifest.source.scan_bytes == sum(path.stat().st_size for path in (drive / "velodyne").iterdir())
    assert done == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_both_label_folders(drive: Path, tmp_path: Path) -> None:
    (drive / "predictions").mkdir()
    for path in (drive / "labels").iterdir():
        labels = np.fromfile(path, np.uint32) & 0xFFFF
        np.where(labels == 48, 40, labels).astype(np.uint32).tofile(drive / "predictions" / path.name)
    reduce_drive(drive, tmp_path / "out", keyframes=None)
    for folder in ("labels", "predictions"):
        assert_same(open_drive(drive, labels=folder), open_drive(tmp_path / "out", labels=folder))
    roads = [open_drive(tmp_path / "out", labels=folder).ground_points(0) for folder in ("labels", "predictions")]
    assert roads[0].road_count < roads[1].road_count == len(roads[1].xyz)
    reduce_drive(drive, tmp_path / "one", label_folders=["predictions"], keyframes=None)
    assert {name.split("/")[1] for name in inside(tmp_path / "one") if "/" in name} == {"predictions"}


@pytest.mark.parametrize("scheme", ["learning", "40", [40, 48]])
def test_label_schemes(tmp_path: Path, make: ModuleType, scheme: str | list[int]) -> None:
    name = scheme if scheme == "learning" else "semantickitti"
    reduce_all(make.write_semantickitti(tmp_path / "07", scheme=name), tmp_path / "out", label_scheme=scheme)


def test_kitti_raw_with_the_calibration_above(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_kitti_raw(tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync")
    (root / "calib_imu_to_velo.txt").rename(root.parent / "calib_imu_to_velo.txt")
    reduce_all(root, tmp_path / "out")
    names = inside(tmp_path / "out")
    assert {"calib_imu_to_velo.txt", "velodyne_points/timestamps.txt", "oxts/data/0000000011.txt"} <= set(names)
    assert read_manifest(tmp_path / "out").pose_frame == "oxts"


def test_kitti360_with_gaps_between_its_scans(tmp_path: Path, make: ModuleType) -> None:
    poses, frames = make.lidar_poses(), [*range(100, 106), *range(110, 116)]
    root = make.write_semantickitti(tmp_path / "360", poses=poses, pose_frame="lidar", scheme="kitti360", frames=frames)
    (root / "times.txt").unlink()
    (root / "poses.txt").write_text(make.pose_text(poses, frames=frames))
    reduce_all(root, tmp_path / "out")
    assert read_manifest(tmp_path / "out").scans == [(100, 6), (110, 6)]


def test_kitti360_imu_poses_with_calibrations_in_a_folder(tmp_path: Path, make: ModuleType) -> None:
    """IMU x forward, z down; its calibrations lie in calibration/ and one folder above."""
    root = make.write_semantickitti(tmp_path / "360", pose_frame="lidar", scheme="kitti360")
    T_imu_lidar = np.diag([1.0, -1.0, -1.0, 1.0])
    T_cam_lidar = make.T_CAM_LIDAR
    T_imu_cam = T_imu_lidar @ np.linalg.inv(T_cam_lidar)
    poses = make.lidar_poses() @ np.linalg.inv(T_imu_lidar)
    (root / "poses.txt").write_text(make.pose_text(poses, frames=list(range(12))))
    (root / "calibration").mkdir()
    lines = {"calib_cam_to_velo.txt": "", "calib_cam_to_pose.txt": "image_00: "}
    for (name, key), T, folder in zip(
        lines.items(), (np.linalg.inv(T_cam_lidar), T_imu_cam), (root / "calibration", tmp_path), strict=True
    ):
        (folder / name).write_text(key + " ".join(f"{v:.12g}" for v in T[:3].ravel()) + "\n")
    assert open_drive(root).pose_frame == "imu"
    reduce_all(root, tmp_path / "out")
    assert {"calibration/calib_cam_to_velo.txt", "calib_cam_to_pose.txt"} <= set(inside(tmp_path / "out"))


@pytest.fixture
def bare(tmp_path: Path, make: ModuleType) -> Path:
    """A sequence 08 of 12 scans without a georeference."""
    root: Path = make.write_semantickitti(tmp_path / "sequences" / "08")
    return root


def oxts_rows(make: ModuleType) -> list[str]:
    return [row + "\n" for row in make.oxts_lines(make.lidar_poses(), T_lidar_imu=make.T_LIDAR_IMU)]


def test_the_raw_drive_of_a_sequence(bare: Path, tmp_path: Path, make: ModuleType) -> None:
    """Sequence 08 starts at frame 1100 of its raw drive."""
    raw = tmp_path / "2011_09_30" / "2011_09_30_drive_0028_sync"
    (raw / "oxts" / "data").mkdir(parents=True)
    (raw.parent / "calib_imu_to_velo.txt").write_text(make.CALIBRATION)
    for frame, row in enumerate(oxts_rows(make)):
        (raw / "oxts" / "data" / f"{1100 + frame:010d}.txt").write_text(row)
    reduce_all(bare, tmp_path / "out", oxts=raw)
    assert "georeference/oxts/0000000011.txt" in inside(tmp_path / "out")
    assert (tmp_path / "out/georeference/calib_imu_to_velo.txt").read_text() == make.CALIBRATION
    again = tmp_path / "2011_09_30_drive_0028_sync" / "small"  # a name that means raw frames elsewhere
    reduce_all(bare, again, oxts=raw)


@pytest.mark.parametrize("suffix", [".txt", ".txt.gz"])
def test_a_file_of_rows(bare: Path, tmp_path: Path, make: ModuleType, suffix: str) -> None:
    rows = tmp_path / "elsewhere" / f"08{suffix}"
    rows.parent.mkdir()
    text = "".join(oxts_rows(make)).encode()
    rows.write_bytes(gzip.compress(text) if suffix.endswith("gz") else text)
    (rows.parent / "calib_imu_to_velo.txt").write_text(make.CALIBRATION)
    (bare / "calib_imu_to_velo.txt").write_text(make.CALIBRATION.replace("-0.8 0.3", "0 0"))
    reduce_all(bare, tmp_path / "out", oxts=rows)
    assert (tmp_path / "out" / f"georeference/oxts{suffix}").read_bytes() == rows.read_bytes()


def test_a_geo_csv_comes_before_that_of_the_drive(drive: Path, tmp_path: Path, make: ModuleType) -> None:
    given = tmp_path / "better.csv"
    poses = make.lidar_poses(step_m=0.9, turn_rad=0.01)
    given.write_text(make.geo_csv(poses).replace(",49", ",48"))
    reduce_all(drive, tmp_path / "out", oxts=given)
    assert "geo.csv" not in inside(tmp_path / "out")
    assert (tmp_path / "out/georeference/geo.csv").read_bytes() == given.read_bytes()


def test_scan_by_scan_and_in_place(drive: Path) -> None:
    """What a service does: reduce scans in any order, then write the rest where the drive lies."""
    before = open_drive(drive)
    reduction = prepare_reduction(drive, keyframes=None)
    (drive / "ground" / "labels").mkdir(parents=True)
    for frame in reversed(range(12)):
        data = reduce_scan(reduction.scans["labels"], frame)
        assert decode_ground(data, "").xyz.tobytes() == before.ground_points(frame).xyz.tobytes()
        reduction.write_ground(frame, drive)
    reduction.write_rest(drive)
    assert_same(before, open_drive(drive))
    assert inspect_drive(drive).reduced is not None


def test_an_older_one_is_replaced(drive: Path, reduced: Path) -> None:
    (reduced / "map.osm").write_text("<osm/>")
    (reduced / "calib_imu_to_velo.txt").write_text("of another drive")
    (drive / "geo.csv").unlink()
    reduce_drive(drive, reduced, keyframes=None)
    assert_same(open_drive(drive), open_drive(reduced))
    assert len(list((reduced / "ground/labels").iterdir())) == 12
    assert (reduced / "map.osm").read_text() == "<osm/>"  # what is not ours stays


def test_a_folder_of_something_else_is_not_touched(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letter.txt").write_text("dear")
    with pytest.raises(OutputError, match=r"holds letter\.txt but no reduced\.json"):
        reduce_drive(drive, tmp_path / "home", keyframes=None)
    assert inside(tmp_path / "home") == ["letter.txt"]
    with pytest.raises(OutputError):
        reduce_drive(drive, drive, keyframes=None)


def test_a_damaged_scan_leaves_nothing_behind(drive: Path, tmp_path: Path) -> None:
    """Scan 5 is not among those that are looked into first."""
    points = np.fromfile(drive / "velodyne/000005.bin", np.float32)
    points[0] = np.inf
    points.tofile(drive / "velodyne/000005.bin")
    with pytest.raises(DriveError, match=r"velodyne/000005\.bin: point 0 of 1,725 is not finite"):
        reduce_drive(drive, tmp_path / "new" / "out", keyframes=None)
    assert not (tmp_path / "new").exists()


def test_a_reduced_drive_is_not_reduced_again(reduced: Path, tmp_path: Path) -> None:
    with pytest.raises(DriveError, match="is a reduced drive already"):
        reduce_drive(reduced, tmp_path / "out", keyframes=None)


def test_a_name_that_xml_cannot_carry(tmp_path: Path, make: ModuleType) -> None:
    reduce_all(make.write_semantickitti(tmp_path / "two\nlines"), tmp_path / "two")
    assert open_drive(tmp_path / "two").name == "two\N{REPLACEMENT CHARACTER}lines"
    assert open_drive(tmp_path / "two", name="renamed").name == "renamed"
    reduce_all(make.write_semantickitti(tmp_path / "Straße 7 :)"), tmp_path / "out")
