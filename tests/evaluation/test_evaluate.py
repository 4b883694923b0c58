"""Scores by hand, what cannot be scored, what is worth a warning; roads of a drive against those of a map."""

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from interloc.errors import ConfigError, GeoreferenceError, MapError
from interloc.evaluation.coverage import track_bounds, track_to_road
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import LAYER_FEATURES, report_record
from interloc.evaluation.roads import score_roads
from interloc.geometry import wrap_longitude
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import intersection_nodes
from interloc.osm.reader import read_osm
from interloc.roadmap.network import RoadEdge, RoadNetwork, RoadNode
from tests.evaluation.made import at, graph, oxts_run, run
from tests.output.small import small_result, with_roads, write_folder

# Sequence: nodes of policy `drive` in the relevant zones along the IMU's track.
NODES_IN_ZONE = {"00": 26, "05": 13, "07": 7, "09": 11}


def test_one_keyframe_two_nodes_three_detections() -> None:
    made = run([(0, 0)], [(0, 1, 0), (0, 3, 4), (0, 12, 0)], [(0.5, 0)])
    record = report_record(evaluate(made, graph([(0, 0), (0, -18)], arm_m=15)))
    assert (record["keyframes"], record["detections"], record["matched"]) == (1, 3, 3)
    assert record["ace_m"] == pytest.approx((1 + 5 + 12) / 3, abs=1e-2)  # positions count as printed
    assert (record["tp"]["4.5"], record["fp"]["4.5"], record["fn"]["4.5"]) == (1, 2, 1)
    assert record["precision"]["5.5"] == pytest.approx(2 / 3, abs=1e-6)
    assert record["recall"]["5.5"] == pytest.approx(2 / 3, abs=1e-6)
    assert (record["nodes_in_zone"], record["nodes_found"]) == (2, 1)
    assert record["map_level"]["precision"] == 1.0
    assert record["map_level"]["recall"] == 0.5
    assert record["osm"] == {
        "source": "made-up.osm",
        "made_up": False,
        "date": "2024-01-01T00:00:00Z",
        "nodes": 2,
        "bounds": None,
        "highways": 8,
        "clipped_highways": 0,
        "buildings": 0,
    }


def test_zones_come_from_the_configuration_of_the_run() -> None:
    config = {"bev": {"size_m": 100.0}, "branches": {"outer_radius_m": 30.0}}
    result = evaluate(run([(0, 0)], config=config), graph([(0, 0)]))
    assert (result.roi_m, result.relevant_zone_m) == (100.0, 40.0)
    result = evaluate(run([(0, 0)], config=config), graph([(0, 0)]), roi_m=120, relevant_zone_m=60)
    assert (result.roi_m, result.relevant_zone_m) == (120.0, 60.0)


def test_a_zone_without_extent_is_refused() -> None:
    with pytest.raises(ConfigError, match="relevant zone is -20 m"):
        evaluate(run([(0, 0)], config={"branches": {"outer_radius_m": 70.0}}), graph([(0, 0)]))


def test_without_georeference_there_is_no_evaluation() -> None:
    with pytest.raises(GeoreferenceError, match="--oxts"):
        evaluate(run([(0, 0)], georeferenced=False), graph([(0, 0)]))


def test_a_map_of_another_place_is_refused() -> None:
    with pytest.raises(MapError, match=r"made-up\.osm covers lon .* the drive lies at .* 7\.0 km"):
        evaluate(run([(0, 7050)]), graph([(0, 0)]))


def test_a_map_of_another_continent_is_refused() -> None:
    elsewhere = graph([(0, 0)])
    elsewhere = graph([(0, 0)], lonlat=-elsewhere.lonlat)
    with pytest.raises(MapError, match="another sequence"):
        evaluate(run([(0, 0)]), elsewhere)


def test_a_map_that_covers_half_the_drive_is_worth_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="interloc"):
        result = evaluate(run([(0, 0), (0, 400)]), graph([(0, 0)]))
    assert "50% of the keyframes" in result.warnings[0]
    assert "50% of the keyframes" in caplog.text


