"""Roads and buildings of the map near a drive, roads that were seen; what fails beside the answer is said."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

from interloc.errors import Beside, IncompleteError, OutputError
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.osm import reader
from interloc.osm.reader import read_osm
from interloc.output.roads import building_features
from interloc.output.write import write_results
from interloc.roadmap.graph import Edge, Graph, Node
from interloc.roadmap.topology import connect
from tests.evaluation.made import graph, run

BOUNDS = (8.39, 48.99, 8.42, 49.02)
CORNERS = [(8.4, 49.0), (8.4, 49.0001), (8.4002, 49.0001), (8.4002, 49.0)]  # clockwise
FAR = [(8.41, 49.0), (8.4102, 49.0), (8.4102, 49.0001)]


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """A street; of the buildings two are whole, one of them far from the street."""
    nodes = [*CORNERS, *FAR, (8.4, 49.0003), (8.402, 49.0003)]
    lines = [f'<node id="{i}" lat="{lat}" lon="{lon}"/>' for i, (lon, lat) in enumerate(nodes, 1)]
    ways = [
        (20, [1, 2, 3, 4, 1], ("building", "yes")),
        (21, [5, 6, 7, 5], ("building", "church")),
        (22, [1, 2, 3, 4], ("building", "yes")),  # open
        (23, [1, 2, 99, 4, 1], ("building", "yes")),  # a node is missing
        (24, [1, 2, 3, 1], ("building", "no")),
        (25, [1, 2, 1], ("building", "yes")),  # no area
        (30, [8, 9], ("highway", "residential")),
    ]
    for way, refs, (key, value) in ways:
        inside = "".join(f'<nd ref="{ref}"/>' for ref in refs)
        lines.append(f'<way id="{way}">{inside}<tag k="{key}" v="{value}"/></way>')
    path = tmp_path / "map.osm"
    path.write_text(f'<osm version="0.6">{"".join(lines)}</osm>')
    return path


def test_buildings_near_the_track_are_polygons(town: Path) -> None:
    graph = read_osm(town, BOUNDS)
    assert graph.buildings.id.tolist() == [20, 21]
    feature, *_ = building_features(graph, np.array([[8.4, 49.0003], [8.402, 49.0003]]))
    assert feature["properties"] == {"osm_id": "20", "osm_type": "way"}
    outline = shapely.geometry.shape(feature["geometry"])
    assert outline.equals(shapely.Polygon(CORNERS))
    assert outline.exterior.is_ccw
    assert building_features(graph, np.array([[8.3, 49.0]])) == []


def test_buildings_are_left_out_where_they_would_take_long(town: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(read_osm(town).buildings) == 0  # not of a whole map
    monkeypatch.setattr(reader, "MAX_NODES_WITH_BUILDINGS", 8)
    assert len(read_osm(town, BOUNDS).buildings) == 0


def fails(*_: object, **__: object) -> None:
    raise KeyError("unexpected")


@pytest.mark.parametrize(
    ("broken", "missing"),
    [
        ("interloc.output.write.roads", "the map of the roads"),
        ("interloc.evaluation.figures.map_figure", "the figure map"),
        ("interloc.evaluation.evaluate.score_roads", "the score of the roads"),
        ("interloc.evaluation.report.render_html", "report.html"),
        ("interloc.evaluation.report.building_features", "the layer osm_buildings"),
    ],
)
def test_what_fails_beside_the_answer_is_missing_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str, missing: str
) -> None:
    monkeypatch.setattr(broken, fails)
    result, beside = run([(0, 0)], [(0, 0, 0)]), Beside()
    write_results(result, tmp_path, beside=beside)
    write_report(evaluate(result, graph([(0, 0)])), tmp_path, beside=beside)
    assert any(each.startswith(f"{missing}: a fault of InterLoc itself: KeyError") for each in beside.missing)
    assert len(json.loads((tmp_path / "detections.geojson").read_text())["features"]) == 1
    assert json.loads((tmp_path / "report.json").read_text())["missing"] == beside.missing
    with pytest.raises(IncompleteError, match=missing):
        beside.check(tmp_path)


def test_a_full_disk_is_no_part_that_can_be_missing() -> None:
    with pytest.raises(OutputError), Beside().part("roads"):
        raise OutputError("no space left")


def test_a_road_that_passes_over_itself_is_one_road() -> None:
    """Two neighbouring arms of the crossing are the ends of one loop."""
    made = Graph()
    crossing = made.add_node(Node(np.zeros(2), 4.0))
    ends = [made.add_node(Node(np.array(xy), 4.0)) for xy in ((-90.0, 0.0), (0.0, -90.0))]
    corners = ([(0, 0), (-90, 0)], [(0, 0), (80, 0), (80, 80), (0, 80), (0, 0)], [(0, 0), (0, -90)])
    for end, line in zip((ends[0], crossing, ends[1]), corners, strict=True):
        stops = np.arange(0.0, 1.0 + 1e-9, 1.0 / (40 * (len(line) - 1))) * (len(line) - 1)
        xy = np.stack([np.interp(stops, range(len(line)), np.array(line, float)[:, axis]) for axis in (0, 1)], axis=-1)
        made.add_edge(Edge(crossing, end, xy, np.full(len(xy), 4.0), np.ones(len(xy), dtype=np.bool_)))
    connect(made, np.empty((0, 2)), [])
    (road,) = made.edges.values()
    assert {road.start, road.end} == set(ends)
    assert 480.0 < road.length_m < 520.0
