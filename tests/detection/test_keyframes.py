"""Which scans are keyframes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from interloc.arrays import FloatArray
from interloc.config import KeyframeConfig
from interloc.detection.keyframes import select_keyframes
from interloc.geometry import rigid_transforms
from tests.small_drives import level_poses


def plain_select(T_world_lidar: FloatArray, distance_m: float, angle_deg: float) -> list[int]:
    chosen: list[int] = []
    for i, pose in enumerate(T_world_lidar):
        if chosen:
            last = T_world_lidar[chosen[-1]]
            moved = np.linalg.norm(pose[:3, 3] - last[:3, 3])
            turned = np.degrees(Rotation.from_matrix(last[:3, :3].T @ pose[:3, :3]).magnitude())
            if moved <= distance_m and turned <= angle_deg:
                continue
        chosen.append(i)
    return chosen


def test_scan_after_more_than_the_distance_is_taken() -> None:
    assert select_keyframes(level_poses([0, 1, 2, 2.01, 4, 4.02, 9]), KeyframeConfig()).tolist() == [0, 3, 5, 6]


def test_no_poses_no_keyframes() -> None:
    assert select_keyframes(np.empty((0, 4, 4)), KeyframeConfig()).tolist() == []


@given(st.integers(0, 2**32 - 1), st.sampled_from([(2.0, 5.0), (0.0, 0.0), (5.0, 180.0), (1000.0, 1.0)]))
def test_equals_the_plain_twin_on_a_random_walk_and_takes_all_its_choice_again(
    seed: int, limits: tuple[float, float]
) -> None:
    generator = np.random.default_rng(seed)
    shifts, turns = (np.cumsum(generator.normal(0, each, (60, 3)), axis=0) for each in (0.7, 0.02))
    path = rigid_transforms(Rotation.from_rotvec(turns).as_matrix(), shifts)
    config = KeyframeConfig(distance_m=limits[0], angle_deg=limits[1])
    chosen = select_keyframes(path, config)
    assert chosen.tolist() == plain_select(path, *limits)
    assert len(select_keyframes(path[chosen], config)) == len(chosen)
    later = chosen[len(chosen) // 2 :]  # a part of a drive chooses what the whole does
    assert len(select_keyframes(path[later], config)) == len(later)
