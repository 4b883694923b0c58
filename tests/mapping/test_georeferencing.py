"""Detections land where they are, whatever the poses drift."""

import math

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from interloc.arrays import FloatArray
from interloc.detection.detector import KeyframeDetections
from interloc.detection.keyframes import Keyframe
from interloc.drive import Georeference
from interloc.errors import GeoreferenceError
from interloc.geometry import lonlat_from_enu, rotate_2d, rotation_from_rpy
from interloc.mapping.georeferencing import build_tables
from interloc.results import DetectionTable, KeyframeTable
from tests.small_drives import level_poses

KARLSRUHE = (49.011, 8.42)


def keyframe(
    index: int, T_world_lidar: FloatArray, lidar_xy: list[list[float]], angles: list[list[float]]
) -> KeyframeDetections:
    lidar = np.array(lidar_xy, dtype=float).reshape(-1, 2)
    yaw = math.atan2(T_world_lidar[1, 0], T_world_lidar[0, 0])
    return KeyframeDetections(
        Keyframe(100 + index, T_world_lidar, 0.1 * index),
        lidar_xy=lidar,
        world_xy=rotate_2d(lidar, yaw) + T_world_lidar[:2, 3],
        branch_angles_rad=[np.array(a) for a in angles],
        score=np.full(len(lidar), 0.5),
        branch_widths_m=[np.full(len(a), np.nan) for a in angles],
        std_m=np.ones(len(lidar)),
    )


def tables_of(
    found: list[KeyframeDetections], georeference: Georeference | None
) -> tuple[KeyframeTable, DetectionTable]:
    scans = np.array([k.keyframe.frame - 100 for k in found], dtype=np.int64)
    return build_tables(found, scans, georeference)


def fixes(yaws: list[float], lonlat: FloatArray | None = None, tilt: float = 0.0) -> Georeference:
    n = len(yaws)
    places = np.tile([KARLSRUHE[1], KARLSRUHE[0]], (n, 1)) if lonlat is None else lonlat
    rotations = rotation_from_rpy(np.full(n, tilt), np.full(n, tilt), np.array(yaws))
    return Georeference(places[:, 1], places[:, 0], np.zeros(n), rotations, "a test")


def test_ten_metres_ahead_of_a_car_that_looks_north() -> None:
    """The heading in W is another one: only the fix decides."""
    tables = tables_of(
        [keyframe(0, level_poses(5, 5, 0.3), [[10, 0]], [[0.3, 0.3 + math.pi / 2]])], fixes([math.pi / 2])
    )
    keyframes, detections = tables
    azimuth, _, distance = pyproj.Geod(ellps="WGS84").inv(KARLSRUHE[1], KARLSRUHE[0], *detections.lonlat[0])
    assert distance == pytest.approx(10, abs=1e-4)
    assert azimuth == pytest.approx(0, abs=1e-4)
    assert_allclose(detections.bearings_deg[0], [0, 270], atol=1e-9)  # ahead is north, left is west
    assert keyframes.enu_yaw_rad is not None
    assert_allclose(keyframes.enu_yaw_rad, [math.pi / 2])
    assert_allclose(keyframes.world_yaw_rad, [0.3])


def test_the_tilt_of_the_car_does_not_move_a_levelled_detection() -> None:
    level = tables_of([keyframe(0, level_poses(0, 0, 0), [[40, 20]], [[]])], fixes([1.0]))[1].lonlat
    tilted = tables_of([keyframe(0, level_poses(0, 0, 0), [[40, 20]], [[]])], fixes([1.0], tilt=0.05))[1].lonlat
    assert level is not None
    assert tilted is not None
    assert_allclose(tilted, level, atol=1e-12)


def test_without_georeference_all_stays_in_the_world() -> None:
    keyframes, detections = tables_of([keyframe(0, level_poses(1, 2, 0), [[10, 0]], [[0.0, math.pi / 2]])], None)
    assert keyframes.lonlat is keyframes.enu_yaw_rad is detections.lonlat is None
    assert_allclose(detections.world_xy, [[11, 2]])
    assert_allclose(detections.bearings_deg[0], [90, 0])  # clockwise from +y of W


def test_rows_of_keyframes_with_none_one_and_two_detections() -> None:
    rows = [
        keyframe(0, level_poses(0, 0, 0), [], []),
        keyframe(4, level_poses(2, 0, 0), [[5, 0], [6, 0]], [[0.0], [0.0, 1.0, 2.0]]),
        keyframe(7, level_poses(4, 0, 0), [[3, 0]], [[]]),
    ]
    keyframes, detections = tables_of(rows, fixes([0.0] * 8))
    assert keyframes.frame.tolist() == [100, 104, 107]
    assert detections.keyframe.tolist() == [1, 1, 2]
    assert [len(b) for b in detections.bearings_deg] == [1, 3, 0]
    assert detections.intersection.tolist() == [-1, -1, -1]
    assert detections.score.tolist() == [0.5] * 3


def test_a_run_without_keyframes_has_empty_columns() -> None:
    keyframes, detections = tables_of([], fixes([0.0]))
    assert keyframes.world_xy.shape == detections.world_xy.shape == (0, 2)
    assert detections.lonlat.shape == (0, 2)


def test_a_georeference_of_another_drive_is_named() -> None:
    with pytest.raises(GeoreferenceError, match=r"a test: scan number 3 of the drive has no fix"):
        tables_of([keyframe(2, level_poses(0, 0, 0), [], [])], fixes([0.0, 0.0]))


@given(st.floats(-3, 3), st.floats(-500, 500), st.floats(-3, 3), st.floats(-1, 1))
def test_drift_of_the_poses_never_reaches_the_map(yaw: float, drift_m: float, start: float, drift_rad: float) -> None:
    """One intersection seen from two places whose W drifted apart: the fixes bring it to the same spot."""
    node = np.array([30.0, -12.0])  # in ENU
    places = np.array([[0.0, 0.0], [55.0, 20.0]])
    enu_yaws = [yaw, yaw + 1.0]
    world = [level_poses(0, 0, start), level_poses(drift_m, 7, start + 1.0 + drift_rad)]
    rows = []
    for index in range(2):
        (seen,) = rotate_2d((node - places[index])[None], -enu_yaws[index])
        world_yaw = math.atan2(world[index][1, 0], world[index][0, 0])
        rows.append(keyframe(index, world[index], [seen.tolist()], [[0.4 - enu_yaws[index] + world_yaw]]))
    lonlat = lonlat_from_enu(KARLSRUHE[0], KARLSRUHE[1], places)
    _, detections = tables_of(rows, fixes(enu_yaws, lonlat))
    _, _, error = pyproj.Geod(ellps="WGS84").inv(*detections.lonlat[0], *detections.lonlat[1])
    assert error < 1e-3  # what meridians turn within 60 m
    turn = (detections.bearings_deg[0] - detections.bearings_deg[1] + 180) % 360 - 180
    assert_allclose(turn, 0, atol=1e-6)
