"""The road seen by LiDAR lies where the drive was, in the file and in the picture of it."""

import io
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from pyproj import Transformer

from interloc.arrays import FloatArray
from interloc.errors import DamagedResultError
from interloc.geometry import lonlat_from_enu, rotate_2d, utm_zone
from interloc.mapping.mosaic import TILE, Mosaic, Raster, build_mosaic
from interloc.output.layout import ROAD_FILE
from interloc.output.read import read_results
from interloc.output.road import MAX_PICTURE_PX, draw_road, read_road, write_road
from interloc.output.write import write_results
from interloc.results import DriveResult, RoadPatch
from tests.output.small import small_result

SPOT_XY = np.array([30.0, -20.0])  # from the second keyframe, along the axes of W


def result_with_spot(*, local: bool = False) -> DriveResult:
    """Return a run whose second keyframe saw road in a square of 3 m, and nowhere else; and its first one none."""
    result = small_result(local=local)
    cells = np.zeros((200, 200), np.uint8)
    corner_xy = np.array([-50.0, 50.0]) + result.keyframes.world_xy[1]
    row, col = (np.array([50.0 - SPOT_XY[1], SPOT_XY[0] + 50.0]) / 0.5).astype(int)
    cells[row - 3 : row + 3, col - 3 : col + 3] = 1
    empty = RoadPatch.pack(0, np.array([-50.0, 50.0]), 0.5, np.zeros_like(cells))
    return replace(result, road=(empty, RoadPatch.pack(1, corner_xy, 0.5, cells)))


def spot_lonlat() -> FloatArray:
    """Return where the middle of the square is on the earth: by the fix of its own keyframe (paper, eq. 12)."""
    table = small_result().keyframes
    angle = table.enu_yaw_rad[1] - table.world_yaw_rad[1]
    ((lon, lat),) = table.lonlat[1:]
    return lonlat_from_enu(lat, lon, rotate_2d(SPOT_XY, angle))


def middle(raster: Raster) -> FloatArray:
    """Return the centroid of all cells that hold something, metres."""
    places = [
        (np.argwhere(tile) + np.array(key) * TILE + 0.5) * [-raster.cell_m, raster.cell_m]
        for key, tile in raster.tiles.items()
    ]
    y, x = np.concatenate(places).mean(axis=0)
    return np.array([x, y])


def test_a_patch_lies_where_the_detections_of_its_keyframe_do() -> None:
    mosaic = build_mosaic(result_with_spot())
    assert mosaic.epsg == 32632
    assert_allclose(
        middle(mosaic.raster), Transformer.from_crs(4326, 32632, always_xy=True).transform(*spot_lonlat()), atol=0.3
    )
    area = sum(int(np.count_nonzero(tile)) for tile in mosaic.raster.tiles.values()) * 0.25
    assert area == pytest.approx(9.0, abs=1.5)
    local = build_mosaic(result_with_spot(local=True))
    assert local.epsg is None
    assert_allclose(middle(local.raster), small_result().keyframes.world_xy[1] + SPOT_XY, atol=0.3)
    assert (utm_zone(-179.9, -10.0), utm_zone(8.4, 49.0), utm_zone(180.0, 1.0)) == (32701, 32632, 32601)


def test_cells_are_counted_and_a_large_area_gets_larger_ones() -> None:
    result = result_with_spot()
    twice = build_mosaic(replace(result, road=result.road * 2)).raster
    assert max(tile.max() for tile in twice.tiles.values()) == 2
    lonlat = np.array([[8.0, 48.0], [9.5, 50.0]])  # 110 km by 220 km
    far = replace(result, keyframes=replace(result.keyframes, lonlat=lonlat))
    raster = build_mosaic(far).raster
    assert raster.cell_m == 2.0
    assert len(raster.tiles) == 1
    coarse = raster.coarser()
    assert coarse.cell_m == 4.0
    assert_allclose(middle(coarse), middle(raster), atol=4.0)


def test_the_file_says_where_it_lies(tmp_path: Path) -> None:
    path = tmp_path / ROAD_FILE
    for local in (False, True):
        mosaic = build_mosaic(result_with_spot(local=local))
        write_road(mosaic, path)
        again = read_road(path)
        assert (again.epsg, again.raster.cell_m) == (mosaic.epsg, mosaic.raster.cell_m)
        assert again.raster.tiles.keys() == mosaic.raster.tiles.keys()
        assert all(np.array_equal(tile, mosaic.raster.tiles[key]) for key, tile in again.raster.tiles.items())
    whole = path.read_bytes()
    at = whole.index(b"\x78\x9c") + 4  # in what zlib packed
    for damaged in (whole[:200], whole[:at] + b"\xff" * 9 + whole[at + 9 :]):
        path.write_bytes(damaged)
        with pytest.raises(DamagedResultError, match=r"road\.tif is missing or damaged"):
            read_road(path)


def test_a_result_written_over_itself_keeps_its_road_however_it_is_called(tmp_path: Path) -> None:
    write_results(result_with_spot(), tmp_path / "out")
    (tmp_path / "link").symlink_to("out")
    write_results(read_results(tmp_path / "out"), tmp_path / "link")
    assert read_road(tmp_path / "out" / ROAD_FILE).raster.tiles


