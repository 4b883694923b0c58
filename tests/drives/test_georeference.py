"""Georeference: OXTS, geo.csv, raw drives, their lever arm; fixes that are late, stand still or repeat."""

import gzip
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pyproj
import pytest

from interloc.arrays import FloatArray
from interloc.drive import Georeference
from interloc.drives.files import GeoreferenceFile, SourceFile
from interloc.drives.findings import Findings
from interloc.drives.georeference.fixes import fit_moving, fit_shift
from interloc.drives.georeference.geodetic import ecef_poses, poses_of, without_standing
from interloc.drives.georeference.read import (
    geo_csv_text,
    georeference_of_lidar,
    raw_offset,
    read_geo_csv,
    read_georeference,
    read_oxts_rows,
)
from interloc.drives.inspect import inspect_drive
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.files import read_poses
from interloc.drives.poses.frame import KITTI_T_VELO_IMU
from interloc.errors import GeoreferenceError
from interloc.geometry import enu_from_lonlat, invert_transform, lonlat_from_enu, rotate_2d, rotation_from_rpy

FRAMES = np.arange(12)


def parts(root: Path, *, oxts: Path | None = None, geo: Path | None = None) -> DriveParts:
    return DriveParts("semantickitti", root, root, None, None, (root,), oxts, geo)


def test_oxts_folder_with_lever_arm(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_kitti_raw(tmp_path / "raw")
    georeference = read_georeference(parts(root, oxts=root / "oxts"), FRAMES, None)
    assert georeference.source == "oxts/data, lever arm of calib_imu_to_velo.txt"
    np.testing.assert_allclose(poses_of(georeference), make.lidar_poses(), atol=0.02)


def test_published_lever_arm_is_said(tmp_path: Path, make: ModuleType) -> None:
    rows = tmp_path / "07.txt"
    rows.write_text("\n".join(make.oxts_lines(make.lidar_poses(), T_lidar_imu=KITTI_T_VELO_IMU)))
    report = inspect_drive(make.write_semantickitti(tmp_path / "07"), oxts=rows)
    assert "published by KITTI" in report.georeference
    assert [(note.severity, note.path) for note in report.problems] == [("note", "calib_imu_to_velo.txt")]


def test_rows_map_by_frame_number(tmp_path: Path, make: ModuleType) -> None:
    rows = tmp_path / "07.txt.gz"
    rows.write_bytes(gzip.compress("\n".join(make.oxts_lines(make.lidar_poses(), T_lidar_imu=np.eye(4))).encode()))
    every, some = (read_oxts_rows(GeoreferenceFile(rows, tmp_path), frames) for frames in (FRAMES, np.array([3, 7])))
    np.testing.assert_array_equal(some, every[[3, 7]])


def test_too_few_rows_or_files(tmp_path: Path, make: ModuleType) -> None:
    rows = tmp_path / "07.txt"
    rows.write_text("\n".join(make.oxts_lines(make.lidar_poses(5), T_lidar_imu=np.eye(4))))
    with pytest.raises(GeoreferenceError, match=r"5 rows, but the drive has the frames 0 to 11 \(12 scans\)"):
        read_georeference(parts(tmp_path), FRAMES, rows)
    root = make.write_kitti_raw(tmp_path / "raw")
    (root / "oxts" / "data" / "0000000004.txt").unlink()
    with pytest.raises(GeoreferenceError, match=r"oxts/data: 1 of 12 scans have no fix: frames 4"):
        read_georeference(parts(root, oxts=root / "oxts"), FRAMES, None)


def oxts_row(column: int, value: str) -> Callable[[str], str]:
    return lambda row: " ".join([*row.split()[:column], value, *row.split()[column + 1 :]])


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (oxts_row(0, "95"), "no place to drive"),
        (oxts_row(2, "1e6"), "no place to drive"),
        (oxts_row(5, "90"), "Usual cause: degrees"),
        (oxts_row(0, "nan"), "not finite"),
        (oxts_row(0, "north"), "not a number"),
        (lambda _: "1 2 3", "line 1: 3 values; expected 30"),
        (lambda _: " ".join(["0"] * 30), "no fix"),
    ],
)
def test_bad_oxts_rows(tmp_path: Path, make: ModuleType, edit: Callable[[str], str], words: str) -> None:
    rows = tmp_path / "07.txt"
    rows.write_text(edit(make.oxts_lines(make.lidar_poses(1), T_lidar_imu=np.eye(4))[0]))
    with pytest.raises(GeoreferenceError, match=words):
        read_georeference(parts(tmp_path), np.array([0]), rows)


