"""The fast detector against the plain reference, over whole drives.

Pixels differ (another disc, another thinning), so results are compared: how many detections of each have one of the
other close by, and the maps that they are fused to. A corner that is found one pixel aside changes the start and mean
of each branch, and with them the point by up to some pixels: hence tolerances of up to a metre.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from interloc.arrays import FloatArray, IntArray
from interloc.config import PAPER
from interloc.drive import Drive, Georeference, GroundPoints
from interloc.drives.open import open_drive
from interloc.pipeline import detect
from interloc.results import DriveResult
from tests.reference import detect_by_reference
from tests.towns import town_drive


@dataclass(frozen=True)
class Crossing:
    """A vehicle on a road 8 m wide that another one crosses at right angles, 30 m ahead of the first scan."""

    name: str = "crossing"
    scans: int = 6
    georeference: Georeference | None = None

    @property
    def frames(self) -> IntArray:
        return np.arange(self.scans)

    @property
    def T_world_lidar(self) -> FloatArray:
        poses = np.tile(np.eye(4), (self.scans, 1, 1))
        poses[:, 0, 3] = 3.0 * np.arange(self.scans)
        return poses

    @property
    def times_s(self) -> None:
        return None

    def ground_points(self, index: int) -> GroundPoints:
        random = np.random.default_rng(index)
        along, across = random.uniform(-70.0, 70.0, (2, 40_000)), random.uniform(-4.0, 4.0, (2, 40_000))
        x = np.concatenate([along[0], across[1] + 30.0 - 3.0 * index])
        y = np.concatenate([across[0], along[1]])
        xyz = np.column_stack([x, y, np.full(len(x), -1.7)]).astype(np.float32)
        return GroundPoints.split(xyz, np.ones(len(x), np.bool_))


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """The beginning of the small town, as far as behind its first two junctions."""
    return open_drive(town_drive(tmp_path_factory, 45))


def gaps_m(ones: DriveResult, others: DriveResult) -> FloatArray:
    """Return the distance from each detection to the nearest of the other run at the same keyframe; far: none."""
    a, b = ones.detections, others.detections
    distance = np.hypot(*np.moveaxis(a.world_xy[:, None] - b.world_xy[None], -1, 0))
    distance[a.keyframe[:, None] != b.keyframe[None]] = np.inf
    nearest: FloatArray = distance.min(axis=1)
    return nearest


def test_an_ideal_crossing_is_found_alike() -> None:
    drive = Crossing()
    fast, plain = detect(drive, PAPER), detect_by_reference(drive)
    assert plain.detections.keyframe.tolist() == fast.detections.keyframe.tolist() == list(range(6))
    for result in (fast, plain):
        assert np.hypot(*(result.detections.world_xy - (30.0, 0.0)).T).max() < 0.5
        assert [len(angles) for angles in result.detections.bearings_deg] == [4] * 6
    assert np.abs(fast.detections.score - plain.detections.score).max() < 0.1


def test_a_town_is_found_alike(town: Drive) -> None:
    fast, plain = detect(town, PAPER), detect_by_reference(town)
    assert len(plain.detections) > 20
    for gaps in (gaps_m(fast, plain), gaps_m(plain, fast)):
        assert np.mean(gaps < 1.0) >= 0.75
        assert np.median(gaps) < 0.8
    maps = fast.intersections.world_xy, plain.intersections.world_xy
    assert len(maps[0]) == len(maps[1])
    distance = np.hypot(*np.moveaxis(maps[0][:, None] - maps[1][None], -1, 0))
    assert distance.min(axis=1).max() < 1.0