def test_other_ground_is_a_page_of_its_own(tmp_path: Path) -> None:
    """Readers of the first page see what they always saw; a cell that is 0 in both was not seen."""
    result = result_with_spot()
    patch = result.road[1]
    ring = np.minimum(cv2.dilate(patch.cells(), np.ones((5, 5), np.uint8)), 1 - patch.cells())
    both = RoadPatch.pack(1, patch.corner_xy, patch.resolution_m, patch.cells(), ring)
    mosaic = build_mosaic(replace(result, road=(both,)))
    assert mosaic.other is not None
    assert_allclose(middle(mosaic.other), middle(mosaic.raster), atol=0.3)
    write_road(mosaic, tmp_path / "both.tif")
    write_road(replace(mosaic, other=None), tmp_path / "road.tif")
    again, without = (read_road(tmp_path / name) for name in ("both.tif", "road.tif"))
    assert again.other is not None
    assert without.other is None
    for found, expected in (
        (again.raster, mosaic.raster),
        (again.other, mosaic.other),
        (without.raster, mosaic.raster),
    ):
        assert found.tiles.keys() == expected.tiles.keys()
        assert all(np.array_equal(tile, expected.tiles[key]) for key, tile in found.tiles.items())
    by_opencv = [cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED) for name in ("both.tif", "road.tif")]
    assert np.array_equal(*by_opencv)


def test_readers_that_know_no_empty_tiles_read_it(tmp_path: Path) -> None:
    path = tmp_path / ROAD_FILE
    tiles = {(row, row): np.full((TILE, TILE), row + 1, np.uint8) for row in range(8)}  # of 64
    write_road(Mosaic(Raster(0.5, tiles), 32632), path)
    by_opencv = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    with Image.open(path) as by_pillow:
        assert (np.asarray(by_pillow) == by_opencv).all()
    assert by_opencv[::TILE, ::TILE].tolist() == np.diag(range(1, 9)).tolist()
    assert read_road(path).raster.tiles.keys() == tiles.keys()
    assert path.stat().st_size < 4000, "the empty ones are there once"


@pytest.mark.skipif(shutil.which("gdallocationinfo") is None, reason="GDAL is not installed")
def test_gdal_reads_it(tmp_path: Path) -> None:
    path = tmp_path / ROAD_FILE
    tiles = {key: np.zeros((TILE, TILE), np.uint8) for key in ((0, 0), (2, 3))}  # the others are not there
    for tile in tiles.values():
        tile[7, 9] = 5
    write_road(Mosaic(Raster(0.5, tiles), None), path)
    x, y = (3 * TILE + 9.5) * 0.5, -(2 * TILE + 7.5) * 0.5
    assert gdal("gdallocationinfo", "-valonly", "-geoloc", path, str(x), str(y)).strip() == "5"
    assert gdal("gdallocationinfo", "-valonly", "-geoloc", path, str(x), str(y + 128)).strip() == "0"
    write_road(build_mosaic(result_with_spot()), path)
    assert gdal("gdallocationinfo", "-valonly", "-wgs84", path, *map(str, spot_lonlat())).strip() == "1"
    about = gdal("gdalinfo", path)
    assert all(each in about for each in ("UTM zone 32N", "NoData Value=0", "Block=256x256", "COMPRESSION=DEFLATE"))


def gdal(*command: object) -> str:
    return subprocess.run([str(each) for each in command], capture_output=True, text=True, check=True).stdout


def test_the_picture_shows_it_at_its_place() -> None:
    picture = draw_road(build_mosaic(result_with_spot()))
    alpha = np.asarray(Image.open(io.BytesIO(picture.png)).convert("RGBA"))[..., 3]
    assert alpha.shape == picture.size[::-1]
    rows, cols = np.nonzero(alpha)
    to_mercator = Transformer.from_crs(4326, 3857, always_xy=True)
    west, south = to_mercator.transform(*picture.bounds[:2])
    east, north = to_mercator.transform(*picture.bounds[2:])
    x = west + (cols.mean() + 0.5) / alpha.shape[1] * (east - west)
    y = north - (rows.mean() + 0.5) / alpha.shape[0] * (north - south)
    assert_allclose((x, y), to_mercator.transform(*spot_lonlat()), atol=0.6)
    local = draw_road(build_mosaic(result_with_spot(local=True)))
    assert (local.bounds[2] - local.bounds[0], local.cell_m) == (local.size[0] * 0.5, 0.5)


def test_the_picture_of_a_large_drive_is_drawn_in_larger_cells() -> None:
    tile = np.ones((TILE, TILE), np.uint8)
    picture = draw_road(Mosaic(Raster(0.5, {(0, 0): tile, (40, 30): tile}), None))  # 5.2 km
    assert max(picture.size) <= MAX_PICTURE_PX
    assert picture.cell_m == 2.0
    alpha = np.asarray(Image.open(io.BytesIO(picture.png)).convert("RGBA"))[..., 3]
    assert np.count_nonzero(alpha) == 2 * 64 * 64
