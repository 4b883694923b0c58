"""Who may use the service: anyone on this machine, holders of a token elsewhere.

`app.http.gate` keeps everybody else out before the body of a request is read; here is what endpoints see.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from app.context import Context
from app.store.tokens import ANONYMOUS
from interloc.errors import ConfigError

_bearer = HTTPBearer(
    scheme_name="token",
    description="A token of `interloc token add NAME`; not needed where the service runs for one machine only.",
    auto_error=False,
)


async def client_of(request: Request, _: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]) -> str:
    """Return the name of the client, which the gate has determined; the whole API depends on it."""
    client: str = request.state.client
    return client


ClientDep = Annotated[str, Depends(client_of)]
"""Name of the client, which is the name of its token: the owner of what it makes."""


def check_exposure(context: Context) -> None:
    """Refuse to listen where other machines can connect, unless there is a token or it is wanted.

    Raises
    ------
    ConfigError
        There is no token.
    """
    settings = context.settings
    if settings.is_loopback or settings.allow_anonymous or context.tokens.exist():
        return
    raise ConfigError(
        f"--host {settings.host} lets other machines in, and there is no token. Make one with `interloc token add "
        "NAME` or set INTERLOC_TOKEN; --allow-anonymous serves everybody who can connect."
    )


__all__ = ["ANONYMOUS", "ClientDep", "check_exposure", "client_of"]