def test_a_track_beside_the_roads_is_worth_a_warning() -> None:
    result = evaluate(run([(20, 12)]), graph([(0, 0)]))
    assert result.track_to_road_m == pytest.approx(12.0, abs=0.01)
    assert "12.0 m (median)" in result.warnings[0]


def test_what_lies_beyond_the_bounds_of_the_map_is_not_scored() -> None:
    (west, south), (east, north) = at([(-60, -60), (20, 60)])
    clipped = graph([(0, 0), (30, 0)], arm_m=15, areas=((west, south, east, north),))
    result = evaluate(run([(0, 0)], [(0, 1, 0), (0, 30, 0)], [(0, 0), (30, 0)]), clipped)
    assert (len(result.nodes), len(result.detections), result.detections_outside_map) == (1, 1, 1)
    assert result.scores.at(5.0, result.scores.precision) == 1.0


def test_distance_to_the_road_is_to_the_line_not_to_its_nodes() -> None:
    cross = graph([(0, 0)])
    assert track_to_road(at([(25, 2), (60, 0), (-3, -3)]), cross) == pytest.approx([2.0, 10.0, 3.0], abs=1e-3)


def test_warnings_of_the_map_are_those_of_the_evaluation() -> None:
    assert evaluate(run([(0, 0)]), graph([(0, 0)], warnings=("odd",))).warnings[0] == "odd"


def test_a_drive_across_the_180th_meridian_is_scored_like_any_other() -> None:
    made, roads = (
        run([(-20, 0), (0, 0), (20, 0)], detections=[(0, 1, 1), (2, 2, 0)], intersections=[(1, 1)]),
        graph([(0, 0)]),
    )
    there, there_roads = (moved(each) for each in (made, roads))
    assert there.keyframes.lonlat[:, 0].max() - there.keyframes.lonlat[:, 0].min() > 359.0
    assert track_bounds(there.keyframes.lonlat)[0] > 179.9 > -179.9 > track_bounds(there.keyframes.lonlat)[2]
    at_home, across = evaluate(made, roads), evaluate(there, there_roads)
    assert across.matching.error_m == pytest.approx(at_home.matching.error_m, abs=0.02)
    assert across.map_level.error_m == pytest.approx(at_home.map_level.error_m, abs=0.02)
    assert across.track_to_road_m == pytest.approx(at_home.track_to_road_m, abs=0.02)
    assert across.warnings == at_home.warnings
    assert all(-1 < line.bounds[2] - line.bounds[0] < 1 for line in across.geodataframe("osm_roads").geometry), "cut"


def moved(thing: Any) -> Any:
    """Return a run or a map, moved east until its middle lies on the 180th meridian."""

    def east(lonlat: np.ndarray) -> np.ndarray:
        return np.column_stack([wrap_longitude(lonlat[:, 0] + 180.0 - 8.4), lonlat[:, 1]])

    if isinstance(thing, RoadGraph):
        return replace(thing, lonlat=east(thing.lonlat))
    tables = {name: getattr(thing, name) for name in ("keyframes", "detections", "intersections")}
    return replace(thing, **{name: replace(table, lonlat=east(table.lonlat)) for name, table in tables.items()})


def test_bounds_of_a_drive_leave_room_for_the_roi() -> None:
    west, south, east, north = track_bounds(run([(0, 0), (1000, 500)]).keyframes.lonlat, margin_m=100)
    assert np.array([[west, south], [east, north]]) == pytest.approx(at([(-100, -100), (1100, 600)]), abs=1e-5)


@pytest.mark.parametrize("sequence", NODES_IN_ZONE)
def test_kitti_tracks_lie_on_their_roads(sequence: str, data: Callable[[str], Path]) -> None:
    roads = read_osm(data(f"kitti/osm/{sequence}.osm.gz"))
    nodes = intersection_nodes(roads)
    result = evaluate(oxts_run(data(f"kitti/oxts/{sequence}.txt.gz"), nodes.lonlat, noise_m=1.0), roads)
    assert 0.3 < result.track_to_road_m < 1.3
    assert result.warnings == ()
    record = report_record(result)
    assert record["nodes_in_zone"] == NODES_IN_ZONE[sequence]
    assert record["nodes_found"] == record["nodes_in_zone"]
    assert record["ace_m"] == pytest.approx(1.25, abs=0.06)  # the mean of a Rayleigh distribution of 1 m
    assert record["precision"]["5.0"] > 0.99
    assert record["map_level"]["recall"] == 1.0


