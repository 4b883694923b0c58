"""Who may use the service: anyone on this machine, holders of a token elsewhere.

`app.http.gate` keeps everybody else out before the body of a request is read; here is what endpoints see.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from app.context import Context
from app.http.openapi import changes_something
from app.http.problem_types import TOKEN_MAY_ONLY_READ
from app.http.problems import Problem
from app.states import Scope
from app.store.tokens import Holder
from interloc.errors import ConfigError

_bearer = HTTPBearer(
    scheme_name="token",
    description="A token of `interloc token add`; not needed where the service runs for one machine only.",
    auto_error=False,
)


async def client_of(request: Request, _: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]) -> str:
    """Return the name of the client, which the gate has determined; the whole API depends on it.

    A request that would change something, with a token that may only read, is a 403.
    """
    holder: Holder = request.state.holder
    route = request.scope["route"]
    if changes_something(request.method, route.openapi_extra):
        if holder.scope != Scope.WRITE:
            context: Context = request.app.state.context
            context.metrics.refused_tokens.labels("read only").inc()
            raise Problem(
                TOKEN_MAY_ONLY_READ,
                f"The token of {holder.name} has the scope {holder.scope}, and {request.method} {request.url.path} "
                "changes something. The operator makes one that may with `interloc token add NAME`.",
                headers={"WWW-Authenticate": 'Bearer realm="interloc", error="insufficient_scope", scope="write"'},
            )
        request.state.action = route.name
    return holder.name


ClientDep = Annotated[str, Depends(client_of)]
"""Name of the client, which is the name of its token: the owner of what it makes."""


def check_exposure(context: Context) -> None:
    """Refuse to listen where other machines can connect, unless there is a token or it is wanted."""
    settings = context.settings
    if settings.is_loopback or settings.allow_anonymous or context.tokens.exist():
        return
    raise ConfigError(
        f"--host {settings.host} lets other machines in, and there is no token. Make one with `interloc token add "
        "NAME`, which prints it once (in a container, on the same volume: `docker run --rm -v interloc:/data interloc "
        "token add NAME`), or set INTERLOC_TOKEN; --allow-anonymous serves everybody who can connect."
    )
