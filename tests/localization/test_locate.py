"""A drive is placed where it was, or refused: what is accepted and what is not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import interloc
from interloc.errors import ConfigError, LocationError, MapError
from interloc.geometry import bearing_deg, wrap_angle, yaw_of
from interloc.localization.apply import require_found
from interloc.localization.evidence import MARGIN, MIN_ROAD, Evidence, decide, too_short
from interloc.localization.locate import Location, locate
from interloc.localization.track import sightings_of, track_of
from interloc.osm.graph import RoadGraph
from interloc.results import DriveResult
from tests.evaluation.made import run
from tests.localization.town import LAT_DEG, LON_DEG, MadeDrive, drive_along, graph_of, route_xy, town_graph
from tests.small_drives import level_poses


@pytest.fixture(scope="module")
def town() -> RoadGraph:
    return town_graph()


@pytest.fixture(scope="module")
def found(town: RoadGraph) -> tuple[MadeDrive, Location]:
    drive = drive_along(route_xy())
    return drive, locate(drive, town)


def test_a_drive_is_placed_where_it_was(found: tuple[MadeDrive, Location]) -> None:
    drive, location = found
    assert location.decision.outcome == "found"
    assert np.median(drive.error_m(location.georeference)) < 1.0
    assert np.percentile(drive.error_m(location.georeference), 95) < 3.0
    off = np.degrees(np.abs(wrap_angle(yaw_of(location.georeference.R_enu_lidar) - drive.true_yaw_rad)))
    assert np.median(off) < 0.5
    ahead_deg = bearing_deg(yaw_of(location.georeference.R_enu_lidar[:1]))[0]
    assert location.places[0].heading_deg == pytest.approx(ahead_deg, abs=0.5)
    assert len(location.georeference.lat_deg) == len(location.position_std_m) == len(drive.frames)
    assert np.all((location.position_std_m > 0.05) & (location.position_std_m < 10.0))


def test_the_lane_offset_is_found(found: tuple[MadeDrive, Location]) -> None:
    assert found[1].facts["lane_offset_m"] == pytest.approx(-1.5, abs=0.7)


def test_a_drive_in_a_mirror_is_refused(town: RoadGraph) -> None:
    drive = drive_along(route_xy() * [-1.0, 1.0])
    location = locate(drive, town)
    assert location.decision.outcome != "found"
    with pytest.raises(LocationError, match=r"made: .*Give a map that holds the roads driven"):
        require_found(location, drive.name)


def test_a_map_of_another_town_is_refused() -> None:
    xy = 150.0 * np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 2)
    xy = xy + np.random.default_rng(3).uniform(-45.0, 45.0, xy.shape)
    edges = [(i, i + 1) for i in range(63) if i % 8 != 7] + [(i, i + 8) for i in range(56)]
    assert locate(drive_along(route_xy()), graph_of(xy, edges)).decision.outcome != "found"


def test_a_short_drive_is_refused_at_once_in_words(town: RoadGraph) -> None:
    location = locate(drive_along(np.array([[0.0, 0.0], [60.0, 0.0]])), town)
    assert (location.decision.outcome, location.places) == ("not_found", [])
    assert "57 m long" in location.decision.reason


def test_a_straight_drive_is_ambiguous_on_streets_that_are_all_straight() -> None:
    xy = np.array([[0.0, 0.0], [1500.0, 0.0], [0.0, 400.0], [1500.0, 400.0]])
    location = locate(drive_along(np.array([[300.0, 0.0], [700.0, 0.0]])), graph_of(xy, [(0, 1), (2, 3)]))
    assert location.decision.outcome == "ambiguous"
    assert len(location.places) > 1
    with pytest.raises(LocationError, match=r"ambiguous: .*49\.\d+,8\.\d+ heading"):
        require_found(location, "straight")


@pytest.mark.parametrize(
    ("scale", "drift", "missing"), [(1.02, 0.0, ()), (1.0, -5.0, ()), (1.0, 0.0, ((21, 30), (29, 30)))]
)
def test_poses_that_drift_and_streets_that_the_map_lacks_do_no_harm(
    town: RoadGraph, scale: float, drift: float, missing: tuple[tuple[int, int], ...]
) -> None:
    drive = drive_along(route_xy(), scale=scale, drift_deg_per_km=drift)
    kept = np.array([tuple(sorted(edge)) not in missing for edge in town.edges.tolist()])
    location = locate(drive, replace(town, edges=town.edges[kept], edge_way=town.edge_way[kept]))
    if location.georeference is not None:
        assert np.median(drive.error_m(location.georeference)) < 3.0


def test_near_limits_the_search(town: RoadGraph) -> None:
    drive = drive_along(route_xy())
    location = locate(drive, town, near=(LAT_DEG, LON_DEG), radius_m=400.0)
    assert location.facts["map_km"] < 19.0
    with pytest.raises(MapError, match=r"holds no roads for cars within 1 km of 50\.0"):
        locate(drive, town, near=(50.0, LON_DEG), radius_m=1000.0)
    assert locate(drive, town, near=(LAT_DEG, LON_DEG), radius_m=100.0).georeference is None
    with pytest.raises(ConfigError, match="belong together"):
        locate(drive, town, near=(LAT_DEG, LON_DEG))


def test_the_record_lists_the_places_with_coordinates_and_figures(found: tuple[MadeDrive, Location]) -> None:
    record = found[1].record()
    assert record["outcome"] == "found"
    first = record["places"][0]
    assert abs(first["lat_deg"] - found[0].true_lonlat[0, 1]) < 1e-4
    assert first["score"] > record["places"][1]["score"]
    assert record["map"] == "town"


def test_a_real_drive_is_placed_without_gnss(data: Callable[[str], Path]) -> None:
    """KITTI 10, 0.9 km: the poses of SemanticKITTI, the trajectory alone, 166 km of roads; the truth is OXTS."""
    kitti = data("kitti")
    rows = np.loadtxt(kitti / "oxts" / "10.txt.gz")
    calibration = (kitti / "calib" / "10.txt").read_text().split("Tr:")[1].split()[:12]
    T_cam_lidar = np.vstack([np.array(calibration, dtype=np.float64).reshape(3, 4), [0, 0, 0, 1]])
    camera = np.tile(np.eye(4), (len(rows), 1, 1))
    camera[:, :3] = np.loadtxt(kitti / "poses_suma" / "10.txt")[: len(rows)].reshape(-1, 3, 4)
    poses = np.linalg.inv(T_cam_lidar) @ camera @ T_cam_lidar
    drive = MadeDrive(np.linalg.inv(poses[0]) @ poses, rows[:, 1::-1], rows[:, 5])
    location = locate(drive, interloc.read_osm(kitti / "karlsruhe.osm.gz"))
    assert location.decision.outcome == "found"
    assert location.georeference is not None
    assert np.median(drive.error_m(location.georeference)) < 2.5  # OXTS is the IMU, 0.8 m behind the LiDAR


def evidence(road: float, seen: int = 0, at_nodes: int = 0, missed: int = 0) -> Evidence:
    return Evidence(road, seen, at_nodes, at_nodes + missed, missed, 1.0, 0.0)


SEEN = evidence(0.9, seen=4, at_nodes=4)


@pytest.mark.parametrize(
    ("best", "runner_up", "by_chance", "length_m", "outcome"),
    [
        (evidence(0.9), 0.5, 0.5, 1000.0, "found"),
        (evidence(0.9), 0.9 - MARGIN / 2, 0.3, 1000.0, "ambiguous"),
        (evidence(0.9), 0.9 - 1.5 * MARGIN, 0.3, 1000.0, "found"),
        (evidence(0.9), 0.9 - 1.5 * MARGIN, 0.3, 500.0, "ambiguous"),  # a short drive needs a larger lead
        (SEEN, 1.4 - 1.5 * MARGIN, 0.3, 500.0, "found"),  # above all by its trajectory alone
        (SEEN, 1.4 - 1.2 * MARGIN, 0.3, 500.0, "ambiguous"),
        (SEEN, 1.4 - 1.2 * MARGIN, 0.3, 700.0, "found"),
        (evidence(0.9), 0.3, 0.9 - MARGIN / 2, 1000.0, "not_found"),  # no better than chance
        (evidence(MIN_ROAD - 0.01), 0.0, 0.0, 1000.0, "not_found"),  # beside the roads
        (None, 0.0, 0.0, 1000.0, "not_found"),
        (evidence(0.9, seen=6, at_nodes=6), 0.5, 0.5, 1000.0, "found"),
        (SEEN, 0.49, 1.33, 650.0, "found"),  # nothing but its own mirror image comes near
        (SEEN, 1.1, 1.33, 650.0, "not_found"),
        (SEEN, 0.49, 1.36, 650.0, "not_found"),
        (evidence(0.75, seen=4, at_nodes=4), 0.1, 1.18, 650.0, "not_found"),
        (evidence(0.99), 0.1, 0.92, 1000.0, "not_found"),  # without intersections
        (evidence(0.9, seen=6, at_nodes=1, missed=5), 0.5, 0.5, 1000.0, "not_found"),
        (evidence(0.8, seen=6, at_nodes=3, missed=4), 0.5, 0.5, 1000.0, "found"),  # far ahead of both
        (evidence(0.8, seen=6, at_nodes=3, missed=4), 0.5, 0.8, 1000.0, "not_found"),
        (evidence(0.8, seen=6, at_nodes=3, missed=4), 0.8, 0.5, 1000.0, "not_found"),
    ],
)
def test_a_place_must_lead_by_enough(
    best: Evidence | None, runner_up: float, by_chance: float, length_m: float, outcome: str
) -> None:
    assert decide(best, runner_up, by_chance, length_m).outcome == outcome


def test_reasons_and_advice_are_said() -> None:
    assert "longer drive" in too_short(12.0).advice
    assert "longer drive" in decide(evidence(0.9), 0.9 - MARGIN / 2, 0.3, 1000.0).advice
    assert "chance" in decide(evidence(0.9), 0.3, 0.9 - MARGIN / 2, 1000.0).reason
    wrong = evidence(0.9, seen=6, at_nodes=1, missed=5)
    assert "1 of the 6 intersections" in decide(wrong, 0.5, 0.5, 1000.0).reason


def test_intersections_count_for_both_sides() -> None:
    assert evidence(1.0, seen=4, at_nodes=4).score == 1.5
    assert evidence(1.0, seen=4, at_nodes=2, missed=2).intersections == 0.5
    assert evidence(1.0).score == 1.0


CROSSING = np.array([40.0, 5.0])


STRAIGHT = level_poses(2.0 * np.arange(60))


def run_over(poses: np.ndarray, keyframes: list[int]) -> DriveResult:
    """Detections of one crossing from some scans."""
    result = run(poses[:, :2, 3], [(row, *CROSSING) for row in keyframes], georeferenced=False)
    return replace(result, keyframes=replace(result.keyframes, frame=np.arange(len(poses))))


def test_a_crossing_is_one_sighting_with_its_branches() -> None:
    seen = sightings_of(run_over(STRAIGHT, list(range(10, 30))), np.arange(60), track_of(STRAIGHT))
    assert len(seen) == 1
    assert np.allclose(seen.xy, [CROSSING], atol=1e-6)
    assert 34.0 < seen.at_m[0] < 44.0
    angles = np.sort(np.degrees(wrap_angle(seen.angles_rad[0, :3])))
    assert np.allclose(angles, [-90.0, 0.0, 90.0], atol=1e-6)  # along -y, +x, +y
    assert np.isnan(seen.angles_rad[0, 3:]).all()
    assert np.allclose(seen.mirrored().xy, CROSSING * [1.0, -1.0], atol=1e-6)


def test_two_detections_are_no_intersection() -> None:
    assert len(sightings_of(run_over(STRAIGHT, [18, 20]), np.arange(60), track_of(STRAIGHT))) == 0
