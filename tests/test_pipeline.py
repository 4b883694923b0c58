"""Whole drives: offline equals online, ranges and processes change nothing, errors and progress arrive."""

import itertools
import os
import subprocess
import sys
from itertools import islice
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from interloc.arrays import Float32Array, IntArray
from interloc.config import DEFAULT, DetectorConfig, with_settings
from interloc.detection.detector import Detector, KeyframeDetections
from interloc.detection.keyframes import select_keyframes
from interloc.drive import Georeference, GroundPoints, read_ahead, scans_of
from interloc.drives.folder import FolderDrive
from interloc.drives.open import open_drive
from interloc.errors import DriveError, GeoreferenceError
from interloc.pipeline import detect, detect_range, split, stream
from interloc.results import DriveResult
from tests.small_drives import level_poses, pose_text, write_scan

JUNCTIONS = [(40.0 * i, 0.0) for i in range(12)]


def ground() -> Float32Array:
    """Cover the roads of a street with a side road every 40 m, to the left and to the right in turn, in W."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-30, 500, 0.8), np.arange(-40, 40, 0.8)))
    nearest = np.round(x / 40)
    side = (np.abs(x - 40 * nearest) < 4) & (np.where(nearest % 2 == 0, y, -y) > 0)
    is_road = (np.abs(y) < 4) | side
    return np.column_stack([x, y, np.full(x.size, -1.73)])[is_road].astype(np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A SemanticKITTI sequence of 420 scans, a metre apart; every other one is a keyframe of `CONFIG`."""
    path = tmp_path_factory.mktemp("drive") / "00"
    world = ground()
    x = np.arange(420)
    poses = level_poses(x, np.sin(x / 20), np.arctan(np.cos(x / 20) / 20) - np.arctan(1 / 20))
    for frame, T in enumerate(poses):
        near = world[np.abs(world[:, 0] - frame) < 25]
        local = (near - T[:3, 3]) @ T[:3, :3]
        write_scan(path, frame, np.column_stack([local, np.zeros(len(local))]), 40)
    (path / "poses.txt").write_text(pose_text(poses))
    return path


def config_of(lookahead: int | None = None) -> DetectorConfig:
    values = DEFAULT.model_dump()
    values["keyframes"] |= {"distance_m": 1.5, "window": 6, "lookahead": lookahead}
    values["bev"] |= {"size_m": 84, "resolution_m": 0.6, "min_points": 1}
    return DetectorConfig.model_validate(values)


CONFIG = config_of()


@pytest.fixture(scope="module")
def drive(folder: Path) -> FolderDrive:
    return open_drive(folder, pose_frame="lidar", check=False)


def bits(found: KeyframeDetections) -> tuple[int, bytes, bytes, list[bytes], bytes]:
    angles = [a.tobytes() for a in found.branch_angles_rad]
    return found.keyframe.frame, found.world_xy.tobytes(), found.lidar_xy.tobytes(), angles, found.score.tobytes()


def table_bits(result: DriveResult) -> list[bytes]:
    found, map_ = result.detections, result.intersections
    columns = [found.keyframe, found.world_xy, found.lidar_xy, found.score, found.intersection, *found.bearings_deg]
    return [column.tobytes() for column in [*columns, map_.world_xy, map_.observations]]


def keyframes_of(drive: FolderDrive, config: DetectorConfig) -> IntArray:
    return select_keyframes(drive.T_world_lidar, config.keyframes)


@pytest.fixture(scope="module")
def result(drive: FolderDrive) -> DriveResult:
    return detect(drive, CONFIG)


# --- what a run yields -----------------------------------------------------------------------------------------------


def test_every_junction_is_found_and_becomes_one_intersection(result: DriveResult) -> None:
    passed = np.array([place for place in JUNCTIONS if 20 < place[0] < 400])
    map_ = result.intersections.world_xy
    distance = np.hypot(*np.moveaxis(map_[:, None] - passed, -1, 0))
    assert np.all(distance.min(axis=0) < 0.6)  # a cell
    assert np.all(np.count_nonzero(distance < 10, axis=0) == 1)


def test_run_is_recorded(result: DriveResult) -> None:
    run = result.run
    assert run["drive"] == "00"
    assert DetectorConfig.model_validate(run["config"]) == CONFIG
    assert (run["scans"], run["keyframes"], run["workers"]) == (420, 210, 1)
    assert run["georeference"] is None
    assert {"python", "interloc", "numpy", "numba"} <= set(run["versions"])
    assert 0 < sum(run["stage_seconds"].values()) <= run["seconds"]
    assert run["peak_memory_bytes"] > 10_000_000


