"""The OpenAPI document: what FastAPI cannot generate of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any, TypeVar

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute

from app.http.problems import MEDIA_TYPE, ProblemDocument

Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])

DESCRIPTION = """
A *drive* is uploaded file by file, checked and reduced by its *commit*; a *job* finds the intersections in it, and
scores them against OpenStreetMap where a map is given; its *results* are GeoJSON, reports, pictures and exports.

```sh
curl -X POST $API/drives -H 'Content-Type: application/json' -d '{"name": "07"}'        # -> id of the drive
curl -T velodyne/000000.bin $API/drives/$DRIVE/files/velodyne/000000.bin                # ... and so on, in any order
curl -X POST $API/drives/$DRIVE/commit                                                  # -> what is in it or is wrong
curl -X POST $API/jobs -H 'Content-Type: application/json' -d '{"drive_id": "'$DRIVE'"}'  # -> id of the job
curl -N $API/jobs/$JOB/events                                                           # its progress as it happens
curl $API/jobs/$JOB/intersections                                                       # the map, as GeoJSON
```

`interloc push DRIVE --server URL --run -o OUT` does all of that, and sends only what the method needs.

Every error is a problem document (RFC 9457) whose `detail` says what was found, what was expected and what to do.
Lists come in pages: give `next` of one as `after` of the following. Times are RFC 3339, lengths metres, angles
degrees clockwise from north. Every answer carries an `X-Request-ID`, by which its line in the log is found.
"""

TAGS = [
    {"name": "Drives", "description": "Recorded drives, from the first file to a drive that jobs can use."},
    {"name": "Uploads", "description": "Files of a drive: one by one, in batches, as an archive; check and reduction."},
    {"name": "Jobs", "description": "Work on drives: submit, follow, cancel. Jobs survive restarts of the service."},
    {"name": "Results", "description": "What a successful job found; the same bytes as the command line writes."},
    {"name": "Exports", "description": "Results in formats of GIS programs."},
    {"name": "Trash", "description": "Deleted drives and jobs: restore them, or delete them for good."},
    {"name": "System", "description": "For operators and for the page."},
]

CHANGES_NOTHING = {"x-changes-nothing": True}
"""``openapi_extra`` of an operation that only answers though its method is POST: a token that may only read will do."""

_SAFE = {"GET", "HEAD", "OPTIONS"}
_CLOSED = "The service needs a valid API token."
_CHALLENGE = {"WWW-Authenticate": {"description": "How to authenticate.", "schema": {"type": "string"}}}
_WAIT = {"Retry-After": {"description": "Seconds to wait.", "schema": {"type": "integer"}}}


def changes_something(method: str, extra: dict[str, Any] | None) -> bool:
    """Return whether an operation changes something, by its method and its ``openapi_extra``."""
    return method.upper() not in _SAFE and not (extra or {}).get("x-changes-nothing", False)


def operation_id(route: APIRoute) -> str:
    """Name an operation like its function: good names in generated clients."""
    return route.name


def get_and_head(
    router: APIRouter,
    path: str,
    **options: Any,  # noqa: ANN401 - FastAPI's
) -> Callable[[Endpoint], Endpoint]:
    """Register an address for GET, and for HEAD without a second entry in the OpenAPI."""

    def register(endpoint: Endpoint) -> Endpoint:
        router.add_api_route(path, endpoint, methods=["GET"], **options)
        router.add_api_route(path, endpoint, methods=["HEAD"], **{**options, "include_in_schema": False})
        return endpoint

    return register


class Description:
    """Makes the OpenAPI document of an application, once for a service with tokens and once for one without."""

    def __init__(self, app: FastAPI, needs_token: Callable[[], bool]) -> None:
        self._generate = app.openapi
        self._needs_token = needs_token
        self._documents: dict[bool, dict[str, Any]] = {}

    def __call__(self) -> dict[str, Any]:
        """Return the document."""
        needed = self._needs_token()
        if needed not in self._documents:
            self._documents[needed] = _complete(deepcopy(self._generate()), needs_token=needed)
        return self._documents[needed]


def _complete(document: dict[str, Any], *, needs_token: bool) -> dict[str, Any]:
    schemas = document["components"]["schemas"]
    schemas.setdefault(
        "ProblemDocument", ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
    )
    for operations in document["paths"].values():
        for method, operation in operations.items():
            responses = operation["responses"]
            if "parameters" not in operation and "requestBody" not in operation:
                responses.pop("422", None)
            for status, response in _common(method, operation):
                responses.setdefault(status, response)
            for response in responses.values():
                _correct_media_type(response)
            operation["responses"] = dict(sorted(responses.items()))
            if operation.get("security") and not needs_token:
                operation["security"] = [{}, *operation["security"]]
    return document


def _common(method: str, operation: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Describe the problems that operations have in common."""
    yield "400", _problem("The request does not keep to HTTP.")
    yield "431", _problem("The headers are too large, or too many.")
    yield "500", _problem("A fault of the service.")
    yield "503", _problem("The service or its database is busy, or is being stopped.", _WAIT)
    yield "421", _problem("The service does not answer under this host name.")
    if operation.get("security"):
        yield "401", _problem(_CLOSED, _CHALLENGE)
        yield "429", _problem("Too many wrong tokens.", _WAIT)
    if method.upper() not in _SAFE:
        yield "403", _problem("The token may only read, or the request came from a page of another site.")
    if changes_something(method, operation):
        yield "507", _problem("The disk of the service is full.")
    if "requestBody" in operation:
        yield "408", _problem("The body did not go on, or came too slowly.")
        yield "413", _problem("The body is too large.")


def _problem(description: str, headers: dict[str, Any] | None = None) -> dict[str, Any]:
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    described = {"description": description, "content": {MEDIA_TYPE: {"schema": schema}}}
    return described if headers is None else {**described, "headers": headers}


def _correct_media_type(response: dict[str, Any]) -> None:
    """Give problem documents their own media type: FastAPI describes every model in that of the endpoint."""
    content = response.get("content", {})
    for media_type, described in list(content.items()):
        if described.get("schema", {}).get("$ref", "").endswith("/ProblemDocument"):
            content[MEDIA_TYPE] = content.pop(media_type)
