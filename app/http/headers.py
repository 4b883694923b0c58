"""Request headers that the framework does not read: Prefer and Content-Digest."""

import re
from typing import Annotated, Any, cast

import http_sf
from fastapi import Depends, Header, Response
from starlette.datastructures import Headers

from app.http.problem_types import BAD_DIGEST
from app.http.problems import Problem

DEFAULT_WAIT_S = 50
MAX_WAIT_S = 300

_SHA256_BYTES = 32


def wait_of(prefer: str | None, default_s: int = DEFAULT_WAIT_S) -> int:
    """Return the seconds that a request may wait for its work: ``Prefer: wait=10`` or ``respond-async`` (RFC 7240).

    Preferences that are not understood are ignored.
    """
    seconds = default_s
    for preference in (prefer or "").split(","):
        name, _, value = preference.split(";")[0].strip().lower().partition("=")
        if name.strip() == "respond-async":
            seconds = 0
        elif name.strip() == "wait" and re.fullmatch(r'\s*"?\d{1,9}"?\s*', value):
            return min(int(value.strip(' "')), MAX_WAIT_S)
    return seconds


def _wait(default_s: int, description: str) -> Any:  # noqa: ANN401 - as FastAPI's Depends
    header = Header(None, description=description, examples=["wait=10"])

    async def seconds(response: Response, prefer: str | None = header) -> int:
        granted = wait_of(prefer, default_s)
        if prefer:
            response.headers["Preference-Applied"] = f"wait={granted}"
        return granted

    return Depends(seconds)


WaitSeconds = Annotated[
    int, _wait(DEFAULT_WAIT_S, "wait=SECONDS, at most 300, 50 by default; respond-async not to wait (RFC 7240).")
]
"""The time that a request may wait for its work, from its header Prefer."""

WaitIfAsked = Annotated[int, _wait(0, "wait=SECONDS, at most 300, to wait for the end (RFC 7240).")]
"""The same where a request that does not ask for it does not wait."""


IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        description="Any text; a request that is repeated with the same key (after a lost answer) makes nothing twice.",
        examples=["8f14e45f-ceea-467f"],
    ),
]


def sha256_of(headers: Headers) -> str | None:
    """Return the SHA-256 that the body must have, hexadecimal; None where the client sends no digest (RFC 9530).

    A digest that is malformed, or of another algorithm only, could not be checked and is a 422.
    """
    if "content-digest" not in headers:
        return None
    text = ", ".join(headers.getlist("content-digest"))
    try:
        members = cast("dict[str, tuple[object, object]]", http_sf.parse(text.encode("latin-1"), tltype="dictionary"))
        digest = members["sha-256"][0]
    except (http_sf.StructuredFieldError, KeyError):
        digest = None
    if not isinstance(digest, bytes) or len(digest) != _SHA256_BYTES:
        raise Problem(
            BAD_DIGEST,
            f"Content-Digest: found {text[:100]!r}. Expected sha-256=:BASE64: with the 32 bytes of the SHA-256 of the "
            "body in base64; no other algorithm is checked. Usual mistake: hexadecimal digits, or the colons left out.",
            headers={"Want-Content-Digest": "sha-256=10"},
        )
    return digest.hex()
