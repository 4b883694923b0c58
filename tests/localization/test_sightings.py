"""Detections become landmarks: one for each passage of an intersection."""

from dataclasses import replace

import numpy as np

from interloc.geometry import wrap_angle
from interloc.localization.track import sightings_of, track_of
from interloc.results import DriveResult
from tests.evaluation.made import run

CROSSING = np.array([40.0, 5.0])


def straight(count: int = 60) -> np.ndarray:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = 2.0 * np.arange(count)
    return poses


def run_over(poses: np.ndarray, keyframes: list[int]) -> DriveResult:
    """Detections of one crossing from some scans."""
    result = run(poses[:, :2, 3], [(row, *CROSSING) for row in keyframes], georeferenced=False)
    return replace(result, keyframes=replace(result.keyframes, frame=np.arange(len(poses))))


def test_a_crossing_is_one_sighting_with_its_branches() -> None:
    poses = straight()
    seen = sightings_of(run_over(poses, list(range(10, 30))), np.arange(60), track_of(poses))
    assert len(seen) == 1
    assert np.allclose(seen.xy, [CROSSING], atol=1e-6)
    assert 34.0 < seen.at_m[0] < 44.0
    angles = np.sort(np.degrees(wrap_angle(seen.angles_rad[0, :3])))
    assert np.allclose(angles, [-90.0, 0.0, 90.0], atol=1e-6)  # along -y, +x, +y
    assert np.isnan(seen.angles_rad[0, 3:]).all()
    assert np.allclose(seen.mirrored().xy, CROSSING * [1.0, -1.0], atol=1e-6)


def test_two_detections_are_no_intersection() -> None:
    poses = straight()
    assert len(sightings_of(run_over(poses, [18, 20]), np.arange(60), track_of(poses))) == 0
