"""The plain part of the made-up town, seen by a LiDAR without noise: its plan is the truth; junctions alone."""

from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.config import preset
from interloc.drives.open import open_drive
from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.geometry import enu_from_lonlat
from interloc.lab.config import SimulationOptions, TrackConfig
from interloc.lab.drive import simulate
from interloc.lab.measure import MislabelledDrive
from interloc.lab.town import MAP_FILE, Town
from interloc.osm.reader import read_osm
from interloc.pipeline import detect
from interloc.results import DriveResult
from tests.chain.conftest import BARE_SCENE, EXACT_LIDAR, from_origin, junction_drive
from tests.towns import junctions_of

JUNCTIONS = junctions_of(Town("plain"))
RANGE_M = 20.0  # half of the relevant zone


@pytest.fixture(scope="module")
def town_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive through the plain part of the made-up town, its map beside it."""
    out = tmp_path_factory.mktemp("town") / "plain"
    options = SimulationOptions(keyframes_only=True, ground_only=True, scene=BARE_SCENE, sensor=EXACT_LIDAR)
    simulate(Town("plain").trip(TrackConfig(speed_mps=8.2)), out, options)
    return out


@pytest.fixture(scope="module")
def town_result(town_drive: Path) -> DriveResult:
    """What the default preset finds in it."""
    return detect(open_drive(town_drive, check=False))


@pytest.fixture(scope="module")
def evaluation(town_drive: Path, town_result: DriveResult) -> Evaluation:
    return evaluate(town_result, read_osm(town_drive / MAP_FILE))


def errors_m(name: str, lonlat: FloatArray | None) -> FloatArray:
    """Return the distances of places from where the plan has a junction."""
    assert lonlat is not None
    errors: FloatArray = np.hypot(*enu_from_lonlat(*JUNCTIONS[name].lonlat[::-1], lonlat).T)
    return errors


def test_every_node_is_found_and_nothing_else(evaluation: Evaluation) -> None:
    assert evaluation.node_table.in_zone.sum() == len(JUNCTIONS)
    assert evaluation.node_table.found.all()
    assert evaluation.scores.at(5.0, evaluation.scores.precision) == 1
    assert evaluation.scores.at(5.0, evaluation.scores.recall) == 1
    assert evaluation.verdicts.intersections.outcome == ["right"] * len(JUNCTIONS)  # each intersection once


def test_a_place_has_the_same_name_under_both_presets(evaluation: Evaluation, town_drive: Path) -> None:
    literal = detect(open_drive(town_drive, check=False), preset("paper"))
    of_paper = evaluate(literal, evaluation.graph).verdicts.uids
    assert set(of_paper) == set(evaluation.verdicts.uids) == {f"n{each.node_id}" for each in JUNCTIONS.values()}


@pytest.mark.parametrize("name", sorted(JUNCTIONS))
def test_intersection_of_the_map_is_where_the_plan_has_it(town_result: DriveResult, name: str) -> None:
    assert errors_m(name, town_result.intersections.lonlat).min() <= 0.3


@pytest.mark.parametrize("name", sorted(JUNCTIONS))
def test_detections_nearby_are_good_to_a_metre(town_result: DriveResult, name: str) -> None:
    errors = errors_m(name, town_result.detections.lonlat)
    near = np.abs(town_result.detections.lidar_xy).max(axis=1) <= RANGE_M
    assert np.median(errors[errors < 10]) <= 0.6
    assert errors[(errors < 10) & near].max() <= 1.0


@pytest.mark.parametrize("name", sorted(JUNCTIONS))
def test_intersection_has_the_arms_of_the_plan(town_result: DriveResult, name: str) -> None:
    nearest = int(np.argmin(errors_m(name, town_result.intersections.lonlat)))
    found, planned = town_result.intersections.bearings_deg[nearest], JUNCTIONS[name].bearings_deg
    assert len(found) == len(planned)
    apart = np.abs((found[:, None] - planned[None] + 180) % 360 - 180)
    assert apart.min(axis=1).max() < 3
    assert apart.min(axis=0).max() < 3


@pytest.fixture(scope="module")
def noisy_drive(town_drive: Path) -> MislabelledDrive:
    """20 % of the sidewalk, parking and other ground taken for road, 20 % of the road missed."""
    return MislabelledDrive(open_drive(town_drive, check=False), 0.2, 0.2, seed=1)


@pytest.fixture(scope="module")
def noisy_result(noisy_drive: MislabelledDrive) -> DriveResult:
    return detect(noisy_drive)


def test_with_label_errors_every_node_is_found_all_the_same(town_drive: Path, noisy_result: DriveResult) -> None:
    evaluation: Evaluation = evaluate(noisy_result, read_osm(town_drive / MAP_FILE))
    assert evaluation.node_table.in_zone.sum() == 5
    assert evaluation.node_table.found.all()
    assert evaluation.verdicts.intersections.outcome == ["right"] * 5


BRANCHES = {"X": 4, "T": 3, "Y": 3}
BOUND_M = 0.3
CASES = [  # every two of shape, angle and route meet
    (shape, angle_deg, ("straight", "turning")[(i + j) % 2])
    for i, shape in enumerate(BRANCHES)
    for j, angle_deg in enumerate((45, 60, 90, 120))
]


@pytest.mark.parametrize(("shape", "angle_deg", "route"), CASES)
def test_there_is_one_intersection_with_all_its_arms_where_the_streets_meet(
    tmp_path: Path, shape: str, angle_deg: float, route: str
) -> None:
    drive = open_drive(junction_drive(tmp_path / "drive", shape, angle_deg, route), check=False)
    found = detect(drive).intersections
    assert [len(bearings) for bearings in found.bearings_deg] == [BRANCHES[shape]]
    assert found.lonlat is not None
    assert from_origin(found.lonlat).max() <= BOUND_M
