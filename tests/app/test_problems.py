"""Errors are problem documents."""

from __future__ import annotations

from collections.abc import Callable

import httpx
import pytest

from tests.app.postgres import postgres_url  # noqa: F401 - a fixture

AS_JSON = {"Content-Type": "application/json"}


def test_unknown_address_is_a_problem_document(client: httpx.Client) -> None:
    answer = client.get("/api/v1/nowhere")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["instance"] == "/api/v1/nowhere"
    assert answer.json()["status"] == 404


def test_names_that_have_no_utf8_are_told(client: httpx.Client) -> None:
    answer = client.post("/api/v1/drives", content=b'{"name": "a", "\\ud800": 1}', headers=AS_JSON)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"


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
        client.get("/api/v1/jobs/%00/intersections"),
        client.get("/api/v1/jobs", params={"drive": "\0"}),
        client.get(f"{drive}/files", params={"after": "\0"}),
        client.put("/api/v1/drives/%00/files/a", content=b"1"),
        client.post("/api/v1/jobs", json={"drive_id": "\0"}),
        client.post("/api/v1/jobs", json={"drive_id": drive.rpartition("/")[2], "osm": {"file": "\0.osm"}}),
    ):
        assert answer.status_code in {200, 404, 422}, answer.text
