"""Several files in one request: multipart/form-data, read as it arrives, each part written straight to its own file."""

from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.datastructures import Headers

from app.context import Context
from app.http.headers import sha256_of
from app.http.intake import Arrival, Intake
from app.http.limits import CLOSE, too_large
from app.http.problem_types import BAD_PART, BODY_MALFORMED, NOT_MULTIPART_FORM_DATA, TOO_MANY_FILES
from app.http.problems import Problem
from app.paths import check_path

_MAX_HEADERS, _MAX_HEADER_BYTES = 16, 8192  # of a part
_PLAIN_ENCODINGS = {b"binary", b"8bit", b"7bit"}


def boundary_of(content_type: str | None) -> bytes:
    """Return what separates the parts; a 415 where the body is not multipart/form-data."""
    kind, options = parse_options_header(content_type or "")
    if kind != b"multipart/form-data" or not options.get(b"boundary"):
        raise Problem(
            NOT_MULTIPART_FORM_DATA,
            f"Content-Type {content_type or '(none)'!r}. Expected multipart/form-data with its boundary.",
            headers=CLOSE,
        )
    return options[b"boundary"]


class BatchReader:
    """Takes a body in pieces and writes its parts to files."""

    def __init__(
        self,
        context: Context,
        boundary: bytes,
    ) -> None:
        self._context, self._limits = context, context.settings
        self._size = 0
        self._headers: dict[bytes, bytes] = {}
        self._name = self._value = b""  # of the header that is being read
        self._sha256: str | None = None  # of the part that is being read, where the client announces it
        self._intakes: list[Intake] = []
        self._arrivals: dict[str, Arrival] = {}
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
            max_header_count=_MAX_HEADERS,
            max_header_size=_MAX_HEADER_BYTES,
        )

    def take(self, data: bytes) -> None:
        """Take the next bytes of the body."""
        self._size += len(data)
        if self._size > self._limits.max_batch_bytes:
            raise too_large("A request with several files", self._limits.max_batch_bytes)
        try:
            self._parser.write(data)
        except MultipartParseError as error:
            raise _malformed(str(error)) from error

    def finish(self) -> list[Arrival]:
        """Return the files, all on disk."""
        if not self._ended:
            raise _malformed("it ends before its last boundary")
        if not self._arrivals:
            raise _bad_part("The request has no parts. Expected one or more files.")
        return list(self._arrivals.values())

    def discard(self) -> None:
        """Remove the files that were not moved to their places."""
        for intake in self._intakes:
            intake.discard()

    def _begin_part(self) -> None:
        most = self._limits.max_batch_files
        if len(self._intakes) >= most:
            raise Problem(
                TOO_MANY_FILES,
                f"One request may have {most:,} files at most. Send several. Nothing of this one was kept.",
                headers=CLOSE,
            )
        self._headers = {}

    def _take_header_name(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]

    def _take_header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _end_header(self) -> None:
        self._headers[self._name.lower()] = self._value
        self._name = self._value = b""

    def _open_part(self) -> None:
        kind, options = parse_options_header(self._headers.get(b"content-disposition"))
        if kind != b"form-data" or b"name" not in options:
            raise _malformed("a part has no Content-Disposition: form-data with a name")
        if self._headers.get(b"content-transfer-encoding", b"binary").strip().lower() not in _PLAIN_ENCODINGS:
            raise _bad_part("A part has a Content-Transfer-Encoding; expected its bytes as they are.")
        field, filename = _text(options[b"name"]), options.get(b"filename")
        if field != "files" or not filename:
            raise _bad_part(f"A part {field[:80]!r}; expected `files`, each with its path in the drive as file name.")
        path = check_path(_text(filename))
        if path in self._arrivals:
            raise _bad_part(f"{path} comes twice.")
        self._sha256 = sha256_of(Headers(raw=list(self._headers.items())))
        self._intakes.append(Intake(self._context, path, self._limits.max_file_bytes))

    def _take_data(self, data: bytes, start: int, end: int) -> None:
        self._intakes[-1].write(memoryview(data)[start:end])

    def _end_part(self) -> None:
        arrival = self._intakes[-1].finish(self._sha256)
        self._arrivals[arrival.path] = arrival

    def _end(self) -> None:
        self._ended = True


def _text(value: bytes) -> str:
    try:
        return value.decode()
    except UnicodeDecodeError:
        raise _bad_part(f"{value[:80]!r} is not UTF-8.") from None


def _bad_part(what: str) -> Problem:
    """Return the problem that a part has."""
    return Problem(BAD_PART, f"{what} Nothing of this request was kept.", headers=CLOSE)


def _malformed(what: str) -> Problem:
    return Problem(BODY_MALFORMED, f"multipart/form-data: {what}. Nothing of it was kept.", headers=CLOSE)
