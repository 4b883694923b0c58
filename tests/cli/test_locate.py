"""`interloc locate` and `interloc run --locate`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import interloc as library
from interloc.geometry import lonlat_from_enu
from interloc.localization.placing import place_result
from tests.localization.conftest import BLOCKS, LAT_DEG, LON_DEG, drive_along, route_xy, town_xy

TRUE = drive_along(route_xy())


@pytest.fixture(scope="module")
def town_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive through the made-up town whose scans show a patch of road each: the trajectory is all there is."""
    root = tmp_path_factory.mktemp("drives") / "town"
    (root / "velodyne").mkdir(parents=True)
    (root / "labels").mkdir()
    x, y = np.meshgrid(np.linspace(-3, 3, 7), np.linspace(-3, 3, 7))
    points = np.stack([x, y, np.full_like(x, -1.73), np.zeros_like(x)], axis=-1).reshape(-1, 4).astype(np.float32)
    lines = []
    for frame, pose in enumerate(TRUE.T_world_lidar[::2]):
        points.tofile(root / f"velodyne/{frame:06d}.bin")
        np.full(len(points), 40, np.uint32).tofile(root / f"labels/{frame:06d}.label")
        lines.append(" ".join(f"{value:.9e}" for value in pose[:3].ravel()))
    (root / "poses.txt").write_text("\n".join(lines) + "\n")
    return root


@pytest.fixture(scope="module")
def town_osm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("maps") / "town.osm"
    lonlat = lonlat_from_enu(LAT_DEG, LON_DEG, town_xy())
    text = ['<osm version="0.6">']
    text += [f'<node id="{i}" lat="{lat:.9f}" lon="{lon:.9f}"/>' for i, (lon, lat) in enumerate(lonlat.tolist(), 1)]
    lines = [[r * BLOCKS + c for c in range(BLOCKS)] for r in range(BLOCKS)]
    lines += [[r * BLOCKS + c for r in range(BLOCKS)] for c in range(BLOCKS)]
    for number, line in enumerate(lines, 1):
        refs = "".join(f'<nd ref="{corner + 1}"/>' for corner in line)
        text.append(f'<way id="{number}">{refs}<tag k="highway" v="residential"/></way>')
    path.write_text("\n".join([*text, "</osm>"]))
    return path


def test_a_drive_is_placed_and_read_again(town_drive: Path, town_osm: Path, tmp_path: Path, interloc: Callable) -> None:
    geo, figure = tmp_path / "geo.csv", tmp_path / "where.png"
    done = interloc(
        "locate", town_drive, "--osm", town_osm, "--track-only", "-o", geo, "--figure", figure, "--json", "--quiet"
    )
    assert done.code == 0, done.err
    assert done.json["outcome"] == "found"
    assert figure.read_bytes().startswith(b"\x89PNG")
    placed = library.open_drive(town_drive, oxts=geo).georeference
    assert placed is not None
    truth = replace(TRUE, true_lonlat=TRUE.true_lonlat[::2])
    assert np.median(truth.error_m(placed)) < 1.5


def test_run_places_and_evaluates(
    town_drive: Path, town_osm: Path, tmp_path: Path, interloc: Callable, strict_json: Callable
) -> None:
    done = interloc("run", town_drive, "-o", tmp_path / "out", "--osm", town_osm, "--locate", "--quiet")
    assert done.code == 0, done.err
    run = strict_json(tmp_path / "out" / "run.json")
    assert run["location"]["source"] == "map"
    assert run["location"]["outcome"] == "found"
    assert "town.osm" in run["georeference"]
    report = strict_json(tmp_path / "out" / "report.json")
    assert any("left this node out" in warning for warning in report["warnings"])
    assert "left this node out" in (tmp_path / "out" / "report.html").read_text()


def test_not_found_is_exit_code_1_and_nothing_is_written(
    drive: Path, osm: Path, tmp_path: Path, interloc: Callable
) -> None:
    done = interloc("locate", drive, "--osm", osm, "-o", tmp_path / "geo.csv", "--quiet")
    assert done.code == 1
    assert "Nothing was written" in done.complaint
    assert not (tmp_path / "geo.csv").exists()
    done = interloc("run", drive, "--osm", osm, "-o", tmp_path / "out", "--locate", "--quiet")
    assert done.code == 1
    assert not (tmp_path / "out").exists()


def test_one_known_pose(drive: Path, tmp_path: Path, interloc: Callable) -> None:
    geo = tmp_path / "geo.csv"
    done = interloc("locate", drive, "--at", "49.0,8.4,90", "-o", geo)
    assert done.code == 0, done.err
    assert "uncertainty" in done.out
    placed = library.open_drive(drive, oxts=geo).georeference
    assert placed is not None
    assert (placed.lat_deg[0], placed.lon_deg[0]) == pytest.approx((49.0, 8.4), abs=1e-8)
    assert placed.lon_deg[-1] > 8.401  # it drives east


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "say where to look"),
        (("--osm", "map.osm", "--at", "49,8,0"), "say where to look"),
        (("--at", "49,8"), "3 numbers with commas"),
        (("--osm", "map.osm", "--at-frame", "3"), "--at-frame belongs to --at"),
        (("--at", "49,8,0", "--growth"), "--at needs no map"),
    ],
)
def test_wrong_usage(drive: Path, arguments: tuple[str, ...], says: str, interloc: Callable) -> None:
    done = interloc("locate", drive, *arguments)
    assert done.code == 2
    assert says in done.err


def test_a_run_placed_afterwards_is_that_of_a_drive_with_gnss(drive: Path, local_drive: Path) -> None:
    with_fixes = library.open_drive(drive)
    at_once = library.detect(with_fixes)
    assert with_fixes.georeference is not None
    later = place_result(
        library.detect(library.open_drive(local_drive)), with_fixes, with_fixes.georeference, {"source": "map"}
    )
    assert at_once.detections.lonlat is not None
    assert np.allclose(later.detections.lonlat, at_once.detections.lonlat, atol=1e-10)
    assert np.allclose(later.intersections.lonlat, at_once.intersections.lonlat, atol=1e-10)
    assert np.allclose(later.detections.bearings_deg[0], at_once.detections.bearings_deg[0])