def test_the_fusion_follows_the_configuration(drive: FolderDrive) -> None:
    picky = with_settings(CONFIG, ["fusion.min_observations=100", "fusion.min_confidence=0"])
    result = detect(drive, picky)
    assert len(result.detections) > 0
    assert len(result.intersections) == 0
    assert result.run["config"]["fusion"] == result.run["fusion"]
    assert result.run["fusion"]["min_observations"] == 100


def test_no_kernel_reads_memory_that_was_freed(folder: Path, tmp_path: Path) -> None:
    """Which an interpreter for developers overwrites at once."""
    found = []
    for allocator in ("malloc", "debug"):
        command = [sys.executable, "-m", "interloc", "run", folder, "-o", tmp_path / allocator, "--pose-frame", "lidar"]
        subprocess.run(command, capture_output=True, check=True, env=os.environ | {"PYTHONMALLOC": allocator})
        found.append((tmp_path / allocator / "intersections.local.json").read_bytes())
    assert found[0] == found[1]


# --- one code path ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lookahead", [0, None])
def test_offline_is_the_online_detector_fed_from_the_drive(drive: FolderDrive, lookahead: int | None) -> None:
    config = config_of(lookahead)
    keyframes = keyframes_of(drive, config)[:60]
    offline = detect_range(drive, keyframes, 0, 60, config).detections
    detector = Detector(config)
    scans = scans_of(drive, range(keyframes[-1] + 1))
    online = [found for scan in scans if (found := detector.push(scan)) is not None] + list(detector.finish())
    assert [bits(found) for found in online] == [bits(found) for found in offline]
    assert sum(len(found.world_xy) for found in online) > 20


@pytest.mark.parametrize("lookahead", [0, 2, None])
def test_ranges_with_their_halo_find_exactly_what_one_run_does(drive: FolderDrive, lookahead: int | None) -> None:
    config = config_of(lookahead)
    keyframes = keyframes_of(drive, config)[:60]
    whole = [bits(found) for found in detect_range(drive, keyframes, 0, 60, config).detections]
    for edges in ([0, 30, 60], [0, 1, 5, 17, 59, 60]):
        parts = [detect_range(drive, keyframes, start, stop, config) for start, stop in itertools.pairwise(edges)]
        assert [part.start for part in parts] == edges[:-1]
        assert [bits(found) for part in parts for found in part.detections] == whole


@pytest.mark.parametrize(("shortest", "ranges"), [(100, 2), (20, 11)])
def test_two_processes_find_exactly_what_one_does(
    drive: FolderDrive, result: DriveResult, monkeypatch: pytest.MonkeyPatch, shortest: int, ranges: int
) -> None:
    monkeypatch.setattr("interloc.pipeline._MIN_RANGE_KEYFRAMES", shortest)
    steps: list[tuple[int, int]] = []
    parallel = detect(drive, CONFIG, workers=2, progress=lambda done, total: steps.append((done, total)))
    assert table_bits(parallel) == table_bits(result)
    assert parallel.run["workers"] == 2
    assert set(parallel.run["stage_seconds"]) == set(result.run["stage_seconds"])
    assert steps[-1] == (210, 210)
    assert len(steps) == ranges


# --- ranges ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "workers"), [(1, 1), (5000, 1), (1, 8), (199, 4), (200, 2), (1234, 3), (100_000, 8)])
def test_ranges_cover_all_keyframes_once(count: int, workers: int) -> None:
    ranges = split(count, workers)
    assert ranges[0][0] == 0
    assert ranges[-1][1] == count
    assert all(a[1] == b[0] for a, b in itertools.pairwise(ranges))
    assert all(start < stop for start, stop in ranges)


def test_ranges_are_several_per_process_but_none_is_short() -> None:
    assert len(split(5000, 1)) == 1
    assert len(split(199, 2)) == 1
    assert split(210, 2) == [(0, 105), (105, 210)]
    assert [stop - start for start, stop in split(800, 2)] == [50, 100, 100, 100, 50, 100, 100, 100, 100]
    assert len(split(5000, 2)) == 17


# --- progress and errors ---------------------------------------------------------------------------------------------


def test_progress_counts_the_keyframes(drive: FolderDrive, result: DriveResult) -> None:
    steps: list[tuple[int, int]] = []
    again = detect(drive, CONFIG, progress=lambda done, total: steps.append((done, total)))
    assert steps == [(i + 1, 210) for i in range(210)]
    assert table_bits(again) == table_bits(result)


