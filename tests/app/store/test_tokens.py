"""Who gets in by a token, and who does not."""

import hashlib
import re
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.routing import APIRoute

from app.context import open_database
from app.main import ROUTES
from app.settings import Settings
from app.states import Scope
from app.store import tokens
from app.store.database import Database
from app.store.models import Token
from app.store.tokens import Holder, TokenBook, add_token, list_tokens, revoke_token
from interloc.errors import ConfigError
from tests.app.conftest import Serve, bearer, opened

OWN = "the-token-of-the-operator"
Guarded = tuple[httpx.Client, dict[str, dict[str, str]]]


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    with opened(tmp_path / "data") as context:
        yield context.database


@pytest.fixture(scope="module")
def closed(serve_all: Serve) -> httpx.Client:
    """A server that knows one token."""
    return serve_all(token=OWN)


def test_only_the_hash_of_a_token_is_kept(database: Database, tmp_path: Path) -> None:
    token = add_token(database, "alice")
    assert len(token) > 40
    database.close()
    kept = b"".join(path.read_bytes() for path in (tmp_path / "data").rglob("*") if path.is_file())
    assert token.encode() not in kept
    with sqlite3.connect(tmp_path / "data/interloc.sqlite3") as link:
        assert link.execute("SELECT name, sha256 FROM tokens").fetchall() == [
            ("alice", hashlib.sha256(token.encode()).hexdigest())
        ]
    link.close()


def test_tokens_come_and_go(database: Database) -> None:
    first, second = add_token(database, "bob"), add_token(database, "alice")
    assert [token.name for token in list_tokens(database)] == ["alice", "bob"]
    book = TokenBook(database, Settings())
    book.read(time.monotonic())
    assert [book.recall(token) for token in (first, second, "nonsense")] == [Holder("bob"), Holder("alice"), None]
    revoke_token(database, "bob")
    assert [token.name for token in list_tokens(database)] == ["alice"]
    book.read(time.monotonic())
    assert book.recall(first) is None


