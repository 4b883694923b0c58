"""The road seen by LiDAR over the wire: the file of the result, and a picture that says where it lies."""

import io

import numpy as np
import pytest
from PIL import Image

from interloc.output.layout import ROAD_FILE
from interloc.output.road import draw_road, read_road
from tests.app.results.conftest import Finished


@pytest.mark.parametrize("job", ["default", "local"])
def test_the_raster_and_its_picture(job: str, finished: Finished) -> None:
    file = finished.results / job / ROAD_FILE
    raster = finished.get(f"/jobs/{job}/files/road.tif")
    assert raster.headers["content-type"].startswith("image/tiff")
    assert raster.content == file.read_bytes()
    view = finished.get(f"/jobs/{job}/road").json()
    expected = draw_road(read_road(file))
    assert view["bounds_world_m" if job == "local" else "bounds_lonlat"] == list(expected.bounds)
    assert (view["crs"], view["resolution_m"]) == (None if job == "local" else "EPSG:32632", 0.5)
    picture = finished.get(f"/jobs/{job}/road.png")
    assert picture.content == expected.png
    assert Image.open(io.BytesIO(picture.content)).size == tuple(view["size_px"])
    for address in ("road", "road.png"):
        etag = finished.get(f"/jobs/{job}/{address}").headers["etag"]
        assert finished.get(f"/jobs/{job}/{address}", headers={"if-none-match": etag}).status_code == 304


def test_the_street_is_in_it(finished: Finished) -> None:
    raster = read_road(finished.results / "local" / ROAD_FILE).raster
    along = raster.window(-1, 0, 2, 120)  # 60 m along the street, from its first scan
    assert np.count_nonzero(along) == along.size


def test_a_result_of_an_older_version_has_none(finished: Finished) -> None:
    finished.add_plain("older")
    (finished.data_dir / "jobs/older/result" / ROAD_FILE).unlink()
    for address in ("road", "road.png"):
        answer = finished.get(f"/jobs/older/{address}")
        assert answer.status_code == 404
        assert "older version" in answer.json()["detail"]
    assert finished.get("/jobs/older/layers/intersections").status_code == 200