def test_geo_csv_is_the_lidar_itself(tmp_path: Path, make: ModuleType) -> None:
    (tmp_path / "geo.csv").write_text(make.geo_csv(make.lidar_poses()))
    georeference = read_georeference(parts(tmp_path, geo=tmp_path / "geo.csv"), FRAMES, None)
    np.testing.assert_allclose(poses_of(georeference), make.lidar_poses(), atol=0.02)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda text: text.replace("lat_deg", "latitude"), "no column lat_deg"),
        (lambda text: text.replace(",", ";"), "line 1: its columns are separated by semicolons. Expected commas"),
        (lambda text: "\n".join(text.splitlines()[:-1]), "1 of 12 scans have no row: frames 11"),
        (lambda text: text.splitlines()[0], "header only"),
        (lambda text: text + "12,1,2\n", "line 14: 3 fields"),
        (lambda text: text + text.splitlines()[3], "frame 2 has two rows"),
    ],
)
def test_damaged_geo_csv(tmp_path: Path, make: ModuleType, edit: Callable[[str], str], words: str) -> None:
    (tmp_path / "geo.csv").write_text(edit(make.geo_csv(make.lidar_poses())))
    with pytest.raises(GeoreferenceError, match=words):
        read_geo_csv(GeoreferenceFile(tmp_path / "geo.csv", tmp_path), FRAMES)


def test_a_georeference_that_is_not_there(tmp_path: Path) -> None:
    assert read_georeference(parts(tmp_path), FRAMES, None) is None
    with pytest.raises(GeoreferenceError, match="does not exist"):
        read_georeference(parts(tmp_path), FRAMES, tmp_path / "gone")


def test_raw_drive_of_an_odometry_sequence(tmp_path: Path, make: ModuleType) -> None:
    """Sequence 08 starts at raw frame 1100."""
    raw = tmp_path / "2011_09_30_drive_0028_sync"
    (raw / "oxts" / "data").mkdir(parents=True)
    for frame, row in enumerate(make.oxts_lines(make.lidar_poses(), T_lidar_imu=np.eye(4)), start=1100):
        (raw / "oxts" / "data" / f"{frame:010d}.txt").write_text(row)
    (raw.parent / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
    georeference = read_georeference(parts(tmp_path / "08"), FRAMES, raw)
    np.testing.assert_allclose(poses_of(georeference), make.lidar_poses(), atol=0.02)
    assert "calib_imu_to_velo.txt" in georeference.source


def test_the_folder_of_a_day_is_refused_with_the_raw_drive_in_it(tmp_path: Path, make: ModuleType) -> None:
    make.write_kitti_raw(tmp_path / "2011_09_30" / "2011_09_30_drive_0027_sync")
    with pytest.raises(GeoreferenceError, match=r"holds raw drives: give one of them \(2011_09_30_drive_0027\)"):
        read_georeference(parts(tmp_path / "07"), FRAMES, tmp_path / "2011_09_30")


def test_raw_drive_of_another_sequence(tmp_path: Path) -> None:
    raw = tmp_path / "2011_10_03_drive_0027_sync"
    with pytest.raises(
        GeoreferenceError, match=r"sequence 00, not of 07; the raw drive of 07 is 2011_09_30_drive_0027"
    ):
        raw_offset(raw, "07", FRAMES)
    with pytest.raises(GeoreferenceError, match="03 was never published"):
        raw_offset(raw, "03", FRAMES)
    with pytest.raises(GeoreferenceError, match="frames 0 to 4540"):
        raw_offset(raw, "00", np.array([4541]))
    assert raw_offset(raw, "my_drive", FRAMES) == 0
    assert raw_offset(tmp_path / "elsewhere", "07", FRAMES) == 0


def test_what_oxts_state_of_their_accuracy_survives_a_geo_csv(tmp_path: Path) -> None:
    rows = np.zeros((3, 30))
    rows[:, :2] = [49.0, 8.4]
    rows[:, 23] = [0.02, 0.0, 0.5]  # 0: unknown
    georeference = georeference_of_lidar(rows, np.eye(4), "oxts")
    (tmp_path / "geo.csv").write_text(geo_csv_text(np.arange(3), georeference, exact=True))
    back = read_geo_csv(GeoreferenceFile(tmp_path / "geo.csv", tmp_path), np.arange(3))
    np.testing.assert_array_equal(back.position_std_m, [0.02, np.nan, 0.5])
    without = geo_csv_text(np.arange(3), replace(georeference, position_std_m=None))
    assert without.splitlines()[0].endswith("yaw_rad")


def test_earth_fixed_poses_agree_with_proj() -> None:
    georeference = Georeference(
        lat_deg=np.array([49.0, -33.5]),
        lon_deg=np.array([8.4, 151.2]),
        alt_m=np.array([110.0, 12.0]),
        R_enu_lidar=np.tile(np.eye(3), (2, 1, 1)),
        source="",
    )
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    expected = np.stack(to_ecef.transform(georeference.lon_deg, georeference.lat_deg, georeference.alt_m), axis=1)
    poses = ecef_poses(georeference)
    np.testing.assert_allclose(poses[:, :3, 3], expected, atol=1e-6)
    identity = np.tile(np.eye(3), (2, 1, 1))
    np.testing.assert_allclose(poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2), identity, atol=1e-12)


