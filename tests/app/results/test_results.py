"""What a job yields goes over the wire byte for byte, once, and with reasons where there is none."""

import io
import json
import re
import zipfile
from email.utils import parsedate_to_datetime
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from app.store.models import Job
from interloc.output.layout import ROAD_FILE
from interloc.output.road import draw_road, read_road
from tests.app.processes import raw_get
from tests.app.results.conftest import Finished

LAYERS = ["intersections", "detections", "trajectory", "keyframes", "roads", "junctions", "road_surface"]
LAYERS += ["osm_nodes", "matches", "osm_roads"]
ADDRESSES = [f"layers/{each}" for each in LAYERS]
IDENTITY = {"accept-encoding": "identity"}


def files_of(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_result_of_an_older_version_is_linked_without_roads(finished: Finished) -> None:
    roads = {"roads", "junctions", "road_surface"}
    with finished.older() as folder:
        for summary, linked in (({}, set()), ({"has_roads": True}, roads)):
            with finished.changing() as session:
                session.get_one(Job, "older").summary = {"georeferenced": True, "report": None, **summary}
            links = finished.get("/jobs/older").json()["links"]
            assert roads & links.keys() == linked
            assert {"intersections", "export"} <= links.keys()
        for name in roads:
            (folder / f"{name}.geojson").unlink()
            answer = finished.get(f"/jobs/older/layers/{name}")
            assert (answer.status_code, "an older version made its result" in answer.json()["detail"]) == (404, True)
        assert finished.get("/jobs/older/export?f=fgb&layer=roads").status_code == 404
        assert finished.get("/jobs/older/export?f=gpkg").status_code == 200


@pytest.mark.parametrize("layer", LAYERS)
def test_layers_are_the_bytes_of_the_command_line(layer: str, finished: Finished) -> None:
    expected = (finished.results / "default" / f"{layer}.geojson").read_bytes()
    for headers in (IDENTITY, {"accept-encoding": "gzip"}):
        answer = finished.get(f"/jobs/default/layers/{layer}", headers=headers)
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "application/geo+json"
        assert answer.content == expected
        assert answer.headers.get("vary") == ("Accept-Encoding" if len(expected) >= 1400 else None)
        assert answer.headers["cache-control"] == "private, no-cache"
        assert re.search(rf'filename="Stra_e_street-{layer}\.geojson"', answer.headers["content-disposition"])


def test_what_is_packed_is_the_file_as_it_is_now(finished: Finished) -> None:
    with finished.older() as folder:
        for letter in "ab":
            content = json.dumps([letter] * 1000).encode()
            (folder / "detections.new").write_bytes(content)
            (folder / "detections.new").replace(folder / "detections.geojson")
            for _ in range(2):
                answer = finished.get("/jobs/older/layers/detections", headers={"accept-encoding": "gzip"})
                assert (answer.headers["content-encoding"], answer.content) == ("gzip", content)


@pytest.mark.parametrize("encoding", ["identity", "gzip"])
@pytest.mark.parametrize("address", [*ADDRESSES, "report", "report?format=html", "files/figures/map.png"])
def test_what_the_client_has_is_not_sent_again(address: str, encoding: str, finished: Finished) -> None:
    headers = {"accept-encoding": encoding}
    first = finished.get(f"/jobs/default/{address}", headers=headers)
    etag = first.headers["etag"]
    assert re.fullmatch(r'(W/)?"[^"]+"', etag)
    for known in (etag, f'"other", {etag}', "*"):
        again = finished.get(f"/jobs/default/{address}", headers={**headers, "if-none-match": known})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == etag.removeprefix("W/")
    assert finished.get(f"/jobs/default/{address}", headers={**headers, "if-none-match": '"x"'}).status_code == 200
    modified = first.headers["last-modified"]
    assert (
        finished.get(f"/jobs/default/{address}", headers={**headers, "if-modified-since": modified}).status_code == 304
    )
    old = "Mon, 01 Jan 2024 00:00:00 GMT"
    assert finished.get(f"/jobs/default/{address}", headers={**headers, "if-modified-since": old}).status_code == 200
    assert parsedate_to_datetime(modified).year > 2024


@pytest.mark.parametrize(
    "address", ["layers/detections", "report", "report?format=html", "archive.zip", "files", "files/run.json"]
)
def test_head_tells_what_get_would(address: str, finished: Finished) -> None:
    path = f"/api/v1/jobs/default/{address}"
    head, get = finished.client.head(path), finished.client.get(path)
    assert head.status_code == get.status_code == 200
    assert head.content == b""
    for name in ("content-type", "etag", "content-length", "content-disposition", "content-encoding"):
        if address != "archive.zip" or name != "content-length":
            assert head.headers.get(name) == get.headers.get(name)


def test_report_for_programs_and_for_people(finished: Finished) -> None:
    folder = finished.results / "default"
    for query, expected in (("", "report.json"), ("?format=json", "report.json"), ("?format=html", "report.html")):
        answer = finished.get(f"/jobs/default/report{query}")
        assert answer.content == (folder / expected).read_bytes()
    policy = answer.headers["content-security-policy"]
    assert "sandbox" in policy
    assert "script-src" not in policy
    assert "default-src 'none'" in policy
    assert finished.get("/jobs/default/report?format=pdf").status_code == 422


def test_every_file_is_listed_and_can_be_read(finished: Finished) -> None:
    expected = files_of(finished.results / "default")
    listed = {each["name"]: each for each in finished.get("/jobs/default/files").json()["files"]}
    assert set(listed) == set(expected)
    for name, content in expected.items():
        answer = finished.client.get(listed[name]["href"])
        assert answer.content == content
        assert listed[name]["size_bytes"] == len(content)
        assert answer.headers["content-type"] == listed[name]["media_type"]
    assert finished.get("/jobs/default/files/run.json").json()["drive_name"] == "street"


OUTSIDE = ["../scratch/x", "..%2f..%2f..%2finterloc.sqlite3", "%2fetc%2fpasswd", "a%00b", "figures/..", "link"]


@pytest.mark.parametrize("name", [*OUTSIDE, "figures", "nothing", "a" * 300, "a/" * 200])
def test_no_way_out_of_the_result(name: str, finished: Finished) -> None:
    link = finished.data_dir / "jobs/default/result/link"
    if not link.is_symlink():
        link.symlink_to("/etc/passwd")
    try:
        status, content = raw_get(finished.client, f"/api/v1/jobs/default/files/{name}")
    finally:
        link.unlink()
    assert (status, json.loads(content)["title"]) == (404, "File not found")


def test_the_archive_holds_the_folder(finished: Finished) -> None:
    answer = finished.get("/jobs/default/archive.zip")
    assert answer.headers["content-type"] == "application/zip"
    assert 'filename="Stra_e_street-default.zip"' in answer.headers["content-disposition"]
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        assert archive.testzip() is None
        content = {info.filename: archive.read(info) for info in archive.infolist()}
    styles = {name: content.pop(name) for name in list(content) if name.endswith(".qml")}
    assert len(styles) == 10
    assert b"categorizedSymbol" in styles["Straße_street-default/intersections.qml"]
    expected = files_of(finished.results / "default")
    assert content == {f"Straße_street-default/{name}": data for name, data in expected.items()}
    known = finished.get("/jobs/default/archive.zip", headers={"if-none-match": answer.headers["etag"]})
    assert known.status_code == 304


@pytest.mark.parametrize(("job", "status", "title", "said"), [
    ("nobody", 404, "Job not found", "nobody"),
    ("failed", 409, "Result not ready", "GET /api/v1/jobs/failed says why"),
    ("cancelled", 409, "Result not ready", "cancelled"),
    ("upload", 404, "No results", "commit"),
    ("lost", 410, "Result is gone", "no longer on disk"),
])  # fmt: skip
@pytest.mark.parametrize("address", ["layers/detections", "report", "files", "files/run.json", "archive.zip"])
def test_why_there_is_no_result(job: str, status: int, title: str, said: str, address: str, finished: Finished) -> None:
    answer = finished.get(f"/jobs/{job}/{address}")
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["title"] == title
    assert said in answer.json()["detail"]


def test_why_there_is_no_evaluation(finished: Finished) -> None:
    for address in ("report", "layers/osm_nodes", "layers/matches", "layers/osm_roads"):
        answer = finished.get(f"/jobs/plain/{address}")
        assert (answer.status_code, answer.json()["title"]) == (404, "Not scored")
        assert '"osm"' in answer.json()["detail"]
        assert finished.get(f"/jobs/local/{address}").json()["title"] == "Not georeferenced"
    for layer in ("intersections", "detections", "trajectory", "keyframes"):
        assert finished.get(f"/jobs/plain/layers/{layer}").status_code == 200
        answer = finished.get(f"/jobs/local/layers/{layer}")
        assert (answer.status_code, answer.json()["title"]) == (404, "Not georeferenced")
        hint = re.search(r"/api/v1(/jobs/local/files/\S+\.local\.json)", answer.json()["detail"])
        assert hint is not None
        assert finished.get(hint[1]).json()["local"] is True


def test_a_result_that_has_lost_a_file_is_damaged(finished: Finished) -> None:
    with finished.older() as folder:
        with finished.changing() as session:
            session.get_one(Job, "older").summary = {"georeferenced": True, "report": {"map_f1": 1.0}}
        (folder / "intersections.geojson").unlink()
        for address in ("report", "layers/osm_nodes", "layers/intersections"):
            answer = finished.get(f"/jobs/older/{address}")
            assert (answer.status_code, answer.json()["type"]) == (500, "/problems/result-damaged")


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
    with finished.older() as folder:
        (folder / ROAD_FILE).unlink()
        for address in ("road", "road.png"):
            answer = finished.get(f"/jobs/older/{address}")
            assert (answer.status_code, "older version" in answer.json()["detail"]) == (404, True)
        assert finished.get("/jobs/older/layers/intersections").status_code == 200


def test_two_presets_side_by_side(finished: Finished) -> None:
    answer = finished.get("/compare?jobs=default,paper")
    assert answer.status_code == 200
    told = answer.json()
    assert told["runs"] == ["default", "paper"]
    assert told["names"] == ["default, no map", "paper, no map"]
    assert not any(setting["is_own"] for setting in told["settings"])
    settings = {row["name"]: row["values"] for row in told["settings"]}
    assert settings["preset"] == ["default", "paper"]
    assert all(values[0] != values[1] for values in settings.values())
    reports = [json.loads((finished.results / job / "report.json").read_text()) for job in ("default", "paper")]
    figures = {row["name"]: row["values"] for row in told["figures"]}
    assert figures["ace_m"] == [report["ace_m"] for report in reports]
    assert figures["recall_at_5"] == [report["recall"]["5.0"] for report in reports]
    assert told["found_by_all"] + len(told["found_only_by"][0]) == reports[0]["nodes_found"]
    assert told["inputs"] == told["warnings"] == []


def test_other_labels_are_named_and_a_renamed_drive_is_the_same(finished: Finished) -> None:
    path = finished.data_dir / "jobs/paper/result/run.json"
    before = path.read_text()
    labels = json.loads(before)["labels"]
    path.write_text(json.dumps(json.loads(before) | {"labels": "network salsanext", "drive_name": "renamed"}))
    try:
        told = finished.get("/compare?jobs=default,paper").json()
    finally:
        path.write_text(before)
    assert told["inputs"] == [{"name": "labels", "values": [labels, "network salsanext"]}]
    assert told["warnings"] == []


def test_a_job_beside_itself_would_say_nothing(finished: Finished) -> None:
    for jobs in ("default", "default,default", "", ",", "a,b,c,d,e,f,g,h,i"):
        assert finished.get("/compare", params={"jobs": jobs}).status_code == 422
    assert finished.get("/compare").status_code == 422


@pytest.mark.parametrize(("jobs", "status", "title"), [
    ("default,elsewhere", 422, "Different drives"),
    ("default,plain", 404, "Not scored"),
    ("default,nobody", 404, "Job not found"),
    ("default,failed", 409, "Result not ready"),
])  # fmt: skip
def test_what_cannot_be_compared(jobs: str, status: int, title: str, finished: Finished) -> None:
    answer = finished.get("/compare", params={"jobs": jobs})
    assert (answer.status_code, answer.json()["title"]) == (status, title)


def test_a_pinned_job_stands_for_its_drive_else_the_best_does(finished: Finished) -> None:
    def shown() -> tuple[str | None, str | None]:
        drive = finished.get("/drives/street").raise_for_status().json()
        (listed,) = (each for each in finished.get("/drives").json()["drives"] if each["id"] == "street")
        assert listed["result_job"] == drive["result_job"]
        return drive["result_job"], drive["pinned_job"]

    def pin(job: str | None) -> httpx.Response:
        return finished.client.patch("/api/v1/drives/street", json={"pinned_job": job})

    assert shown()[0] == "lost", "the newest of those of one rank, though its files are gone"
    assert pin("paper").is_success
    assert shown() == ("paper", "paper")
    assert pin("failed").status_code == 409
    assert pin("elsewhere").status_code == 404, "it is of another drive"
    assert pin(None).json()["pinned_job"] is None
    scores = {"paper": {"map_f1": 1.0}, "default": {"map_f1": 0.5}, "plain": {"f1_at_5": 0.4}}
    with finished.changing() as session:
        for job, report in scores.items():
            session.get_one(Job, job).summary = {"georeferenced": True, "report": report}
    assert shown() == ("default", None), "paper comes after, whatever its score"
    with finished.changing() as session:
        for job in scores:
            session.get_one(Job, job).summary = None


def test_one_answer_holds_all_of_a_result_that_the_page_shows(finished: Finished) -> None:
    answer = finished.get("/jobs/default/view").raise_for_status()
    told = answer.json()
    assert told["job"] == finished.get("/jobs/default").json()
    assert told["run"] == finished.get("/jobs/default/files/run.json").json()
    assert told["report"] == finished.get("/jobs/default/report?format=json").json()
    for name in ("intersections", "trajectory", "osm_nodes", "matches"):
        assert told[name] == finished.get(f"/jobs/default/layers/{name}").json()
    assert finished.get("/jobs/default/view", headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    local = finished.get("/jobs/local/view").raise_for_status().json()
    assert local["keyframes"] == finished.get("/jobs/local/files/keyframes.local.json").json()
    assert local["report"] is None
    assert finished.get("/jobs/failed/view").json()["run"] is None
    assert finished.get("/jobs/lost/view").status_code == 410
    assert finished.get("/jobs/nobody/view").status_code == 404
