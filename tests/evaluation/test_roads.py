"""Roads of a drive against those of a map: what is there, what is missing, where it lies, how wide it is."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import LAYER_FEATURES, report_record
from interloc.evaluation.roads import score_roads
from interloc.osm.reader import read_osm
from interloc.roadmap.network import RoadEdge, RoadNetwork, RoadNode
from tests.output.small import small_result, with_roads, write_folder

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
    assert [each["width_m"] for each in ways] == [pytest.approx(7, abs=0.3), None]  # no road runs along the second
    bare = evaluate(small_result(), read_osm(tmp_path / "out.place" / "map.osm"))
    assert report_record(bare)["roads"] is None
    assert {each["properties"]["seen_m"] for each in LAYER_FEATURES["osm_roads"](bare, bare.result)} == {None}
