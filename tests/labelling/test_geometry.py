"""Labels by geometry: a crossing with kerbs, seen by sensors of many kinds."""

import pickle
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from interloc.arrays import Float32Array, FloatArray
from interloc.geometry import rotation_from_rpy
from interloc.labelling.geometry import BESIDE, OTHER_GROUND, ROAD, GeometryLabeller, brightness_of_strip
from interloc.labelling.surface import RANGE_M
from interloc.labelling.track import Track, WindowQuality, doubts_in_words, joined
from tests.small_drives import level_poses

ROAD_M, SIDEWALK_M = 4.0, 2.5
"""Half the width of a street; width of a sidewalk."""


@dataclass(frozen=True)
class Street:
    """How high the kerbs are, the remission of road, sidewalk and grass, where the sensor is (tilt: roll, pitch)."""

    kerb_m: float = 0.12
    shades: tuple[float, float, float] = (0.2, 0.3, 0.5)
    height_m: float = 1.8
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    beams: int = 32

    def poses(self, x: FloatArray, *, heading_rad: float = 0.0) -> FloatArray:
        """Return the poses of the sensor along the street, (N, 4, 4), in the world of the first."""
        poses = level_poses(x)
        poses[:, 2, 3] = self.height_m
        poses[:, :3, :3] = rotation_from_rpy(0.0, 0.0, heading_rad) @ rotation_from_rpy(*self.tilt_rad, 0.0)
        return poses

    def scan(self, pose: FloatArray, seed: int = 0) -> tuple[Float32Array, FloatArray]:
        """Return the (N, 4) points of a scan, and the (N,) distances from the middle of the nearer street."""
        generator = np.random.default_rng(seed)
        elevation = np.radians(np.linspace(-25.0, 5.0, self.beams))
        azimuth = np.radians(np.arange(0.0, 360.0, 0.6))
        e, a = (each.ravel() for each in np.meshgrid(elevation, azimuth, indexing="ij"))
        rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1) @ pose[:3, :3].T
        rays = rays[rays[:, 2] < -0.02]
        range_m = -pose[2, 3] / rays[:, 2]
        xy = pose[:2, 3] + range_m[:, None] * rays[:, :2]
        aside = np.abs(xy).min(axis=1)
        kind = (aside > ROAD_M).astype(np.int64) + (aside > ROAD_M + SIDEWALK_M)  # road, sidewalk, grass
        raised = (kind > 0) & (self.kerb_m > 0)
        range_m[raised] = (self.kerb_m - pose[2, 3]) / rays[raised, 2]
        range_m += generator.normal(0.0, np.array([0.01, 0.01, 0.04])[kind])
        shade = np.array(self.shades)[kind] * generator.uniform(0.8, 1.2, len(kind))
        points = np.column_stack([(range_m[:, None] * rays) @ pose[:3, :3], shade])
        near = range_m < 60.0
        return points[near].astype(np.float32), aside[near]


ALONG = np.arange(-40.0, 20.0, 2.5)
STREET = Street()
KERB_M = 0.5


@cache
def scans_along(street: Street) -> list[Float32Array]:
    return [street.scan(pose, seed)[0] for seed, pose in enumerate(street.poses(ALONG))]


def labeller_of(street: Street, poses: FloatArray) -> GeometryLabeller:
    is_usual = len(poses) == len(ALONG) and np.array_equal(poses, street.poses(ALONG))
    scans = scans_along(street) if is_usual else [street.scan(pose, seed)[0] for seed, pose in enumerate(poses)]
    return GeometryLabeller(poses, np.arange(len(poses)), scans.__getitem__)


def agreement(street: Street, poses: FloatArray, row: int) -> tuple[float, float]:
    """Return precision and recall of the road of a scan; the half metre along the kerb may be missed."""
    points, aside = street.scan(poses[row], row)
    found = labeller_of(street, poses).label(row, points) == ROAD
    range_m = np.linalg.norm(points[:, :3], axis=1)
    there = (aside < ROAD_M - KERB_M) & (range_m > 4.0) & (range_m < 35.0)
    return (found & (aside < ROAD_M)).sum() / found.sum(), (found & there).sum() / there.sum()


SENSORS = {
    "16 beams": replace(STREET, beams=16),
    "32 beams": STREET,
    "64 beams": replace(STREET, beams=64),
    "on a bus, tilted": replace(STREET, height_m=3.0, tilt_rad=(0.1, 0.25)),
    "remission up to 255": replace(STREET, shades=(51.0, 76.0, 128.0)),
    "no remission": replace(STREET, shades=(0.0, 0.0, 0.0)),
}
WAYS = {
    "scans near each other": (np.arange(-40.0, 25.0, 0.5), 60, 0.95, 0.85),
    "scans far apart": (np.arange(-40.0, 25.0, 16.0), 1, 0.95, 0.85),
    "backwards": (ALONG[::-1], 10, 0.95, 0.9),
    "standing": (np.full(12, -15.0), 5, 0.9, 0.6),
}
CASES = {name: (street, ALONG, 14, 0.92, 0.9) for name, street in SENSORS.items()}
CASES |= {name: (STREET, *way) for name, way in WAYS.items()}


