"""Several files in one request: multipart/form-data, read as it comes, each part straight to its own file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header

from app.context import Context
from app.http.intake import Arrival, Intake
from app.http.limits import CLOSE, too_large
from app.http.problems import Problem
from app.paths import check_path

_MAX_HEADER_BYTES = 8192  # of a part
_NUMBERED = r"\d{1,18}\.(bin|label)"

Place = Callable[[str | None], str]
"""From the filename of a part to the path in the drive; raises `Problem` or `BadNameError`."""


def _numbered(folder: str, suffix: str) -> Place:
    def place(filename: str | None) -> str:
        match = re.fullmatch(_NUMBERED, filename or "", re.ASCII)
        if match is None or match[1] != suffix:
            raise bad_part(f"filename {filename!r}; expected the number of the scan, as 000000.{suffix}.")
        return f"{folder}/{filename}"

    return place


def _relative(filename: str | None) -> str:
    if not filename:
        raise bad_part("a part `files` has no filename; expected its path in the drive.")
    return check_path(filename)


def _named(path: str) -> Place:
    return lambda _filename: path


FIELDS: dict[str, Place] = {
    "scans": _numbered("velodyne", "bin"),
    "labels": _numbered("labels", "label"),
    "predictions": _numbered("predictions", "label"),
    "poses": _named("poses.txt"),
    "calib": _named("calib.txt"),
    "times": _named("times.txt"),
    "geo": _named("geo.csv"),
    "files": _relative,
}
"""The parts of a batch of scans."""


def bad_part(what: str) -> Problem:
    """Say what is wrong with a part."""
    return Problem(422, "Bad part", f"{what} Nothing of this request was kept.", headers=CLOSE)


def boundary_of(content_type: str | None) -> bytes:
    """Return what separates the parts.

    Raises
    ------
    Problem
        415: it is no multipart/form-data.
    """
    kind, options = parse_options_header(content_type or "")
    if kind != b"multipart/form-data" or not options.get(b"boundary"):
        raise Problem(
            415,
            "Not multipart/form-data",
            f"Content-Type {content_type or '(none)'!r}. Expected multipart/form-data with its boundary.",
            headers=CLOSE,
        )
    return options[b"boundary"]


class BatchReader:
    """Takes a body in pieces and writes its parts to files.

    Parameters
    ----------
    context
    boundary
    fields
        Names of the parts that are taken, and where each goes.
    max_bytes, max_files, max_file_bytes
        Limits.
    """

    def __init__(
        self,
        context: Context,
        boundary: bytes,
        fields: Mapping[str, Place],
        *,
        max_bytes: int,
        max_files: int,
        max_file_bytes: int,
    ) -> None:
        self._context = context
        self._fields = fields
        self._max_bytes, self._max_files, self._max_file_bytes = max_bytes, max_files, max_file_bytes
        self._size = 0
        self._headers: dict[str, bytes] = {}
        self._header = (b"", b"")
        self._intakes: list[Intake] = []
        self._arrivals: list[Arrival] = []
        self._ended = False
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin_part,
                "on_part_data": self._take_data,
                "on_part_end": self._end_part,
                "on_header_field": self._take_header_name,
                "on_header_value": self._take_header_value,
                "on_header_end": self._end_header,
                "on_headers_finished": self._open_part,
                "on_end": self._end,
            },
        )

    def take(self, data: bytes) -> None:
        """Take the next bytes of the body.

        Raises
        ------
        Problem
            400: it is malformed. 413: too large, or too many files. 422: a part that is not taken.
        """
        self._size += len(data)
        if self._size > self._max_bytes:
            raise too_large("A request with several files", self._max_bytes)
        try:
            self._parser.write(data)
        except MultipartParseError as error:
            raise _malformed(str(error)) from error

    def finish(self) -> list[Arrival]:
        """Return the files, all on disk.

        Raises
        ------
        Problem
            400: the body ended too soon. 422: there is no part in it.
        """
        if not self._ended:
            raise _malformed("it ends before its last boundary")
        if not self._arrivals:
            raise bad_part("The request has no parts.")
        return self._arrivals

    def discard(self) -> None:
        """Remove the files that got no place."""
        for intake in self._intakes:
            intake.discard()

    def _begin_part(self) -> None:
        if len(self._intakes) >= self._max_files:
            raise Problem(
                413,
                "Too many files",
                f"One request may have {self._max_files:,} files at most. Send several. Nothing of this one was kept.",
                headers=CLOSE,
            )
        self._headers = {}
        self._header = (b"", b"")

    def _take_header_name(self, data: bytes, start: int, end: int) -> None:
        self._header = (self._header[0] + data[start:end], b"")
        self._check_header()

    def _take_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header = (self._header[0], self._header[1] + data[start:end])
        self._check_header()

    def _check_header(self) -> None:
        if sum(map(len, self._header)) > _MAX_HEADER_BYTES or len(self._headers) > 16:
            raise _malformed("the headers of a part are too long")

    def _end_header(self) -> None:
        name, value = self._header
        self._headers[name.decode("latin-1").lower()] = value
        self._header = (b"", b"")

    def _open_part(self) -> None:
        kind, options = parse_options_header(self._headers.get("content-disposition", b""))
        if kind != b"form-data" or b"name" not in options:
            raise _malformed("a part has no Content-Disposition: form-data with a name")
        if self._headers.get("content-transfer-encoding", b"binary").strip().lower() not in {
            b"binary",
            b"8bit",
            b"7bit",
        }:
            raise bad_part("A part has a Content-Transfer-Encoding; expected its bytes as they are.")
        field, filename = _text(options[b"name"]), options.get(b"filename")
        place = self._fields.get(field)
        if place is None:
            raise bad_part(f"There is no part {field[:80]!r}; expected {', '.join(self._fields)}.")
        path = place(None if filename is None else _text(filename))
        if any(arrival.path == path for arrival in self._arrivals):
            raise bad_part(f"{path} comes twice.")
        self._intakes.append(Intake(self._context, path, self._max_file_bytes))

    def _take_data(self, data: bytes, start: int, end: int) -> None:
        self._intakes[-1].write(memoryview(data)[start:end])

    def _end_part(self) -> None:
        self._arrivals.append(self._intakes[-1].finish())

    def _end(self) -> None:
        self._ended = True


def _text(value: bytes) -> str:
    try:
        return value.decode()
    except UnicodeDecodeError:
        raise bad_part(f"{value[:80]!r} is not UTF-8.") from None


def _malformed(what: str) -> Problem:
    return Problem(400, "Body malformed", f"multipart/form-data: {what}. Nothing of it was kept.", headers=CLOSE)
