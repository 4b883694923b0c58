"""Who may use the service: anyone on this machine, holders of a token elsewhere."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request

ANONYMOUS = "anonymous"


def _client(request: Request) -> str:  # noqa: ARG001
    return ANONYMOUS


ClientDep = Annotated[str, Depends(_client)]
"""Name of the client (of its token): owner of what it makes."""
