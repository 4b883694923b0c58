"""Segmentation errors as in the paper (section V-C), from the scans to the map."""

from pathlib import Path

import pytest

from interloc.drives.open import open_drive
from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.lab.measure import MislabelledDrive
from interloc.lab.town import MAP_FILE
from interloc.osm.reader import read_osm
from interloc.pipeline import detect
from interloc.results import DriveResult


@pytest.fixture(scope="module")
def noisy_drive(town_drive: Path) -> MislabelledDrive:
    """20 % of the sidewalk, parking and other ground taken for road, 20 % of the road missed."""
    return MislabelledDrive(open_drive(town_drive, check=False), 0.2, 0.2, seed=1)


@pytest.fixture(scope="module")
def noisy_result(noisy_drive: MislabelledDrive) -> DriveResult:
    return detect(noisy_drive)


def test_every_node_is_found_all_the_same(town_drive: Path, noisy_result: DriveResult) -> None:
    evaluation: Evaluation = evaluate(noisy_result, read_osm(town_drive / MAP_FILE))
    assert evaluation.node_table.in_zone.sum() == 5
    assert evaluation.node_table.found.all()
    assert evaluation.map_level.recall == 1
    assert evaluation.map_level.precision == 1


def test_result_does_not_depend_on_the_number_of_processes(
    noisy_drive: MislabelledDrive, noisy_result: DriveResult
) -> None:
    other = detect(noisy_drive, workers=2)
    assert other.run["workers"] == 2
    for table, column in (("detections", "world_xy"), ("detections", "score"), ("intersections", "lonlat")):
        ours, theirs = (getattr(getattr(result, table), column) for result in (noisy_result, other))
        assert ours.tobytes() == theirs.tobytes()
