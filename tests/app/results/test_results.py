"""What a job yields goes over the wire byte for byte, once, and with reasons where there is none."""

import io
import json
import re
import zipfile
from email.utils import parsedate_to_datetime
from pathlib import Path

import pytest

from app.store.models import Job
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
    finished.add_plain("older")
    for summary, linked in (({}, set()), ({"has_roads": True}, roads)):
        with finished.changing() as session:
            session.get_one(Job, "older").summary = {"georeferenced": True, "report": None, **summary}
        links = finished.get("/jobs/older").json()["links"]
        assert roads & links.keys() == linked
        assert {"intersections", "export"} <= links.keys()
    folder = finished.data_dir / "jobs/older/result"
    for name in roads:
        (folder / f"{name}.geojson").unlink()
        answer = finished.get(f"/jobs/older/layers/{name}")
        assert (answer.status_code, "an older version made its result" in answer.json()["detail"]) == (404, True)
    answer = finished.get("/jobs/older/export?f=fgb&layer=roads")
    assert answer.status_code == 404
    assert finished.get("/jobs/older/export?f=gpkg").status_code == 200
    with finished.changing() as session:
        session.delete(session.get_one(Job, "older"))


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


def test_ranges_of_a_file(finished: Finished) -> None:
    whole = (finished.results / "default/detections.geojson").read_bytes()
    part = finished.get(
        "/jobs/default/layers/detections", headers={"range": "bytes=100-299", "accept-encoding": "gzip"}
    )
    assert part.status_code == 206
    assert part.content == whole[100:300]
    assert part.headers["content-range"] == f"bytes 100-299/{len(whole)}"
    assert finished.get("/jobs/default/layers/detections", headers={"range": f"bytes={len(whole)}-"}).status_code == 416
    changed = {"range": "bytes=0-9", "if-range": '"something else"'}
    assert finished.get("/jobs/default/layers/detections", headers=changed).status_code == 200


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


@pytest.mark.parametrize(
    "name",
    [
        "../scratch/x",
        "..%2f..%2f..%2finterloc.sqlite3",
        "%2fetc%2fpasswd",
        "figures",
        "nothing",
        "a%00b",
        "figures/..",
        "link",
        "a" * 300,
        "a/" * 200,
    ],
)
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
