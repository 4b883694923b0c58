"""Problem documents (RFC 9457): the answers to requests that are not fulfilled."""

import errno
import logging
from asyncio import CancelledError
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.encoders import jsonable_encoder
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import DataError, OperationalError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match

from app.http import problem_types as kinds
from app.http.fields import EXPECTED
from app.http.problem_types import TYPES, UNTYPED, ProblemType
from app.paths import BadNameError
from app.store.database import is_disk_full, is_read_only
from app.store.storage import DataFolderGoneError
from app.work.task import DriveGoneError
from interloc.arrays import JsonObject
from interloc.drives.findings import Finding
from interloc.errors import ConfigError, DriveError, InterLocError, ModelError

MEDIA_TYPE = "application/problem+json"

OUT_OF_SPACE = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Of errors of the system: what was written does not fit, by the disk or by a quota."""
_FAILING = frozenset({errno.EROFS, errno.EIO, errno.EACCES, errno.EPERM})

_log = logging.getLogger(__name__)


class ProblemDocument(BaseModel):
    """An error: what happened, and what to do."""

    model_config = ConfigDict(
        extra="allow",
        json_schema_extra={
            "x-media-type": MEDIA_TYPE,
            "examples": [
                {
                    "type": "/problems/drive-not-found",
                    "title": "Drive not found",
                    "status": 404,
                    "detail": "There is no drive 5f0c. GET /api/v1/drives lists them.",
                    "instance": "/api/v1/drives/5f0c",
                }
            ],
        },
    )

    type: str = Field(
        UNTYPED,
        description="Kind of the problem, the same in all versions: about:blank where the HTTP status says all, else "
        f"/problems/ and one of {', '.join(TYPES)}.",
        json_schema_extra={"format": "uri-reference"},
        examples=["/problems/drive-not-found"],
    )
    title: str = Field(examples=["Drive not found"])
    status: int = Field(examples=[404])
    detail: str = Field(examples=["There is no drive 5f0c. GET /api/v1/drives lists them."])
    instance: str | None = Field(None, examples=["/api/v1/drives/5f0c"])
    problems: list[Finding] | None = None


class Problem(Exception):  # noqa: N818 - the name of RFC 9457
    """Raised anywhere in the service to answer with a problem document.

    The detail says what was found, what was expected and what to do; `more` are further members, for example
    ``problems``.
    """

    def __init__(
        self,
        kind: ProblemType,
        detail: str,
        *,
        status: int | None = None,
        headers: dict[str, str] | None = None,
        **more: Any,  # noqa: ANN401 - whatever JSON can hold
    ) -> None:
        super().__init__(detail)
        self.kind = kind
        self.detail = detail
        self.status = kind.status if status is None else status
        self.headers = headers
        self.more = more

    def document(self) -> JsonObject:
        """Return the document, without its instance."""
        return {
            "type": self.kind.type,
            "title": self.kind.title,
            "status": self.status,
            "detail": self.detail,
            **jsonable_encoder(self.more),
        }


_OF_LIBRARY: dict[type[InterLocError], ProblemType] = {
    BadNameError: kinds.BAD_FILE_NAME,
    ConfigError: kinds.BAD_SETTING,
    DriveError: kinds.DRIVE_NOT_USABLE,
    DriveGoneError: kinds.DRIVE_NOT_WHOLE,
    ModelError: kinds.MODEL_NOT_USABLE,
}


def from_error(error: InterLocError) -> Problem:
    """Turn an error of the library into a problem."""
    return Problem(_OF_LIBRARY.get(type(error), kinds.NOT_POSSIBLE), str(error), status=error.http_status)


def disk_full(headers: dict[str, str] | None = None) -> Problem:
    """Return the problem that the disk of the service is full."""
    return Problem(
        kinds.DISK_FULL,
        "The service has no disk space left. Nothing of this request was kept; empty the trash (DELETE /api/v1/trash), "
        "delete drives that are no longer needed for good (DELETE /api/v1/drives/{id}?purge=true) or ask its operator, "
        "who has to make room where not even that can be written; then send it again.",
        headers=headers,
    )


def stored(document: JsonObject) -> Problem:
    """Make a problem again from its document; what the first versions stored has no type, so its title tells it."""
    members = {name: value for name, value in document.items() if name not in {"type", "instance"}}
    status, title, detail = (members.pop(name) for name in ("status", "title", "detail"))
    kind = next((kind for kind in TYPES.values() if kind.title == title), ProblemType("", status, title))
    return Problem(kind, detail, status=status, **members)


def add_handlers(app: FastAPI) -> None:
    """Answer every error with a problem document; what is not in the table is answered by the outermost middleware."""
    for error in _TO_PROBLEM:
        app.add_exception_handler(error, _handle)


def problem_of(error: Exception | CancelledError) -> Problem:
    """Turn any error into a problem; it is logged where it is a fault of the service."""
    if isinstance(error, CancelledError):  # the server stops, and did not wait any longer
        detail = "The service stops before this request is done. Send it again when the service runs again."
        return Problem(kinds.BUSY, detail, headers={"Retry-After": "5"})
    for kind in type(error).__mro__:
        if kind in _TO_PROBLEM:
            return _TO_PROBLEM[kind](error)
    return _of_fault(error)


def respond(problem: Problem, path: str) -> JSONResponse:
    """Return the answer to a request of this path."""
    document = {**problem.document(), "instance": path}
    return JSONResponse(document, problem.status, headers=problem.headers, media_type=MEDIA_TYPE)


async def _handle(request: Request, error: Exception) -> JSONResponse:
    if isinstance(error, RequestValidationError) and isinstance(error.body, bytes):  # it was not read as JSON
        found = request.headers.get("content-type")
        given = "The body has no Content-Type" if found is None else f"The Content-Type of the body is {found[:80]}"
        usual = "Usual cause: `curl -d`; `curl --json` sends JSON."
        error = Problem(kinds.NOT_JSON, f"{given}; expected application/json. {usual}")
    problem = problem_of(error)
    if problem.status == HTTPStatus.METHOD_NOT_ALLOWED:
        # The framework names those of its first operation.
        routes = (each for each in request.app.routes if each.matches(request.scope)[0] == Match.PARTIAL)
        problem.headers = {"Allow": ", ".join(sorted({method for route in routes for method in route.methods}))}
    if "GIS" in getattr(request.scope.get("route"), "tags", ()) and problem.status == 422:
        problem.status = HTTPStatus.BAD_REQUEST  # as OGC API - Features wants it
    return respond(problem, request.url.path)


_DETAILS_OF_FRAMEWORK = {
    "Not Found": "There is nothing at this address. GET /docs shows what there is.",
    "Method Not Allowed": "This address takes other methods; GET /docs shows which.",
    "There was an error parsing the body": "The body is not JSON in UTF-8, is compressed, or is nested too deep.",
}


def _of_http_error(error: HTTPException) -> Problem:
    headers = dict(error.headers) if error.headers else None
    detail = _DETAILS_OF_FRAMEWORK.get(str(error.detail), str(error.detail))
    status = HTTPStatus(error.status_code)
    kind = kinds.BODY_REFUSED if status in {408, 413} else ProblemType("", status, status.phrase)
    return Problem(kind, detail, status=status, headers=headers)


def _of_validation_error(error: RequestValidationError) -> Problem:
    broken = next((each for each in error.errors() if each["type"] == "json_invalid"), None)
    if broken is not None:
        where, why = broken["loc"][-1], broken.get("ctx", {}).get("error", "")
        return Problem(kinds.BODY_MALFORMED, f"The body is not JSON: {why}, at character {where}.")
    by_field: dict[str, list[str]] = {}
    for each in error.errors():
        place = each["loc"] if each["loc"][0] == "body" else each["loc"][:2]  # behind it each type of a union
        by_field.setdefault(".".join(map(str, place)), []).append(_in_words(each))
    problems = [Finding("error", path, "; or: ".join(messages)) for path, messages in by_field.items()]
    detail = f"{problems[0].path}: {problems[0].message}."
    if len(problems) > 1:
        detail += f" And {len(problems) - 1} more."
    return Problem(kinds.REQUEST_NOT_VALID, detail, problems=problems)


def _in_words(error: JsonObject) -> str:
    """Return what is wrong with a value: pydantic's own words tell of patterns and of classes of Python."""
    if error["type"] in {"model_type", "model_attributes_type", "dict_type"}:
        expected = "an object, in braces"
    elif error["type"] == "string_pattern_mismatch":
        pattern = error["ctx"]["pattern"]
        expected = EXPECTED.get(pattern, f"text of the form {pattern}")
    else:
        return str(error["msg"]).removeprefix("Value error, ").removesuffix(".")
    found = repr(error["input"])
    return f"found {found if len(found) <= 60 else f'{found[:60]}…'}; expected {expected}"


