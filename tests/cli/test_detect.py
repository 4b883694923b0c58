"""`interloc run` without a map: from a drive to a result folder."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import CROSSING_M

FILES = {"detections", "keyframes", "intersections", "trajectory", "roads", "junctions", "road_surface"}
RUN = {"road.tif", "run.json"}


def test_the_files_of_the_contract(detected: Path, strict_json: Callable) -> None:
    assert {path.name for path in detected.iterdir()} == {f"{name}.geojson" for name in FILES} | RUN
    detections = strict_json(detected / "detections.geojson")["features"]
    assert len(detections) > 20
    assert detections[0]["properties"].keys() >= {
        "frame",
        "branch_count",
        "branch_bearings_deg",
        "score",
        "intersection",
    }
    assert detections[0]["details"].keys() == {"x_m", "y_m", "world_x_m", "world_y_m"}
    keyframes = strict_json(detected / "keyframes.geojson")["features"]
    assert [k["properties"]["frame"] for k in keyframes] == list(range(0, 210, 4))
    assert keyframes[0]["properties"].keys() >= {"frame", "heading_deg", "detections"}
    assert sum(k["properties"]["detections"] for k in keyframes) == len(detections)
    (line,) = strict_json(detected / "trajectory.geojson")["features"]
    assert line["geometry"]["type"] == "LineString"


def test_run_json_tells_what_the_run_was(
    interloc: Callable, detected: Path, short_drive: Path, tmp_path: Path, strict_json: Callable
) -> None:
    run = strict_json(detected / "run.json")
    assert (run["scans"], run["keyframes"], run["drive"]) == (210, 53, "crossing")
    assert run["versions"].keys() >= {"interloc", "numpy", "numba", "python"}
    assert run["stage_seconds"].keys() >= {"read", "accumulate", "bev", "occupancy", "centerline", "candidates"}
    assert run["peak_memory_bytes"] > 1e7
    assert interloc("run", short_drive, "-o", tmp_path / "out", "--set", "bev.resolution_m=0.2").code == 0
    assert strict_json(tmp_path / "out" / "run.json")["config"]["bev"]["resolution_m"] == 0.2


def test_without_georeference_nothing_pretends_to_be_degrees(
    interloc: Callable, local_result: Path, short_drive: Path, tmp_path: Path, strict_json: Callable
) -> None:
    assert {path.name for path in local_result.iterdir()} == {f"{name}.local.json" for name in FILES} | RUN
    intersections = strict_json(local_result / "intersections.local.json")
    assert intersections["local"]
    assert "crs" not in intersections
    (intersection,) = intersections["features"]
    assert intersection["geometry"]["coordinates"] == pytest.approx(CROSSING_M, abs=0.5)
    (short_drive / "geo.csv").unlink()
    said = interloc("run", short_drive, "-o", tmp_path / "out").out
    assert "none: positions are metres in the frame of the first scan" in said


def test_two_processes_give_the_same_bytes(interloc: Callable, drive: Path, tmp_path: Path) -> None:
    # Enough keyframes that two processes share them.
    every_scan = ("--set", "keyframes.distance_m=0.5", "--set", "bev.resolution_m=0.6")
    for workers in (1, 2):
        arguments = ("run", drive, "-o", tmp_path / str(workers), "--workers", workers, *every_scan)
        assert interloc(*arguments).code == 0
    for name in sorted(FILES):
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
