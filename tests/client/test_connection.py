"""Patience with servers that are busy, restart or break off; plain words where patience does not help."""

import socket
import threading
import time
from typing import Any

import pytest

from interloc.client.connection import Connection, Refusal
from interloc.client.live import LiveSender
from interloc.client.upload import FileAnswer
from interloc.errors import ConfigError, NetworkError
from tests.client.conftest import answer, hang_up, problem

NO_DRIVES: dict[str, list[str]] = {"drives": []}


@pytest.mark.parametrize("fault", ["hang_up", "damaged", 429, 502, 503, 504])
def test_a_server_that_breaks_off_or_is_busy_is_asked_again(
    fault: str | int, connection: Connection, faulty: Any
) -> None:
    broken = {"hang_up": hang_up, "damaged": answer(200, NO_DRIVES, Content_Encoding="gzip")}
    reply = broken[fault] if isinstance(fault, str) else problem(fault, "Busy", "Later.", Retry_After="1")
    faulty.script = [answer(200, NO_DRIVES), reply, answer(200, NO_DRIVES)]
    before = time.monotonic()
    connection.check_server()
    connection.check_server()
    assert [method for method, _ in faulty.seen] == ["GET"] * 3
    assert isinstance(fault, str) or time.monotonic() - before >= 1.0  # the pause that it asks for


def test_a_pause_beyond_patience_is_the_servers_word(faulty: Any) -> None:
    faulty.script = [problem(429, "Queue full", "100 jobs of yours are waiting.", Retry_After="3600")]
    with Connection(faulty.address) as connection, pytest.raises(Refusal, match="Queue full: 100 jobs") as refused:
        connection.check_server()
    assert refused.value.status == 429
    assert len(faulty.seen) == 1


def test_a_body_is_sent_anew_at_each_attempt(connection: Connection, faulty: Any) -> None:
    file = {"path": "a.bin", "size_bytes": 6, "sha256": "00"}
    faulty.script = [problem(503, "Busy", "Later.", Retry_After="0"), answer(201, file)]
    headers = {"Content-Length": "6"}
    connection.ask("PUT", "/drives/1/files/a.bin", FileAnswer, body=lambda: iter([b"abc", b"def"]), headers=headers)
    assert faulty.bodies == [b"abcdef", b"abcdef"]


def test_a_refusal_is_final_and_in_the_servers_words(connection: Connection, faulty: Any) -> None:
    problems = [
        {"severity": "error", "path": "labels/000003.label", "message": "is missing."},
        {"severity": "note", "path": "poses.txt", "message": "1,101 poses."},
    ]
    faulty.script = [problem(422, "Drive not usable", "2 files are at fault.", more={"problems": problems})]
    with pytest.raises(Refusal) as refused:
        connection.check_server()
    assert str(refused.value) == "Drive not usable: 2 files are at fault.\n  labels/000003.label: is missing."
    assert len(faulty.seen) == 1


def test_a_token_that_is_refused(faulty: Any) -> None:
    faulty.script = [problem(401, "Not authorized", "The token is not known.")]
    with Connection(faulty.address, "secret-token") as connection, pytest.raises(Refusal) as refused:
        connection.check_server()
    assert faulty.headers[0]["Authorization"] == "Bearer secret-token"
    assert "The token is not known. Give a token of this server by INTERLOC_TOKEN" in str(refused.value)
    assert "secret-token" not in str(refused.value)


@pytest.mark.parametrize("token", ["two words", "line\nbreak", "umläut"])
def test_a_token_that_is_not_valid(token: str) -> None:
    with pytest.raises(ConfigError, match=r"^token: "):
        Connection("http://127.0.0.1:1", token)


@pytest.mark.parametrize(
    ("status", "body", "kind", "text"),
    [
        (404, b"<html>", "text/html", "404 Not Found to GET /api/v1/drives, which is not how an InterLoc"),
        (200, b"<html>", "text/html", "answered GET /api/v1/drives with text/html that is not what an InterLoc"),
        (200, b"[1, 2]", "application/json", "with application/json that is not what an InterLoc"),
        (200, b"", "text/plain", "with text/plain that is not what an InterLoc"),
        (308, b"", "text/plain", r"redirects to https://example.org\. Give"),
    ],
)
def test_another_server_at_the_address(
    status: int, body: bytes, kind: str, text: str, connection: Connection, faulty: Any
) -> None:
    faulty.script = [answer(status, body, kind=kind, Location="https://example.org/api/v1/drives")]
    with pytest.raises(NetworkError, match=text):
        connection.check_server()


def test_a_redirect_of_a_live_session_is_not_followed(faulty: Any) -> None:
    faulty.script = [answer(200, {}), answer(308, Location="https://example.org/api/v1/live")]
    with pytest.raises(NetworkError, match=r"redirects to https://example.org\. Give"):
        LiveSender(faulty.address, None, {"name": "a"}, lambda _: None).run(lambda _: iter(()))


def test_nobody_at_the_address_is_reported_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("interloc.client.connection._FIRST_PATIENCE_S", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with Connection(f"http://127.0.0.1:{port}") as connection, pytest.raises(NetworkError) as failed:
            connection.check_server()
    assert "cannot be reached" in str(failed.value)
    assert "Give its address by --server or INTERLOC_SERVER" in str(failed.value)


def test_plain_http_where_https_was_expected(faulty: Any) -> None:
    faulty.script = [answer(200, NO_DRIVES)]
    with (
        Connection(faulty.address.replace("http:", "https:")) as connection,
        pytest.raises(NetworkError, match="it does not speak https"),
    ):
        connection.check_server()


def test_waiting_ends_when_the_connection_closes(faulty: Any) -> None:
    faulty.script = [answer(200, NO_DRIVES), problem(503, "Busy", "Later.", Retry_After="60")]
    failures: list[NetworkError] = []
    with Connection(faulty.address) as connection:
        connection.check_server()

        def ask() -> None:
            try:
                connection.check_server()
            except NetworkError as error:
                failures.append(error)

        asking = threading.Thread(target=ask)
        asking.start()
        while len(faulty.seen) < 2:
            time.sleep(0.01)
        connection.closing.set()
        asking.join(30)
    (failure,) = failures
    assert str(failure) in {f"{faulty.address}: stopped waiting.", f"{faulty.address}: busy (503)."}


@pytest.mark.parametrize(
    ("given", "base"),
    [
        ("http://127.0.0.1:8000/", "http://127.0.0.1:8000"),
        ("http://127.0.0.1:8000/api/v1/", "http://127.0.0.1:8000"),
        (" https://example.org/interloc/docs ", "https://example.org/interloc"),
        ("http://[::1]:8000", "http://[::1]:8000"),
    ],
)
def test_addresses(given: str, base: str) -> None:
    with Connection(given) as connection:
        assert connection.server == base


@pytest.mark.parametrize("given", ["127.0.0.1:8000", "localhost", "ftp://example.org", "http://", "", "http://[::1"])
def test_addresses_that_are_not_valid(given: str) -> None:
    with pytest.raises(ConfigError, match=r"^server '"):
        Connection(given)


def test_an_address_with_a_password_is_refused_without_showing_it() -> None:
    with pytest.raises(ConfigError) as refused:
        Connection("https://user:hunter2@example.org")
    assert "hunter2" not in str(refused.value)


def test_a_token_over_plain_http_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    with Connection("http://example.org", "token"):
        assert "http://example.org: the token is sent without encryption" in caplog.text
