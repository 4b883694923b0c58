"""What an evaluation writes about every detection, intersection and node, and that it can be written again."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.evaluation.report import LAYER_FEATURES, map_line, render_html, report_record, write_report
from interloc.output.read import read_results
from interloc.output.vector_files import write_vector_file
from interloc.output.write import write_results
from interloc.results import DriveResult
from tests.evaluation.made import at, graph, run

NEW = ["outcome", "osm_id", "error_m", "reason"]


def features(folder: Path, layer: str) -> list[dict[str, Any]]:
    return json.loads((folder / f"{layer}.geojson").read_text(encoding="utf-8"))["features"]


def properties(evaluation: Evaluation, layer: str) -> list[dict[str, Any]]:
    """What the features of a layer would say."""
    features = LAYER_FEATURES[layer](evaluation, evaluation.result)
    return [each["properties"] | each.get("details", {}) for each in features]


def told(folder: Path, layer: str, *names: str) -> list[tuple[Any, ...]]:
    rows = [each["properties"] | each.get("details", {}) for each in features(folder, layer)]
    return [tuple(row[name] for name in names) for row in rows]


@pytest.fixture(scope="module")
def made() -> DriveResult:
    """Nodes at 0,0 (found) and 0,-15 (missed); intersections on the first, in the open, and far from the track."""
    result = run([(0, 0), (5, 0)], [(0, 1, 0), (1, 0, 2), (1, 12, 14), (1, 40, 40)], [(0.5, 1), (12, 14), (-45, 0)])
    fused = np.array([0, 0, 1, -1])
    return replace(result, detections=replace(result.detections, intersection=fused))


@pytest.fixture(scope="module")
def folder(made: DriveResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result that was scored. Shared: do not change it."""
    out = tmp_path_factory.mktemp("scored") / "out"
    write_results(made, out)
    write_report(evaluate(made, graph([(0, 0), (0, -15), (80, 0)], arm_m=15)), out)
    return out


def test_an_intersection_is_right_wrong_or_unscored(folder: Path) -> None:
    right, wrong, unscored = told(folder, "intersections", "outcome", "osm_id", "error_m", "reason", "uid")
    assert right[:2] == ("right", "100")
    assert right[2] == pytest.approx(1.118, abs=1e-3)
    assert right[3:] == (None, "n100")
    assert wrong[:3] == ("wrong", None, None)
    assert wrong[3].startswith("second one at a compound or wide junction: node 100, 18.4 m away")
    assert unscored[0] == "unscored"
    assert "relevant zone of no keyframe" in unscored[3]


def test_a_detection_is_right_or_wrong_and_names_its_node(folder: Path) -> None:
    rows = told(folder, "detections", "id", "outcome", "osm_id", "intersection")
    assert rows == [
        ("0-1", "right", "100", 1),
        ("10-1", "right", "100", 1),
        ("10-2", "wrong", "100", 2),
        ("10-3", *rows[3][1:]),
    ]
    assert rows[3][1] == "wrong"
    errors = [error for (error,) in told(folder, "detections", "error_m")]
    assert errors[:3] == pytest.approx([1.0, 2.0, 18.44], abs=0.01)
    assert [reason is None for (reason,) in told(folder, "detections", "reason")] == [True, True, False, False]


def test_a_node_is_found_missed_or_outside(folder: Path) -> None:
    rows = told(folder, "osm_nodes", "osm_id", "outcome", "intersection")
    assert rows == [("100", "found", 1), ("105", "missed", None), ("110", "outside", None)]
    reasons = [reason for (reason,) in told(folder, "osm_nodes", "reason")]
    assert reasons[0] is reasons[2] is None
    assert reasons[1]


def test_service_roads_can_be_counted_without_another_run() -> None:
    made = run([(0, 0)], [(0, 1, 0)], [(0.5, 1)])
    roads = graph([(0, 0)])
    roads = replace(roads, ways=replace(roads.ways, highway=("service",) * len(roads.ways)))
    report = report_record(evaluate(made, roads, policy="drive"))
    assert report["map_line"] == "1 not counted by this policy, 0 of 0 nodes found"
    assert [each["outcome"] for each in report["intersections"]] == ["not_counted"]
    assert (report["map_level"]["false"], report["map_level"]["precision"]) == (0, None)
    switched = report["with_service"]
    assert switched["map_line"].startswith("1 of 1 intersection right within 10 m, 1 of 1 node found")
    assert [(each["id"], each["outcome"], each["osm_id"]) for each in switched["intersections"]] == [
        (1, "right", "100")
    ]
    assert [each["outcome"] for each in switched["nodes"]] == ["found"]
    page = render_html(report, dict.fromkeys(("map", "thresholds"), ""))
    assert "With service roads counted too" in page


