"""The OpenAPI document: what FastAPI cannot generate of it."""

import re
from collections.abc import Callable
from copy import deepcopy
from typing import Any

from app.http.problems import ProblemDocument
from interloc.arrays import JsonObject

Responses = dict[int | str, JsonObject]
"""Answers of an endpoint by their status, as FastAPI takes them."""

UNLISTED = re.compile(
    r".*/ogc/.+|/api/v1/.*/ogc"
    r"|/api/v1/(demo|compare|drives/\{drive_id\}/trajectory)"
    r"|/api/v1/maps/\{map_id\}/(drives(/\{drive_id\})?|queue/\{finding\}/picture\.png)"
    r"|/api/v1/jobs/\{job_id\}/(keyframes/.+|road|road\.png|view)"
)
"""Addresses that the description leaves out: what only the page calls, or what describes itself."""


DESCRIPTION = """
A *drive* is uploaded file by file, checked and reduced by its *commit*; a *job* finds the intersections in it, and
scores them against OpenStreetMap where a map is given; its *results* are GeoJSON, reports, pictures and exports.

```sh
curl -X POST $API/drives -H 'Content-Type: application/json' -d '{"name": "07"}'        # -> id of the drive
curl -T velodyne/000000.bin $API/drives/$DRIVE/files/velodyne/000000.bin                # ... and so on, in any order
curl -X POST $API/drives/$DRIVE/commit                                                  # -> what is in it or is wrong
curl -X POST $API/jobs -H 'Content-Type: application/json' -d '{"drive_id": "'$DRIVE'"}'  # -> id of the job
curl -N $API/jobs/$JOB/events                                                           # its progress as it happens
curl $API/jobs/$JOB/layers/intersections                                                # the map, as GeoJSON
```

`interloc push DRIVE --server URL --run -o OUT` does all of that, and sends only what the method needs.

Lists come in pages: give `next` of one as `after` of the following. Lists, drives, jobs, results have an `ETag`: ask
again with `If-None-Match`, and the answer is 304 while nothing has changed. A query parameter that an address lacks
is refused. Times are RFC 3339, lengths metres, angles degrees
clockwise from north. Every answer carries an `X-Request-ID`, by which its line in the log is found.

Every error is a problem document (RFC 9457) whose `detail` says what was found, what was expected and what to do. Its
`type` tells programs what has happened, and is the same in every version (`ProblemDocument` lists them).
"""

TAGS = [
    {"name": "Drives", "description": "Recorded drives, from the first file to a drive that jobs can use."},
    {"name": "Uploads", "description": "Files of a drive: one by one, in batches, as an archive; check and reduction."},
    {"name": "Jobs", "description": "Work on drives: submit, follow, cancel. Jobs survive restarts of the service."},
    {
        "name": "Live",
        "description": "Intersections while driving. A sender opens the WebSocket `/api/v1/live` (token as everywhere) "
        'and begins with the text `{"type": "begin", "name": "07", "preset"?, "config"?}`, or after a '
        'broken connection with `{"type": "continue", "session": ID}`; it is told `{"type": "session", "id", '
        '"last_frame"}`. It sends each scan as one binary message: `ILS1`, the length of a head as uint32, the head as '
        "JSON (`frame`, `pose`, `points`, `road_count`, ...), points as float32, those of road first; all "
        "little-endian. Each scan is answered by a text: JSON whose `type` is `scan`, `dropped` or `refused`. The text "
        '`{"type": "end"}` ends the session. docs/live.md has every field. Others watch `/live/{session}/events`.',
    },
    {"name": "Results", "description": "What a successful job found; the same bytes as the command line writes."},
    {"name": "Exports", "description": "Results in formats of GIS programs."},
    {"name": "GIS", "description": "OGC API - Features: results as layers of a GIS, by place, time and CQL2 filters."},
    {"name": "Maps", "description": "Many drives as one map, and the queue of what OpenStreetMap has wrong by it."},
    {"name": "Trash", "description": "Deleted drives: restore them, or delete them for good."},
]

CHANGES_NOTHING = {"x-changes-nothing": True}
"""``openapi_extra`` of an operation that only answers though its method is POST: a token that may only read will do."""

SAFE = {"GET", "HEAD", "OPTIONS"}
"""Methods that change nothing."""

