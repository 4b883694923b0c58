"""`interloc evaluate`, `compare`, `explain`, `export`, `merge` and `audit`: what is made of result folders."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyogrio
import pytest

from interloc.config import PAPER
from tests.cli.conftest import contents, strict_json
from tests.output.small import MAP, small_result, write_folder

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


def with_run(finished: Path, out: Path, **changed: object) -> Path:
    """Copy a result folder as if the run had been another one."""
    shutil.copytree(finished, out)
    run = json.loads((out / "run.json").read_text()) | changed
    (out / "run.json").write_text(json.dumps(run))
    return out


@pytest.fixture(scope="module")
def outs(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Result folders of two presets. Shared: do not change them."""
    place = tmp_path_factory.mktemp("outs") / "paper"
    return finished, with_run(finished, place, config=PAPER.model_dump(mode="json"))


def test_figures_and_settings_side_by_side(outs: tuple[Path, Path], interloc: Callable) -> None:
    told = interloc("compare", *outs, "--json").json
    assert told["runs"] == [str(out) for out in outs]
    assert {"name": "preset", "values": ["default", "paper"]} in told["settings"]
    text = interloc("compare", *outs).out
    (line,) = [line.split() for line in text.splitlines() if line.startswith("OSM nodes found")]
    (figure,) = [row["values"] for row in told["figures"] if row["name"] == "map_nodes_found"]
    assert line[3:] == [str(value) for value in figure]
    assert told["found_by_all"] == 1
    assert "1 OSM node found by all, 0 OSM nodes missed by all" in text


def test_what_cannot_be_compared(outs: tuple[Path, Path], detected: Path, tmp_path: Path, interloc: Callable) -> None:
    assert "two runs or more" in interloc("compare", outs[0]).complaint
    assert "is not an InterLoc result: it has no run.json" in interloc("compare", outs[0], tmp_path).complaint
    outcome = interloc("compare", outs[0], detected)
    assert outcome.code == 2
    assert "interloc evaluate" in outcome.complaint


def test_the_steps_of_a_keyframe(interloc: Callable, drive: Path, osm: Path, tmp_path: Path) -> None:
    out = tmp_path / "steps"
    out.mkdir()
    (out / "explain.json").write_text("{}")  # of an earlier call
    outcome = interloc("explain", drive, "--frame", 101, "-o", out, "--osm", osm, "--preset", "paper")
    assert outcome.code == 0
    assert "keyframe 26 of 53 is scan 100" in outcome.err
    assert [Path(line) for line in outcome.out.splitlines()] == [out / "overview.png", out / "explain.json"]
    assert cv2.imread(str(out / "overview.png")).std() > 1  # something is drawn
    record = strict_json(out / "explain.json")
    assert record["keyframe"] == 25
    assert record["ground_truth"]["nodes"]


def test_a_result_as_one_file_for_gis(finished: Path, tmp_path: Path, interloc: Callable) -> None:
    told = interloc("export", finished, "-o", tmp_path / "out.gpkg", "--json").json
    assert told["layers"] == ["intersections", "roads", "trajectory", "osm_nodes"]
    assert pyogrio.list_layers(tmp_path / "out.gpkg")[:, 0].tolist() == [*told["layers"], "layer_styles"]
    said = interloc("export", finished, "-o", tmp_path / "matches.kml", "--layer", "matches")
    assert (said.code, said.out.splitlines()[-1].split()) == (0, ["layers", "matches"])
    assert (tmp_path / "matches.kml").read_bytes().startswith(b"<?xml")


def test_complaints_in_one_line(local_result: Path, tmp_path: Path, interloc: Callable) -> None:
    out = local_result
    assert "no georeference. Place it: `interloc locate" in interloc("export", out, "-o", tmp_path / "o.kml").complaint
    outcome = interloc("export", out, "-o", tmp_path / "out.shp")
    assert outcome.code == 2
    assert "unknown format '.shp'" in outcome.complaint
    assert not list(tmp_path.iterdir())
    said = interloc("export", out, "-o", tmp_path / "out.gpkg")
    assert "none: metres in the frame of the first scan. Place it: " in said.out
    assert not said.err
    assert pyogrio.read_info(tmp_path / "out.gpkg", layer="roads")["crs"] in {None, 'LOCAL_CS["Undefined SRS"]'}


def test_drives_become_one_map_that_grows(tmp_path: Path, interloc: Callable) -> None:
    result = small_result()
    for name, confidence in (("a", 0.7), ("b", 0.8), ("c", 0.9)):
        sure = replace(result.intersections, confidence=np.array([confidence]))
        driven = replace(result.keyframes, lonlat=result.keyframes.degrees + 1e-6 * confidence)
        write_folder(tmp_path / name, replace(result, intersections=sure, keyframes=driven), scored=False)
    city = tmp_path / "city"
    told = interloc("merge", f"monday={tmp_path / 'a'}", f"tuesday={tmp_path / 'b'}", "-o", city, "--json").json
    assert (told["intersections"], told["seen_by_several"], told["added"]) == (1, 1, ["monday", "tuesday"])
    told = interloc("merge", tmp_path / "c", "-o", city, "--json").json
    assert [each["drive"] for each in told["drives"]] == ["07", "monday", "tuesday"]
    again = interloc("merge", tmp_path / "a", "-o", city)
    assert "07 is on the map already, as monday" in again.out
    assert interloc("merge", "--remove", "monday", "-o", city, "--json").json["added"] == []
    (place,) = json.loads((city / "city.geojson").read_text())["features"]
    assert place["properties"]["drive_names"] == "07, tuesday"


def test_what_cannot_be_merged_is_refused_and_the_map_stays(tmp_path: Path, interloc: Callable) -> None:
    one = write_folder(tmp_path / "one", small_result(), scored=False)
    other = write_folder(tmp_path / "other", small_result(empty=True), scored=False)
    local = write_folder(tmp_path / "local", small_result(local=True), scored=False)
    city = tmp_path / "city"
    interloc("merge", one, "-o", city)
    before = {path.name: path.read_bytes() for path in city.iterdir() if path.is_file()}
    clash = interloc("merge", other, "-o", city)
    assert clash.code == 2
    assert "drive '07' is on the map" in clash.err
    assert "--replace" in clash.err
    assert "07: it has no georeference" in interloc("merge", local, "-o", city).err
    assert "give one or more result folders" in interloc("merge", "-o", city).err
    assert "'x' is not on the map" in interloc("merge", "--remove", "x", "-o", city).err
    assert {path.name: path.read_bytes() for path in city.iterdir() if path.is_file()} == before
    assert interloc("merge", other, "--replace", "-o", city, "--json").json["intersections"] == 0


def test_a_map_of_drives_is_compared_with_openstreetmap(tmp_path: Path, interloc: Callable) -> None:
    (tmp_path / "map.osm").write_text(MAP)
    interloc("merge", write_folder(tmp_path / "a", small_result(), scored=False), "-o", tmp_path / "city")
    arguments = ("audit", tmp_path / "city", "--osm", tmp_path / "map.osm", "-o", tmp_path / "audit")
    told = interloc(*arguments, "--passes", 1, "--json").json
    assert (told["findings"], set(told["by_kind"].values())) == (0, {0})
    assert json.loads((tmp_path / "audit" / "audit.json").read_text())["osm"] == "map.osm"
    assert interloc(*arguments, "--kind", "moved").out.startswith("findings   0 moved")
    assert "is not a map of many drives" in interloc("audit", tmp_path / "a", *arguments[2:]).complaint
