"""`interloc evaluate`: a result folder against OpenStreetMap."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import contents

REPORT = {"report.json", "report.html", "osm_nodes.geojson", "matches.geojson", "osm_roads.geojson", "figures"}


@pytest.fixture
def out(detected: Path, tmp_path: Path) -> Path:
    """A result folder of one's own."""
    return Path(shutil.copytree(detected, tmp_path / "out"))


def test_the_report_joins_the_result_as_that_of_a_run(interloc: Callable, out: Path, finished: Path, osm: Path) -> None:
    before = contents(out)
    outcome = interloc("evaluate", out, "--osm", osm)
    assert outcome.code == 0
    assert {path.name for path in out.iterdir()} == set(before) | REPORT
    judged = {"detections.geojson", "intersections.geojson"}
    after = contents(out)
    assert {name for name in before if after[name] != before[name]} == judged  # the same, with verdicts
    for name in ("report.json", "osm_roads.geojson"):
        assert after[name] == (finished / name).read_bytes()
    for name in judged:
        assert b'"outcome":"right"' in after[name]
        assert b'"outcome":"right"' not in before[name]
    assert outcome.out.splitlines()[0].startswith("map ")
    facts = dict(line.split("  ", 1) for line in outcome.out.splitlines())
    assert facts["map"].strip().startswith("1 of 1 intersection right within 10 m, 1 of 1 node found, median ")
    assert facts["detection level"].strip().startswith("ACE ")
    assert facts["policy"].strip() == "drive: 1 OSM node in the relevant zone"


def test_local_coordinates_are_refused_in_words(interloc: Callable, local_result: Path, osm: Path) -> None:
    before = contents(local_result)
    outcome = interloc("evaluate", local_result, "--osm", osm)
    assert outcome.code == 1
    assert "the run has no georeference" in outcome.complaint
    assert "--oxts" in outcome.complaint
    assert contents(local_result) == before


def test_a_map_of_another_place_is_refused(interloc: Callable, out: Path, osm: Path) -> None:
    elsewhere = out.parent / "elsewhere.osm"
    elsewhere.write_text(osm.read_text().replace('lat="49.', 'lat="48.').replace('lat="48.9', 'lat="47.9'))
    before = contents(out)
    assert "elsewhere.osm" in interloc("evaluate", out, "--osm", elsewhere).complaint
    assert contents(out) == before


def test_an_older_report_survives_a_failure(
    interloc: Callable, finished: Path, osm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = Path(shutil.copytree(finished, tmp_path / "out"))
    before = contents(out)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("interloc.evaluation.report.render_html", interrupt)  # the figures are written by then
    outcome = interloc("evaluate", out, "--osm", osm, "--policy", "all")
    assert outcome.code == 1
    assert outcome.err.strip() == "interloc: interrupted; nothing was written"
    assert contents(out) == before
    assert [path.name for path in out.parent.iterdir()] == ["out"]