def test_a_match_joins_detection_node_and_intersection(folder: Path) -> None:
    assert told(folder, "matches", "detection", "intersection")[:3] == [("0-1", 1), ("10-1", 1), ("10-2", 2)]


def test_every_feature_has_an_id_of_its_own(folder: Path) -> None:
    for layer in ("intersections", "detections", "keyframes", "trajectory", "osm_nodes", "matches"):
        ids = [feature["id"] for feature in features(folder, layer)]
        assert len(set(ids)) == len(ids) > 0
    assert [feature["id"] for feature in features(folder, "detections")] == ["0-1", "10-1", "10-2", "10-3"]


def test_the_counts_of_reasons_are_those_of_the_layers(folder: Path) -> None:
    report = json.loads((folder / "report.json").read_text())
    for layer, outcome, name in (
        ("detections", "wrong", "detections"),
        ("intersections", "wrong", "intersections"),
        ("osm_nodes", "missed", "nodes"),
    ):
        assert sum(report["reasons"][name].values()) == told(folder, layer, "outcome").count((outcome,)) > 0
    level = report["map_level"]
    assert told(folder, "intersections", "outcome").count(("right",)) == level["true"] == 1
    assert told(folder, "intersections", "outcome").count(("wrong",)) == level["false"] == 1
    assert told(folder, "osm_nodes", "outcome").count(("missed",)) == level["missed"]


def test_the_report_leads_with_the_map(folder: Path) -> None:
    line = "1 of 2 intersections right within 10 m, 1 not judged, 1 of 2 nodes found, median 1.1 m"
    assert json.loads((folder / "report.json").read_text())["map_line"] == line
    page = (folder / "report.html").read_text()
    assert page.index(line) < page.index("Center error")
    assert "What is wrong, and why" in page


def test_a_node_that_was_detected_and_missed_is_not_found() -> None:
    evaluation = evaluate(run([(0, 0)], [(0, 1, 0)]), graph([(0, 0)]))  # no intersection came of it
    (node,) = properties(evaluation, "osm_nodes")
    assert (node["outcome"], node["found"], node["detected"]) == ("missed", False, True)


def test_the_line_of_a_map_with_nothing_in_it() -> None:
    level = {"true": 0, "intersections_in_zone": 1, "gate_m": 10.0, "nodes_in_zone": 1, "missed": 1, "median_m": None}
    level |= {"not_counted": 0, "not_judged": 0}
    assert map_line(level) == "0 of 1 intersection right within 10 m, 0 of 1 node found"


def test_scoring_again_replaces_the_verdicts(folder: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(folder, tmp_path / "out"))
    other = evaluate(read_results(out), graph([(12, 14)]))
    write_report(other, out)
    assert told(out, "intersections", "outcome", "osm_id")[:2] == [("wrong", None), ("right", "100")]
    again = evaluate(read_results(out), graph([(0, 0), (0, -15), (80, 0)], arm_m=15))
    for layer in ("intersections", "detections", "osm_nodes", "matches"):
        written = [each["properties"] | each.get("details", {}) for each in features(folder, layer)]
        assert properties(again, layer) == written


def test_detections_beyond_the_map_are_unscored(made: DriveResult) -> None:
    west, south = at((-60, -60))[0]
    east, north = at((30, 30))[0]
    evaluation = evaluate(made, graph([(0, 0)], areas=((west, south, east, north),)))
    beyond = properties(evaluation, "detections")[3]
    assert (beyond["outcome"], beyond["reason"]) == ("unscored", "beyond the bounds of the map")


def test_a_folder_of_an_older_version_opens_and_exports(folder: Path, tmp_path: Path) -> None:
    old = tmp_path / "old"
    old.mkdir()
    new = {
        "intersections": [*NEW, "uid", "first_time", "last_time", "names"],
        "detections": [*NEW, "id", "time"],
        "osm_nodes": ["outcome", "intersection", "reason", "names"],
        "matches": ["intersection"],
    }
    for path in folder.glob("*.*json"):
        content = json.loads(path.read_text())
        for feature in content.get("features", []):
            del feature["id"]
            feature["properties"] |= feature.pop("details", {})
            if feature["properties"].get("osm_id"):
                feature["properties"]["osm_id"] = int(feature["properties"]["osm_id"])
            for name in new.get(path.stem, []):
                del feature["properties"][name]
        (old / path.name).write_text(json.dumps(content))
    assert len(read_results(old).intersections) == 3
    assert "matches" in write_vector_file(old, tmp_path / "old.gpkg", layer="all")
