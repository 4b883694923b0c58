"""The fast detector against the plain reference, over whole drives.

Pixels differ (another disc, another thinning), so results are compared: how many detections of each have one of the
other close by, and the maps that they are fused to. A corner that is found one pixel aside changes the start and mean
of each branch, and with them the point by up to some pixels: hence tolerances of up to a metre.
"""

from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.config import PAPER
from interloc.drive import Drive
from interloc.drives.open import open_drive
from interloc.pipeline import detect
from interloc.results import DriveResult
from tests.app.street import BLOCK_M, write_street
from tests.reference import detect_by_reference
from tests.towns import town_drive


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


def test_crossings_of_a_straight_street_are_found_alike(tmp_path: Path) -> None:
    drive = open_drive(write_street(tmp_path / "street", 30))
    fast, plain = detect(drive, PAPER), detect_by_reference(drive)
    assert plain.detections.keyframe.tolist() == fast.detections.keyframe.tolist()
    assert set(fast.detections.keyframe.tolist()) == set(range(30))
    assert gaps_m(fast, plain).max() < 0.5
    for result in (fast, plain):
        x, y = result.detections.world_xy.T
        assert np.hypot((x + BLOCK_M / 2) % BLOCK_M - BLOCK_M / 2, y).max() < 1.5
    counts = [[len(angles) for angles in result.detections.bearings_deg] for result in (fast, plain)]
    assert counts[0] == counts[1]
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