BINARY = {"type": "string", "format": "binary"}
"""Schema of bytes."""


def body_of(content: dict[str, JsonObject]) -> JsonObject:
    """Describe a body that must be there by the schemas of its media types, for `openapi_extra` of an operation."""
    described = {media_type: {"schema": schema} for media_type, schema in content.items()}
    return {"requestBody": {"required": True, "content": described}}


PROBLEMS: Responses = {
    "4XX": {
        "model": ProblemDocument,
        "description": "The request is refused, or what it asks for is not there; `detail` says why, and what to do.",
    },
    "5XX": {
        "model": ProblemDocument,
        "description": "A fault of the service; or it cannot work now: it is busy, being stopped, or its disk is full.",
    },
}
"""What every operation may answer, for `responses` of the router of all."""


def changes_something(method: str, extra: JsonObject | None) -> bool:
    """Return whether an operation changes something, by its method and its ``openapi_extra``."""
    return method.upper() not in SAFE and not (extra or {}).get("x-changes-nothing", False)


_documents: dict[bool, JsonObject] = {}


def described(generate: Callable[[], JsonObject], needs_token: Callable[[], bool]) -> Callable[[], JsonObject]:
    """Return what makes the OpenAPI document of an application, once with tokens and once without.

    All applications of a process have the same: their routes are the same, see `app.main`.
    """

    def document() -> JsonObject:
        needed = needs_token()
        if needed not in _documents:
            _documents[needed] = _complete(deepcopy(generate()), needs_token=needed)
        return _documents[needed]

    return document


def _complete(document: JsonObject, *, needs_token: bool) -> JsonObject:
    schemas = document["components"]["schemas"]
    for schema in schemas.values():
        _suit_generators(schema)
    for operations in document["paths"].values():
        for operation in operations.values():
            for response in operation["responses"].values():
                _correct_media_type(response, schemas)
                _offer_bytes(response)
            _leave_out_null_body(operation)
            if operation.get("security") and not needs_token:
                operation["security"] = [{}, *operation["security"]]
    used = _schemas_of(document["paths"], schemas, set())
    document["components"]["schemas"] = {name: schema for name, schema in schemas.items() if name in used}
    return document


def _schemas_of(part: Any, schemas: JsonObject, found: set[str]) -> set[str]:  # noqa: ANN401 - JSON
    """Return the names of the schemas that a part of the document needs, with those found before."""
    if isinstance(part, dict):
        name = str(part.get("$ref", "")).rpartition("/")[2]
        if name in schemas and name not in found:
            found.add(name)
            _schemas_of(schemas[name], schemas, found)
    for each in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        _schemas_of(each, schemas, found)
    return found


def _correct_media_type(response: JsonObject, schemas: JsonObject) -> None:
    """Give a model its own media type, where it has one: FastAPI describes every model in that of the endpoint."""
    content = response.get("content", {})
    for each in content.values():
        each.pop("itemSchema", None)  # of a stream of events: OpenAPI 3.2 has it, 3.1 does not
    for media_type, described in list(content.items()):
        name = described.get("schema", {}).get("$ref", "").rpartition("/")[2]
        own = schemas.get(name, {}).get("x-media-type")
        if own is not None:
            content[own] = content.pop(media_type)


def _offer_bytes(response: JsonObject) -> None:
    """Describe files also as plain bytes: client generators leave out an answer of which they know no media type."""
    content = response.get("content", {})
    if content and not any(each.endswith("json") or each.startswith("text/") for each in content):
        content.setdefault("application/octet-stream", {"schema": {"type": "string", "format": "binary"}})


def _leave_out_null_body(operation: JsonObject) -> None:
    """Describe a body that may be left out by its model alone: generated clients would send null for none."""
    for content in operation.get("requestBody", {}).get("content", {}).values():
        alternatives = content["schema"].get("anyOf", [])
        if {"type": "null"} in alternatives and len(alternatives) == 2:
            content["schema"] = next(each for each in alternatives if each != {"type": "null"})


def _suit_generators(schema: JsonObject) -> None:
    """Leave out what client generators cannot write down: defaults that are objects, numbers that are constants."""
    for described in schema.get("properties", {}).values():
        if isinstance(described.get("default"), dict):
            del described["default"]
        if type(described.get("const")) is int:
            del described["const"]
