"""Detections become landmarks: one for each passage of an intersection."""

import numpy as np

from interloc.geometry import wrap_angle
from interloc.localization.track import sightings_of, track_of
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable, unknown_like

CROSSING = np.array([40.0, 5.0])


def straight(count: int = 60) -> np.ndarray:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = 2.0 * np.arange(count)
    return poses


def run_over(poses: np.ndarray, keyframes: list[int]) -> DriveResult:
    """Detections of one crossing from some scans."""
    count = len(poses)
    table = KeyframeTable(np.arange(count), np.full(count, np.nan), poses[:, :2, 3], np.zeros(count))
    rows = np.array(keyframes, dtype=np.int64)
    world = np.tile(CROSSING, (len(rows), 1))
    bearings = [np.array([0.0, 90.0, 270.0]) for _ in rows]  # along +y, +x, -x
    detections = DetectionTable(
        rows,
        world - poses[rows, :2, 3],
        world,
        None,
        bearings,
        np.ones(len(rows)),
        np.full(len(rows), -1),
        unknown_like(bearings),
    )
    none = np.zeros(0)
    ids = np.zeros(0, dtype=np.int64)
    fused = IntersectionTable(ids, np.zeros((0, 2)), None, none, ids, none, [], ids, ids, [])
    return DriveResult("made", table, detections, fused, poses[:, :2, 3], None)


def test_a_crossing_is_one_sighting_with_its_branches() -> None:
    poses = straight()
    seen = sightings_of(run_over(poses, list(range(10, 30))), np.arange(60), track_of(poses))
    assert len(seen) == 1
    assert np.allclose(seen.xy, [CROSSING], atol=1e-6)
    assert 34.0 < seen.at_m[0] < 44.0
    angles = np.sort(np.degrees(wrap_angle(seen.angles_rad[0, :3])))
    assert np.allclose(np.abs(angles), [180.0, 0.0, 90.0], atol=1e-6) or np.allclose(angles, [0.0, 90.0, 180.0])
    assert np.isnan(seen.angles_rad[0, 3:]).all()
    assert np.allclose(seen.mirrored().xy, CROSSING * [1.0, -1.0], atol=1e-6)


def test_two_detections_are_no_intersection() -> None:
    poses = straight()
    assert len(sightings_of(run_over(poses, [18, 20]), np.arange(60), track_of(poses))) == 0
