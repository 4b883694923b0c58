"""Headers that tell browsers what the page may do, and that nothing else may be done with it."""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette._utils import get_route_path
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.settings import Settings

DATA_POLICY = "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; sandbox"
"""Of what lies below the API, should a browser take it for a document: it may be anything that was uploaded."""

_HSTS_S = 180 * 24 * 3600


def page_policy(settings: Settings) -> str:
    """Return the policy of the page: its own files, and images of the tile server."""
    tiles = _tile_source(settings.tile_url)
    return (
        f"default-src 'self'; img-src 'self' data: blob:{tiles}; worker-src 'self'; connect-src 'self'; "
        "object-src 'none'; form-action 'self'; frame-src 'self'; frame-ancestors 'none'; base-uri 'none'"
    )


class SecurityHeaders:
    """Adds them to every answer; a header that an endpoint has set stays."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._page_policy = page_policy(settings)
        self._always = {
            "x-content-type-options": "nosniff",
            # Tile servers want to know who asks; other sites need not know which drive was looked at.
            "referrer-policy": "strict-origin-when-cross-origin",
            "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
            "permissions-policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Go on, and add to the answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        is_api = get_route_path(scope).startswith("/api/")
        policy = DATA_POLICY if is_api else self._page_policy

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in self._always.items():
                    headers.setdefault(name, value)
                headers.setdefault("content-security-policy", policy)
                if is_api:
                    headers.setdefault("cache-control", "no-store")
                if scope["scheme"] == "https":
                    headers.setdefault("strict-transport-security", f"max-age={_HSTS_S}")
            await send(message)

        await self._app(scope, receive, send_with_headers)


def _tile_source(tile_url: str | None) -> str:
    """Return the host of a tile address as a source, with a blank before it; ``{s}`` stands for any subdomain."""
    parts = urlsplit((tile_url or "").replace("{s}", "*"))
    return f" {parts.scheme}://{parts.netloc}" if parts.scheme in {"http", "https"} and parts.netloc else ""