def _of_os_error(error: OSError) -> Problem:
    if error.errno in OUT_OF_SPACE:
        return disk_full()
    return _read_only(error) if error.errno in _FAILING else _of_fault(error)


def _read_only(error: Exception) -> Problem:
    _log.error("the disk of the service: %s", error)
    return Problem(
        kinds.STORAGE_READ_ONLY,
        "The disk of the service fails, or may not be written. Nothing of this request was kept; its operator has to "
        "look after the disk, then send it again.",
        headers={"Retry-After": "30"},
    )


def _of_database_error(error: SQLAlchemyError) -> Problem:
    if is_disk_full(error):
        return disk_full()
    if is_read_only(error):
        return _read_only(error)
    _log.warning("database: %s", error)
    detail = "The database did not answer in time. Send the request again in a moment."
    return Problem(kinds.DATABASE_BUSY, detail, headers={"Retry-After": "5"})


def _of_gone_folder(error: DataFolderGoneError) -> Problem:
    _log.error("%s", error)
    return Problem(kinds.DATA_FOLDER_GONE, f"Nothing was changed: {error}", headers={"Retry-After": "5"})


def _of_data_error(error: DataError) -> Problem:
    if "NUL" not in str(error.orig):
        return _of_fault(error)
    return Problem(kinds.REQUEST_NOT_VALID, "An id or a name holds a zero character. Expected text without it.")


def _of_fault(error: Exception) -> Problem:
    _log.error("a fault of the service itself", exc_info=error)
    return Problem(
        kinds.FAULT_OF_THE_SERVICE, "A fault of the service itself; its log has the details. Please report it."
    )


_TO_PROBLEM: dict[type[Exception], Callable[[Any], Problem]] = {
    Problem: lambda error: error,
    InterLocError: from_error,
    HTTPException: _of_http_error,
    RequestValidationError: _of_validation_error,
    OSError: _of_os_error,
    ClientDisconnect: lambda _: Problem(
        kinds.UPLOAD_BROKEN_OFF, "The client closed the connection before the body was complete. Nothing was kept."
    ),
    DataFolderGoneError: _of_gone_folder,
    DataError: _of_data_error,
    OperationalError: _of_database_error,
    PoolTimeout: _of_database_error,
}
