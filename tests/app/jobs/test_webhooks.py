"""Whoever is named in a request is told of the job: signed, again where that fails, and nobody else is ever called."""

import base64
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.jobs import webhooks
from app.jobs.webhooks import signature
from app.settings import Settings
from app.store.models import Delivery
from tests.app.conftest import Serve, alone
from tests.app.processes import API, job_of, started, wait_until

KEY = b"0123456789abcdef0123456789abcdef"
SECRET = f"whsec_{base64.b64encode(KEY).decode()}"


class Receiver(ThreadingHTTPServer):
    """Notes what it is told, and answers what is next in `answers`, else 204."""

    daemon_threads = True

    def __init__(self) -> None:
        self.told: list[tuple[str, dict[str, str], bytes]] = []
        self.answers: list[int] = []
        super().__init__(("127.0.0.1", 0), _Handler)
        self.uri = f"http://127.0.0.1:{self.server_port}"


class _Handler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.told.append((self.path, dict(self.headers), body))
        status = self.server.answers.pop(0) if self.server.answers else 204
        self.send_response(status)
        if status == 302:
            self.send_header("Location", f"{self.server.uri}/elsewhere")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def receiving() -> Iterator[Receiver]:
    with Receiver() as receiver:
        threading.Thread(target=receiver.serve_forever, args=(0.02,), daemon=True).start()
        yield receiver
        receiver.shutdown()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as one:
        yield one


def commit(client: httpx.Client, **subscriber: str) -> str:
    """Make a drive without anything in it, and commit it; returns the id of the job of its check, which fails."""
    drive_id = client.post(f"{API}/drives", json={"name": "empty"}).json()["id"]
    body = {"subscriber": subscriber}
    answer = client.post(f"{API}/drives/{drive_id}/commit", json=body, headers={"Prefer": "wait=0"})
    assert answer.status_code in {202, 422}, answer.text
    (job,) = client.get(f"{API}/jobs?kind=commit&drive={drive_id}").json()["jobs"]
    job_id: str = job["id"]
    return job_id


def test_a_subscriber_is_told_signed_and_again_where_that_failed(
    serve: Serve, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webhooks, "RETRIES_S", (0.0, 0.0))
    monkeypatch.setattr(webhooks, "_LOOK_S", 0.05)
    client = serve(webhook_hosts="127.0.0.1", webhook_secret=SECRET, public_url="https://maps.example/lidar")
    receiver.answers = [204, 500]  # the begin; then the end, twice
    uris = {"inProgressUri": f"{receiver.uri}/began", "failedUri": f"{receiver.uri}/failed?x=1"}
    job_id = commit(client, **uris, successUri=f"{receiver.uri}/good")
    wait_until(lambda: len(receiver.told) == 3, "three calls")
    paths = [path for path, _, _ in receiver.told]
    assert sorted(paths) == ["/began", "/failed?x=1", "/failed?x=1"]
    ends = [(headers, body) for path, headers, body in receiver.told if path != "/began"]
    assert len({headers["webhook-id"] for headers, _ in ends}) == 1
    for _, headers, body in receiver.told:
        expected = signature(KEY, headers["webhook-id"], int(headers["webhook-timestamp"]), body)
        assert headers["webhook-signature"] == expected
    told = json.loads(ends[0][1])
    assert told["type"] == "job.successful"  # the check was made; the drive has errors
    assert told["data"]["href"] == f"https://maps.example/lidar/api/v1/jobs/{job_id}"
    assert told["data"]["summary"]["ok"] is False

    def both_delivered() -> Any:
        deliveries = job_of(client, job_id)["deliveries"]
        return deliveries if all(each["state"] == "delivered" for each in deliveries) else None

    first, last = wait_until(both_delivered, "both deliveries")
    assert (first["type"], first["attempts"], first["error"]) == ("job.running", 1, None)
    assert (last["id"], last["attempts"]) == (ends[0][0]["webhook-id"], 2)
    assert 'interloc_webhooks_total{outcome="failed"} 1.0' in client.get("/metrics").text

    receiver.answers = [302, 500, 404]
    job_id = commit(client, failedUri=f"{receiver.uri}/moved")
    (gone,) = wait_until(lambda: [d for d in job_of(client, job_id)["deliveries"] if d["next_at"] is None], "the end")
    assert (gone["state"], gone["attempts"]) == ("given up", 3)
    assert gone["error"].startswith("404 Not Found")
    assert "/elsewhere" not in [path for path, _, _ in receiver.told]


def test_signatures_are_those_of_the_library_of_standard_webhooks() -> None:
    key = base64.b64decode("MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw")
    signed = signature(key, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    assert signed == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


@alone
async def test_a_call_is_bounded_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhooks, "_CALL_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as host:

        def drip() -> None:
            connection, _ = host.accept()
            with connection, suppress(OSError):
                connection.sendall(b"HTTP/1.1 500 Broken\r\nX: ")
                while True:
                    connection.sendall(b"x")
                    time.sleep(0.05)

        threading.Thread(target=drip, daemon=True).start()
        uri = f"http://127.0.0.1:{host.getsockname()[1]}/x"
        began = time.monotonic()
        told = await webhooks._call(Delivery(id="msg_1", uri=uri, body="{}"), Settings(), 0)
    assert told == "There was no answer within 0.5 s."
    assert time.monotonic() - began < 5


def test_a_server_killed_before_the_call_still_calls(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:  # breaks the first call off, and never answers the next
        silent.settimeout(60)
        settings = {"webhook_hosts": "127.0.0.1", "webhook_secret": SECRET, "workers": 1}
        uri = f"http://127.0.0.1:{silent.getsockname()[1]}/x"
        with started(tmp_path / "data", tmp_path / "1.log", **settings) as server:
            job_id = commit(server.client, failedUri=uri)
            silent.accept()[0].close()
            wait_until(lambda: [d for d in job_of(server.client, job_id)["deliveries"] if d["attempts"]], "the call")
            server.kill()
    with started(tmp_path / "data", tmp_path / "2.log", **settings) as server:
        (delivery,) = job_of(server.client, job_id)["deliveries"]
        assert (delivery["state"], delivery["attempts"]) == ("waiting", 1)
        assert delivery["next_at"] is not None


def test_who_may_not_be_called_is_refused_at_once(serve: Serve, receiver: Receiver) -> None:
    def refused(client: httpx.Client, uri: str) -> str:
        drive_id = client.post(f"{API}/drives", json={"name": "x"}).json()["id"]
        answer = client.post(f"{API}/drives/{drive_id}/commit", json={"subscriber": {"failedUri": uri}})
        assert (answer.status_code, answer.json()["type"]) == (422, "/problems/webhook-refused"), answer.text
        return str(answer.json()["detail"])

    client = serve(webhook_hosts="hooks.example.org", webhook_secret=SECRET)
    assert "none of the hosts" in refused(client, receiver.uri)
    assert "is not an address" in refused(client, "https://hooks.example.org:99999/")
    assert "none of the hosts" in refused(client, "https://hooks.example.org.evil.test/")
    assert "without a user" in refused(client, "https://a:b@hooks.example.org/")