@pytest.mark.parametrize("name", ["", "a b", "ä", "-x", "anonymous", "operator", "x" * 65, "a\n"])
def test_a_bad_name_of_a_token_is_refused(database: Database, name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be the name"):
        add_token(database, name)


def test_tokens_have_a_maximum(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tokens, "MAX_TOKENS", 1)
    add_token(database, "ann")
    with pytest.raises(ConfigError, match="no more can be"):
        add_token(database, "bob")


@pytest.mark.parametrize(("headers", "says"), [
    ({}, "needs an API token"),
    ({"Authorization": "Bearer"}, "holds no token"),
    ({"Authorization": f"Basic {OWN}"}, "holds no token"),
    ({"Authorization": OWN}, "holds no token"),
    (bearer("x" * 600), "holds no token"),
    (bearer(OWN[:-1]), "no such token"),
    (bearer(OWN.upper()), "no such token"),
])  # fmt: skip
@pytest.mark.parametrize("path", ["/api/v1/drives", "/api/v1/nowhere", "/metrics", "/api/v1/jobs/0123456789abcdef"])
def test_without_the_token_nothing_is_said(closed: httpx.Client, path: str, headers: dict[str, str], says: str) -> None:
    answer = closed.get(path, headers=headers)
    assert answer.status_code == 401
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.headers["www-authenticate"].startswith('Bearer realm="interloc"')
    assert says in answer.json()["detail"]
    given = headers.get("Authorization", "").partition(" ")[2]
    assert not given or given not in answer.text


def test_what_is_open_without_a_token(closed: httpx.Client) -> None:
    assert closed.get("/healthz").status_code == 200
    assert closed.get("/readyz").status_code == 200
    assert closed.get("/openapi.json").status_code == 200


def test_the_token_names_the_owner(serve: Serve, database: Database) -> None:
    token = add_token(database, "alice")
    client = serve(token=OWN)
    for given, owner in ((token, "alice"), (OWN, "operator")):
        answer = client.post("/api/v1/drives", json={"name": "a"}, headers=bearer(given))
        assert answer.status_code == 201
        assert answer.json()["owner"] == owner
    assert client.get("/metrics", headers={"authorization": f"bearer {token}"}).status_code == 200


def test_a_token_that_is_added_closes_a_running_server(
    serve: Serve, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.store.tokens._BELIEVED_S", 0.0)
    client = serve()
    assert client.get("/api/v1/drives").status_code == 200
    token = add_token(database, "alice")
    assert client.get("/api/v1/drives").status_code == 401
    assert client.get("/api/v1/drives", headers=bearer(token)).status_code == 200
    revoke_token(database, "alice")
    assert client.get("/api/v1/drives", headers=bearer(token)).status_code == 401
    assert client.get("/api/v1/drives").status_code == 401  # who takes a token back does not mean to open the service


def test_an_exposed_server_stays_closed_when_the_last_token_goes(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", host="10.0.0.1")
    database = open_database(settings)
    assert TokenBook(database, settings).are_needed()
    assert not TokenBook(database, settings.model_copy(update={"allow_anonymous": True})).are_needed()
    database.close()


def test_wrong_tokens_never_stop_a_valid_one(serve: Serve, database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    token = add_token(database, "alice")
    client = serve()
    assert {client.get("/metrics", headers=bearer(f"guess-{n:010d}")).status_code for n in range(25)} == {401}
    late = add_token(database, "bob")
    monkeypatch.setattr("app.store.tokens._BELIEVED_S", 0.0)  # whatever was believed is forgotten
    for each in (token, late):
        assert client.get("/api/v1/drives", headers=bearer(each)).status_code == 200
    assert 'interloc_refused_tokens_total{reason="unknown"} 25.0' in client.get("/metrics", headers=bearer(token)).text


def changing_routes() -> list[tuple[str, str]]:
    """Method and address of every operation whose method is not a safe one, also of those that are not described."""
    return [
        (method, re.sub(r"\{\w+(:path)?\}", "x", route.path))
        for route in ROUTES
        if isinstance(route, APIRoute)
        for method in route.methods - {"GET", "HEAD", "OPTIONS"}
    ]


@pytest.fixture(scope="module")
def guarded(serve_all: Serve, tmp_path_factory: pytest.TempPathFactory) -> Guarded:
    """A server, and headers with tokens of several kinds by name."""
    data = tmp_path_factory.mktemp("guarded")
    kinds: dict[str, dict[str, Any]] = {
        "reader": {"scope": Scope.READ},
        "writer": {},
        "poor": {"max_bytes": 1000, "max_jobs": 1},
        "sparing": {"max_bytes": 1000},
    }
    with opened(data) as context:
        headers = {name: bearer(add_token(context.database, name, **kind)) for name, kind in kinds.items()}
    return serve_all(data_dir=data), headers


def test_a_token_that_may_only_read_changes_nothing(guarded: Guarded) -> None:
    client, headers = guarded
    drive = client.post("/api/v1/drives", json={"name": "a"}, headers=headers["writer"]).json()["id"]
    routes = changing_routes()
    answers = {
        (method, path): client.request(
            method,
            path,
            headers={**headers["reader"], "Content-Type": "application/json"},
            content=b'{"name": "a", "drive_id": "x", "files": {}}',
        )
        for method, path in routes
    }
    refused = {route for route, answer in answers.items() if answer.json().get("title") == "Token may only read"}
    assert set(routes) - refused == {("POST", "/api/v1/drives/look")}
    answer = client.delete(f"/api/v1/drives/{drive}", headers=headers["reader"])
    assert answer.status_code == 403
    assert "reader" in answer.json()["detail"]
    assert 'error="insufficient_scope"' in answer.headers["www-authenticate"]
    assert client.get(f"/api/v1/drives/{drive}", headers=headers["reader"]).status_code == 200


def test_a_token_ends_when_it_expires(database: Database, serve: Serve, tmp_path: Path) -> None:
    with database.reading() as session:
        now = database.clock(session)
    with pytest.raises(ConfigError, match="would have expired already"):
        add_token(database, "late", expires_at=now - 1)
    token = add_token(database, "guest", expires_at=now + 3600)
    client = serve(tmp_path / "data")
    assert client.get("/api/v1/drives", headers=bearer(token)).status_code == 200
    with database.writing() as session:
        session.get_one(Token, "guest").expires_at = now - 60
    book = TokenBook(database, Settings())
    book.read(time.monotonic())
    holder = book.recall(token)
    assert holder is not None
    assert holder.has_expired
    assert book.are_needed()  # the service does not open by itself
    answer = serve(tmp_path / "data").get("/api/v1/drives", headers=bearer(token))  # one that has not believed it yet
    assert answer.status_code == 401
    assert "The token of guest expired on 20" in answer.json()["detail"]


def test_when_a_token_was_last_used_is_written_later(database: Database) -> None:
    token = add_token(database, "alice")
    add_token(database, "bob")
    book = TokenBook(database, Settings())
    book.read(time.monotonic())
    assert book.recall(token) is not None
    assert [each.last_used_at for each in list_tokens(database)] == [None, None]
    book.write_uses()
    alice, bob = list_tokens(database)
    assert alice.last_used_at == pytest.approx(alice.created_at, abs=60)
    assert bob.last_used_at is None


def test_a_client_keeps_no_more_than_its_token_allows(guarded: Guarded) -> None:
    client, headers = guarded
    mine = headers["poor"]
    first, second = (
        client.post("/api/v1/drives", json={"name": name}, headers=mine).headers["location"] for name in "ab"
    )
    for status in (201, 200):  # sent again it replaces itself
        assert client.put(f"{first}/files/poses.txt", content=bytes(600), headers=mine).status_code == status
    answer = client.put(f"{second}/files/poses.txt", content=bytes(600), headers=mine)
    assert (answer.status_code, answer.json()["title"]) == (413, "Quota used up")
    assert client.get(f"{second}/files", headers=mine).json()["files"] == []
    # Whoever sends it, the drive is that of the client; a file that replaces another counts by what it adds.
    others = headers["writer"]
    assert client.put(f"{second}/files/poses.txt", content=bytes(600), headers=others).status_code == 413
    assert client.put(f"{first}/files/poses.txt", content=bytes(900), headers=mine).status_code == 200
    assert client.delete(f"{first}/files/poses.txt", headers=mine).status_code == 204
    assert client.put(f"{second}/files/poses.txt", content=bytes(600), headers=mine).status_code == 201


def test_whose_token_has_a_limit_sends_to_drives_of_its_own_only(guarded: Guarded) -> None:
    client, headers = guarded
    rich, sparing = (headers[name] for name in ("writer", "sparing"))
    others, own = (
        client.post("/api/v1/drives", json={"name": "a"}, headers=each).headers["location"] for each in (rich, sparing)
    )
    answer = client.put(f"{others}/files/poses.txt", content=bytes(400), headers=sparing)
    assert (answer.status_code, answer.json()["title"]) == (413, "Quota used up")
    assert client.post(f"{others}/archive", content=b"PK\x03\x04", headers=sparing).status_code == 413
    sent = [
        client.put(f"{own}/files/{n}", content=bytes(400), headers=each).status_code
        for n, each in enumerate((rich, sparing, rich))
    ]
    assert sent == [201, 201, 413]


@pytest.mark.parametrize("token", ["", "short", "fifteen-letters", "sixteen-lettersé", "sixteen\nletters.."])
def test_a_token_of_the_settings_must_be_hard_to_guess(token: str) -> None:
    with pytest.raises(ValueError, match="16 or more printable"):
        Settings(token=token)  # type: ignore[arg-type] # as the environment gives it
