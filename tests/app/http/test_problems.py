"""Errors are problem documents."""

from collections.abc import Callable

import httpx
import pytest

AS_JSON = {"Content-Type": "application/json"}


def test_names_that_have_no_utf8_are_told(client: httpx.Client) -> None:
    answer = client.post("/api/v1/drives", content=b'{"name": "a", "\\ud800": 1}', headers=AS_JSON)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    ("address", "body", "says"),
    [
        ("/drives", {"name": "a\0b"}, r"body.name: found 'a\x00b'; expected a name in one line, "),
        ("/drives", {"name": "a", "options": [1]}, "body.options: found [1]; expected an object, in braces."),
        ("/drives", {"name": "a", "options": {"poses": "a\\b"}}, "body.options.poses: 'a"),
        (
            "/drives",
            {"name": "a", "options": {"crs": "utm"}},
            "body.options.crs: found 'utm'; expected a coordinate system",
        ),
        ("/jobs", {"drive_id": "a b"}, "body.drive_id: found 'a b'; expected an id: 1 to 64 letters"),
        ("/jobs", {"drive_id": "a", "osm": "a.osm"}, """body.osm: found 'a.osm'; expected {"file": "map.osm.gz"} """),
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


@pytest.mark.parametrize("given", ["application/x-www-form-urlencoded", "text/plain", None])
def test_json_that_is_not_announced_as_json_is_told(client: httpx.Client, given: str | None) -> None:
    headers = {} if given is None else {"Content-Type": given}
    answer = client.post("/api/v1/drives", content=b'{"name": "x"}', headers=headers)
    assert (answer.status_code, answer.json()["type"]) == (415, "/problems/not-json")
    assert f"{given or 'no Content-Type'}; expected application/json" in answer.json()["detail"]


@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_zero_characters_find_nothing(
    serve: Callable[..., httpx.Client], request: pytest.FixtureRequest, database: str
) -> None:
    client = (
        serve(database_url=request.getfixturevalue("postgres_url"))
        if database == "postgresql"
        else request.getfixturevalue("client")
    )
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
