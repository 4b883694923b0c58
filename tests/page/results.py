"""A server with results to look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.app.processes import API, ServerProcess, archive_of, ended

SCANS = 90
TOKEN = "a-token-that-only-these-tests-know-0123456789"  # noqa: S105


@dataclass(frozen=True)
class Done:
    """A server with two results of the same street: with and without georeference."""

    server: ServerProcess
    job: str
    local_job: str
    street: Path

    @property
    def data(self) -> Path:
        """Data folder of the server."""
        return self.server.log.with_name("data")

    def features(self, layer: str) -> list[dict[str, Any]]:
        answer = self.server.client.get(f"{API}/jobs/{self.job}/{layer}").raise_for_status()
        return list(answer.json()["features"])

    def report(self) -> dict[str, Any]:
        return dict(self.server.client.get(f"{API}/jobs/{self.job}/report").raise_for_status().json())


def run_street(server: ServerProcess, folder: Path, **request: Any) -> str:
    """Upload a drive, run it, wait for the end; returns the id of the job."""
    drive = server.client.post(f"{API}/drives", json={"name": folder.name}).raise_for_status().json()["id"]
    server.client.post(f"{API}/drives/{drive}/archive", content=archive_of(folder)).raise_for_status()
    server.client.post(f"{API}/drives/{drive}/commit", json={}).raise_for_status()
    job = server.client.post(f"{API}/jobs", json={"drive_id": drive, **request}).raise_for_status().json()["id"]
    assert ended(server.client, job)["state"] == "successful"
    return str(job)


def show(page: Any, done: Done, fields: str, job: str | None = None) -> None:
    """Open a link to a result, and wait for its map."""
    page.goto("about:blank")
    page.goto(f"{done.server.address}/#job={job or done.job}&{fields}")
    page.wait_for_selector(".legend:visible")
