"""Which nodes only one of several runs found, which settings differ."""

from pathlib import Path
from typing import Any

import pytest

from interloc.errors import ConfigError, DamagedResultError
from interloc.evaluation.compare import compare_reports as compare
from interloc.evaluation.record import read_report

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
    plain = dict.fromkeys(("keyframes", "detections", "nodes_in_zone", "nodes_found"), 7)
    errors = dict.fromkeys(("ace_m", "median_m", "p95_m"), 1.25)
    osm = {"source": "map.osm", "date": None}
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
    a = {"drive_name": "07", "labels": "labels", "georeference": "geo.csv (poses of the LiDAR)"}
    told = compare_reports(["a", "b"], [report({}), report({})], [a, a | {"labels": "predictions"}])
    assert told["inputs"] == [{"name": "labels", "values": ["labels", "predictions"]}]
    assert told["settings"] == told["warnings"] == []
    told = compare_reports(["a", "b"], [report({}), report({})], [a, {"drive_name": "08"}])
    assert [row["name"] for row in told["inputs"]] == ["drive", "labels", "georeference"]
    assert [row["values"][1] for row in told["inputs"]] == ["08", None, None]
    (warning,) = told["warnings"]
    assert "different drives (07, 08)" in warning


def test_figures_that_do_not_stand_side_by_side_are_said() -> None:
    told = compare_reports(["a", "b"], [report({}), report({}, policy="all", keyframes=8)], [{}, {}])
    assert [w.split("different ")[1].split(" (")[0] for w in told["warnings"]] == [
        "ground truth policies",
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


def test_one_run_is_no_comparison() -> None:
    with pytest.raises(ConfigError, match="two runs or more"):
        compare_reports(["a"], [report({})], [{}])