@pytest.mark.parametrize(("street", "x", "row", "precise", "complete"), CASES.values(), ids=CASES.keys())
def test_road_ends_at_kerbs_and_goes_on_into_the_side_street(
    street: Street, x: FloatArray, row: int, precise: float, complete: float
) -> None:
    precision, recall = agreement(street, street.poses(x), row)
    assert precision > precise
    assert recall > complete


def test_ground_beside_the_road_and_other_things_are_told_apart() -> None:
    poses = STREET.poses(ALONG)
    points, aside = STREET.scan(poses[14], 14)
    points[0, 2] += 1.0  # something above the ground
    labels = labeller_of(STREET, poses).label(14, points)
    near = np.linalg.norm(points[:, :2], axis=1) < 20.0
    beside = near & (aside > ROAD_M + 1.0) & (aside < ROAD_M + SIDEWALK_M)
    assert (labels[beside] == BESIDE).mean() > 0.9
    assert labels[0] == 0
    assert set(np.unique(labels[aside < ROAD_M])) <= {0, ROAD, BESIDE, OTHER_GROUND}


def test_labels_depend_on_the_drive_alone() -> None:
    poses = STREET.poses(ALONG)
    labeller = labeller_of(STREET, poses)
    points = scans_along(STREET)
    in_order = [labeller.label(row, points[row]) for row in range(14)]  # beyond the 25 m of the first part
    sent = pickle.loads(pickle.dumps(GeometryLabeller(poses, np.arange(len(poses)), _Scans(points))))  # noqa: S301 - own
    for row in (13, 3, 11):
        np.testing.assert_array_equal(sent.label(row, points[row]), in_order[row])


class _Scans:
    def __init__(self, points: list[Float32Array]) -> None:
        self.points = points

    def __call__(self, row: int) -> Float32Array:
        return self.points[row]


def test_scans_without_ground_have_no_labels() -> None:
    poses = STREET.poses(ALONG)
    empty = np.zeros((0, 4), np.float32)
    labeller = GeometryLabeller(poses, np.arange(len(poses)), lambda _: empty)
    points = np.array([[5, 0, -1.8, 0], [np.nan, 0, 0, 0]], np.float32)
    np.testing.assert_array_equal(labeller.label(3, points), [0, 0])
    assert labeller.quality_of(3).is_doubtful


def test_points_that_are_no_numbers_or_too_far_have_no_label() -> None:
    poses = STREET.poses(ALONG)
    labeller = labeller_of(STREET, poses)
    points = np.array([[np.nan, 5, 0, 0], [np.inf, 5, 0, 0], [RANGE_M[1] + 1, 0, -1.8, 0], [8, 0, -1.8, 0]], np.float32)
    np.testing.assert_array_equal(labeller.label(14, points), [0, 0, 0, ROAD])


def test_quality_tells_a_street_with_kerbs_from_a_plain() -> None:
    plain = replace(STREET, kerb_m=0.0, shades=(0.3, 0.3, 0.3))
    street, flat = (labeller_of(each, each.poses(ALONG)) for each in (STREET, plain))
    for row in (0, 14):
        assert not street.quality_of(row).is_doubtful
        assert flat.quality_of(row).is_doubtful
    assert [window.start_m for window in flat.known_quality()] == [0.0, 25.0]


ODD = {
    "snow: all as bright, kerbs filled": replace(STREET, kerb_m=0.03, shades=(0.8, 0.8, 0.8)),
    "unpaved: no kerbs, hardly brighter beside": replace(STREET, kerb_m=0.0, shades=(0.3, 0.33, 0.4)),
    "no remission, low kerbs": replace(STREET, kerb_m=0.04, shades=(0.0, 0.0, 0.0)),
    "low kerbs": replace(STREET, kerb_m=0.05, shades=(0.3, 0.33, 0.4)),
}


@pytest.mark.parametrize("street", ODD.values(), ids=ODD.keys())
def test_odd_streets_are_right_or_told(street: Street) -> None:
    poses = street.poses(ALONG)
    labeller = labeller_of(street, poses)
    points, aside = street.scan(poses[14], 14)
    found = labeller.label(14, points) == ROAD
    precision = (found & (aside < ROAD_M)).sum() / found.sum()
    assert precision > 0.95 or labeller.quality_of(14).is_doubtful


def test_brightness_is_relative_to_what_the_same_laser_saw_of_the_strip() -> None:
    table = np.zeros((8, 3))
    table[2], table[3], table[6] = (100, 20, 4 + 1), (10, 3, 0.9 + 0.1), (9, 9, 9)
    result = brightness_of_strip(table)
    assert result[2, 0] == pytest.approx(0.2)
    assert result[3, 0] == pytest.approx(23 / 110)  # too few of its own
    np.testing.assert_allclose(result[6], [0, np.inf, 0.7])
    assert result[2, 1] == result[3, 1] > 0
    nothing = brightness_of_strip(np.tile([100.0, 0.0, 0.0], (4, 1)))
    np.testing.assert_allclose((5.0 - nothing[:, 0]) / nothing[:, 1] + nothing[:, 2], 0.0)


