"""A connection to a service: its address, the token, its answers, and retries while it is busy or restarts."""

import ipaddress
import logging
import random
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any, Self, TypeVar

import httpx
from pydantic import BaseModel, ValidationError

from interloc.errors import ConfigError, NetworkError
from interloc.wording import first_fault

API = "/api/v1"
DEFAULT_SERVER = "http://127.0.0.1:8000"

_PROBLEM_TYPE = "application/problem+json"
_SHOWN_PROBLEMS = 20
BUSY = frozenset({429, 502, 503, 504})
_FIRST_PATIENCE_S = 2.0  # while a server has never answered: most likely there is no server
_LONGEST_PAUSE_S = 10.0

_log = logging.getLogger(__name__)

Model = TypeVar("Model", bound=BaseModel)
"""An answer, as far as the client reads it; members that it does not know are ignored."""


class FileProblem(BaseModel):
    """A problem with one file of a drive."""

    severity: str = "error"
    path: str = ""
    message: str = ""

    def __str__(self) -> str:
        return f"{self.path}: {self.message}" if self.path else self.message


class ProblemAnswer(BaseModel):
    """A problem document (RFC 9457)."""

    title: str = ""
    status: int = 0
    detail: str = ""
    problems: list[FileProblem] | None = None

    def __str__(self) -> str:
        text = ": ".join(dict.fromkeys(part for part in (self.title, self.detail) if part)) or f"status {self.status}"
        errors = [str(problem) for problem in self.problems or () if problem.severity == "error"]
        new = [error for error in errors if error.rstrip(".") not in text]
        rest = len(new) - _SHOWN_PROBLEMS
        more = [f"and {rest} more"] if rest > 0 else []
        return "\n  ".join([text, *new[:_SHOWN_PROBLEMS], *more])


class Refusal(NetworkError):  # noqa: N818 - an answer of the server, not a fault
    """The service did not do what was asked, and says why."""

    def __init__(self, status: int, problem: ProblemAnswer, hint: str = "") -> None:
        token = "Give a token of this server by INTERLOC_TOKEN or --token." if status == 401 else ""
        super().__init__(" ".join(filter(None, [str(problem), hint, token])))
        self.status = status
        self.problem = problem


class _Anything(BaseModel):
    """Any object of JSON."""


