"""Pictures of a keyframe: drawn by a worker from the drive, once, and where the result says that it is."""

import io
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from interloc.config import preset
from interloc.drives.open import open_drive
from interloc.explain.evidence import gather
from interloc.explain.figures import OVERLAYS, draw_overlay
from tests.app.results.conftest import Finished

FRAME = 30


@pytest.mark.parametrize("job", ["default", "paper"])
def test_pictures_are_those_of_the_library(job: str, finished: Finished) -> None:
    evidence = gather(open_drive(finished.results / "street"), FRAME, preset(job))
    for layer in OVERLAYS:
        answer = finished.get(f"/jobs/{job}/keyframes/{FRAME}/bev.png?layer={layer}")
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "image/png"
        assert answer.content == draw_overlay(evidence, layer)
    assert finished.get(f"/jobs/{job}/keyframes/{FRAME}/bev.png").content == draw_overlay(evidence, "bev")
    assert Image.open(io.BytesIO(answer.content)).size == (1500, 1500)


def test_the_numbers_agree_with_the_result(finished: Finished) -> None:
    view = finished.get(f"/jobs/default/keyframes/{FRAME}/bev").json()
    features = json.loads((finished.results / "default/detections.geojson").read_text())["features"]
    mine = [f["geometry"]["coordinates"] for f in features if f["properties"]["frame"] == FRAME]
    assert len(mine) > 0
    assert_allclose(sorted(d["lonlat"] for d in view["detections"]), sorted(mine), atol=2e-9)
    keyframes = json.loads((finished.results / "default/keyframes.geojson").read_text())["features"]
    (place,) = [k["geometry"]["coordinates"] for k in keyframes if k["properties"]["frame"] == FRAME]
    cell_deg = 2 * view["resolution_m"] / 70_000
    assert_allclose(np.mean(view["corners_lonlat"], axis=0), place, atol=cell_deg)
    assert view["layers"] == list(OVERLAYS)
    assert (view["size_px"], view["resolution_m"], view["relevant_zone_m"]) == (750, 0.16, 40.0)


def test_without_georeference_corners_are_local(finished: Finished) -> None:
    view = finished.get(f"/jobs/local/keyframes/{FRAME}/bev").json()
    assert view["corners_lonlat"] is None
    (left, top), (right, _), (_, bottom), _ = view["corners_world_m"]
    assert_allclose([right - left, top - bottom], 120.0, atol=0.17)
    assert finished.get(f"/jobs/local/keyframes/{FRAME}/bev.png?layer=all").status_code == 200


def test_what_was_drawn_is_kept_and_revalidated(finished: Finished) -> None:
    address = "/jobs/plain/keyframes/12/bev.png?layer=branches"
    first = finished.get(address)
    folder = finished.data_dir / "jobs/plain/cache/bev/12"
    assert {path.name for path in folder.iterdir()} == {"view.json", *(f"{layer}.png" for layer in OVERLAYS)}
    drawn = (folder / "branches.png").stat().st_mtime_ns
    again = finished.get(address, headers={"if-none-match": first.headers["etag"]})
    assert again.status_code == 304
    assert "max-age" in first.headers["cache-control"]
    assert (folder / "branches.png").stat().st_mtime_ns == drawn
    head = finished.client.head(f"/api/v1{address}")
    assert head.headers["content-length"] == str(len(first.content))


def test_many_at_once_are_drawn_once_each(finished: Finished) -> None:
    addresses = [f"/jobs/plain/keyframes/{frame}/bev.png?layer={layer}" for frame in (20, 21, 22) for layer in OVERLAYS]
    with ThreadPoolExecutor(12) as threads:
        answers = list(threads.map(finished.get, addresses * 2))
    assert {answer.status_code for answer in answers} == {200}
    half = len(addresses)
    assert [a.content for a in answers[:half]] == [a.content for a in answers[half:]]
    assert len({a.headers["etag"] for a in answers}) > 1


@pytest.mark.parametrize(("address", "status", "said"), [
    ("/jobs/default/keyframes/4711/bev.png", 404, "the nearest one is 39"),
    ("/jobs/default/keyframes/4711/bev", 404, "not a keyframe"),
    ("/jobs/nobody/keyframes/1/bev.png", 404, "no job nobody"),
    ("/jobs/failed/keyframes/1/bev", 409, "failed"),
    ("/jobs/default/keyframes/-1/bev", 422, "frame"),
    ("/jobs/default/keyframes/x/bev.png", 422, "frame"),
    ("/jobs/default/keyframes/1/bev.png?layer=roof", 422, "layer"),
])  # fmt: skip
def test_what_cannot_be_drawn(address: str, status: int, said: str, finished: Finished) -> None:
    answer = finished.get(address)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert said in answer.json()["detail"]


def test_a_drive_that_is_damaged_is_no_fault_of_the_service(finished: Finished) -> None:
    scan = finished.data_dir / "drives/other/reduced/ground/labels/000030.ground"
    content = scan.read_bytes()
    scan.write_bytes(content[:-3])
    try:
        answer = finished.get("/jobs/elsewhere/keyframes/30/bev")
    finally:
        scan.write_bytes(content)
    assert answer.status_code == 422
    assert "ground/labels/000030.ground" in answer.json()["detail"]
    assert not (finished.data_dir / "jobs/elsewhere/cache/bev").exists()
    assert finished.get("/jobs/elsewhere/keyframes/30/bev").status_code == 200


def test_a_drive_whose_files_were_removed_is_gone(finished: Finished) -> None:
    reduced = finished.data_dir / "drives/other/reduced"
    reduced.rename(reduced.with_name("away"))
    try:
        answer = finished.get("/jobs/elsewhere/keyframes/32/bev")
    finally:
        reduced.with_name("away").rename(reduced)
    assert (answer.status_code, answer.json()["title"]) == (410, "Drive not whole")
    assert "no longer on the disk of the service" in answer.json()["detail"]
