"""`interloc run`: from a drive to a result folder, with a map to a report."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.cli.conftest import CROSSING_M

LAYERS = {"detections", "keyframes", "intersections", "trajectory", "roads", "junctions", "road_surface"}
RUN = {"road.tif", "run.json"}
FILES = {f"{name}.geojson" for name in (*LAYERS, "osm_nodes", "matches", "osm_roads")} | RUN
FILES |= {"report.json", "report.html", "figures"}


def test_all_files_are_there_and_can_be_read(finished: Path, strict_json: Callable) -> None:
    assert {path.name for path in finished.iterdir()} == FILES
    for path in finished.glob("*json"):
        assert strict_json(path)
    assert {path.suffix for path in (finished / "figures").iterdir()} == {".png", ".svg"}
    page = (finished / "report.html").read_text()
    assert "<svg" in page or "data:image" in page
    assert "crossing" in page


def test_a_run_replaces_an_older_one_and_is_replaced(
    interloc: Callable, drive: Path, short_drive: Path, osm: Path, detected: Path, tmp_path: Path, strict_json: Callable
) -> None:
    out = tmp_path / "out"
    shutil.copytree(detected, out)
    outcome = interloc("run", drive, "-o", out, "--osm", osm, "--preset", "paper", "--json")
    assert not outcome.err
    assert outcome.json["report"] == strict_json(out / "report.json")
    assert outcome.json["run"]["keyframes"] == 53
    assert strict_json(out / "run.json")["config"]["preset"] == "paper"
    (intersection,) = strict_json(out / "intersections.geojson")["features"]
    facts = intersection["details"]
    assert np.hypot(facts["world_x_m"] - CROSSING_M[0], facts["world_y_m"] - CROSSING_M[1]) < 1.0
    assert {path.name for path in out.iterdir()} == FILES
    quiet = interloc("run", short_drive, "-o", out, "--quiet")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")
    assert not (out / "report.json").exists()  # it was about another run


def test_without_georeference_it_refuses_before_the_work(
    interloc: Callable, local_drive: Path, osm: Path, tmp_path: Path
) -> None:
    outcome = interloc("run", local_drive, "-o", tmp_path / "out", "--osm", osm)
    assert outcome.code == 1
    assert "the drive has no georeference" in outcome.complaint
    assert "--oxts" in outcome.complaint
    assert not list(tmp_path.iterdir())


def test_the_false_detections_of_kitti_360_are_a_junction_with_a_service_road(
    interloc: Callable, data: Callable[[str], Path], tmp_path: Path
) -> None:
    outcome = interloc("run", data("kitti360_0009"), "-o", tmp_path / "out", "--osm", data("kitti/osm/00.osm.gz"))
    assert "1 x junction with a way that the policy leaves out" in outcome.out
    layers = {
        layer: [each["properties"] for each in json.loads((tmp_path / f"out/{layer}.geojson").read_text())["features"]]
        for layer in ("detections", "intersections")
    }
    wrong = [each for each in layers["detections"] if each["outcome"] == "wrong"]
    assert len(wrong) == 6
    assert all("highway=service" in each["reason"] for each in wrong)
    assert [each["osm_id"] is None for each in layers["intersections"]].count(True) == 1
    assert "n1213522196" in [each["uid"] for each in layers["intersections"]]  # the node of the service road
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["reasons"]["detections"]["left_out"] == 6
    assert report["map_line"].startswith(
        "5 of 5 intersections right within 10 m, 1 not counted by this policy, 5 of 5 nodes found"
    )


def test_an_excerpt_of_kitti_07_by_its_oxts_rows(
    interloc: Callable, data: Callable[[str], Path], tmp_path: Path
) -> None:
    sequence, osm = data("semantickitti_mini/sequences/07"), data("kitti/osm/07.osm.gz")
    refused = interloc("run", sequence, "-o", tmp_path / "out", "--osm", osm, "--quiet")
    assert "the drive has no georeference" in refused.complaint
    arguments = ("-o", tmp_path / "out", "--osm", osm, "--oxts", data("kitti/oxts/07.txt.gz"), "--json")
    outcome = interloc("run", sequence, *arguments)
    assert outcome.code == 0
    assert outcome.json["run"]["georeferenced"] is True


def test_without_georeference_it_says_that_positions_are_metres(
    interloc: Callable, local_result: Path, short_drive: Path, tmp_path: Path
) -> None:
    assert {path.name for path in local_result.iterdir()} == {f"{name}.local.json" for name in LAYERS} | RUN
    (short_drive / "geo.csv").unlink()
    said = interloc("run", short_drive, "-o", tmp_path / "out").out
    assert "none: positions are metres in the frame of the first scan" in said


def test_two_processes_give_the_same_bytes(interloc: Callable, drive: Path, tmp_path: Path) -> None:
    # Enough keyframes that two processes share them.
    every_scan = ("--set", "keyframes.distance_m=0.5", "--set", "bev.resolution_m=0.6")
    for workers in (1, 2):
        arguments = ("run", drive, "-o", tmp_path / str(workers), "--workers", workers, *every_scan)
        assert interloc(*arguments).code == 0
    for name in sorted(LAYERS):
        one, two = ((tmp_path / str(workers) / f"{name}.geojson").read_bytes() for workers in (1, 2))
        assert one == two, name
    assert b'"workers": 2' in (tmp_path / "2" / "run.json").read_bytes()


def test_a_folder_of_somebody_else_is_refused(interloc: Callable, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    outcome = interloc("run", drive, "-o", tmp_path)
    assert outcome.code == 1
    assert "is not an InterLoc result: it holds thesis.tex but no run.json. It was not touched." in outcome.complaint
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_drive_itself_is_refused_as_output(interloc: Callable, short_drive: Path) -> None:
    before = sorted(short_drive.rglob("*"))
    assert interloc("run", short_drive, "-o", short_drive).code == 1
    assert sorted(short_drive.rglob("*")) == before


def test_labels_of_another_folder_and_scheme(interloc: Callable, short_drive: Path, tmp_path: Path) -> None:
    for path in (short_drive / "labels").iterdir():
        labels = np.fromfile(path, np.uint32)
        np.where(labels == 40, 3, 1).astype(np.uint32).tofile(path)
    (short_drive / "labels").rename(short_drive / "predictions")
    options = ("--labels", "predictions", "--label-scheme", "3")
    assert interloc("run", short_drive, "-o", tmp_path / "out", *options).code == 0
    assert "predictions" in interloc("run", short_drive, "-o", tmp_path / "other", "--labels", "labels").complaint
