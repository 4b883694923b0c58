"""Files and documents over HTTP: validators, ranges, packed copies; what has none `app.http.middleware` compresses."""

import hashlib
import os
import re
import threading
import zlib
from collections.abc import Hashable
from email.utils import formatdate
from pathlib import Path
from typing import Any, BinaryIO, Literal
from urllib.parse import quote

from fastapi import Request
from fastapi.responses import FileResponse, Response
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.staticfiles import NotModifiedResponse, StaticFiles
from starlette.types import Message, Receive, Scope, Send

from app.context import Context
from app.http.problem_types import NO_SUCH_RANGE
from app.http.problems import Problem

MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
    ".fgb": "application/vnd.flatgeobuf",
    ".geojson": "application/geo+json",
    ".gpkg": "application/geopackage+sqlite3",
    ".html": "text/html; charset=utf-8",
    ".ico": "image/x-icon",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".kml": "application/vnd.google-earth.kml+xml",
    ".kmz": "application/vnd.google-earth.kmz",
    ".map": "application/json",
    ".mjs": "text/javascript; charset=utf-8",
    ".parquet": "application/vnd.apache.parquet",
    ".pmtiles": "application/vnd.pmtiles",
    ".png": "image/png",
    ".qgz": "application/x-qgis-project-container",
    ".svg": "image/svg+xml",
    ".tif": "image/tiff; application=geotiff",
    ".webmanifest": "application/manifest+json",
    ".woff2": "font/woff2",
    ".zip": "application/zip",
}
REVALIDATE = "private, no-cache"
"""Keep it, but ask every time whether it is still the same: one short exchange, and a purged result is gone."""

DOCUMENT_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'self'; "
    "sandbox allow-popups allow-popups-to-escape-sandbox allow-top-navigation-by-user-activation"
)
"""For documents made of data (reports, SVG): they bring their own style, and no script of theirs would run."""

_MAX_BYTES_AT_ONCE = 4 * 1024 * 1024  # read where the answer is made, without further trips to the thread pool

MIN_PACKED_BYTES, PACKING_LEVEL = 1400, 1
"""What fits into one packet does not travel faster when it is smaller; and the client waits for the packing."""
_ASKED_OFTEN = frozenset({".css", ".geojson", ".html", ".js", ".json"})
_MAX_COPIES_BYTES = 32 * 1024 * 1024  # of all copies; a larger file is packed while it is sent

_STATIC_FILES = StaticFiles(check_dir=False)


class _PackedCopies:
    """Packed copies of files that were asked for lately, in memory: packing takes fifty times as long as sending."""

    def __init__(self) -> None:
        self._copies: dict[Hashable, bytes] = {}  # the one that was asked for last is the last
        self._bytes = 0
        self._lock = threading.Lock()

    def of(self, file: BinaryIO, version: Hashable) -> bytes:
        """Return the copy of an open file, which is made where none of this version is there."""
        with self._lock:
            copy = self._copies.pop(version, None)
            if copy is not None:
                self._copies[version] = copy
                return copy
        packer = zlib.compressobj(PACKING_LEVEL, wbits=16 + zlib.MAX_WBITS)  # as gzip
        pieces = iter(lambda: file.read(WholeFile.chunk_size), b"")
        copy = b"".join([*map(packer.compress, pieces), packer.flush()])
        with self._lock:
            self._bytes += len(copy) - len(self._copies.pop(version, b""))
            self._copies[version] = copy
            while self._bytes > _MAX_COPIES_BYTES:
                self._bytes -= len(self._copies.pop(next(iter(self._copies))))
        return copy


_packed_copies = _PackedCopies()