class Connection:
    """A service at an address, as http://127.0.0.1:8000, and its API token if it has any; threads may share it.

    At most `connections` requests are under way at once; each is repeated for `patience_s` while the server cannot be
    reached or is too busy, and may be silent for `timeout_s`.
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
        self.is_local = is_loopback(url.host)
        if token and url.scheme == "http" and not self.is_local:
            _log.warning("%s: the token is sent without encryption; give an https address if there is one", self.server)
        self._client = httpx.Client(
            base_url=self.server + API,
            headers={"User-Agent": f"interloc/{version('interloc')}", **authorization(token)},
            timeout=httpx.Timeout(timeout_s, connect=10.0, pool=None),
            limits=httpx.Limits(max_connections=connections + 2, max_keepalive_connections=connections + 2),
            verify=ssl.create_default_context() if url.scheme == "https" else False,
            trust_env=not self.is_local,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.closing.set()
        self._client.close()

    def check_server(self, path: str = "/drives?limit=1") -> None:
        """Check that there is a service at the address, and that it accepts the token."""
        self.ask("GET", path, _Anything)

    def ask(self, method: str, path: str, model: type[Model], **options: Any) -> Model:  # noqa: ANN401 - see request
        """Send a request, and read the JSON of its answer; `options`: see `request`."""
        return self._parse(self.request(method, path, **options), model)

    def request(
        self,
        method: str,
        path: str,
        *,
        json: object = None,
        params: Mapping[str, str | int] | None = None,
        body: Callable[[], bytes | Iterator[bytes]] | None = None,
        files: Any = None,  # noqa: ANN401 - parts of multipart/form-data, as httpx takes them
        headers: Mapping[str, str] | None = None,
    ) -> httpx.Response:
        """Send a request to a path below ``/api/v1``, and repeat it while the server cannot be reached or is busy.

        The body is called for at each attempt; an iterator needs a Content-Length among the headers. Raises `Refusal`
        where the service says why, `NetworkError` where none answered in time.
        """
        began, pauses = time.monotonic(), 0
        while True:
            asked_s: float | None = None
            try:
                content = body and body()
                response = self._client.request(
                    method, path.lstrip("/"), json=json, params=params, content=content, files=files, headers=headers
                )
            except httpx.RequestError as error:
                reason = _reason(error)
                is_hopeless = isinstance(error, httpx.UnsupportedProtocol | httpx.LocalProtocolError)
                may_repeat = not is_hopeless and "SSL" not in str(error)  # of a certificate that is not trusted
            else:
                self._answered = True
                asked = response.headers.get("retry-after", "")
                asked_s = float(asked) if asked.isascii() and asked.isdigit() and len(asked) < 8 else None
                reason = f"busy ({response.status_code})"
                may_repeat = response.status_code in BUSY
                if not may_repeat or time.monotonic() - began + (asked_s or 0.0) >= self._patience_s:
                    self._is_out.clear()
                    return self.check(response)
            self._check_patience(reason, time.monotonic() - began, may_repeat=may_repeat)
            pauses += 1
            spread = random.uniform(0.75, 1.25)  # noqa: S311 - threads shall not repeat their requests all at once
            pause_s = min(0.25 * 2.0 ** min(pauses, 8), _LONGEST_PAUSE_S) * spread if asked_s is None else asked_s
            if self.closing.wait(pause_s):
                raise NetworkError(f"{self.server}: stopped waiting.")

    @contextmanager
    def stream(self, path: str) -> Iterator[httpx.Response]:
        """Open an answer that is read in chunks; it is not requested again when it breaks off."""
        try:
            with self._client.stream("GET", path.lstrip("/")) as response:
                self._answered = True
                if not response.is_success:
                    response.read()
                yield self.check(response)
        except httpx.RequestError as error:
            raise NetworkError(f"{self.server}: {_reason(error)}.") from error

    def _check_patience(self, reason: str, waited_s: float, *, may_repeat: bool) -> None:
        """Raise NetworkError where another attempt makes no sense; log the first failure of an outage."""
        patience_s = self._patience_s if self._answered else min(self._patience_s, _FIRST_PATIENCE_S)
        if not may_repeat or self.closing.is_set() or waited_s >= patience_s:
            tried = f" (for {waited_s:.0f} s)" if waited_s >= 1 else ""
            hint = "" if self._answered else " Is it running there? Give its address by --server or INTERLOC_SERVER."
            raise NetworkError(f"{self.server}: {reason}{tried}.{hint}")
        if self._answered and not self._is_out.is_set():  # once per outage, whatever the number of threads
            self._is_out.set()
            _log.info("%s: %s; trying again for up to %.0f s", self.server, reason, patience_s)

    def check(self, response: httpx.Response) -> httpx.Response:
        """Return an answer that is a success; raise Refusal, or NetworkError where no service of InterLoc answered."""
        if response.is_success:
            return response
        if _media_type(response) == _PROBLEM_TYPE:
            problem = self._parse(response, ProblemAnswer)
            raise Refusal(response.status_code, problem)
        if response.has_redirect_location:
            target = str(response.url.join(response.headers["location"])).partition(API)[0]
            raise NetworkError(f"{self.server} redirects to {target}. Give the address that it moved to as the server.")
        raise NetworkError(
            f"{self.server} answered {response.status_code} {response.reason_phrase} to {response.request.method} "
            f"{response.request.url.path}, which is not how an InterLoc server answers. Expected the address of one, "
            "such as http://127.0.0.1:8000. Usual cause: the address of another server, or a proxy before it that "
            "refuses large bodies or is restarting."
        )

    def _parse(self, response: httpx.Response, model: type[Model]) -> Model:
        try:
            return model.model_validate_json(response.content)
        except ValidationError as error:
            found = _media_type(response) or "nothing"
            raise NetworkError(
                f"{self.server} answered {response.request.method} {response.request.url.path} with {found} that is "
                f"not what an InterLoc server answers ({first_fault(error)}). Usual cause: "
                "the address of another server, or one of another version."
            ) from None


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
    """Return the header of a token; raise ConfigError where it cannot be one."""
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


def _media_type(response: httpx.Response) -> str:
    return str(response.headers.get("content-type", "")).partition(";")[0].strip().lower()


def _reason(error: httpx.RequestError) -> str:
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
    if isinstance(error, httpx.DecodingError):
        return f"its answer was damaged on the way ({text.lower()})"
    return f"the connection broke off ({(text or type(error).__name__).rstrip('.').lower()})"
