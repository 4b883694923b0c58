"""`interloc locate` and `interloc run --locate`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import interloc as library
from interloc.localization.apply import place_result
from tests.cli.conftest import strict_json
from tests.localization.town import MadeDrive, write_town_drive, write_town_map


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, MadeDrive]:
    root = tmp_path_factory.mktemp("drives") / "town"
    return root, write_town_drive(root, every_m=4)


@pytest.fixture(scope="module")
def town_drive(made: tuple[Path, MadeDrive]) -> Path:
    return made[0]


@pytest.fixture(scope="module")
def town_osm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("maps") / "town.osm"
    write_town_map(path)
    return path


def test_a_drive_is_placed_and_read_again(
    made: tuple[Path, MadeDrive], town_osm: Path, tmp_path: Path, interloc: Callable
) -> None:
    town_drive, truth = made
    geo = tmp_path / "geo.csv"
    done = interloc("locate", town_drive, "--osm", town_osm, "--near", "1,1", "--quiet")
    assert f"{town_osm}: holds no highways within" in done.err, "only what lies around is read"
    done = interloc("locate", town_drive, "--osm", town_osm, "--track-only", "-o", geo, "--json", "--quiet")
    assert done.code == 0, done.err
    assert done.json["outcome"] == "found"
    placed = library.open_drive(town_drive, oxts=geo).georeference
    assert placed is not None
    assert np.median(truth.error_m(placed)) < 1.5


def test_run_places_and_evaluates(town_drive: Path, town_osm: Path, tmp_path: Path, interloc: Callable) -> None:
    done = interloc("run", town_drive, "-o", tmp_path / "out", "--osm", town_osm, "--locate", "--quiet")
    assert done.code == 0, done.err
    run = strict_json(tmp_path / "out" / "run.json")
    assert run["location"]["source"] == "map"
    assert run["location"]["outcome"] == "found"
    assert "town.osm" in run["georeference"]
    places = strict_json(tmp_path / "out" / "places.geojson")["features"]
    assert [place["properties"]["rank"] for place in places] == list(range(1, len(places) + 1))
    report = strict_json(tmp_path / "out" / "report.json")
    assert any("left this node out" in warning for warning in report["warnings"])
    assert "left this node out" in (tmp_path / "out" / "report.html").read_text()


def test_not_found_is_exit_code_1_and_nothing_is_written(
    drive: Path, short_drive: Path, osm: Path, tmp_path: Path, interloc: Callable
) -> None:
    done = interloc("locate", drive, "--osm", osm, "--track-only", "-o", tmp_path / "geo.csv", "--quiet")
    assert done.code == 1
    assert "it was not found on the map" in done.complaint or "its place is ambiguous" in done.complaint
    assert not (tmp_path / "geo.csv").exists()
    done = interloc("run", short_drive, "--osm", osm, "-o", tmp_path / "out", "--locate", "--quiet")
    assert done.code == 1
    assert not (tmp_path / "out").exists()


def test_the_track_of_a_phone_places_a_drive_and_replaces_only_what_it_may(
    made: tuple[Path, MadeDrive], tmp_path: Path, interloc: Callable
) -> None:
    town_drive, truth = made
    geo, gpx = tmp_path / "geo.csv", tmp_path / "watch.gpx"
    moments = np.datetime64("2026-11-27T10:00:00") + np.arange(len(truth.frames)).astype("timedelta64[s]")
    (town_drive / "times.txt").write_text("".join(f"{each.astype(np.int64)}\n" for each in moments))
    points = "".join(
        f'<trkpt lat="{lat}" lon="{lon}"><time>{moment}Z</time></trkpt>'
        for (lon, lat), moment in zip(truth.true_lonlat[::5].tolist(), moments[::5], strict=True)
    )
    gpx.write_text(f'<gpx version="1.1" creator="phone"><trk><trkseg>{points}</trkseg></trk></gpx>')
    geo.write_text("measured\n")
    done = interloc("locate", town_drive, "--gpx", gpx, "-o", geo)
    assert (done.code, geo.read_text()) == (2, "measured\n")
    assert f"{geo} is there already, and was not touched" in done.complaint
    done = interloc("locate", town_drive, "--gpx", gpx, "-o", geo, "--overwrite")
    assert done.code == 0, done.err
    assert "uncertainty" in done.out
    placed = library.open_drive(town_drive, oxts=geo).georeference
    assert placed is not None
    assert np.median(truth.error_m(placed)) < 2.0


def test_a_run_placed_afterwards_is_that_of_a_drive_with_gnss(drive: Path, detected: Path, local_result: Path) -> None:
    with_fixes, at_once = library.open_drive(drive), library.read_results(detected)
    assert with_fixes.georeference is not None
    later = place_result(library.read_results(local_result), with_fixes, with_fixes.georeference, {"source": "map"})
    assert at_once.detections.lonlat is not None
    assert later.detections.lonlat is not None
    printed = {"rtol": 0.0, "atol": 1e-7}
    assert np.allclose(later.detections.lonlat, at_once.detections.lonlat, **printed)
    assert np.allclose(later.intersections.lonlat, at_once.intersections.lonlat, **printed)
    assert np.allclose(later.detections.bearings_deg[0], at_once.detections.bearings_deg[0], atol=2e-3)
