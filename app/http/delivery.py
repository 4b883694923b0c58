"""Files over HTTP: strong validators, ranges, and a gzip copy where that pays."""

from __future__ import annotations

import gzip
import hashlib
import os
import shutil
import threading
from contextlib import ExitStack, suppress
from email.utils import formatdate
from pathlib import Path
from typing import Any, BinaryIO

from fastapi import Request
from fastapi.responses import FileResponse, Response
from starlette.datastructures import Headers
from starlette.staticfiles import NotModifiedResponse, StaticFiles
from starlette.types import Message, Receive, Scope, Send

from app.context import Context
from app.http.headers import accepts_gzip
from app.http.problem_types import CHANGED_MEANWHILE, NO_SUCH_RANGE
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
    ".kmz": "application/vnd.google-earth.kmz",
    ".map": "application/json",
    ".mjs": "text/javascript; charset=utf-8",
    ".parquet": "application/vnd.apache.parquet",
    ".pmtiles": "application/vnd.pmtiles",
    ".png": "image/png",
    ".qgs": "application/x-qgis-project",
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

_COMPRESSIBLE = frozenset({".css", ".csv", ".geojson", ".html", ".js", ".json", ".kml", ".map", ".mjs", ".svg"})
_MIN_BYTES = 1400  # what fits into one packet does not travel faster when it is smaller
_LEVEL_AT_ONCE = 1  # of gzip: the client waits for it
_GZIP_MARK = '-gzip"'  # end of the ETag of what is compressed: another representation has another tag
_MAX_BYTES_AT_ONCE = 4 * 1024 * 1024  # read where the answer is made, without further trips to the thread pool

_PACKING = threading.BoundedSemaphore(2)  # copies made at once: what takes a second for a large file
_STATIC_FILES = StaticFiles(check_dir=False)


class WholeFile(FileResponse):
    """An open file, or ranges of it: what is sent is the one that was opened, whatever gets its name meanwhile.

    Parameters
    ----------
    file
        Open for reading. It may be closed: the answer has a descriptor of its own.
    options
        Of `FileResponse`.
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
                raise _BadRangeError(message["status"])
            await send(message)

        try:
            await super().__call__(scope, receive, send_unless_refused)
        except _BadRangeError as error:
            if error.status == 416:
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


class _BadRangeError(Exception):
    """FileResponse was about to refuse the range."""

    def __init__(self, status: int) -> None:
        super().__init__()
        self.status = status


def media_type_of(path: Path) -> str:
    """Return the media type of a file by its name."""
    return MEDIA_TYPES.get(path.suffix.lower(), "application/octet-stream")


def deliver(
    request: Request,
    path: Path,
    *,
    gzip_copies: Path | None = None,
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
        The file. It is never changed in place, so its time and size stand for its bytes; it is opened once.
    gzip_copies
        Folder of the gzip copies, which are made when first asked for; None: no compression.
    name
        File name offered to whoever saves it.
    download
        Save it rather than show it.
    vary
        Another request header that the choice of the file depends on.
    policy
        Content-Security-Policy of HTML and SVG; None: that of the service.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    """
    with ExitStack() as opened:
        file: BinaryIO = opened.enter_context(path.open("rb"))
        stat = os.fstat(file.fileno())
        media_type = media_type_of(path)
        etag = f"{stat.st_mtime_ns:x}-{stat.st_size:x}"
        headers = {"cache-control": cache_control, "last-modified": formatdate(stat.st_mtime, usegmt=True)}
        if gzip_copies is not None and path.suffix.lower() in _COMPRESSIBLE and stat.st_size >= _MIN_BYTES:
            vary = f"{vary}, Accept-Encoding" if vary else "Accept-Encoding"
            if "range" not in request.headers and accepts_gzip(request.headers):
                copy = _gzip_copy(file, path, gzip_copies, f"{stat.st_mtime_ns:x}.gz")
                if copy is not None:
                    file = opened.enter_context(copy)
                    etag = f"{etag}{_GZIP_MARK[:-1]}"
                    headers["content-encoding"] = "gzip"
        headers["etag"] = f'"{etag}"'
        if vary:
            headers["vary"] = vary
        if policy is not None and media_type.startswith(("text/html", "image/svg")):
            headers["content-security-policy"] = policy
        known = not_modified(request, headers)
        if known is not None:
            return known
        if name is not None:
            headers["content-disposition"] = f'{"attachment" if download else "inline"}; filename="{name}"'
        if "range" in request.headers or os.fstat(file.fileno()).st_size > _MAX_BYTES_AT_ONCE:
            return WholeFile(file, headers=headers, media_type=media_type)
        headers["accept-ranges"] = "bytes"
        return Response(file.read(), headers=headers, media_type=media_type)


