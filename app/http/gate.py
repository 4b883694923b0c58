"""Who gets in. Everything here is decided by the head of a request; nothing of a refused body is read.

A service for this machine asks for no token, so a web page that the user visits must not be able to use it through
the user's browser. Two attacks are kept out:

- DNS rebinding: the page's own name is pointed at 127.0.0.1, and to the browser the service is the page's origin. Such
  requests carry the page's name as ``Host``: only names of this machine (and ``INTERLOC_ALLOWED_HOSTS``) are answered.
- Cross-site requests: a page can send forms and simple requests anywhere, though it cannot read the answers. Browsers
  report it in ``Sec-Fetch-Site``, older ones and plain http in ``Origin``: requests that change something are refused
  when they come from another origin. Programs send neither header.

Neither is a danger where a token is needed: browsers add none by themselves, there are no cookies. A token may also
come as the password of HTTP Basic, which is what QGIS can send; browsers repeat such a password by themselves once a
user has typed it, so that it only serves to read.

Endpoints see who sends a request by `client_of`.
"""

import base64
import logging
import re
import time
from typing import Annotated
from urllib.parse import urlsplit

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from app import logs
from app.context import Context
from app.http.openapi import SAFE, changes_something
from app.http.problem_types import REQUEST_OF_ANOTHER_SITE, TOKEN_MAY_ONLY_READ, TOKEN_NEEDED, UNKNOWN_HOST_NAME
from app.http.problems import Problem, respond
from app.settings import Settings
from app.states import Scope as TokenScope
from app.store.database import moment
from app.store.tokens import ANONYMOUS, Holder, TokenBook
from interloc.client.connection import is_loopback
from interloc.errors import ConfigError

_PROBES = {"/healthz", "/readyz"}
_MAX_TOKEN = 512  # characters
_OGC = re.compile(r"(/api/v1/(jobs|maps)/[^/]+)?/ogc(/.*)?", re.DOTALL)

_log = logging.getLogger(__name__)


def path_of(scope: Scope) -> str:
    """Return the path of a request below the root path, which a reverse proxy may take off or leave on."""
    path: str = scope["path"]
    root: str = scope.get("root_path", "")
    return path[len(root) :] if root and f"{path}/".startswith(f"{root}/") else path


def is_api(path: str) -> bool:
    """Return whether a path is of the API, which needs a token where there are any, and not of the page."""
    return path.startswith(("/api/", "/ogc/")) or path == "/ogc"


