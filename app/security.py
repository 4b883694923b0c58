"""Who may use the service: anyone on this machine, holders of a token elsewhere."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request
from sqlalchemy import select

from app.models import Token
from app.service import Service
from interloc.errors import ConfigError

ANONYMOUS = "anonymous"


def _client(request: Request) -> str:  # noqa: ARG001
    return ANONYMOUS


ClientDep = Annotated[str, Depends(_client)]
"""Name of the client (of its token): owner of what it makes."""


def has_tokens(service: Service) -> bool:
    """Tell whether clients need a token."""
    if service.settings.token is not None:
        return True
    with service.database.reading() as session:
        return session.scalar(select(Token.name).limit(1)) is not None


def check_exposure(service: Service) -> None:
    """Refuse to listen where other machines can connect, unless tokens keep them out or it is wanted.

    Raises
    ------
    ConfigError
        There is no token.
    """
    settings = service.settings
    if settings.is_loopback or settings.allow_anonymous or has_tokens(service):
        return
    raise ConfigError(
        f"--host {settings.host} lets other machines in, and there is no token. Make one with `interloc token add "
        "NAME` or set INTERLOC_TOKEN; --allow-anonymous serves everybody who can connect."
    )