class WholeFile(FileResponse):
    """An open file, or ranges of it: what is sent is the one that was opened, whatever gets its name meanwhile.

    The file may be closed before the answer is sent, which has a descriptor of its own.
    """

    chunk_size = 1024 * 1024  # a thread switch per chunk: large results go at the speed of the disk cache

    def __init__(self, file: BinaryIO, status_code: int = 200, **options: Any) -> None:  # noqa: ANN401
        self._descriptor = os.dup(file.fileno())
        path = Path(f"/dev/fd/{self._descriptor}")  # opens the same file once more, also one that has lost its name
        super().__init__(
            path if path.exists() else file.name, status_code, stat_result=os.fstat(file.fileno()), **options
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer; a range that is malformed is ignored (RFC 9110, section 14.2), one outside of the file a problem."""

        async def send_unless_refused(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in {400, 416}:
                raise HTTPException(message["status"])
            await send(message)

        try:
            if _STATIC_FILES.is_not_modified(self.headers, Headers(scope=scope)):
                await NotModifiedResponse(self.headers)(scope, receive, send)
            else:
                await super().__call__(scope, receive, send_unless_refused)
        except HTTPException as error:
            if error.status_code == 416:
                size = int(self.headers["content-length"])
                raise Problem(
                    NO_SUCH_RANGE,
                    f"Range: {Headers(scope=scope)['range'][:80]!r} lies outside of the file of {size:,} bytes.",
                    headers={"Content-Range": f"bytes */{size}"},
                ) from None
            headers = [(name, value) for name, value in scope["headers"] if name != b"range"]
            await super().__call__({**scope, "headers": headers}, receive, send)
        finally:
            os.close(self._descriptor)


def disposition(name: str, kind: Literal["attachment", "inline"] = "attachment") -> str:
    """Return the header Content-Disposition of a file name (RFC 6266): plain, and in full where that differs."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name)
    plain = plain if re.match("[A-Za-z0-9]", plain) else f"drive{plain}"
    full = "" if plain == name else f"; filename*=UTF-8''{quote(name, safe='')}"
    return f'{kind}; filename="{plain}"{full}'


def media_type_of(path: Path) -> str:
    """Return the media type of a file by its name."""
    return MEDIA_TYPES.get(path.suffix.lower(), "application/octet-stream")


def deliver(
    request: Request,
    path: Path,
    *,
    name: str | None = None,
    download: bool = False,
    cache_control: str = REVALIDATE,
    policy: str | None = DOCUMENT_POLICY,
) -> Response:
    """Answer a GET or HEAD with a file: 200, 206 for a range, 304 where the client has it.

    A file is never changed in place, so its time and size stand for its bytes. `policy` is the Content-Security-Policy
    of HTML and SVG, None that of the service.
    """
    with path.open("rb") as file:
        stat = os.fstat(file.fileno())
        media_type = media_type_of(path)
        headers = {
            "etag": f'"{stat.st_mtime_ns:x}-{stat.st_size:x}"',
            "cache-control": cache_control,
            "last-modified": formatdate(stat.st_mtime, usegmt=True),
        }
        if policy is not None and media_type.startswith(("text/html", "image/svg")):
            headers["content-security-policy"] = policy
        known = not_modified(request, headers)
        if known is not None:
            return known
        if name is not None:
            headers["content-disposition"] = disposition(name, "attachment" if download else "inline")
        is_whole = "range" not in request.headers
        is_copied = path.suffix.lower() in _ASKED_OFTEN and MIN_PACKED_BYTES <= stat.st_size <= _MAX_COPIES_BYTES
        if is_whole and is_copied and "gzip" in request.headers.get("accept-encoding", ""):
            content = _packed_copies.of(file, (stat.st_dev, stat.st_ino, headers["etag"]))
            headers |= {"accept-ranges": "bytes", "content-encoding": "gzip", "vary": "Accept-Encoding"}
            return Response(content, headers=headers, media_type=media_type)
        if not is_whole or stat.st_size > _MAX_BYTES_AT_ONCE:
            return WholeFile(file, headers=headers, media_type=media_type)
        headers["accept-ranges"] = "bytes"
        return Response(file.read(), headers=headers, media_type=media_type)


def answer_tagged(request: Request, content: bytes, media_type: str = "application/json", **headers: str) -> Response:
    """Answer a GET or HEAD with what was made for it, and its ETag: 200, or 304 where the client has the same."""
    headers = {"etag": tag_of(content), "cache-control": REVALIDATE, **headers}
    return not_modified(request, headers) or Response(content, headers=headers, media_type=media_type)


def service_address(request: Request) -> str:
    """Return the address of the service as its client sees it, without a slash at its end."""
    context: Context = request.app.state.context
    return context.settings.public_url or str(request.base_url).rstrip("/")


def tag_of(content: bytes) -> str:
    """Return the ETag of an answer."""
    return f'"{hashlib.sha256(content).hexdigest()[:24]}"'


def not_modified(request: Request, headers: dict[str, str]) -> Response | None:
    """Return the 304 where the client has what these headers describe (If-None-Match, If-Modified-Since)."""
    known = Headers(headers)
    return NotModifiedResponse(known) if _STATIC_FILES.is_not_modified(known, request.headers) else None
