"""The report of an evaluation, its files and its page; reports side by side: nodes, settings and inputs that differ."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from interloc.errors import DamagedResultError
from interloc.evaluation.compare import compare_reports as compare
from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.evaluation.figures import map_figure, threshold_figure
from interloc.evaluation.record import read_report
from interloc.evaluation.report import write_report
from interloc.results import DriveResult
from tests.cli.conftest import strict_json
from tests.evaluation.made import graph, run

Scored = tuple[Evaluation, DriveResult]

FILES = ["detections.geojson", "figures/map.png", "figures/thresholds.svg", "intersections.geojson", "matches.geojson"]
FILES += ["osm_nodes.geojson", "osm_roads.geojson", "report.html", "report.json"]


@pytest.fixture(scope="module")
def scored() -> Scored:
    """Two keyframes, three nodes: one found, one missed, one out of reach; a detection far from everything."""
    made = run([(0, 0), (5, 0)], [(0, 1, 0), (1, 0, 2), (1, 40, 40)], [(0.5, 1)])
    return evaluate(made, graph([(0, 0), (0, -15), (80, 0)], arm_m=15)), made


@pytest.fixture(scope="module")
def folder(scored: Scored, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    write_report(scored[0], out)
    return out


def written(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_the_files_of_the_contract_are_there(folder: Path) -> None:
    assert written(folder) == FILES


def test_the_record_has_the_fields_of_the_contract(folder: Path) -> None:
    record = strict_json(folder / "report.json")
    fields = """policy osm keyframes detections matched ace_m ace_tp_m ace_under_10_m median_m p95_m rmse_m tp fp fn
        precision recall f1 roi_m relevant_zone_m nodes_in_zone nodes_found map_level"""
    assert set(fields.split()) <= set(record)
    assert (record["keyframes"], record["detections"], record["matched"]) == (2, 3, 3)
    assert (record["tp"]["5.0"], record["fp"]["5.0"], record["fn"]["5.0"]) == (2, 1, 2)
    assert list(record["precision"])[:2] == ["0.5", "1.0"]
    assert {"6.9", "13.3"} <= set(record["f1"])
    assert {node["osm_id"]: node["found"] for node in record["nodes"]} == {"100": True, "105": False}


def test_matches_lead_from_detection_to_node(folder: Path) -> None:
    features = strict_json(folder / "matches.geojson")["features"]
    assert [feature["properties"]["outcome"] for feature in features] == ["TP", "TP", "FP"]
    first = features[0]
    assert first["geometry"]["type"] == "LineString"
    assert first["geometry"]["coordinates"][1] == pytest.approx([8.4, 49.0], abs=1e-9)
    assert first["properties"]["frame"] == 0
    assert first["properties"]["error_m"] == pytest.approx(1.0, abs=1e-2)
    assert first["properties"]["osm_id"] == "100"


class Page(HTMLParser):
    """Collects the tags of a page and checks that they nest."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in {"meta", "img", "br"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_asks_no_server_for_anything(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.open == []
    names = {tag for tag, _ in page.tags}
    assert not names & {"script", "link", "iframe", "object", "form"}
    sources = [attributes["src"] for tag, attributes in page.tags if "src" in attributes]
    assert len(sources) == 2
    assert all(source is not None and source.startswith("data:image/") for source in sources)
    assert "@import" not in text
    assert not re.search(r"url\(", text)


def test_names_cannot_smuggle_markup_into_the_page(scored: Scored, tmp_path: Path) -> None:
    evaluation, result = scored
    evil = "<script>alert(1)</script> a $b_{ 2 $ 高速"  # nor confuse what draws text
    evil_run = replace(evaluation.result, drive=evil)
    evaluation = replace(evaluation, result=evil_run, graph=replace(evaluation.graph, source=evil), warnings=(evil,))
    run = {"config": {"a": evil, "ids": {40}}, "host": evil}
    write_report(evaluation, tmp_path, result=replace(result, drive=evil, run=run))
    assert written(tmp_path) == FILES
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in text
    assert text.count("&lt;script&gt;") >= 5
    assert "a $b_{ 2 $ 高速" in text


def test_a_run_that_found_nothing_has_a_report(tmp_path: Path) -> None:
    made = run([(0, 0)])
    write_report(evaluate(made, graph([(0, 0)])), tmp_path)
    assert strict_json(tmp_path / "report.json")["ace_m"] is None
    assert "no intersections, 0 of 1 node found" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_road_without_junction_has_a_report(tmp_path: Path) -> None:
    made = run([(0, 100)], [(0, 1, 100)])
    write_report(evaluate(made, graph([(0, 0)], arm_m=150), policy="consolidated"), tmp_path)
    assert "did not come close to any OSM intersection of this policy" in (tmp_path / "report.html").read_text(
        encoding="utf-8"
    )


def test_the_same_evaluation_gives_the_same_files(scored: Scored, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "osm_buildings.geojson").write_text("of an older map, which had some")
    write_report(scored[0], tmp_path)
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    assert written(tmp_path) == written(folder)


def test_figures_carry_units_and_every_detection(scored: Scored) -> None:
    evaluation, result = scored
    axes = map_figure(evaluation, result).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("east [m]", "north [m]", 1.0)
    counts = {str(line.get_label()).split(",")[0]: 0 for line in axes.lines}
    for line in axes.lines:
        counts[str(line.get_label()).split(",")[0]] += len(line.get_xdata())  # type: ignore[arg-type]
    assert (counts["detection"], counts["OSM node"], counts["OSM node out of reach"]) == (3, 2, 1)
    assert "[m]" in threshold_figure(evaluation).axes[0].get_xlabel()