def answer_tagged(request: Request, content: bytes, media_type: str = "application/json", **headers: str) -> Response:
    """Answer a GET or HEAD with what was made for it, and its ETag: 200, or 304 where the client has the same.

    It is compressed where that pays and the client takes gzip.
    """
    headers = {"etag": tag_of(content), "cache-control": REVALIDATE, **headers}
    is_packed = False
    if len(content) >= _MIN_BYTES:
        headers["vary"] = f"{headers['vary']}, Accept-Encoding" if "vary" in headers else "Accept-Encoding"
        is_packed = accepts_gzip(request.headers)
    if is_packed:
        headers |= {"etag": f"{headers['etag'][:-1]}{_GZIP_MARK}", "content-encoding": "gzip"}
    known = not_modified(request, headers)
    if known is not None:
        return known
    if is_packed:
        content = gzip.compress(content, _LEVEL_AT_ONCE, mtime=0)
    return Response(content, headers=headers, media_type=media_type)


def service_address(request: Request) -> str:
    """Return the address of the service as its client sees it, without a slash at its end."""
    context: Context = request.app.state.context
    return context.settings.public_url or str(request.base_url).rstrip("/")


def tag_of(content: bytes) -> str:
    """Return the ETag of an answer."""
    return f'"{hashlib.sha256(content).hexdigest()[:24]}"'


def require_unchanged(if_match: str | None, content: bytes) -> None:
    """Refuse (412) a change of what is no longer the version that the client has seen.

    Parameters
    ----------
    if_match
        Header If-Match: ETags, or ``*`` for any version; None: the client does not mind.
    content
        What GET would answer now, compressed or not.
    """
    given = {tag.strip().replace(_GZIP_MARK, '"') for tag in (if_match or "").split(",")}
    if if_match is None or given & {"*", tag_of(content)}:
        return
    raise Problem(
        CHANGED_MEANWHILE,
        f"If-Match: {if_match[:80]} is not its current version, which is {tag_of(content)}. Get it again, and send the "
        "change with that ETag if it is still wanted.",
    )


def not_modified(request: Request, headers: dict[str, str]) -> Response | None:
    """Return the 304 where the client has what these headers describe (If-None-Match, If-Modified-Since)."""
    known = Headers(headers)
    return NotModifiedResponse(known) if _STATIC_FILES.is_not_modified(known, request.headers) else None


def _gzip_copy(file: BinaryIO, path: Path, folder: Path, version: str) -> BinaryIO | None:
    """Return the gzip copy of a file, made if need be; None where it cannot be made, as on a full disk, or not now."""
    name = hashlib.sha256(str(path).encode()).hexdigest()[:16]
    copy = folder / f"{name}.{version}"
    with suppress(FileNotFoundError):
        return copy.open("rb")
    if not _PACKING.acquire(blocking=False):
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (
            atomic_write(copy) as sink,
            gzip.GzipFile(filename="", mode="wb", compresslevel=6, fileobj=sink, mtime=0) as packer,
        ):
            shutil.copyfileobj(file, packer, 1024 * 1024)
    except (OSError, OutputError):
        file.seek(0)
        return None
    finally:
        _PACKING.release()
    for other in folder.glob(f"{name}.*.gz"):  # of an older version
        if other != copy:
            with suppress(OSError):
                other.unlink()
    return copy.open("rb")
