"""A connection to a service: its address, the token, and retries while a server is busy or restarts."""

from __future__ import annotations

import ipaddress
import logging
import random
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from types import TracebackType
from typing import Any, Self

import httpx

from interloc.client.answers import DrivesAnswer, Model, check, parse
from interloc.errors import ConfigError, NetworkError

API = "/api/v1"
DEFAULT_SERVER = "http://127.0.0.1:8000"

_BUSY = frozenset({429, 502, 503, 504})
_NOT_DONE = frozenset({429, 503})  # the request was not worked on; 502 and 504 of a proxy leave that open
_FIRST_PATIENCE_S = 2.0  # while a server has never answered: most likely there is no server
_LONGEST_PAUSE_S = 10.0

_log = logging.getLogger(__name__)


class Connection:
    """A service at an address. Threads may share it.

    Parameters
    ----------
    server
        Base address, as http://127.0.0.1:8000.
    token
        API token, where the service asks for one.
    connections
        Number of requests that may be under way at once.
    patience_s
        Time for which a request is repeated while the server cannot be reached or is too busy.
    timeout_s
        Longest silence within a request.

    Raises
    ------
    ConfigError
        The address or the token is not valid.
    """

    def __init__(
        self,
        server: str = DEFAULT_SERVER,
        token: str | None = None,
        *,
        connections: int = 8,
        patience_s: float = 120.0,
        timeout_s: float = 90.0,
    ) -> None:
        url = _address(server)
        self.server = str(url).rstrip("/")
        self.closing = threading.Event()
        """When set, no request is repeated, and every pause ends with an error."""
        self._patience_s = patience_s
        self._answered = False
        self._is_out = threading.Event()
        local = is_loopback(url.host)
        if token and url.scheme == "http" and not local:
            _log.warning("%s: the token is sent without encryption; give an https address if there is one", self.server)
        self._client = httpx.Client(
            base_url=self.server + API,
            headers={"User-Agent": f"interloc/{version('interloc')}", **authorization(token)},
            timeout=httpx.Timeout(timeout_s, connect=10.0, pool=None),
            limits=httpx.Limits(max_connections=connections + 2, max_keepalive_connections=connections + 2),
            verify=ssl.create_default_context() if url.scheme == "https" else False,
            trust_env=not local,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.closing.set()
        self._client.close()

    def check_server(self) -> None:
        """Check that there is a service at the address, and that it accepts the token.

        Raises
        ------
        NetworkError
            There is no service, or it needs another token.
        """
        self.ask("GET", "/drives", DrivesAnswer, params={"limit": 1})

    def ask(self, method: str, path: str, model: type[Model], **options: Any) -> Model:  # noqa: ANN401 - see request
        """Send a request, and read the JSON of its answer; `options`: see `request`."""
        return parse(self.request(method, path, **options), model, self.server)

    def request(
        self,
        method: str,
        path: str,
        *,
        json: object = None,
        params: Mapping[str, str | int] | None = None,
        body: Callable[[], bytes | Iterator[bytes]] | None = None,
        headers: Mapping[str, str] | None = None,
        repeatable: bool = True,
    ) -> httpx.Response:
        """Send a request, and repeat it while the server cannot be reached or is busy.

        Parameters
        ----------
        path
            Path below ``/api/v1``, quoted where necessary.
        body
            Called at each attempt; an iterator needs a Content-Length among the `headers`.
        repeatable
            False: a request that the server may have received is not sent again.

        Raises
        ------
        Refusal
            The service refuses and says why.
        NetworkError
            No service answered in time.
        """
        waiting = _Waiting(self._patience_s)
        while True:
            try:
                response = self._client.request(
                    method, path.lstrip("/"), json=json, params=params, content=body and body(), headers=headers
                )
            except httpx.TransportError as error:
                may_repeat = repeatable or isinstance(error, httpx.ConnectError | httpx.ConnectTimeout)
                self._pause(waiting, _reason(error), None, may_repeat=may_repeat and not _is_hopeless(error))
                continue
            self._answered = True
            if response.status_code in _BUSY and (repeatable or response.status_code in _NOT_DONE):
                pause_s = _retry_after(response)
                if waiting.allows(pause_s):
                    self._pause(waiting, f"busy ({response.status_code})", pause_s, may_repeat=True)
                    continue
            self._is_out.clear()
            return check(response, self.server)

    @contextmanager
    def stream(
        self, path: str, *, headers: Mapping[str, str] | None = None, timeout_s: float | None = None
    ) -> Iterator[httpx.Response]:
        """Open an answer that is read in chunks; it is not requested again when it breaks off.

        Raises
        ------
        Refusal, NetworkError
            As `request`; also when the connection breaks.
        """
        timeout = httpx.USE_CLIENT_DEFAULT if timeout_s is None else httpx.Timeout(timeout_s, connect=10.0, pool=None)
        try:
            with self._client.stream("GET", path.lstrip("/"), headers=headers, timeout=timeout) as response:
                self._answered = True
                if not response.is_success:
                    response.read()
                yield check(response, self.server)
        except httpx.TransportError as error:
            raise NetworkError(f"{self.server}: {_reason(error)}.") from error

    def _pause(self, waiting: _Waiting, reason: str, pause_s: float | None, *, may_repeat: bool) -> None:
        """Wait before the next attempt, or raise NetworkError."""
        if not self._answered:
            waiting.patience_s = min(waiting.patience_s, _FIRST_PATIENCE_S)
        if not may_repeat or self.closing.is_set() or not waiting.allows(pause_s):
            tried = f" (for {waiting.waited_s:.0f} s)" if waiting.waited_s >= 1 else ""
            hint = "" if self._answered else " Is it running there? Give its address by --server or INTERLOC_SERVER."
            raise NetworkError(f"{self.server}: {reason}{tried}.{hint}")
        if self._answered and not self._is_out.is_set():  # once per outage, whatever the number of threads
            self._is_out.set()
            _log.info("%s: %s; trying again for up to %.0f s", self.server, reason, waiting.patience_s)
        if self.closing.wait(waiting.next_pause(pause_s)):
            raise NetworkError(f"{self.server}: stopped waiting.")


class _Waiting:
    """The pauses of one request: they get longer, until its time is over."""

    def __init__(self, patience_s: float) -> None:
        self.patience_s = patience_s
        self._since = time.monotonic()
        self._pauses = 0

    @property
    def waited_s(self) -> float:
        """Time since the request was first sent."""
        return time.monotonic() - self._since

    def allows(self, pause_s: float | None) -> bool:
        """Tell whether there is time for one more pause; one that the server asked for must fit in whole."""
        return self.waited_s + (pause_s or 0.0) < self.patience_s

    def next_pause(self, pause_s: float | None) -> float:
        """Return the length of the next pause."""
        self._pauses += 1
        if pause_s is not None:
            return pause_s
        spread = random.uniform(0.75, 1.25)  # noqa: S311 - threads shall not repeat their requests all at once
        return min(0.25 * 2.0 ** min(self._pauses, 8), _LONGEST_PAUSE_S) * spread


def _address(server: str) -> httpx.URL:
    """Check a base address; what a browser's address bar adds to it is cut off."""
    try:
        url = httpx.URL(server.strip())
    except httpx.InvalidURL as error:
        raise ConfigError(f"server {server!r}: {error}. Expected an address such as {DEFAULT_SERVER}.") from None
    if url.scheme not in {"http", "https"} or not url.host:
        raise ConfigError(f"server {server!r}: expected an address such as {DEFAULT_SERVER}, with http:// or https://.")
    if url.userinfo:
        raise ConfigError(
            "server: the address contains a user name or password. Give a token by INTERLOC_TOKEN instead."
        )
    path = url.path.rstrip("/")
    for ending in (API, "/docs", "/index.html"):
        path = path.removesuffix(ending)
    return url.copy_with(path=path or "/", query=None, fragment=None)


def authorization(token: str | None) -> dict[str, str]:
    """Return the header of a token.

    Raises
    ------
    ConfigError
        It cannot be one.
    """
    if not token:
        return {}
    if not (token.isascii() and token.isprintable() and " " not in token):
        raise ConfigError(
            "token: it contains spaces or other characters that no token has. Usual cause: too much was copied."
        )
    return {"Authorization": f"Bearer {token}"}


def is_loopback(host: str) -> bool:
    """Tell whether a host is this machine, whose ports a proxy of the environment cannot reach."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _retry_after(response: httpx.Response) -> float | None:
    """Return the pause that the server asks for, in seconds."""
    text = response.headers.get("retry-after", "")
    return float(text) if text.isascii() and text.isdigit() and len(text) < 8 else None


def _is_hopeless(error: httpx.TransportError) -> bool:
    """Tell whether another attempt would fail too: a certificate that is not trusted, an unknown protocol."""
    return isinstance(error, httpx.UnsupportedProtocol | httpx.LocalProtocolError) or "SSL" in str(error)


def _reason(error: httpx.TransportError) -> str:
    """Describe in words how the connection failed."""
    text = str(error)
    if "CERTIFICATE_VERIFY_FAILED" in text:
        return f"its certificate is not trusted on this machine ({text.rpartition(': ')[2].rstrip('.')})"
    if "SSL" in text:
        return f"it does not speak https ({text.rstrip('.')})"
    if isinstance(error, httpx.ConnectError | httpx.ConnectTimeout):
        return f"cannot be reached ({(text or 'timed out').rstrip('.').lower()})"
    if isinstance(error, httpx.TimeoutException):
        return "did not answer in time"
    return f"the connection broke off ({(text or type(error).__name__).rstrip('.').lower()})"
