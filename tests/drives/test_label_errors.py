"""Segmentation errors on purpose."""

from pathlib import Path

import numpy as np
import pytest

from interloc.drives.open import open_drive
from interloc.errors import ConfigError
from interloc.lab.measure import MislabelledDrive, parse_level


def test_no_noise_changes_nothing_and_all_swaps_road_and_the_rest(sequence: Path) -> None:
    drive = open_drive(sequence)
    points = drive.ground_points(2)
    np.testing.assert_array_equal(MislabelledDrive(drive, 0.0, 0.0).ground_points(2).road, points.road)
    np.testing.assert_array_equal(MislabelledDrive(drive, 1.0, 1.0).ground_points(2).road, points.confusable)


def test_shares_are_kept(sequence: Path) -> None:
    drive = open_drive(sequence)
    noisy = MislabelledDrive(drive, 0.2, 0.05, seed=3)
    missed = taken = road = rest = 0
    for index in range(len(drive.frames)):
        clean, points = drive.ground_points(index), noisy.ground_points(index)
        kept = len(set(map(tuple, points.road)) & set(map(tuple, clean.road)))
        road, rest = road + len(clean.road), rest + len(clean.confusable)
        missed, taken = missed + len(clean.road) - kept, taken + len(points.road) - kept
    assert missed / road == pytest.approx(0.05, abs=0.01)
    assert taken / rest == pytest.approx(0.2, abs=0.02)


def test_the_same_points_err_whatever_the_order_and_others_by_another_seed(sequence: Path) -> None:
    drive = open_drive(sequence)
    one, again, other = (MislabelledDrive(drive, 0.2, 0.2, seed=seed) for seed in (1, 1, 2))
    forward = [one.ground_points(index).road for index in range(4)]
    backward = [again.ground_points(index).road for index in reversed(range(4))]
    for a, b in zip(forward, reversed(backward), strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(forward[0]) not in {len(forward[1]), len(other.ground_points(0).road)}


@pytest.mark.parametrize(("r_fpr", "r_fnr", "seed"), [(5, 0, 0), (0, -0.1, 0), (float("nan"), 0, 0), (0, 0, -1)])
def test_shares_that_are_none(sequence: Path, r_fpr: float, r_fnr: float, seed: int) -> None:
    with pytest.raises(ConfigError):
        MislabelledDrive(open_drive(sequence), r_fpr, r_fnr, seed)


@pytest.mark.parametrize("level", ["", "5", "5/", "a/b", "5/101", "-1/5", "5/5/5"])
def test_a_level_that_makes_no_sense_is_refused(level: str) -> None:
    assert parse_level(" 7.5 / 0 ") == (0.075, 0.0)
    with pytest.raises(ConfigError, match="such as 5/20"):
        parse_level(level)