def test_a_drive_that_begins_on_grass_doubts_that_stretch_alone() -> None:
    x = np.arange(-90.0, 40.0, 2.5)
    poses = STREET.poses(x)
    poses[:, 1, 3] = np.interp(x, [-60.0, -30.0], [25.0, 0.0])  # across the sidewalk, to the street
    labeller = labeller_of(STREET, poses)
    assert labeller.quality_of(2).is_doubtful
    row = len(x) - 8
    assert not labeller.quality_of(row).is_doubtful
    points, aside = STREET.scan(poses[row], row)
    found = labeller.label(row, points) == ROAD
    assert (aside[found] < ROAD_M).mean() > 0.9


def track_of(poses: FloatArray) -> Track:
    return Track.of(poses, np.arange(len(poses)))


def test_windows_follow_the_distance_driven() -> None:
    track = track_of(level_poses(np.arange(0.0, 101.0, 5.0)))
    assert track.window_of(5) == 1
    assert track.rows_in(1).tolist() == [5, 6, 7, 8, 9]


def test_context_is_about_a_scan_every_two_metres() -> None:
    track = track_of(level_poses(np.arange(0.0, 300.0, 0.5)))
    distance = track.distance_m[track.context(4)]
    assert distance[0] >= 55.0
    assert distance[-1] < 170.0
    assert (np.diff(distance[1:]) == 2.0).all()


def test_a_stop_takes_no_other_scan_out_of_the_context() -> None:
    x = np.arange(0.0, 60.0, 12.0)
    halted = np.concatenate([x[:3], np.full(60, 24.0), x[3:]])
    assert halted[track_of(level_poses(halted)).context(0)].tolist() == x.tolist()


def test_scans_that_cannot_be_read_are_no_context() -> None:
    track = Track.of(level_poses(np.arange(0.0, 60.0, 3.0)), np.array([0, 2, 4, 19]))
    assert track.context(0).tolist() == [0, 2, 4, 19]


def test_trembling_is_no_motion() -> None:
    x = np.concatenate([np.random.default_rng(0).normal(0.0, 0.05, 500), np.arange(0.0, 10.0)])
    track = track_of(level_poses(x))
    assert track.distance_m[499] < 0.6
    assert track.distance_m[-1] == pytest.approx(9.0, abs=0.3)
    assert len(track.context(0)) == 10


def test_line_bends_as_the_vehicle_turns() -> None:
    angle = np.linspace(0.0, np.pi, 6)  # scans 12.6 m apart on a circle
    track = track_of(level_poses(20 * np.sin(angle), 20 * (1 - np.cos(angle)), angle))
    inside = (track.line[:, 3] > 0) & (track.line[:, 3] < track.distance_m[-1])
    radius = np.hypot(track.line[inside, 0], track.line[inside, 1] - 20)
    np.testing.assert_allclose(radius, 20.0, atol=0.1)


def test_line_goes_on_behind_the_first_scan_and_beyond_the_last() -> None:
    for backwards in (False, True):
        x = np.arange(0.0, 20.0)[:: -1 if backwards else 1]
        line = track_of(level_poses(x)).line
        assert line[:, 0].min() == pytest.approx(-4.0)
        assert line[:, 0].max() == pytest.approx(23.0)


def test_a_jump_of_the_poses_is_not_driven() -> None:
    line = track_of(level_poses(np.array([0.0, 5.0, 205.0, 210.0]))).line
    assert not ((line[:, 0] > 10.0) & (line[:, 0] < 200.0)).any()


def test_one_scan_alone_has_a_track() -> None:
    track = track_of(level_poses(np.zeros(1)))
    assert track.context(0).tolist() == [0]
    assert np.isfinite(track.line).all()


def test_little_contrast_a_wide_road_and_a_patched_strip_are_doubtful() -> None:
    assert not WindowQuality(0.0, 25.0, contrast=9.0, width_m=7.0, evenness=2.5).is_doubtful
    assert WindowQuality(0.0, 25.0, contrast=3.0, width_m=7.0, evenness=2.5).is_doubtful
    assert WindowQuality(0.0, 25.0, contrast=9.0, width_m=12.0, evenness=2.5).is_doubtful
    assert WindowQuality(0.0, 25.0, contrast=9.0, width_m=7.0, evenness=0.5).is_doubtful


def test_stretches_that_follow_each_other_are_one() -> None:
    assert joined([(25.0, 50.0), (100.0, 125.0), (125.0, 150.0)]) == [(25.0, 50.0), (100.0, 150.0)]
    assert "doubtful from 310 to 450 m, 1,000 to 1,025 m of the track" in doubts_in_words([(310, 450), (1000, 1025)])
