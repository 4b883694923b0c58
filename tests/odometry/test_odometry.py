"""Poses from points: the motion of a LiDAR down a street, told where it cannot be followed; taken out of the scans."""

import sys

import numpy as np
import pytest
from numpy.typing import ArrayLike

from interloc.arrays import FloatArray
from interloc.errors import DriveError
from interloc.geometry import invert_transform
from interloc.odometry import Odometry, Velocity, is_bent, register
from tests.street_points import TURN_S, poses_along, seen, seen_driving, street


def follow(
    poses: FloatArray, *, clock: FloatArray | None = None, deskew: bool = True, speeds: FloatArray | None = None
) -> FloatArray:
    world, odometry = street(), Odometry(deskew=deskew)
    found = []
    for row, pose in enumerate(poses):
        xyz, times_s = (seen(world, pose), None) if speeds is None else seen_driving(world, pose, speeds[row])
        found.append(odometry.add(xyz, float(row) if clock is None else clock[row], times_s))
    return np.array(found)


def error_m(found: FloatArray, poses: FloatArray) -> float:
    truth = invert_transform(poses[0]) @ poses
    return float(np.linalg.norm(found[:, :3, 3] - truth[:, :3, 3], axis=1).max())


def test_a_scan_laid_onto_another() -> None:
    world, poses = street(), poses_along(np.array([1.5]), turn_rad=0.05)
    found = register(seen(world, poses[1]), seen(world, poses[0]))
    np.testing.assert_allclose(found.T_target_source, invert_transform(poses[0]) @ poses[1], atol=0.02)
    assert found.inlier_share > 0.8
    assert found.information > 1


def test_scans_that_share_nothing_do_not_fit() -> None:
    world = street()
    found = register(seen(world, poses_along(np.zeros(1))[0]), seen(street(1)[:, [1, 0, 2]], np.eye(4)))
    assert found.inlier_share < 0.6


def test_no_points_fit_nothing() -> None:
    assert register(np.zeros((0, 3), np.float32), np.full((9, 3), np.nan, np.float32)).inlier_share == 0


@pytest.mark.parametrize(
    ("steps", "turn_rad", "clock"),
    [
        *(([speed] * 4, 0.0, None) for speed in (-1.2, 0.0, 0.7, 4.0)),  # it starts at any speed
        (np.linspace(2.0, 0.0, 11), 0.05, None),  # turns and brakes
        ([1.0, 1.0, 1.0, 3.0, 1.0, 1.0], 0.0, [0.0, 1.0, 2.0, 3.0, 6.0, 7.0, 8.0]),  # scans are missing
    ],
)
def test_a_drive_is_followed(steps: ArrayLike, turn_rad: float, clock: ArrayLike | None) -> None:
    poses = poses_along(np.array(steps), turn_rad=turn_rad)
    assert error_m(follow(poses, clock=None if clock is None else np.array(clock)), poses) < 0.1


def test_motion_within_scans_is_taken_out() -> None:
    poses = poses_along(np.full(12, 2.0))  # enough scans to see that errors of velocity do not build up
    speeds = np.full(13, 2.0 / TURN_S)
    clock = TURN_S * np.arange(13)
    assert error_m(follow(poses, clock=clock, speeds=speeds), poses) < 0.1


def test_the_same_scans_give_the_same_poses() -> None:
    poses = poses_along(np.full(2, 1.0), turn_rad=0.02)
    np.testing.assert_array_equal(follow(poses), follow(poses))


@pytest.mark.parametrize("steps", [[17.0, 17.0, 17.0], [1.0, 1.0, 14.0, 1.0]])
def test_scans_too_far_apart_are_refused(steps: list[float]) -> None:
    with pytest.raises(DriveError, match=r"it (does not fit|fits the scan before it at several places)|little in it"):
        follow(poses_along(np.array(steps)))


def test_nothing_that_stands_out_is_told() -> None:
    rng = np.random.default_rng(0)
    plane = np.column_stack([rng.uniform(-20, 20, (3_000, 2)), np.full(3_000, -1.7)]).astype(np.float32)
    odometry = Odometry()
    odometry.add(plane, 0.0)
    with pytest.raises(DriveError, match="little in it tells how far it is"):
        odometry.add(plane + np.float32([0.5, 0, 0]), 1.0)


def through_tunnel(length_m: float) -> float:
    """Drive into a tunnel of smooth walls 25 m ahead, and out of it; return how far off that ends, metres."""
    rng, world = np.random.default_rng(0), street()
    world = np.concatenate([world[world[:, 0] < 25], world[world[:, 0] > 25] + [length_m, 0, 0]])
    poses = poses_along(np.full(round((length_m + 25) / 3.0), 3.0))
    odometry, found = Odometry(), []
    for row, pose in enumerate(poses):
        along = pose[0, 3] + rng.uniform(-30, 30, 6_000)
        along = along[(along > 25) & (along < 25 + length_m)]
        around = rng.uniform(-10, 10, len(along))
        walls = np.column_stack([along, np.clip(around, -5, 5), np.clip(10 - np.abs(around), 0, 5)])
        found.append(odometry.add(np.concatenate([seen(world, pose), seen(walls, pose)]), float(row)))
    return error_m(np.array(found), poses)


def test_a_short_tunnel_is_followed() -> None:
    assert through_tunnel(15.0) < 0.5


def test_a_long_tunnel_is_told() -> None:
    with pytest.raises(DriveError, match=r"nothing has told how far|little in it"):
        through_tunnel(90.0)


def test_the_map_forgets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("interloc.odometry._FORGET_AFTER", 10)
    world, poses = street(), poses_along(np.full(40, 1.0))
    odometry = Odometry()
    sizes = []
    for row, pose in enumerate(poses):
        odometry.add(seen(world, pose), float(row))
        sizes.append(len(odometry._map))
    assert max(sizes[20:]) < 1.3 * sizes[20]


def test_without_small_gicp_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(DriveError, match=r"need small_gicp, which is not installed: pip .*(small-gicp|odometry)"):
        Odometry()


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
