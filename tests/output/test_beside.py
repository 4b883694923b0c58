"""What is beside the answer of a run cannot lose it."""

import json
from pathlib import Path

import numpy as np
import pytest

from interloc.errors import Beside, IncompleteError, OutputError
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.output.write import write_results
from interloc.roadmap.graph import Edge, Graph, Node
from interloc.roadmap.topology import connect
from tests.evaluation.made import graph, run


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
    for number, (end, line) in enumerate(zip((ends[0], crossing, ends[1]), corners, strict=True)):
        stops = np.arange(0.0, 1.0 + 1e-9, 1.0 / (40 * (len(line) - 1))) * (len(line) - 1)
        xy = np.stack([np.interp(stops, range(len(line)), np.array(line, float)[:, axis]) for axis in (0, 1)], axis=-1)
        assert number < 3
        made.add_edge(Edge(crossing, end, xy, np.full(len(xy), 4.0), np.ones(len(xy), dtype=np.bool_)))
    connect(made, np.empty((0, 2)), [])
    (road,) = made.edges.values()
    assert {road.start, road.end} == set(ends)
    assert 480.0 < road.length_m < 520.0
