"""The demo drive: made once for a client, committed by itself, good for a job with its own map."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from app.settings import Settings
from tests.app.conftest import Serve
from tests.app.processes import API, wait_until


def until(client: httpx.Client, address: str, state: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        told: dict[str, Any] = client.get(f"{API}{address}").json()
        assert told["state"] != "failed", told
        return told if told["state"] == state else None

    found: dict[str, Any] = wait_until(look, state, every_s=0.1)
    return found


def test_the_demo_runs_from_one_click_to_a_report(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Settings, "max_demo_scans", 50)
    client = serve()
    impatient = {"prefer": "wait=0"}
    with ThreadPoolExecutor(4) as threads:
        answers = list(threads.map(lambda _: client.post(f"{API}/demo", headers=impatient), range(4)))
    assert {answer.status_code for answer in answers} == {202}
    (drive_id,) = {answer.json()["id"] for answer in answers}
    assert answers[0].headers["location"] == f"{API}/drives/{drive_id}"
    drive = until(client, f"/drives/{drive_id}", "ready")  # nobody asks for its commit
    assert [problem for problem in drive["report"]["problems"] if problem["severity"] == "error"] == []
    again = client.post(f"{API}/demo")
    assert (again.status_code, again.json()["id"]) == (200, drive_id)
    assert len(client.get(f"{API}/drives").json()["drives"]) == 1

    request = {"drive_id": drive_id, "osm": {"file": "map.osm"}}
    job = client.post(f"{API}/jobs", json=request).json()
    summary = until(client, f"/jobs/{job['id']}", "successful")["summary"]
    found = summary["report"]["nodes_found"]
    assert 0 < found == summary["report"]["nodes_in_zone"]
    assert client.get(f"{API}/jobs/{job['id']}/report").json()["nodes_found"] == found
    assert client.get(f"{API}/jobs/{job['id']}/layers/osm_roads").status_code == 200
    assert client.get(f"{API}/jobs/{job['id']}/keyframes/20/bev.png?layer=all").status_code == 200

    assert client.delete(f"{API}/drives/{drive_id}").status_code == 204
    new = client.post(f"{API}/demo", headers=impatient).json()
    assert new["id"] != drive_id


def test_a_demo_that_was_cancelled_is_begun_anew(serve: Serve) -> None:
    client = serve()
    first = client.post(f"{API}/demo", headers={"prefer": "wait=0"}).json()
    (job,) = client.get(f"{API}/jobs?kind=demo").json()["jobs"]
    client.delete(f"{API}/jobs/{job['id']}")
    until(client, f"/jobs/{job['id']}", "dismissed")
    second = client.post(f"{API}/demo", headers={"prefer": "wait=0"}).json()
    assert second["id"] != first["id"]
