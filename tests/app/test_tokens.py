"""Who gets in by a token, and who does not."""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from app.context import open_database
from app.settings import Settings
from app.store.database import Database
from app.store.tokens import TokenBook, add_token, list_tokens, revoke_token
from interloc.errors import ConfigError

OWN = "the-token-of-the-operator"
Serve = Callable[..., httpx.Client]


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    opened = open_database(Settings(data_dir=tmp_path / "data"))
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def closed(serve_all: Serve) -> httpx.Client:
    """A server that knows one token."""
    return serve_all(token=OWN)


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


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
    assert (book.client_of(first), book.client_of(second), book.client_of("nonsense")) == ("bob", "alice", None)
    revoke_token(database, "bob")
    assert [token.name for token in list_tokens(database)] == ["alice"]
    assert TokenBook(database, Settings()).client_of(first) is None


@pytest.mark.parametrize("name", ["", "a b", "ä", "-x", "anonymous", "operator", "x" * 65, "a\n"])
def test_a_bad_name_of_a_token_is_refused(database: Database, name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be the name"):
        add_token(database, name)


def test_a_name_is_given_once(database: Database) -> None:
    add_token(database, "alice")
    with pytest.raises(ConfigError, match="interloc token revoke alice"):
        add_token(database, "alice")
    with pytest.raises(ConfigError, match="there is no token carol"):
        revoke_token(database, "carol")


def test_without_tokens_this_machine_needs_none(client: httpx.Client) -> None:
    assert client.get("/api/v1/drives").status_code == 200
    assert client.get("/config.json").json()["needs_token"] is False
    assert client.post("/api/v1/drives", json={"name": "a"}).json()["owner"] == "anonymous"


@pytest.mark.parametrize(
    ("headers", "says"),
    [
        ({}, "needs an API token"),
        ({"Authorization": "Bearer"}, "holds no token"),
        ({"Authorization": f"Basic {OWN}"}, "holds no token"),
        ({"Authorization": OWN}, "holds no token"),
        (bearer("x" * 600), "holds no token"),
        (bearer(OWN[:-1]), "no such token"),
        (bearer(OWN.upper()), "no such token"),
    ],
)
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
    assert closed.get("/config.json").json()["needs_token"] is True
    assert closed.get("/openapi.json").status_code == 200


def test_the_token_names_the_owner(serve: Serve, tmp_path: Path) -> None:
    data = tmp_path / "data"
    database = open_database(Settings(data_dir=data))
    token = add_token(database, "alice")
    database.close()
    client = serve(data, token=OWN)
    for given, owner in ((token, "alice"), (OWN, "operator")):
        answer = client.post("/api/v1/drives", json={"name": "a"}, headers=bearer(given))
        assert answer.status_code == 201
        assert answer.json()["owner"] == owner
    assert client.get("/metrics", headers={"authorization": f"bearer {token}"}).status_code == 200


def test_a_token_that_is_added_closes_a_running_server(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = tmp_path / "data"
    monkeypatch.setattr("app.store.tokens._BELIEVED_S", 0.0)
    client = serve(data)
    assert client.get("/api/v1/drives").status_code == 200
    database = open_database(Settings(data_dir=data))
    token = add_token(database, "alice")
    assert client.get("/api/v1/drives").status_code == 401
    assert client.get("/api/v1/drives", headers=bearer(token)).status_code == 200
    revoke_token(database, "alice")
    assert client.get("/api/v1/drives", headers=bearer(token)).status_code == 401
    database.close()


def test_an_exposed_server_stays_closed_when_the_last_token_goes(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", host="10.0.0.1")
    database = open_database(settings)
    assert TokenBook(database, settings).are_needed()
    assert not TokenBook(database, settings.model_copy(update={"allow_anonymous": True})).are_needed()
    database.close()


def test_guessing_is_slowed_down_but_not_for_others(serve: Serve) -> None:
    client = serve(token=OWN)
    statuses = [client.get("/metrics", headers=bearer(f"guess-{n:010d}")).status_code for n in range(25)]
    assert statuses == [401] * 20 + [429] * 5
    answer = client.get("/api/v1/drives", headers=bearer("another-guess-of-mine"))
    assert 1 <= int(answer.headers["retry-after"]) <= 61
    assert client.get("/api/v1/drives", headers=bearer(OWN)).status_code == 200


@pytest.mark.parametrize("token", ["", "short", "fifteen-letters", "sixteen-lettersé", "sixteen\nletters.."])
def test_a_token_of_the_settings_must_be_hard_to_guess(token: str) -> None:
    with pytest.raises(ValueError, match="16 or more printable"):
        Settings(token=token)  # type: ignore[arg-type] # as the environment gives it