class Gate:
    """Refuses by host, origin and token; leaves who sends a request in ``request.state.holder``."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._hosts = {*settings.allowed_hosts, urlsplit(settings.public_url).hostname} - {None}
        self._checks_hosts = bool(self._hosts) or settings.is_loopback
        # One thread of its own: tokens are read even where all others wait for the database.
        self._reader = CapacityLimiter(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Go on, or refuse."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        problem = await self._problem(scope)
        if problem is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(respond(problem, scope["path"]))
        else:
            await respond(problem, scope["path"])(scope, receive, send)

    async def _problem(self, scope: Scope) -> Problem | None:
        path = path_of(scope)
        scope.setdefault("state", {})["holder"] = Holder(ANONYMOUS)
        if path in _PROBES:
            return None
        headers = Headers(scope=scope)
        context: Context = scope["app"].state.context
        if not context.tokens.need_is_known:
            await self._read(context.tokens, time.monotonic())
        needed = context.tokens.are_needed()
        problem = None if needed else self._foreign(scope, headers)
        if problem is None and (is_api(path) or path == "/metrics"):
            problem = await self._identify(scope, headers, context, needed=needed)
        return problem

    def _foreign(self, scope: Scope, headers: Headers) -> Problem | None:
        """Refuse what a page of another site sends through the user's browser."""
        host = _name_of(headers.get("host", ""))
        if self._checks_hosts and not (is_loopback(host) or host.endswith(".localhost") or host in self._hosts):
            return Problem(
                UNKNOWN_HOST_NAME,
                "The service answers under the names of this machine only: localhost, 127.0.0.1. "
                "INTERLOC_ALLOWED_HOSTS takes the name under which a reverse proxy shows it.",
            )
        if scope.get("method") in SAFE or "authorization" in headers:  # a socket has no method, and is not safe
            return None
        site = headers.get("sec-fetch-site")
        if site is None:
            origin = headers.get("origin")
            is_own = origin is None or origin.partition("://")[2] == headers.get("host")
            site = "same-origin" if is_own else "cross-site"
        if site in {"same-origin", "none"}:
            return None
        return Problem(REQUEST_OF_ANOTHER_SITE, "Pages of other sites may not change anything here.")

    async def _identify(self, scope: Scope, headers: Headers, context: Context, *, needed: bool) -> Problem | None:
        """Find out whose token it is. Wrong ones cost little, see `app.store.tokens`, and none can be guessed."""
        given = headers.get("authorization")
        offers_basic = _OGC.fullmatch(path_of(scope)) is not None  # a GIS asks
        if given is None:
            return _unauthorized("This service needs an API token.", basic=offers_basic) if needed else None
        scheme, _, token = given.partition(" ")
        token = token.strip()
        if scheme.lower() == "basic" and scope.get("method") in SAFE:
            try:
                token = base64.b64decode(token, validate=True).decode().partition(":")[2]
            except ValueError:
                token = ""
        elif scheme.lower() != "bearer":
            token = ""
        if not token or len(token) > _MAX_TOKEN:
            found = "The Authorization header holds no token: `Bearer TOKEN` is expected."
            return _unauthorized(found, basic=offers_basic)
        asked = time.monotonic()
        if not context.tokens.is_fresh:
            await self._read(context.tokens, asked)
        holder = context.tokens.recall(token)
        if holder is None:
            await self._read(context.tokens, asked)  # it may have been made just now
            holder = context.tokens.recall(token)
        if holder is None:
            context.metrics.refused_tokens.labels("unknown").inc()
            _log.warning("wrong token", extra={"address": scope["client"][0] if scope.get("client") else ""})
            return _unauthorized(
                "There is no such token, or it was revoked. The operator makes one with "
                "`interloc admin token add NAME`.",
                'error="invalid_token"',
                basic=offers_basic,
            )
        logs.bind(client=holder.name)
        if holder.has_expired:
            context.metrics.refused_tokens.labels("expired").inc()
            return _unauthorized(
                f"The token of {holder.name} expired on {moment(holder.expires_at or 0):%Y-%m-%d %H:%M} UTC. The "
                "operator makes another one with `interloc admin token add NAME`.",
                'error="invalid_token"',
                basic=offers_basic,
            )
        scope["state"]["holder"] = holder
        return None

    async def _read(self, tokens: TokenBook, asked: float) -> None:
        await to_thread.run_sync(tokens.read, asked, limiter=self._reader)


def _unauthorized(found: str, parameter: str = "", *, basic: bool = False) -> Problem:
    """Return the problem; only where a GIS asks is Basic offered, as browsers open a dialogue then."""
    challenge = f'Bearer realm="interloc"{", " if parameter else ""}{parameter}'
    if basic:
        challenge = f'Basic realm="interloc", charset="UTF-8", {challenge}'
    detail = f"{found} Send it as `Authorization: Bearer TOKEN`, or to read as the password of any user."
    return Problem(TOKEN_NEEDED, detail, headers={"WWW-Authenticate": challenge})


def _name_of(host: str) -> str:
    """Return the name in a Host header, without port and brackets."""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


_bearer = HTTPBearer(
    scheme_name="token",
    description="A token of `interloc admin token add`; not needed where the service runs for one machine only.",
    auto_error=False,
)


async def client_of(request: Request, _: Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]) -> str:
    """Return the name of the client, which the gate has determined; the whole API depends on it.

    A request that would change something, with a token that may only read, is a 403.
    """
    holder: Holder = request.state.holder
    route = request.scope["route"]
    if changes_something(request.method, route.openapi_extra):
        if holder.scope != TokenScope.WRITE:
            context: Context = request.app.state.context
            context.metrics.refused_tokens.labels("read only").inc()
            raise Problem(
                TOKEN_MAY_ONLY_READ,
                f"The token of {holder.name} has the scope {holder.scope}, and {request.method} {request.url.path} "
                "changes something. The operator makes one that may with `interloc admin token add NAME`.",
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
        f"--host {settings.host} lets other machines in, and there is no token. Make one with "
        "`interloc admin token add NAME`, which prints it once (in a container, on the same volume: `docker run --rm "
        "-v interloc:/data interloc admin token add NAME`), or set INTERLOC_TOKEN; --allow-anonymous serves everybody "
        "who can connect."
    )
