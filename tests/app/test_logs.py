"""The log: a line a request, with everything needed to find it again and no secrets."""

import json
import logging
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from app import logs
from app.settings import Settings
from tests.app.conftest import Serve

Lines = Callable[..., list[dict[str, Any]]]
OWN = "the-token-of-the-operator"
pytestmark = pytest.mark.usefixtures("untouched_logging")


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> Lines:
    """The lines that were logged, parsed, once there are so many of requests: they come after the answers."""
    kept: list[str] = []

    class Stream:
        def write(self, text: str) -> None:
            kept.append(text)

        def flush(self) -> None:
            pass

    monkeypatch.setattr(sys, "stderr", Stream())
    logs.set_up(Settings(log_format="json"))

    def read(requests: int = 0) -> list[dict[str, Any]]:
        deadline = time.monotonic() + 20
        while True:
            parsed = [json.loads(line) for line in "".join(kept).splitlines()]
            if sum(line["logger"] == "app.access" for line in parsed) >= requests:
                return parsed
            assert time.monotonic() < deadline, f"never logged: {parsed}"
            time.sleep(0.01)

    return read


def test_a_request_is_one_line(serve: Serve, lines: Lines) -> None:
    client = serve(token=OWN)
    drive = "0123456789abcdef"
    answer = client.get(
        f"/api/v1/drives/{drive}/files?after=secret-of-the-query",
        headers={"Authorization": f"Bearer {OWN}", "X-Request-ID": "mine-1"},
    )
    assert (answer.status_code, answer.headers["x-request-id"]) == (404, "mine-1")
    (line,) = [line for line in lines(1) if line["logger"] == "app.access"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00", line.pop("time"))
    assert line.pop("duration_ms") >= 0
    assert line == {
        "level": "info",
        "logger": "app.access",
        "message": f"GET /api/v1/drives/{drive}/files 404",
        "method": "GET",
        "path": f"/api/v1/drives/{drive}/files",
        "status": 404,
        "request": "mine-1",
        "client": "operator",
        "drive": drive,
    }


def test_who_changed_what_is_logged(serve: Serve, lines: Lines, tmp_path: Path) -> None:
    client = serve(tmp_path / "data", token=OWN)
    client.headers["Authorization"] = f"Bearer {OWN}"
    address = client.post("/api/v1/drives", json={"name": "a"}).headers["location"]
    drive = address.rpartition("/")[2]
    client.put(f"{address}/files/a.txt", content=b"1")
    client.post("/api/v1/drives/look", json={"name": "a", "files": {}})
    client.delete(f"{address}/files/a.txt")
    client.delete(f"{address}/files/a.txt")  # there is none: nothing changed
    client.delete(address)
    found = [line for line in lines(6) if line["logger"] == "app.audit"]
    assert [(line["client"], line["action"], line["drive"]) for line in found] == [
        ("operator", action, drive) for action in ("create_drive", "delete_file", "delete_drive")
    ]


def test_no_secret_is_logged(serve: Serve, lines: Lines) -> None:
    client = serve(token=OWN)
    for token in (OWN, "a-wrong-token-of-mine"):
        client.get("/api/v1/drives", headers={"Authorization": f"Bearer {token}"}, params={"token": token})
    text = json.dumps(lines(2))
    assert "wrong token" in text
    assert OWN not in text
    assert "a-wrong-token" not in text


def test_checks_of_health_are_not_logged(serve: Serve, lines: Lines) -> None:
    client = serve()
    for path in ("/healthz", "/readyz", "/metrics", "/config.json"):
        assert client.get(path).status_code == 200
    assert [line["path"] for line in lines(1) if line["logger"] == "app.access"] == ["/config.json"]


@pytest.mark.parametrize("given", ["", "a b", "x" * 65, "ä", '"}'])
def test_an_odd_request_id_is_replaced(client: httpx.Client, given: str) -> None:
    answer = client.get("/healthz", headers={"X-Request-ID": given.encode()})
    assert re.fullmatch(r"[0-9a-f]{16}", answer.headers["x-request-id"])


def test_a_client_cannot_write_lines_of_its_own(serve: Serve, lines: Lines) -> None:
    path = '/api/v1/x%0a{"level": "error"}%1b[31m'
    assert serve().get(path).status_code == 404
    (line,) = [line for line in lines(1) if line["logger"] == "app.access"]
    assert line["path"] == '/api/v1/x\n{"level": "error"}\x1b[31m'
    record = logging.LogRecord("app", logging.INFO, "", 0, "GET %s", (line["path"],), None)
    assert logs.TextFormatter().format(record).endswith(r'info    GET /api/v1/x\n{"level": "error"}\x1b[31m')


def test_a_fault_is_logged_once_and_not_told(serve: Serve, lines: Lines, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a detail that nobody may see")

    monkeypatch.setattr("app.metrics.Metrics.render", broken)
    answer = serve().get("/metrics")
    assert (answer.status_code, answer.json()["title"]) == (500, "Fault of the service")
    assert "detail that" not in answer.text
    assert answer.headers["x-content-type-options"] == "nosniff"
    (line,) = [line for line in lines(1) if "exception" in line]
    assert "ZeroDivisionError: a detail that nobody may see" in line["exception"]
    assert line["request"] == answer.headers["x-request-id"]
