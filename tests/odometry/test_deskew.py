"""The motion within a scan: taken out of the points, and known where it was taken out before."""

import numpy as np

from interloc.odometry import Velocity, is_bent
from tests.street_points import TURN_S, poses_along, seen, seen_driving, street

AHEAD = Velocity(np.array([15.0, 0.0, 0.0]), np.zeros(3))
START = poses_along(np.zeros(1))[0]


def test_points_come_back_to_where_they_were() -> None:
    raw, times_s = seen_driving(street(), START, 15.0)
    assert np.abs(raw - seen(street(), START)).max() > 1.4
    np.testing.assert_allclose(AHEAD.undo(raw, times_s), seen(street(), START), atol=1e-3)


def test_a_turn_is_taken_out() -> None:
    turning = Velocity(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    point = np.array([[10.0, 0.0, 0.5]], np.float32)
    moved = turning.undo(point, np.array([0.1], np.float32))
    np.testing.assert_allclose(moved, [[10 * np.cos(0.1), 10 * np.sin(0.1), 0.5]], rtol=1e-5)


def test_velocity_and_pose_are_inverse() -> None:
    velocity = Velocity(np.array([3.0, 0.2, -0.1]), np.array([0.1, -0.2, 0.3]))
    again = Velocity.between(velocity.after(0.4), 0.4)
    np.testing.assert_allclose(again.linear_mps, velocity.linear_mps)
    np.testing.assert_allclose(again.angular_radps, velocity.angular_radps)


def test_points_tell_whether_the_motion_is_still_in_them() -> None:
    raw, times_s = seen_driving(street(), START, 15.0)
    assert is_bent(raw, times_s, AHEAD) is True
    assert is_bent(AHEAD.undo(raw, times_s), times_s, AHEAD) is False


def test_a_standing_lidar_tells_nothing() -> None:
    raw, times_s = seen_driving(street(), START, 0.0)
    assert is_bent(raw, times_s, Velocity(np.zeros(3), np.zeros(3))) is None


def test_a_lidar_that_does_not_spin_tells_nothing() -> None:
    xyz = seen(street(), START)
    times_s = np.random.default_rng(0).uniform(0, TURN_S, len(xyz)).astype(np.float32)
    assert is_bent(xyz, times_s, AHEAD) is None