ORIGIN = np.array([457_000.0, 5_428_000.0])


def road(number: int, *points: tuple[float, float], is_driven: bool = True) -> RoadEdge:
    xy = np.array(points) + ORIGIN
    profile = np.full(20, 6.4)
    return RoadEdge(number, 1, 2, xy, 6.5, 6.2, 6.8, profile, 1.0, 9, 0.05, is_driven)


def test_completeness_correctness_and_what_was_seen_of_each_way(tmp_path: Path) -> None:
    network = RoadNetwork(
        [RoadNode(1, "dead_end", ORIGIN), RoadNode(2, "dead_end", ORIGIN)],
        [road(1, (0, 1.5), (100, 1.5)), road(2, (0, 50), (100, 50), is_driven=False)],
        [shapely.box(*(ORIGIN - 10), *(ORIGIN + np.array([100, 130])))],
        32632,
    )
    places = {1: (-100, 0), 2: (200, 0), 3: (0, 100), 4: (100, 100)}  # half of the first way was seen
    lonlat = network.lonlat(np.array(list(places.values())) + ORIGIN)
    nodes = "".join(f'<node id="{n}" lat="{y:.9f}" lon="{x:.9f}"/>' for n, (x, y) in zip(places, lonlat, strict=True))
    ways = "".join(
        f'<way id="{10 + n}"><nd ref="{n}"/><nd ref="{n + 1}"/><tag k="highway" v="residential"/></way>' for n in (1, 3)
    )
    (tmp_path / "map.osm").write_text(f'<osm version="0.6">{nodes}{ways}</osm>')
    graph = read_osm(tmp_path / "map.osm")
    scores = score_roads(network, graph, "drive")
    text = (tmp_path / "map.osm").read_text().replace("</way>", '<tag k="oneway" v="-1"/></way>')
    (tmp_path / "back.osm").write_text(text)
    against = score_roads(network, read_osm(tmp_path / "back.osm"), "drive").ways
    assert against[0].offset_m == pytest.approx(-1.5, abs=0.05)  # left of the direction in which one may drive
    assert scores.completeness == pytest.approx(110 / 210, abs=0.04)  # the way at y = 100 has no road
    assert scores.correctness == pytest.approx(0.5)  # the road at y = 50 has no way
    assert scores.quality == pytest.approx(100 / 300, abs=0.03)
    first, second = (scores.ways[graph.ways.id.tolist().index(way)] for way in (11, 13))
    assert (first.seen_m, first.mapped) == (pytest.approx(110, abs=3), pytest.approx(1.0, abs=0.1))
    assert first.offset_m == pytest.approx(1.5, abs=0.05)
    assert (first.width_m, first.is_driven) == (6.4, True)
    assert (second.mapped, second.is_driven) == (0.0, False)
    assert np.isnan(second.width_m)


def test_the_report_and_the_ways_tell_what_was_seen(tmp_path: Path) -> None:
    out = write_folder(tmp_path / "out", with_roads(small_result()), scored=True)
    report = json.loads((out / "report.json").read_text())
    assert report["roads"].keys() == {"buffer_m", "completeness", "correctness", "quality", "map_m", "roads_m"}
    assert report["roads"]["completeness"] > 0.9
    ways = [each["properties"] for each in json.loads((out / "osm_roads.geojson").read_text())["features"]]
    assert ways[0]["width_m"] == pytest.approx(7, abs=0.3)
    assert [each["seen_m"] for each in ways] == [100.0, pytest.approx(2, abs=1)], "no road runs along the second"
    bare = evaluate(small_result(), read_osm(tmp_path / "out.place" / "map.osm"))
    assert report_record(bare)["roads"] is None
    assert {each["properties"]["seen_m"] for each in LAYER_FEATURES["osm_roads"](bare, bare.result)} == {None}
