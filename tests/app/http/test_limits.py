"""Requests that are too large or too slow."""

import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from app.http import routing
from app.server import Protocol
from app.store.storage import Storage
from tests.app.conftest import Serve
from tests.app.processes import bytes_below, connected, heard

MB = 1024**2
REFUSED_EARLY = (httpx.WriteError, httpx.ReadError)
"""What a client meets that still sends when it is refused: by chance it reads the answer, or not."""


def test_a_json_body_is_small(client: httpx.Client) -> None:
    body = json.dumps({"name": "a", "pad": "x" * MB}).encode()
    answer = client.post("/api/v1/drives", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 413
    assert answer.json()["detail"].startswith("The body is larger than 1,048,576 bytes")


def test_a_json_body_in_chunks_is_counted(client: httpx.Client) -> None:
    def pieces() -> Iterator[bytes]:
        for _ in range(40):
            yield b" " * 65536

    try:
        answer = client.post("/api/v1/drives", content=pieces(), headers={"Content-Type": "application/json"})
    except REFUSED_EARLY:
        return
    assert answer.status_code == 413


@pytest.mark.parametrize(
    "body",
    [b"[" * 100_000, b'{"name": NaN}', b"\xff\xfe", b'{"name": "\\ud800"}', b'{"\\ud800": 1}', b"null", b"1e999"],
)
def test_json_that_is_none_is_the_fault_of_the_client(client: httpx.Client, body: bytes) -> None:
    answer = client.post("/api/v1/drives", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code in {400, 422}
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_body_that_stops_half_way_is_given_up(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = client.post("/api/v1/drives", json={"name": "a"}).json()["id"]
    monkeypatch.setattr(routing, "IDLE_S", 0.2)
    for target in ("POST /api/v1/drives", f"PUT /api/v1/drives/{drive}/files/poses.txt"):
        with connected(client) as link:
            head = (
                f"{target} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n"
            )
            link.sendall(head.encode() + b'{"name"')
            answer = heard(link)
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b"Nothing more of the body came for 0.2 seconds" in answer
    assert client.get(f"/api/v1/drives/{drive}/files").json()["files"] == []


def test_a_body_that_trickles_in_is_given_up(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """It never pauses, so only its rate tells."""
    drive = client.post("/api/v1/drives", json={"name": "a"}).json()["id"]
    monkeypatch.setattr(routing, "IDLE_S", 0.3)
    with connected(client) as link:
        head = (
            f"PUT /api/v1/drives/{drive}/files/poses.txt HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n"
        )
        link.sendall(head.encode())
        try:
            for _ in range(300):
                link.sendall(b"x")
                time.sleep(0.02)
        except (BrokenPipeError, ConnectionResetError):
            pass
        answer = heard(link)
    assert answer.startswith(b"HTTP/1.1 408 ") or answer == b""
    monkeypatch.undo()
    assert client.get(f"/api/v1/drives/{drive}/files").json()["files"] == []
    assert client.put(f"/api/v1/drives/{drive}/files/poses.txt", content=bytes(10_000)).status_code == 201


def test_a_head_without_end_is_refused(client: httpx.Client) -> None:
    with connected(client) as link:
        link.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Long: ")
        try:
            for _ in range(40):
                link.sendall(b"x" * (Protocol.max_head_bytes // 16))
                time.sleep(0.001)
        except (BrokenPipeError, ConnectionResetError):
            pass
        answer = heard(link)
    assert answer == b""
    assert client.get("/healthz").status_code == 200


def test_a_head_that_trickles_in_is_given_up(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Protocol, "head_s", 0.5)
    for begin in (b"", b"GET /healthz HTTP/1.1\r\nHost: local"):
        with connected(client) as link:
            link.sendall(begin)
            assert heard(link) == b""
    with connected(client) as link:  # also the second request of a connection
        link.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\nGET /hea")
        assert heard(link).startswith(b"HTTP/1.1 200 ")


def test_what_the_framework_refuses_is_told_in_words(client: httpx.Client) -> None:
    as_json = {"Content-Type": "application/json"}
    for answer, status, words in (
        (client.get("/api/v1/nothing"), 404, "/docs"),
        (other := client.delete("/api/v1/drives"), 405, "takes other methods"),
        (client.post("/api/v1/drives", content=b"{", headers=as_json), 400, "JSON"),
    ):
        assert answer.status_code == status
        assert words in answer.json()["detail"]
    assert answer.json()["type"] == "/problems/body-malformed"
    assert other.headers["allow"] == "GET, HEAD, POST"


def test_connections_that_are_too_many_are_closed(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    client = serve()
    assert client.get("/healthz").status_code == 200
    monkeypatch.setattr(Protocol, "max_connections", 3)
    with connected(client) as first, connected(client), connected(client) as last:
        assert heard(last) == b""
        first.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert heard(first).startswith(b"HTTP/1.1 200 ")


def test_no_body_fills_the_disk(serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk of 100 MB of which 20 MB must stay free, and bodies of 30 MB that are all held back half-way."""
    data = tmp_path / "data"

    def free_bytes(_storage: Storage) -> int:
        return 100 * MB - bytes_below(data)

    monkeypatch.setattr(Storage, "free_bytes", free_bytes)
    client = serve(min_free_bytes=20 * MB)
    drive = client.post("/api/v1/drives", json={"name": "town"}).headers["location"]
    let_go = threading.Event()
    half_way = threading.Semaphore(0)

    def body() -> Iterator[bytes]:
        for number in range(30):
            if number == 5:
                half_way.release()
                assert let_go.wait(60)
            yield bytes(MB)

    def put(number: int) -> int:
        try:
            with httpx.Client(base_url=client.base_url, timeout=60) as own:
                return own.put(f"{drive}/files/velodyne/{number:06d}.bin", content=body()).status_code
        except REFUSED_EARLY:
            return 507

    with ThreadPoolExecutor(6) as pool:
        answers = [pool.submit(put, number) for number in range(6)]
        for _ in range(6):
            assert half_way.acquire(timeout=60)
        let_go.set()
        statuses = [answer.result() for answer in answers]
    assert set(statuses) <= {201, 507}
    assert free_bytes(Storage(data)) >= 14 * MB  # each may be one piece ahead of what it saw
    assert 507 in statuses
    with connected(client) as link:
        link.sendall(f"PUT {drive}/files/a HTTP/1.1\r\nHost: localhost\r\nContent-Length: {90 * MB}\r\n\r\n".encode())
        assert heard(link).startswith(b"HTTP/1.1 507 ")
    assert client.put(f"{drive}/files/poses.txt", content=b"1").status_code == 201
