"""The digest that a client sends along with a body (RFC 9530): ``Content-Digest: sha-256=:...:``."""

from __future__ import annotations

import base64
import binascii
import re

from starlette.datastructures import Headers

from app.http.problems import Problem

FIELDS = ("content-digest", "repr-digest")
_MEMBER = re.compile(r"\s*([a-z*][a-z0-9_\-.*]*)\s*=\s*:([A-Za-z0-9+/=]*):\s*(?:;[^,]*)?")
_BYTES = 32


def sha256_of(headers: Headers) -> str | None:
    """Return the SHA-256 that the body must have, hexadecimal; None where the client names none.

    Raises
    ------
    Problem
        422: it is malformed, or by another algorithm only, so that it could not be checked.
    """
    found = {_sha256(name, headers[name]) for name in FIELDS if name in headers}
    if len(found) > 1:
        raise _malformed("Content-Digest", "differs from Repr-Digest, but the body is sent as it is")
    return found.pop() if found else None


def _sha256(field: str, text: str) -> str:
    members: dict[str, str] = {}
    for member in text.split(","):
        match = _MEMBER.fullmatch(member)
        if match is None:
            raise _malformed(field, f"{member.strip()[:80]!r} is no digest")
        members[match[1]] = match[2]
    if "sha-256" not in members:
        raise _malformed(field, f"has {', '.join(members)}, but only sha-256 is checked here")
    try:
        digest = base64.b64decode(members["sha-256"], validate=True)
    except binascii.Error:
        raise _malformed(field, "its sha-256 is not base64") from None
    if len(digest) != _BYTES:
        raise _malformed(field, f"its sha-256 has {len(digest)} bytes, not {_BYTES}")
    return digest.hex()


def _malformed(field: str, what: str) -> Problem:
    return Problem(
        422,
        "Bad digest",
        f"{field}: {what}. Expected sha-256=:BASE64: with the 32 bytes of the SHA-256 of the body in base64. Usual "
        "mistake: hexadecimal digits, or the colons left out.",
        headers={"Want-Content-Digest": "sha-256=10"},
    )
