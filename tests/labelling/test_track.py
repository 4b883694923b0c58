"""The driven track, cut into windows."""

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.labelling.track import Track, WindowQuality, doubts_in_words, joined


def poses_at(x: FloatArray, y: FloatArray | None = None, heading_rad: FloatArray | None = None) -> FloatArray:
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    poses[:, 0, 3] = x
    if y is not None:
        poses[:, 1, 3] = y
    if heading_rad is not None:
        c, s = np.cos(heading_rad), np.sin(heading_rad)
        poses[:, :2, :2] = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return poses


def track_of(poses: FloatArray) -> Track:
    return Track.of(poses, np.arange(len(poses)))


def test_windows_follow_the_distance_driven() -> None:
    track = track_of(poses_at(np.arange(0.0, 101.0, 5.0)))
    assert track.window_of(5) == 1
    assert track.rows_in(1).tolist() == [5, 6, 7, 8, 9]


def test_context_is_about_a_scan_every_two_metres() -> None:
    track = track_of(poses_at(np.arange(0.0, 300.0, 0.5)))
    distance = track.distance_m[track.context(4)]
    assert distance[0] >= 55.0
    assert distance[-1] < 170.0
    assert (np.diff(distance[1:]) == 2.0).all()


def test_scans_that_cannot_be_read_are_no_context() -> None:
    track = Track.of(poses_at(np.arange(0.0, 60.0, 3.0)), np.array([0, 2, 4, 19]))
    assert track.context(0).tolist() == [0, 2, 4, 19]


def test_trembling_is_no_motion() -> None:
    x = np.concatenate([np.random.default_rng(0).normal(0.0, 0.05, 500), np.arange(0.0, 10.0)])
    track = track_of(poses_at(x))
    assert track.distance_m[499] < 0.6
    assert track.distance_m[-1] == pytest.approx(9.0, abs=0.3)
    assert len(track.context(0)) == 10


def test_line_bends_as_the_vehicle_turns() -> None:
    angle = np.linspace(0.0, np.pi, 6)  # scans 12.6 m apart on a circle
    track = track_of(poses_at(20 * np.sin(angle), 20 * (1 - np.cos(angle)), angle))
    inside = (track.line[:, 3] > 0) & (track.line[:, 3] < track.distance_m[-1])
    radius = np.hypot(track.line[inside, 0], track.line[inside, 1] - 20)
    np.testing.assert_allclose(radius, 20.0, atol=0.1)


def test_line_goes_on_behind_the_first_scan_and_beyond_the_last() -> None:
    for backwards in (False, True):
        x = np.arange(0.0, 20.0)[:: -1 if backwards else 1]
        line = track_of(poses_at(x)).line
        assert line[:, 0].min() == pytest.approx(-4.0)
        assert line[:, 0].max() == pytest.approx(23.0)


def test_a_jump_of_the_poses_is_not_driven() -> None:
    line = track_of(poses_at(np.array([0.0, 5.0, 205.0, 210.0]))).line
    assert not ((line[:, 0] > 10.0) & (line[:, 0] < 200.0)).any()


def test_one_scan_alone_has_a_track() -> None:
    track = track_of(poses_at(np.zeros(1)))
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
