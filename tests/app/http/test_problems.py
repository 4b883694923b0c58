"""Errors are problem documents."""

import asyncio

import httpx
import pytest

from app.http.middleware import Faults
from tests.app.conftest import Serve, alone


@pytest.mark.parametrize(
    ("address", "body", "says"),
    [
        ("/drives", {"name": "a\0b"}, r"body.name: found 'a\x00b'; expected a name in one line, "),
        ("/drives", {"name": "a", "options": [1]}, "body.options: found [1]; expected an object, in braces."),
        ("/drives", {"name": "a", "options": {"poses": "a\\b"}}, "body.options.poses: 'a"),
        ("/drives", {"name": "a", "options": {"crs": "utm"}}, "body.options.crs: found 'utm'; expected a coordinate"),
        ("/jobs", {"drive_id": "a b"}, "body.drive_id: found 'a b'; expected an id: 1 to 64 letters"),
        *(
            ("/jobs", {"drive_id": "a", "osm": osm}, f'body.osm: found {osm!r}; expected {{"file": "map.osm.gz"}} ')
            for osm in ("a.osm", 3, {}, {"files": "a.osm"}, {"file": 3}, {"file": "a.osm", "overpass": True})
        ),
        ("/jobs", {"drive_id": "a", "near": [49, 8.4]}, "body.near: found [49, 8.4]; expected an object, in braces."),
    ],
)
def test_what_is_wrong_with_a_body_is_told_in_words(
    client: httpx.Client, address: str, body: dict[str, object], says: str
) -> None:
    answer = client.post(f"/api/v1{address}", json=body)
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith(says)
    assert len(answer.json()["problems"]) == 1


@pytest.mark.parametrize(
    ("address", "body", "field"),
    [
        ("/drives", {}, "body.name"),
        ("/drives", {"name": ""}, "body.name"),
        *(("/drives", {"name": f"a{each}b"}, "body.name") for each in "\n\u2029\u202e\u2066"),
        ("/drives", {"name": "a" * 201}, "body.name"),
        ("/drives", {"name": "a", "nonsense": 1}, "body.nonsense"),
        ("/drives", {"name": "a", "options": {"pose_frame": "radar"}}, "body.options.pose_frame"),
        ("/drives", {"name": "a", "options": {"label_scheme": "street"}}, "body.options.label_scheme"),
        ("/drives", {"name": "a", "options": {"oxts": "../../../etc/passwd"}}, "body.options.oxts"),
        ("/drives/look", {"name": "a"}, "body.files"),
        ("/drives/look", {"name": "a", "files": {"x": -1}}, "body.files.x"),
        ("/drives/look", {"name": "a", "files": {}, "contents": {"x": "?"}}, "body.contents.x"),
        ("/drives/look", {"name": "a", "files": {}, "options": {"poses": "../x"}}, "body.options.poses"),
        # Numbers are no text, and 0 is not false.
        ("/drives", {"name": "a", "keep_raw": 0}, "body.keep_raw"),
        ("/drives/look", {"name": "a", "files": {"a": "1"}}, "body.files.a"),
        ("/drives/look", {"name": "a", "files": {"a": True}}, "body.files.a"),
        ("/drives/look", {"name": "a", "files": {}, "keyframes": {"window": "3"}}, "body.keyframes.window"),
        ("/jobs", {"drive_id": "x", "tolerance_m": "15"}, "body.tolerance_m"),
        ("/jobs", {"drive_id": "x", "osm": {"overpass": 1}}, "body.osm"),
    ],
)
def test_a_bad_request_names_its_field(client: httpx.Client, address: str, body: dict[str, object], field: str) -> None:
    answer = client.post(f"/api/v1{address}", json=body)
    assert answer.status_code == 422
    assert answer.json()["problems"][0]["path"] == field


@pytest.mark.parametrize("given", ["application/x-www-form-urlencoded", "text/plain", None])
def test_json_that_is_not_announced_as_json_is_told(client: httpx.Client, given: str | None) -> None:
    headers = {} if given is None else {"Content-Type": given}
    answer = client.post("/api/v1/drives", content=b'{"name": "x"}', headers=headers)
    assert (answer.status_code, answer.json()["type"]) == (415, "/problems/not-json")
    assert f"{given or 'no Content-Type'}; expected application/json" in answer.json()["detail"]


@alone
async def test_what_the_server_stops_in_is_to_be_sent_again() -> None:
    async def given_up(*_: object) -> None:
        raise asyncio.CancelledError

    async with httpx.AsyncClient(transport=httpx.ASGITransport(Faults(given_up))) as client:
        answer = await client.get("http://localhost/api/v1/drives")
    assert (answer.status_code, answer.json()["type"], answer.headers["retry-after"]) == (503, "/problems/busy", "5")


def test_zero_characters_find_nothing(serve: Serve, url: str) -> None:
    client = serve(database_url=url)
    drive = client.post("/api/v1/drives", json={"name": "town"}).headers["location"]
    for answer in (
        client.get("/api/v1/drives/%00"),
        client.delete("/api/v1/drives/a%00"),
        client.get("/api/v1/jobs/%00"),
        client.get("/api/v1/jobs/%00/events"),
        client.get("/api/v1/jobs/%00/layers/intersections"),
        client.get("/api/v1/jobs", params={"drive": "\0"}),
        client.get(f"{drive}/files", params={"after": "\0"}),
        client.put("/api/v1/drives/%00/files/a", content=b"1"),
        client.post("/api/v1/jobs", json={"drive_id": "\0"}),
        client.post("/api/v1/jobs", json={"drive_id": drive.rpartition("/")[2], "osm": {"file": "\0.osm"}}),
    ):
        assert answer.status_code in {200, 404, 422}, answer.text