@pytest.fixture
def damaged(folder: Path, tmp_path: Path, drive: FolderDrive) -> FolderDrive:
    """The drive, with a scan cut off since it was opened."""
    copy = tmp_path / "00"
    (copy / "velodyne").mkdir(parents=True)
    for scan in (folder / "velodyne").iterdir():
        (copy / "velodyne" / scan.name).hardlink_to(scan)
    (copy / "labels").symlink_to(folder / "labels")
    (copy / "poses.txt").write_text((folder / "poses.txt").read_text())
    opened = open_drive(copy, pose_frame="lidar", check=False)
    scan = copy / "velodyne" / "000300.bin"
    content = scan.read_bytes()
    scan.unlink()
    scan.write_bytes(content[:-7])
    return opened


@pytest.mark.parametrize("workers", [1, 2])
def test_damaged_scan_is_named_whichever_process_reads_it(damaged: FolderDrive, workers: int) -> None:
    with pytest.raises(DriveError, match=r"velodyne/000300\.bin"):
        detect(damaged, CONFIG, workers=workers)


class EmptyDrive:
    name = "nothing"
    frames = np.empty(0, np.int64)
    T_world_lidar = np.empty((0, 4, 4))
    times_s = None
    georeference = None

    def ground_points(self, index: int) -> GroundPoints:
        raise NotImplementedError


def test_drive_without_scans_is_refused() -> None:
    with pytest.raises(DriveError, match="nothing: the drive holds no scans"):
        detect(EmptyDrive(), CONFIG)


class CountingDrive:
    """A drive of scans without points, which records what was read; scan 5 is damaged."""

    def __init__(self, count: int) -> None:
        self.name, self.frames = "counted", np.arange(count)
        self.T_world_lidar, self.times_s = np.tile(np.eye(4), (count, 1, 1)), None
        self.georeference: Georeference | None = None
        self.is_slow = True
        self.begun: list[int] = []

    def ground_points(self, index: int) -> GroundPoints:
        self.begun.append(index)
        if index == 5:
            raise DriveError("scan 5 is damaged")
        return GroundPoints(np.full((1, 3), index, np.float32), 1)


@pytest.mark.parametrize(
    "column",
    [
        {"name": None},
        {"T_world_lidar": np.tile(np.eye(4), (8, 1, 1))},
        {"T_world_lidar": [np.eye(4)] * 9},
        {"times_s": np.arange(8.0)},
        {"frames": np.array([*range(5), *range(4)])},
    ],
)
def test_columns_of_a_drive_that_do_not_belong_together_are_refused(column: dict[str, Any]) -> None:
    drive = CountingDrive(9)
    vars(drive).update(column)
    for run in (lambda: detect(drive, CONFIG), lambda: next(stream(drive, CONFIG))):
        with pytest.raises(DriveError, match="a drive has a text as name, N ascending frames"):
            run()


def test_a_fix_that_is_no_number_is_told_before_any_scan_is_read() -> None:
    drive = CountingDrive(9)
    places = np.full((9, 2), (8.4, 49.0))
    places[0, 0] = np.nan
    drive.georeference = Georeference(places[:, 1], places[:, 0], np.zeros(9), np.tile(np.eye(3), (9, 1, 1)), "fixes")
    with pytest.raises(GeoreferenceError, match="fixes: scan number 1 of the drive has no fix"):
        detect(drive, CONFIG)
    assert drive.begun == []


def test_scans_are_read_ahead_but_not_far() -> None:
    drive = CountingDrive(20)
    for index, scan in enumerate(read_ahead(scans_of(drive, [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]), threads=3)):
        assert len(drive.begun) <= index + 4
        np.testing.assert_array_equal(scan.road_points, [[scan.index] * 3])
    assert sorted(drive.begun) == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]  # each once


def test_several_scans_are_read_at_the_same_time() -> None:
    together = Barrier(3)
    drive = CountingDrive(5)
    drive.ground_points = lambda _: GroundPoints(np.full((1, 3), together.wait(60), np.float32), 1)
    assert len([scan.road_points for scan in islice(read_ahead(scans_of(drive, range(3)), threads=3), 3)]) == 3


def test_a_damaged_scan_that_was_read_ahead_is_told_in_its_place() -> None:
    scans = read_ahead(scans_of(CountingDrive(9)), threads=4)
    for _ in range(5):
        next(scans).road_points  # noqa: B018 - reads them
    damaged = next(scans)
    with pytest.raises(DriveError, match="scan 5 is damaged"):
        damaged.road_points  # noqa: B018
