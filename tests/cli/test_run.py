"""`interloc run`: from a drive to a result folder, with a map to a report."""

import json
import re
import resource
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.cli.main import main
from tests.app.processes import Command
from tests.cli.conftest import CROSSING_M, ENVIRONMENT, contents, strict_json

LAYERS = {"detections", "keyframes", "intersections", "trajectory", "roads", "junctions", "road_surface"}
RUN = {"road.tif", "run.json"}
FILES = {f"{name}.geojson" for name in (*LAYERS, "osm_nodes", "matches", "osm_roads")} | RUN
FILES |= {"report.json", "report.html", "figures"}


def test_all_files_are_there_and_can_be_read(finished: Path) -> None:
    assert {path.name for path in finished.iterdir()} == FILES
    for path in finished.glob("*json"):
        assert strict_json(path)
    assert {path.suffix for path in (finished / "figures").iterdir()} == {".png", ".svg"}
    page = (finished / "report.html").read_text()
    assert "<svg" in page or "data:image" in page
    assert "crossing" in page


def test_a_run_replaces_an_older_one_and_is_replaced(
    interloc: Callable, drive: Path, short_drive: Path, osm: Path, detected: Path, tmp_path: Path
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
    assert len(wrong) == 8
    assert sum("highway=service" in each["reason"] for each in wrong) == 7
    assert [each["osm_id"] is None for each in layers["intersections"]].count(True) == 1
    assert "n1213522196" in [each["uid"] for each in layers["intersections"]]  # the node of the service road
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["reasons"]["detections"]["left_out"] == 7
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


def test_points_that_are_not_numbers_in_the_middle_of_the_run_leave_an_older_result(
    interloc: Callable, short_drive: Path, osm: Path, detected: Path, tmp_path: Path
) -> None:
    """Only some scans are looked into before the work; faults of the others show when they are read."""
    older = Path(shutil.copytree(detected, tmp_path / "older" / "out"))
    points = np.fromfile(short_drive / "velodyne/000005.bin", np.float32).reshape(-1, 4)
    labels = np.fromfile(short_drive / "labels/000005.label", np.uint32)
    points[np.flatnonzero(labels == 40)[7], 2] = np.nan
    points.tofile(short_drive / "velodyne/000005.bin")
    outcome = interloc("run", short_drive, "-o", older, "--osm", osm, "--set", "keyframes.distance_m=0.1")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.complaint.startswith("interloc: velodyne/000005.bin: point ")
    assert "is not finite" in outcome.complaint
    assert contents(older) == contents(detected)
    assert [path.name for path in older.parent.iterdir()] == ["out"]
    assert interloc("info", short_drive, "--thorough").code == 1


def run_with_small_files() -> None:
    """The command line, of which no file gets larger than 10 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
    main()


@pytest.mark.skipif(sys.platform == "win32", reason="limits of Unix")
def test_a_disk_that_is_full_leaves_nothing_of_a_run(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "place").mkdir()
    out = tmp_path / "place/new/out"
    arguments = ["run", drive, "-o", out]
    process = Command(arguments, ENVIRONMENT, tmp_path / "said", tmp_path / "err", program=run_with_small_files)
    code, said, err = process.ended()
    assert (code, said) == (1, "")
    assert err == f"interloc: {out}/detections.geojson could not be written: file too large.\n"
    assert not list((tmp_path / "place").iterdir())  # not even the folder above


def test_a_run_without_a_map_says_how_to_get_one(interloc: Callable, drive: Path, tmp_path: Path) -> None:
    outcome = interloc("run", drive, "-o", tmp_path / "out")
    assert outcome.code == 0
    west, south, east, north = map(float, re.findall(r"--bbox (\S+) of `osmium extract`", outcome.out)[0].split(","))
    assert (west < 8.4 < east, south < 49.0 < north) == (True, True)


def test_a_clipped_map_works_with_a_note(interloc: Callable, detected: Path, osm: Path, tmp_path: Path) -> None:
    clipped = tmp_path / "clipped.osm"
    clipped.write_text("\n".join(line for line in osm.read_text().splitlines() if '<node id="5"' not in line))
    outcome = interloc("evaluate", shutil.copytree(detected, tmp_path / "out"), "--osm", clipped)
    assert outcome.code == 0
    assert "clipped.osm: 1 highways refer to nodes outside the extract and were cut" in outcome.err
    assert "1 of 1" in outcome.out
