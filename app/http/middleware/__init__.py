"""What every request passes, from the outside in: log, headers, faults, gate, limits of the body."""

from __future__ import annotations

from fastapi import FastAPI

from app.http.middleware.bodies import Bodies
from app.http.middleware.faults import Faults
from app.http.middleware.gate import Gate
from app.http.middleware.headers import SecurityHeaders
from app.http.middleware.requests import RequestLog
from app.settings import Settings


def add_middleware(app: FastAPI, settings: Settings) -> None:
    """Put them around the application; the last that is added is the outermost."""
    app.add_middleware(Bodies, idle_s=settings.idle_timeout_s)
    app.add_middleware(Gate, settings=settings)
    app.add_middleware(Faults)
    app.add_middleware(SecurityHeaders, settings=settings)
    app.add_middleware(RequestLog, root_path=settings.root_path)
