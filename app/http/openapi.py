"""The OpenAPI document: what FastAPI cannot generate of it."""

from __future__ import annotations

from collections.abc import Callable
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

_UNAUTHORIZED = {
    "description": "The service needs a valid API token.",
    "headers": {
        "WWW-Authenticate": {"description": "How to authenticate.", "schema": {"type": "string"}},
    },
}
_ANY = {
    "description": "Any other problem, such as a request too large (413), too slow (408) or from another site (403)."
}


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
    """Makes the OpenAPI document of an application, once."""

    def __init__(self, app: FastAPI) -> None:
        self._generate = app.openapi
        self._document: dict[str, Any] | None = None

    def __call__(self) -> dict[str, Any]:
        """Return the document."""
        if self._document is None:
            self._document = self._complete(self._generate())
        return self._document

    def _complete(self, document: dict[str, Any]) -> dict[str, Any]:
        schemas = document["components"]["schemas"]
        schemas.setdefault(
            "ProblemDocument", ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
        )
        for operations in document["paths"].values():
            for operation in operations.values():
                responses = operation["responses"]
                if "parameters" not in operation and "requestBody" not in operation:
                    responses.pop("422", None)
                if operation.get("security"):
                    responses.setdefault("401", _problem(_UNAUTHORIZED))
                responses.setdefault("default", _problem(_ANY))
                for response in responses.values():
                    _correct_media_type(response)
                operation["responses"] = dict(sorted(responses.items()))
        return document


def _problem(response: dict[str, Any]) -> dict[str, Any]:
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    return {**response, "content": {MEDIA_TYPE: {"schema": schema}}}


def _correct_media_type(response: dict[str, Any]) -> None:
    """Give problem documents their own media type: FastAPI describes every model in that of the endpoint."""
    content = response.get("content", {})
    for media_type, described in list(content.items()):
        if described.get("schema", {}).get("$ref", "").endswith("/ProblemDocument"):
            content[MEDIA_TYPE] = content.pop(media_type)
