"""Files over HTTP: strong validators, ranges, and a compressed twin where that pays."""

from __future__ import annotations

import gzip
import hashlib
import re
import shutil
import threading
from collections import OrderedDict
from contextlib import suppress
from email.utils import formatdate, parsedate_to_datetime
from pathlib import Path

from fastapi import Request
from fastapi.responses import FileResponse, Response
from starlette.responses import MalformedRangeHeader, RangeNotSatisfiable

from app.http.problems import Problem
from interloc.errors import OutputError
from interloc.files import atomic_write

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
    ".map": "application/json",
    ".mjs": "text/javascript; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
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

_COMPRESSIBLE = frozenset({".css", ".csv", ".geojson", ".html", ".js", ".json", ".kml", ".map", ".mjs", ".svg"})
_MIN_BYTES = 1400  # what fits one packet does not travel faster when it is smaller


class _Bodies:
    """Small files as they were last sent: handing them over takes no more trips to the thread pool."""

    def __init__(self, most_bytes: int, largest_bytes: int) -> None:
        self._most_bytes, self._largest_bytes = most_bytes, largest_bytes
        self._bodies: OrderedDict[tuple[Path, int, int], bytes] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()

    def read(self, path: Path) -> bytes | None:
        """Return the bytes of a file; None where it is too large for that."""
        stat = path.stat()
        if stat.st_size > self._largest_bytes:
            return None
        key = path, stat.st_mtime_ns, stat.st_size
        with self._lock:
            if key in self._bodies:
                self._bodies.move_to_end(key)
                return self._bodies[key]
        body = path.read_bytes()
        with self._lock:
            if key not in self._bodies:
                self._bodies[key] = body
                self._size += len(body)
            while self._size > self._most_bytes:
                self._size -= len(self._bodies.popitem(last=False)[1])
        return body


_BODIES = _Bodies(64 * 1024 * 1024, 4 * 1024 * 1024)


class WholeFile(FileResponse):
    """A file that is not changed while it is sent, or ranges of it."""

    chunk_size = 1024 * 1024  # a thread switch each: large results go at the speed of the disk cache

    @classmethod
    def _parse_range_header(cls, http_range: str, file_size: int) -> list[tuple[int, int]]:
        """Return the ranges that are asked for; the whole where they cannot be understood (RFC 9110, section 14.2)."""
        try:
            return super()._parse_range_header(http_range, file_size)
        except MalformedRangeHeader:
            return []
        except RangeNotSatisfiable as error:
            raise Problem(
                416,
                "No such range",
                f"Range: {http_range[:80]!r} lies outside of the file, which has {file_size:,} bytes.",
                headers={"Content-Range": f"bytes */{file_size}"},
            ) from error


def media_type_of(path: Path) -> str:
    """Return the media type of a file by its name."""
    return MEDIA_TYPES.get(path.suffix.lower(), "application/octet-stream")


def deliver(
    request: Request,
    path: Path,
    *,
    twins: Path | None = None,
    name: str | None = None,
    download: bool = False,
    cache_control: str = REVALIDATE,
    vary: str = "",
    policy: str | None = DOCUMENT_POLICY,
) -> Response:
    """Answer a GET or HEAD with a file: 200, 206 for a range, 304 where the client has it.

    Parameters
    ----------
    path
        The file. It is never changed in place, so its time and size stand for its bytes.
    twins
        Folder of the compressed twins, which are made when first asked for; None: no compression.
    name
        File name offered to whoever saves it.
    download
        Save it rather than show it.
    vary
        Other request headers that the choice of the file depends on.
    policy
        Content-Security-Policy of HTML and SVG; None: that of the service.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    """
    stat = path.stat()
    etag = f'"{stat.st_mtime_ns:x}-{stat.st_size:x}'
    headers = {"cache-control": cache_control}
    media_type = media_type_of(path)
    if twins is not None and path.suffix.lower() in _COMPRESSIBLE and stat.st_size >= _MIN_BYTES:
        vary = f"{vary}, Accept-Encoding" if vary else "Accept-Encoding"
        if "range" not in request.headers and _accepts_gzip(request.headers.get("accept-encoding", "")):
            twin = _twin(path, twins, f"{stat.st_mtime_ns:x}.gz")
            if twin is not None:
                path, etag = twin, f"{etag}-gzip"
                headers["content-encoding"] = "gzip"
    headers["etag"] = f'{etag}"'
    headers["last-modified"] = formatdate(stat.st_mtime, usegmt=True)
    if vary:
        headers["vary"] = vary
    if policy is not None and media_type.startswith(("text/html", "image/svg")):
        headers["content-security-policy"] = policy
    if is_known(request, headers["etag"], stat.st_mtime):
        headers.pop("content-encoding", None)
        return Response(status_code=304, headers=headers)
    body = None if "range" in request.headers else _BODIES.read(path)
    if body is not None:
        if name is not None:
            headers["content-disposition"] = f'{"attachment" if download else "inline"}; filename="{name}"'
        headers["accept-ranges"] = "bytes"
        return Response(body, headers=headers, media_type=media_type)
    return WholeFile(
        path,
        headers=headers,
        media_type=media_type,
        filename=name,
        content_disposition_type="attachment" if download else "inline",
        stat_result=path.stat(),
    )


def is_known(request: Request, etag: str, modified: float | None = None) -> bool:
    """Tell whether the client has what it asks for (RFC 9110, section 13.2.2)."""
    known = request.headers.get("if-none-match")
    if known is not None:
        tags = re.findall(r'(?:W/)?("[^"]*")', known)
        return known.strip() == "*" or etag in tags
    since = request.headers.get("if-modified-since")
    if since is None or modified is None:
        return False
    try:
        return int(modified) <= parsedate_to_datetime(since).timestamp()
    except (ValueError, TypeError):
        return False


def _accepts_gzip(header: str) -> bool:
    weights = _weights(header)
    return weights.get("gzip", weights.get("*", 0.0)) > 0


def prefers_html(header: str) -> bool:
    """Tell whether an Accept header would rather have HTML than JSON; JSON where it does not care."""
    weights = _weights(header)
    anything = weights.get("*/*", 0.0)
    html = weights.get("text/html", weights.get("text/*", anything))
    return html > weights.get("application/json", weights.get("application/*", anything))


def _weights(header: str) -> dict[str, float]:
    """Return the alternatives of an Accept or Accept-Encoding header with their weights."""
    weights = {}
    for part in header.split(","):
        value, *parameters = (piece.strip() for piece in part.lower().split(";"))
        weight = 1.0
        for parameter in parameters:
            if parameter.startswith("q="):
                try:
                    weight = float(parameter[2:])
                except ValueError:
                    weight = 0.0
        if value:
            weights[value] = weight
    return weights


def _twin(path: Path, folder: Path, version: str) -> Path | None:
    """Return the compressed twin of a file, made if need be; None where it cannot be, as on a full disk."""
    name = hashlib.sha256(str(path).encode()).hexdigest()[:16]
    twin = folder / f"{name}.{version}"
    if twin.exists():
        return twin
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (
            path.open("rb") as source,
            atomic_write(twin) as sink,
            gzip.GzipFile(filename="", mode="wb", compresslevel=6, fileobj=sink, mtime=0) as packer,
        ):
            shutil.copyfileobj(source, packer, 1024 * 1024)
    except (OSError, OutputError):
        return None
    for other in folder.glob(f"{name}.*.gz"):  # of an older version
        if other != twin:
            with suppress(OSError):
                other.unlink()
    return twin