def plane_positions(georeference: Georeference) -> FloatArray:
    """East and north on a transverse Mercator plane through the first fix."""
    plane = f"+proj=tmerc +lat_0={georeference.lat_deg[0]} +lon_0={georeference.lon_deg[0]} +k=1 +datum=WGS84"
    project = pyproj.Transformer.from_crs("EPSG:4326", plane, always_xy=True)
    return np.stack(project.transform(georeference.lon_deg, georeference.lat_deg), axis=1)


def rigid_rmse(a: FloatArray, b: FloatArray) -> float:
    """Root mean square distance of two (N, 2) tracks after the best rotation and shift of one."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.sqrt(((b @ rotation - a) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("sequence", ["00", "05", "07", "09"])
def test_oxts_agrees_with_the_ground_truth_and_the_lever_arm_has_the_right_sign(
    data: Callable[[str], Path], sequence: str
) -> None:
    path = data(f"kitti/poses_gt/{sequence}.txt")
    line = next(s for s in data(f"kitti/calib/{sequence}.txt").read_text().splitlines() if s.startswith("Tr:"))
    T_cam_lidar = np.vstack([np.array(line.split()[1:], float).reshape(3, 4), [0, 0, 0, 1]])
    lidar = invert_transform(T_cam_lidar) @ read_poses(SourceFile(path, path.parent)).poses @ T_cam_lidar
    rows = read_oxts_rows(GeoreferenceFile(data(f"kitti/oxts/{sequence}.txt.gz"), path.parent), np.arange(len(lidar)))
    error = {
        name: rigid_rmse(plane_positions(georeference_of_lidar(rows, arm, "")), lidar[:, :2, 3])
        for name, arm in (
            ("right", KITTI_T_VELO_IMU),
            ("none", np.eye(4)),
            ("inverse", invert_transform(KITTI_T_VELO_IMU)),
        )
    }
    assert error["right"] < 0.5
    assert error["right"] < error["none"] - 0.2 < error["inverse"] - 0.4


def with_oxts(root: Path, make: ModuleType, times_s: np.ndarray, poses: np.ndarray) -> Path:
    """Write a raw drive with a scan per 0.1 s, and with rows of OXTS at other times."""
    make.write_kitti_raw(root)
    for row, text in enumerate(make.oxts_lines(poses, T_lidar_imu=make.T_LIDAR_IMU)):
        (root / "oxts" / "data" / f"{row:010d}.txt").write_text(text)
    stamps = np.datetime64("2011-09-26T13:02:25", "us") + np.round(times_s * 1e6).astype("timedelta64[us]")
    (root / "oxts" / "timestamps.txt").write_text("\n".join(str(stamp).replace("T", " ") for stamp in stamps))
    return root


def test_rows_of_the_same_times_are_taken_by_their_numbers(tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses()
    jitter = np.random.default_rng(1).uniform(-0.02, 0.02, len(poses))
    report = inspect_drive(with_oxts(tmp_path / "raw", make, 0.1 * np.arange(len(poses)) + jitter, poses))
    assert not [problem for problem in report.problems if problem.severity != "note"]


@pytest.mark.parametrize(
    ("first_row", "ahead_s", "words"),
    [(-7, 0.0, "rows nearest in time"), (0, 7200.0, r"\+7,200.0 s off the scans.*time zone")],
)
def test_rows_that_start_earlier_are_taken_by_their_times_and_a_clock_of_another_zone_is_named(
    tmp_path: Path, make: ModuleType, first_row: int, ahead_s: float, words: str
) -> None:
    poses = make.lidar_poses()
    rows = np.concatenate([np.repeat(poses[:1], -first_row, axis=0), poses])  # it stood still for these
    report = inspect_drive(with_oxts(tmp_path / "raw", make, ahead_s + 0.1 * np.arange(first_row, len(poses)), rows))
    (told,) = [problem for problem in report.problems if problem.severity == "warning"]
    assert re.search(words, told.message)
    assert report.length_m == pytest.approx(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum(), rel=0.01)


TIMES = np.arange(0.0, 120.0, 0.1)


def path(bend: float = 0.8) -> FloatArray:
    """Return (1200, 2) positions along an S at 8 to 12 m/s."""
    speed = 10.0 + 2.0 * np.sin(TIMES / 7.0)
    heading = bend * np.sin(TIMES / 9.0)
    steps = 0.1 * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.cumsum(steps, axis=0)


@pytest.mark.parametrize("noise_m", [0.0, 1.0])
@pytest.mark.parametrize("late_s", [0.0, 1.0, 2.0, -5.0, 18.0])
def test_a_shift_is_found_whatever_the_noise(late_s: float, noise_m: float) -> None:
    noise = np.random.default_rng(4).normal(0.0, noise_m, (120, 2)) if noise_m else 0.0
    found = fit_shift(TIMES, path(), TIMES[::10] + late_s, rotate_2d(path()[::10], 1.0) + noise)
    assert not found.undecided
    assert found.is_there == (late_s != 0.0)
    if late_s == 0.0:
        return
    assert found.is_sure
    assert found.late == pytest.approx(late_s, abs=0.2)
    assert found.after_m < found.before_m


@pytest.mark.parametrize("by_m", [20.0, 60.0])
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("fix", [5, 20, -10, -30])
def test_a_few_fixes_that_jump_make_no_shift(fix: int, count: int, by_m: float) -> None:
    heading = np.clip((TIMES - 100.0) / 10.0, 0.0, 1.2)
    track = 0.3 * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    fixes = track[::10].copy()
    fixes[fix:, 1][:count] += by_m
    assert not fit_shift(TIMES, track, TIMES[::10], fixes).is_there


def test_too_few_fixes_tell_nothing() -> None:
    assert fit_shift(TIMES, path(), TIMES[:30:10] + 3.0, path()[:30:10]) is None
    standing = np.zeros((len(TIMES), 2))
    assert fit_shift(TIMES, standing, TIMES[::10], standing[::10]) is None


def test_what_cannot_be_told_is_said() -> None:
    """On a straight road and on a bend, at one speed, 3 s late looks as in time; with a stop it does not."""
    heading = TIMES / 40.0
    bend = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    straight = np.stack([10.0 * TIMES, np.zeros_like(TIMES)], axis=1)
    for track in (straight, bend):
        found = fit_shift(TIMES, track, TIMES[::10] + 3.0, track[::10])
        assert not found.is_there
        assert found.undecided_m > 50
        assert "cannot be told" in found.undecided
    stops = straight.copy()
    stops[600:900, 0] = stops[600, 0]
    stops[900:, 0] = stops[600, 0] + straight[:300, 0]
    found = fit_shift(TIMES, stops, TIMES[::10] + 3.0, stops[::10])
    assert found.is_there
    assert found.late == pytest.approx(3.0, abs=0.1)
    assert not found.undecided


def test_speeds_that_repeat_do_not_make_a_shift_of_a_period() -> None:
    """Every 38 s it slows down alike: 2 s late looks as 36 s early; the smaller is taken, and neither is sure."""
    straight = np.cumsum(np.stack([1.0 + 0.2 * np.sin(TIMES / 6.0), np.zeros_like(TIMES)], axis=1), axis=0)
    found = fit_shift(TIMES, straight, TIMES[::10] + 2.0, straight[::10])
    assert found.late == pytest.approx(2.0, abs=0.2)
    assert not found.is_sure


def test_fixes_that_stand_while_the_vehicle_drives_tell_nothing() -> None:
    """Frozen for 12 s and 3 s under fresh stamps, and late by 2 s or not: the others tell the shift."""
    for late_s in (0.0, 2.0):
        fixes = path()[::5].copy()
        fixes[40:64], fixes[100:106] = fixes[40], fixes[100]
        found, runs = fit_moving(TIMES, path(), TIMES[::5] + late_s, fixes)
        assert [(run.first, run.stop) for run in runs] == [(40, 64), (100, 106)]
        assert [run.driven_m for run in runs] == pytest.approx([110.0, 25.0], rel=0.2)
        assert found.is_there == (late_s != 0.0)
        assert found.late == pytest.approx(late_s, abs=0.1)


@pytest.mark.parametrize("late_s", [0.0, 3.0])
def test_a_parked_vehicle_stands_with_its_fixes(late_s: float) -> None:
    parked = np.repeat(path(), np.where(np.arange(len(TIMES)) == 500, 300, 1), axis=0)
    times = 0.1 * np.arange(len(parked))
    noise = np.random.default_rng(4).normal(0.0, 1.0, parked.shape)
    for fixes in (parked, parked + noise):
        assert not fit_moving(times, parked, times + late_s, fixes)[1]


def test_of_fixes_that_repeat_the_first_counts() -> None:
    """New ones come once a second, ten are written."""
    found, runs = fit_moving(TIMES, path(), TIMES, np.repeat(path()[::10], 10, axis=0))
    assert not found.is_there
    assert len(runs) == 120


@pytest.mark.parametrize("stands", [slice(0, 150), slice(400, 640), slice(1100, 1200)])
def test_poses_tell_where_it_was_while_the_georeference_stood(stands: slice) -> None:
    xy, yaw = path(), 0.8 * np.sin(TIMES / 9.0)
    zero = np.zeros(len(xy))
    lonlat = lonlat_from_enu(49.0, 8.4, xy)
    R_enu_lidar = rotation_from_rpy(zero, zero, yaw)
    true = Georeference(lonlat[:, 1], lonlat[:, 0], zero + 110.0, R_enu_lidar, "geo.csv", zero + 0.1)
    rows = np.arange(len(xy))
    rows[stands] = stands.start
    findings = Findings(stop_at_first=False)
    poses = poses_of(true)
    found = without_standing(poses, true.part(rows), np.arange(len(xy)), findings)
    off_m = enu_from_lonlat(found.lat_deg, found.lon_deg, lonlat)
    assert np.abs(off_m).max() < 0.05
    assert np.abs(found.R_enu_lidar - R_enu_lidar).max() < 1e-3
    (warning,) = findings.found
    assert f"scans {stands.start} to {stands.stop - 1}, " in warning.message
    assert without_standing(poses, true, np.arange(len(xy)), Findings(stop_at_first=True)) is true
