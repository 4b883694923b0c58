"""Drives: made, listed page by page, shown, deleted with all that belongs to them."""

import httpx
import pytest

from app.drives import records
from app.drives.models import DriveOptionsModel
from tests.app.conftest import Serve
from tests.app.processes import every


def test_a_new_drive_is_open_for_files(client: httpx.Client) -> None:
    answer = client.post("/api/v1/drives", json={"name": " town ", "options": {"label_scheme": "40,60"}})
    assert answer.status_code == 201
    drive = answer.json()
    assert answer.headers["location"] == f"/api/v1/drives/{drive['id']}"
    assert (drive["name"], drive["state"], drive["files"], drive["size_bytes"]) == ("town", "uploading", 0, 0)
    assert drive["options"] == DriveOptionsModel(label_scheme="40,60").model_dump(mode="json")
    assert drive["expires_at"] > drive["created_at"]
    assert client.get(answer.headers["location"]).json() == drive


def test_a_client_may_have_some_uploads_at_once(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "MAX_UPLOADS", 2)
    client = serve()
    answers = [client.post("/api/v1/drives", json={"name": "a"}) for _ in range(3)]
    assert [answer.status_code for answer in answers] == [201, 201, 429]
    assert answers[2].json()["type"] == "/problems/too-many-uploads"
    client.delete(answers[0].headers["location"]).raise_for_status()
    assert client.post("/api/v1/drives", json={"name": "a"}).status_code == 201


def test_drives_are_listed_newest_first_in_pages(serve: Serve) -> None:
    client = serve()
    ids = [client.post("/api/v1/drives", json={"name": f"drive {n}"}).json()["id"] for n in range(7)]
    assert [drive["id"] for drive in every(client, "/api/v1/drives", "drives", limit=3)] == ids[::-1]
    assert client.get("/api/v1/drives", params={"after": "nonsense"}).status_code == 422
