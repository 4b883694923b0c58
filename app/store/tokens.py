"""API tokens: made and shown once, kept as their SHA-256, looked up by it in a copy of the table.

The table of a team is small, so a server keeps a copy of it. Looking up a token, valid or not, costs a hash and a
dictionary; however many wrong ones come, the table is read a few times per second at most.
"""

import hashlib
import logging
import re
import secrets
import threading
import time
from dataclasses import dataclass

from sqlalchemy import delete, func, or_, select, update
from sqlalchemy.exc import SQLAlchemyError

from app.settings import Settings
from app.states import Scope
from app.store.database import Database
from app.store.models import Token
from interloc.errors import ConfigError

ANONYMOUS = "anonymous"
"""Client of a service that asks for no token."""

OPERATOR = "operator"
"""Client of the token in the settings."""

MAX_TOKENS = 1000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")
_BELIEVED_S = 5.0  # a token that was revoked or has expired is refused after this time at the latest
_PAUSE_S = 0.05  # between two readings of the table
_NEVER = float("-inf")

_audit = logging.getLogger("app.audit")


def add_token(
    database: Database,
    name: str,
    *,
    scope: Scope = Scope.WRITE,
    expires_at: float | None = None,
    max_bytes: int | None = None,
    max_jobs: int | None = None,
) -> str:
    """Make a token for a client, and return it: it cannot be shown again.

    It ends at `expires_at` (seconds since 1970) or never; without limits of its own it has those of the service. A
    `ConfigError` refuses a name that is not one or is taken, and a token that would have expired already.
    """
    if not _NAME.fullmatch(name) or name in {ANONYMOUS, OPERATOR}:
        raise ConfigError(
            f"{name!r} cannot be the name of a token: letters, digits and . _ @ - are allowed (64 at most, "
            f"a letter or digit first), {ANONYMOUS} and {OPERATOR} have a meaning of their own"
        )
    token = f"interloc_{secrets.token_urlsafe(32)}"
    with database.writing() as session:
        now = database.clock(session)
        if expires_at is not None and expires_at <= now:
            raise ConfigError(f"the token of {name} would have expired already; expected a date to come, or 30d")
        if session.get(Token, name) is not None:
            raise ConfigError(f"there is a token {name} already; `interloc admin token revoke {name}` takes it away")
        if (session.scalar(select(func.count()).select_from(Token)) or 0) >= MAX_TOKENS:
            raise ConfigError(
                f"there are {MAX_TOKENS:,} tokens, which each server reads again and again, and no more can be; "
                "`interloc admin token revoke` takes away those that nobody uses (`interloc admin token list`)"
            )
        session.add(
            Token(
                name=name,
                sha256=_sha256(token),
                created_at=now,
                scope=scope,
                expires_at=expires_at,
                max_bytes=max_bytes,
                max_jobs=max_jobs,
            )
        )
    return token


def list_tokens(database: Database) -> list[Token]:
    """Return who has a token, by name."""
    with database.reading() as session:
        return list(session.scalars(select(Token).order_by(Token.name)))


def revoke_token(database: Database, name: str) -> None:
    """Refuse a token from now on."""
    with database.writing() as session:
        gone = session.scalar(delete(Token).where(Token.name == name).returning(Token.name))
    if gone is None:
        raise ConfigError(f"there is no token {name}; `interloc admin token list` shows those that there are")


@dataclass(frozen=True)
class Holder:
    """Who sends a request, and what is allowed to it."""

    name: str
    scope: Scope = Scope.WRITE
    max_bytes: int | None = None
    max_jobs: int | None = None
    """See `Token`."""
    expires_at: float | None = None
    has_expired: bool = False
    """When the table was last read."""


class TokenBook:
    """A copy of the table of tokens that is read again every few seconds.

    A token is looked up by its hash, so the time of the look-up does not reveal how close a guess was.
    """

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._own = _sha256(settings.token.get_secret_value()) if settings.token is not None else None
        self._anonymous = settings.allow_anonymous
        self._closed = not settings.is_loopback  # also from the first token that is seen
        self._holders: dict[str, Holder] = {}
        self._read_at = _NEVER
        self._failure: tuple[float, SQLAlchemyError] | None = None
        self._reading = threading.Lock()
        self._used: dict[str, float] = {}

    @property
    def is_fresh(self) -> bool:
        """Whether the copy was made within the last seconds."""
        return time.monotonic() < self._read_at + _BELIEVED_S

    def recall(self, token: str) -> Holder | None:
        """Return the holder of a token by the copy; None if it is not in it."""
        digest = _sha256(token)
        if digest == self._own:
            return Holder(OPERATOR)
        holder = self._holders.get(digest)
        if holder is not None and not holder.has_expired:
            self._used[holder.name] = time.monotonic()
        return holder

    def read(self, since: float) -> None:
        """Copy the table, unless that was begun after a moment of `time.monotonic`: one copy serves all who wait."""
        with self._reading:
            if self._read_at > since:
                return
            time.sleep(max(0.0, min(_PAUSE_S, self._read_at + _PAUSE_S - time.monotonic())))
            if self._failure is not None and self._failure[0] > since:
                raise self._failure[1]
            begun = time.monotonic()
            try:
                with self._database.reading() as session:
                    now = self._database.clock(session)
                    rows = session.scalars(select(Token)).all()
            except SQLAlchemyError as error:  # all who wait for this copy are told, instead of trying one by one
                self._failure = time.monotonic(), error
                raise
            self._holders = {
                row.sha256: Holder(
                    name=row.name,
                    scope=Scope(row.scope),
                    max_bytes=row.max_bytes,
                    max_jobs=row.max_jobs,
                    expires_at=row.expires_at,
                    has_expired=row.expires_at is not None and row.expires_at <= now,
                )
                for row in rows
            }
            self._closed |= bool(rows)
            self._read_at = begun

    def still_holds(self, holder: Holder) -> bool:
        """Return whether a client may go on: its token was not revoked meanwhile, and has not expired."""
        if holder.name == ANONYMOUS:
            return not self.are_needed()
        return holder.name == OPERATOR or any(
            each.name == holder.name and not each.has_expired for each in self._read_again()
        )

    def named(self, name: str) -> Holder:
        """Return the holder of this name, without limits of its own where there is none: its drives outlive a token."""
        return next((holder for holder in self._read_again() if holder.name == name), Holder(name))

    def _read_again(self) -> list[Holder]:
        if not self.is_fresh:
            self.read(time.monotonic())
        return list(self._holders.values())

    def exist(self) -> bool:
        """Return whether there is any token, expired ones included: a service does not open by itself."""
        return self._own is not None or bool(self._read_again())

    def are_needed(self) -> bool:
        """Return whether clients need a token: also after the last one was revoked."""
        return not self._anonymous and (self._closed or self.exist())

    @property
    def need_is_known(self) -> bool:
        """Whether `are_needed` answers without asking the database."""
        return self._anonymous or self._closed or self._own is not None or self.is_fresh

    def write_uses(self) -> None:
        """Write when tokens were last used; called now and then, never for a request."""
        used, self._used = self._used, {}
        if not used:
            return
        with self._database.writing(patient=True) as session:
            now = self._database.clock(session)
            for name, moment in used.items():
                at = now - (time.monotonic() - moment)
                older = or_(Token.last_used_at.is_(None), Token.last_used_at < at)
                session.execute(update(Token).where(Token.name == name, older).values(last_used_at=at))


def _sha256(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
