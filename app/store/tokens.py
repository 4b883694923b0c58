"""API tokens: made and shown once, kept as their SHA-256, looked up by it."""

from __future__ import annotations

import hashlib
import re
import secrets
import time

from sqlalchemy import delete, select

from app.settings import Settings
from app.store.database import Database
from app.store.models import Token
from interloc.errors import ConfigError

ANONYMOUS = "anonymous"
"""Client of a service that asks for no token."""

OPERATOR = "operator"
"""Client of the token in the settings."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")
_BELIEVED_S = 5.0  # a new token is taken, and a revoked one refused, after this time at the latest


def add_token(database: Database, name: str) -> str:
    """Make a token for a client.

    Returns
    -------
    str
        The token; it cannot be shown again.

    Raises
    ------
    ConfigError
        The name is not one, or is taken.
    """
    if not _NAME.fullmatch(name) or name in {ANONYMOUS, OPERATOR}:
        raise ConfigError(
            f"{name!r} cannot be the name of a token: letters, digits and . _ @ - are allowed (64 at most, "
            f"a letter or digit first), {ANONYMOUS} and {OPERATOR} have a meaning of their own"
        )
    token = f"interloc_{secrets.token_urlsafe(32)}"
    with database.writing() as session:
        if session.get(Token, name) is not None:
            raise ConfigError(f"there is a token {name} already; `interloc token revoke {name}` takes it away")
        session.add(Token(name=name, sha256=_sha256(token), created_at=database.clock(session)))
    return token


def list_tokens(database: Database) -> list[Token]:
    """Return who has a token, by name."""
    with database.reading() as session:
        return list(session.scalars(select(Token).order_by(Token.name)))


def revoke_token(database: Database, name: str) -> None:
    """Refuse a token from now on.

    Raises
    ------
    ConfigError
        There is no such token.
    """
    with database.writing() as session:
        gone = session.scalar(delete(Token).where(Token.name == name).returning(Token.name))
    if gone is None:
        raise ConfigError(f"there is no token {name}; `interloc token list` shows those that there are")


class TokenBook:
    """The clients of tokens; answers of the database are kept for some seconds.

    A token is looked up by its hash, so the time of the look-up does not reveal how close a guess was.
    """

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._own = _sha256(settings.token.get_secret_value()) if settings.token is not None else None
        self._anonymous = settings.allow_anonymous
        self._exposed = not settings.is_loopback
        self._clients: dict[str, tuple[str, float]] = {}
        self._exist: tuple[bool, float] = (False, float("-inf"))

    def recall(self, token: str) -> str | None:
        """Return the client of a token without asking the database; None if it must be asked."""
        digest = _sha256(token)
        if digest == self._own:
            return OPERATOR
        client, until = self._clients.get(digest, ("", float("-inf")))
        return client if time.monotonic() < until else None

    def client_of(self, token: str) -> str | None:
        """Return the client of a token; None if the token is unknown."""
        client = self.recall(token)
        if client is not None:
            return client
        digest = _sha256(token)
        with self._database.reading() as session:
            client = session.scalar(select(Token.name).where(Token.sha256 == digest))
        if client is None:
            self._clients.pop(digest, None)
        else:
            self._clients[digest] = (client, time.monotonic() + _BELIEVED_S)
        return client

    def exist(self) -> bool:
        """Return whether there is any token."""
        if self._own is not None:
            return True
        known, until = self._exist
        if time.monotonic() >= until:
            with self._database.reading() as session:
                known = session.scalar(select(Token.name).limit(1)) is not None
            self._exist = (known, time.monotonic() + _BELIEVED_S)
        return known

    def are_needed(self) -> bool:
        """Return whether clients need a token: also after the last one was revoked, if other machines can connect."""
        return not self._anonymous and (self._exposed or self.exist())

    @property
    def need_is_known(self) -> bool:
        """Whether `are_needed` answers without asking the database."""
        return self._anonymous or self._exposed or self._own is not None or time.monotonic() < self._exist[1]


def _sha256(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