NODES = {1: (8.0, 49.0), 2: (8.1, 49.0), 3: (8.2, 49.0), 4: (8.3, 49.0)}


def report(outcomes: dict[int, str], **values: Any) -> dict[str, Any]:
    """A report whose nodes are found, missed, or outside of the zone."""
    nodes = [
        {
            "osm_id": osm_id,
            "lon": NODES[osm_id][0],
            "lat": NODES[osm_id][1],
            "degree": 3,
            "in_zone": outcome != "outside",
            "found": outcome == "found",
            "outcome": outcome,
            "median_error_m": 1.5 if outcome == "found" else None,
        }
        for osm_id, outcome in outcomes.items()
    ]
    ratios = {name: {"5.0": 0.5} for name in ("precision", "recall", "f1")}
    level = {"precision": None, "recall": 1.0, "mean_m": 0.5, "median_m": 0.4, "true": 3, "false": 1}
    level |= {"nodes_in_zone": 4, "missed": 1, "intersections_in_zone": 4, "gate_m": 10.0}
    plain = dict.fromkeys(("keyframes", "detections", "nodes_in_zone", "nodes_found", "roi_m", "relevant_zone_m"), 7)
    errors = dict.fromkeys(("ace_m", "median_m", "p95_m"), 1.25)
    osm = {"source": "map.osm", "date": None, "nodes": 4}
    return {"policy": "drive", "osm": osm, **plain, **errors, **ratios, "map_level": level, "nodes": nodes, **values}


def compare_reports(*given: Any) -> dict[str, Any]:
    return compare(*given).model_dump()


def test_outcomes_of_nodes() -> None:
    a = report({1: "found", 2: "found", 3: "missed", 4: "missed"})
    b = report({1: "found", 2: "missed", 3: "found", 4: "missed"})
    told = compare_reports(["a", "b"], [a, b], [{}, {}])
    assert told["found_by_all"] == told["missed_by_all"] == 1
    assert told["found_only_by"] == [["2"], ["3"]]
    assert [(n["osm_id"], n["outcomes"], n["median_error_m"]) for n in told["nodes"]] == [
        ("2", ["found", "missed"], [1.5, None]),
        ("3", ["missed", "found"], [None, 1.5]),
    ]


def test_a_node_that_one_run_never_came_near_is_outside() -> None:
    told = compare_reports(
        ["a", "b", "c"], [report({1: "found"}), report({}), report({1: "outside", 2: "found"})], [{}, {}, {}]
    )
    assert [n["outcomes"] for n in told["nodes"]] == [["found", "outside", "outside"], ["outside", "outside", "found"]]
    assert told["found_only_by"] == [["1"], [], ["2"]]


def test_settings_that_differ_are_named_by_their_path() -> None:
    runs = [
        {"config": {"preset": "paper", "bev": {"size_m": 120.0, "resolution_m": 0.16}, "fusion": {"together": 0.1}}},
        {"config": {"preset": "paper", "bev": {"size_m": 120.0, "resolution_m": 0.25}, "fusion": {"together": 0.2}}},
        {"config": {"preset": "paper", "bev": {"size_m": 120.0}, "compound": None}, "workers": 3},
    ]
    assert compare_reports(["a", "b", "c"], [report({})] * 3, runs)["settings"] == [
        {"name": "bev.resolution_m", "values": [0.16, 0.25, None]},
        {"name": "fusion.together", "values": [0.1, 0.2, None]},
    ]


def test_inputs_that_differ_are_no_settings() -> None:
    a = {"drive_name": "07", "labels": "labels", "poses": "poses.txt", "georeference": "geo.csv (poses of the LiDAR)"}
    b = a | {"labels": "predictions", "poses": "b.tum"}
    told = compare_reports(["a", "b"], [report({}), report({})], [a, b])
    assert {row["name"]: row["values"][1] for row in told["inputs"]} == {"labels": "predictions", "poses": "b.tum"}
    assert told["settings"] == told["warnings"] == []
    told = compare_reports(["a", "b"], [report({}), report({})], [a, {"drive_name": "08"}])
    assert [row["name"] for row in told["inputs"]] == ["drive", "labels", "poses", "georeference"]
    assert [row["values"][1] for row in told["inputs"]] == ["08", None, None, None]
    (warning,) = told["warnings"]
    assert "different drives (07, 08)" in warning


def test_figures_that_do_not_stand_side_by_side_are_said() -> None:
    told = compare_reports(["a", "b"], [report({}), report({}, policy="all", keyframes=8, roi_m=160)], [{}, {}])
    assert [w.split("different ")[1].split(" (")[0] for w in told["warnings"]] == [
        "ground truth policies",
        "sides of the zones",
        "numbers of keyframes",
    ]
    assert {row["name"]: row["values"] for row in told["figures"]}["map_precision"] == [None, None]


def test_a_report_says_what_it_lacks_or_has_wrong(tmp_path: Path) -> None:
    wrong = {
        "[]": "does not hold a JSON object",
        "{}": "drive: Field required",
        '{"drive": 7}': "drive: Input should be a",
    }
    for content, message in wrong.items():
        (tmp_path / "report.json").write_text(content)
        with pytest.raises(DamagedResultError, match=message):
            read_report(tmp_path)
