"""The result folder says what the tables say, and only a result folder is read as one."""

import json
import math
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from interloc.errors import OutputError
from interloc.geometry import thin
from interloc.output import layout
from interloc.output.layers import LAYERS
from interloc.output.read import read_results
from interloc.output.write import write_results
from interloc.results import DriveResult, PositionParts
from tests.output.small import small_result, write_folder


def load(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(path.read_text())
    return content


def assert_same(found: Any, expected: Any) -> None:
    """Compare tables to the printed precision."""
    for name, value in vars(expected).items():
        other = getattr(found, name)
        if value is None:
            assert other is None, name
        elif isinstance(value, int):
            assert other == value, name
        elif is_dataclass(value):
            assert_same(other, value)
        elif name.endswith("yaw_rad"):
            assert_allclose(np.cos(other - value), 1, atol=1e-12, err_msg=name)
        elif isinstance(value, list):
            assert len(other) == len(value)
            for a, b in zip(other, value, strict=True):
                if name == "widths_m":
                    assert_allclose(a, b, atol=0.00501, err_msg=name)
                else:
                    assert_allclose(np.cos(np.radians(a - b)), 1, atol=1e-9, err_msg=name)
        elif value.dtype == np.int64:
            assert other.dtype == np.int64
            assert_array_equal(other, value, err_msg=name)
        else:
            tolerance = 0.5001e-7 if name == "lonlat" else 0.5001e-4
            assert_allclose(other, value, rtol=0, atol=tolerance, err_msg=name)


# what is in the files ------------------------------------------------------------------------------------------------


def test_the_files_of_a_georeferenced_run(tmp_path: Path) -> None:
    origin = {"drive": "07", "job": None, "preset": "paper", "labels": None}
    unscored = {"outcome": "unscored", **dict.fromkeys(("osm_id", "error_m", "reason"))}
    layers = ("detections", "keyframes", "trajectory", "intersections", "roads", "junctions", "road_surface")
    files = [*(f"{layer}.geojson" for layer in layers), "run.json"]
    write_results(small_result(), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == set(files)
    detections = load(tmp_path / "detections.geojson")
    assert list(detections) == ["type", *origin, "attribution", "bbox", "features"]  # no crs
    assert {name: detections[name] for name in origin} == origin
    assert detections["bbox"] == [8.4205, 49.0109999, 8.43, 49.02]
    assert detections["features"][1] == {
        "type": "Feature",
        "id": "12-1",
        "geometry": {"type": "Point", "coordinates": [8.4205023, 49.0109999]},
        "properties": {
            "frame": 12,
            "branch_count": 3,
            "branch_bearings_deg": [1.0, 91.5, 181.25],
            "branch_widths_m": [None, None, None],
            "score": 0.5,
            "intersection": 1,
            "id": "12-1",
            "time": None,
            **unscored,
        },
        "details": {"x_m": 8.0, "y_m": 2.0, "position_std_m": 0.25, "world_x_m": 10.1, "world_y_m": 1.0},
    }
    assert detections["features"][2]["properties"]["intersection"] is None
    keyframe = load(tmp_path / "keyframes.geojson")["features"][1]
    assert keyframe["properties"] == {"frame": 12, "heading_deg": 270.0, "detections": 2, "time": None}
    assert keyframe["details"] == {"time_s": None, "world_x_m": 2.125, "world_y_m": -1.0, "world_yaw_rad": 0.5}
    intersection = load(tmp_path / "intersections.geojson")["features"][0]
    assert intersection["properties"] == {
        "id": 1,
        "uid": "49.01110,8.42063",
        "position_std_m": 0.25,
        "branch_count": 3,
        "branch_bearings_deg": [0.5, 90.75, 180.5],
        "branch_widths_m": [6.5, None, 3.25],
        "confidence": 0.75,
        **dict.fromkeys(("first_time", "last_time", "names")),
        **unscored,
    }
    assert intersection["details"] == {
        "observations": 2,
        "position_cov_m2": [0.0625, 0.03, 0.0625],
        "first_frame": 0,
        "last_frame": 12,
        "world_x_m": 10.0625,
        "world_y_m": 1.0,
        **dict.fromkeys(("fix_std_m", "shape_cov_m2", "scatter_std_m")),
    }
    (line,) = load(tmp_path / "trajectory.geojson")["features"]
    assert line["geometry"] == {"type": "LineString", "coordinates": [[8.4203, 49.0109], [8.4204, 49.01095]]}
    assert line["properties"] == {"scans": 2}
    assert load(tmp_path / "run.json") == {
        "format": "interloc-result",
        "format_version": 1,
        "drive_name": "07",
        "georeferenced": True,
        "files": files,
        "first_time": None,
        "last_time": None,
        "config": {"preset": "paper"},
        "peak_memory_mb": 12.5,
    }


@pytest.mark.parametrize("empty", [False, True])
def test_texts_are_texts_in_tables_without_rows_too(empty: bool) -> None:
    table = small_result(empty=empty).geodataframe("intersections")
    assert {str(table.dtypes[name]) for name in ("uid", "names", "outcome", "first_time")} == {"string"}


def test_times_of_the_day_are_written_where_the_drive_has_them(tmp_path: Path) -> None:
    result = small_result()
    clock = replace(result.keyframes, time_s=np.array([1317386459.0, 1317386460.25]))
    write_results(replace(result, keyframes=clock), tmp_path)
    detections = load(tmp_path / "detections.geojson")["features"]
    first, last = "2011-09-30T12:40:59.000Z", "2011-09-30T12:41:00.250Z"
    assert [each["properties"]["time"] for each in detections] == [first, last, last]
    (fused,) = load(tmp_path / "intersections.geojson")["features"]
    assert (fused["properties"]["first_time"], fused["properties"]["last_time"]) == (first, last)


def test_a_local_run_never_pretends_to_be_on_the_globe(tmp_path: Path) -> None:
    write_results(small_result(), tmp_path)
    write_results(small_result(local=True), tmp_path)
    assert not list(tmp_path.glob("*.geojson"))  # the older georeferenced files are gone
    for name in ("detections", "keyframes", "trajectory", "intersections"):
        content = load(tmp_path / f"{name}.local.json")
        assert content["local"] is True
        assert "metres" in content["units"]
        assert content["features"][0]["geometry"]["coordinates"] in ([10.0, 1.0], [0.0, 0.0], [10.0625, 1.0]) or (
            content["features"][0]["geometry"]["coordinates"] == [[0.0, 0.0], [2.125, -1.0]]
        )
    assert load(tmp_path / "keyframes.local.json")["features"][0]["properties"]["heading_deg"] == 90.0
    assert load(tmp_path / "run.json")["georeferenced"] is False


def test_nothing_of_an_older_evaluation_survives(tmp_path: Path) -> None:
    out = write_folder(tmp_path / "out", small_result(), scored=True)
    (out / "places.geojson").write_text("of a run that was placed")
    (out / "notes.txt").write_text("the user's")
    write_results(small_result(empty=True), out)
    assert {path.name for path in out.iterdir()} == {*load(out / "run.json")["files"], "notes.txt"}


def test_places_are_written_before_the_run_that_was_placed(tmp_path: Path) -> None:
    (tmp_path / "places.geojson").write_text("its own")
    write_results(replace(small_result(), run={"location": {"source": "map"}}), tmp_path)
    assert (tmp_path / "places.geojson").read_text() == "its own"


def test_files_of_something_else_stay(tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    for name in ("report.html", "figures/mine.png"):
        (tmp_path / name).write_text("the user's")
    write_results(small_result(), tmp_path)
    assert (tmp_path / "report.html").read_text() == (tmp_path / "figures/mine.png").read_text() == "the user's"


@pytest.mark.parametrize(("scans", "positions"), [(0, None), (1, 2), (2, 2)])
def test_a_line_has_two_positions_or_none(tmp_path: Path, scans: int, positions: int | None) -> None:
    result = small_result()
    short = replace(
        result,
        trajectory_world_xy=result.trajectory_world_xy[:scans],
        trajectory_lonlat=result.trajectory_lonlat[:scans],
    )
    write_results(short, tmp_path)
    geometry = load(tmp_path / "trajectory.geojson")["features"][0]["geometry"]
    assert geometry is None if positions is None else len(geometry["coordinates"]) == positions
    back = read_results(tmp_path)
    assert_array_equal(back.trajectory_world_xy, short.trajectory_world_xy)
    assert_array_equal(back.trajectory_lonlat, short.trajectory_lonlat)


def test_a_track_is_thinned_to_half_a_metre_with_both_ends() -> None:
    track = np.stack([np.arange(11) * 0.2, np.zeros(11)], axis=-1)  # 0 .. 2.0 m
    assert thin(track, 0.5).tolist() == [0, 3, 6, 9, 10]
    standing = np.zeros((50, 2))
    assert thin(standing, 0.5).tolist() == [0, 49]
    assert thin(np.zeros((0, 2)), 0.5).tolist() == []


def test_a_run_may_say_what_it_likes(tmp_path: Path) -> None:
    run = {
        "path": Path("drive"),
        "seconds": np.float64(1.5),
        "worst": math.nan,
        "counts": np.array([1, 2]),
        "nested": {"limit": math.inf, "ids": (40, 60), "set": {3, 1}, 7: "seven"},
        "format_version": 99,
    }
    write_results(replace(small_result(), run=run), tmp_path)
    assert read_results(tmp_path).run == {
        "path": "drive",
        "seconds": 1.5,
        "worst": None,
        "counts": [1, 2],
        "nested": {"limit": None, "ids": [40, 60], "set": [1, 3], "7": "seven"},
    }


# there and back ------------------------------------------------------------------------------------------------------


def whole_result(*, local: bool = False, empty: bool = False) -> DriveResult:
    """One that tells everything it can, also beside the 180th meridian."""
    result, count = small_result(local=local, empty=empty), 0 if empty else 1
    parts = PositionParts(np.full(count, 0.2), np.array([[0.5, -0.125, 0.25]])[:count], np.full(count, 0.1))
    clock = replace(result.keyframes, time_s=np.array([1317386459.0, math.nan]))
    named = replace(result, drive="Straße", keyframes=clock, intersections=replace(result.intersections, parts=parts))
    if local:
        return named
    return replace(named, trajectory_lonlat=np.array([[179.99999, -16.5], [-179.99999, -16.6]]))


@pytest.mark.parametrize("result", [
    small_result(), small_result(local=True), whole_result(), whole_result(local=True), whole_result(empty=True)
])  # fmt: skip
def test_what_is_written_is_read_back(result: DriveResult, tmp_path: Path) -> None:
    write_results(result, tmp_path / "out")
    back = read_results(tmp_path / "out")
    write_results(back, tmp_path / "again")
    for path in (tmp_path / "out").iterdir():
        assert (tmp_path / "again" / path.name).read_text() == path.read_text()
    assert back.drive == result.drive
    assert back.run == {"config": {"preset": "paper"}, "peak_memory_mb": 12.5}
    assert back.is_georeferenced == result.is_georeferenced
    assert_same(back.keyframes, result.keyframes)
    assert_same(back.detections, result.detections)
    assert_same(back.intersections, result.intersections)
    assert_allclose(back.trajectory_world_xy, result.trajectory_world_xy)


# what is refused -----------------------------------------------------------------------------------------------------


def test_a_missing_folder_and_a_folder_of_something_else_are_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"none is not a folder\. Give the folder that `interloc run -o` wrote"):
        read_results(tmp_path / "none")
    with pytest.raises(OutputError, match=r"is not an InterLoc result: it has no run.json"):
        read_results(tmp_path)
    (tmp_path / "run.json").write_text('{"scripts": {}}')
    with pytest.raises(OutputError, match=r"run.json is not from InterLoc"):
        read_results(tmp_path)


def test_a_newer_format_is_said(tmp_path: Path) -> None:
    write_results(small_result(), tmp_path)
    run = load(tmp_path / "run.json") | {"format_version": 2}
    (tmp_path / "run.json").write_text(json.dumps(run))
    with pytest.raises(OutputError, match=r"newer InterLoc \(format 2; this one reads up to 1\)\. Update InterLoc"):
        read_results(tmp_path)


DAMAGE = {  # what is replaced in which file, by what; "" is all of it
    "truncated": ("detections.geojson", "", '{"type":', r"detections.geojson is damaged: Invalid JSON"),
    "a list": ("keyframes.geojson", "", "[]", r"Input should be an object"),
    "a missing property": ("detections.geojson", '"x_m"', '"y"', r"features.0.properties.x_m: Field required"),
    "descending": ("keyframes.geojson", '"frame":0', '"frame":99', r"frames do not ascend"),
    "a stranger": ("detections.geojson", '"frame":12', '"frame":13', r"frame 13 is not in the other"),
    "a polygon": ("intersections.geojson", "Point", "Polygon", r"features.0.geometry.type: Input should be 'Point'"),
    "two tracks": ("trajectory.geojson", "", '{"type":"FeatureCollection","features":[]}', r"0 features instead"),
    "a short track": ("trajectory.geojson", "[[0.0,0.0],[", "[[0.0,0.0],[1,1],[", r"different len"),
    "no flag": ("run.json", '"georeferenced": true', '"georeferenced": 1', r"Input should be a valid boolean"),
    "no name": ("run.json", "drive_name", "name", r"georeferenced or drive_name is missing"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_named_with_what_to_do(tmp_path: Path, damage: str) -> None:
    name, old, new, message = DAMAGE[damage]
    write_results(small_result(), tmp_path)
    text = (tmp_path / name).read_text()
    spoiled = text.replace(old, new) if old else new
    assert spoiled != text
    (tmp_path / name).write_text(spoiled)
    with pytest.raises(OutputError, match=message) as caught:
        read_results(tmp_path)
    assert name in str(caught.value)
    assert "interloc run" in str(caught.value)


def test_a_file_that_is_gone_is_named(tmp_path: Path) -> None:
    write_results(small_result(), tmp_path)
    (tmp_path / "trajectory.geojson").unlink()
    with pytest.raises(OutputError, match=r"trajectory.geojson is missing, so the result is not complete"):
        read_results(tmp_path)


def test_layers_of_the_map_are_known_by_name() -> None:
    assert [layer.name for layer in LAYERS.values() if layer.is_osm] == list(layout.MAP_LAYERS)


# writing that fails --------------------------------------------------------------------------------------------------


def test_a_result_is_not_complete_before_its_run_file(tmp_path: Path) -> None:
    write_results(small_result(), tmp_path)
    (tmp_path / "keyframes.geojson").unlink()
    (tmp_path / "keyframes.geojson").mkdir()
    with pytest.raises(OutputError, match=r"keyframes.geojson could not be written: is a directory"):
        write_results(small_result(), tmp_path)
    assert not (tmp_path / "run.json").exists()
