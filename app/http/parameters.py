"""Query parameters that several addresses share, the refusal of those that an address does not have, pages of lists."""

import re
from collections.abc import Collection, Iterator
from typing import Annotated, Any, Literal, NamedTuple

from fastapi import Depends, Query, Request, Response
from fastapi.dependencies.models import Dependant
from pydantic import BaseModel
from sqlalchemy import ColumnElement, and_, func, or_

from app.http.delivery import answer_tagged
from app.http.fields import BOX, EXPECTED, TEXT
from app.http.problem_types import REQUEST_NOT_VALID, UNKNOWN_PARAMETER, ProblemType
from app.http.problems import Problem
from app.store.models import Drive, Job
from interloc.drives.findings import Finding

NamePart = Annotated[
    str | None,
    Query(max_length=200, pattern=TEXT, description="Only those with this in their name, in upper or lower case."),
]


class Box(NamedTuple):
    """A box of longitudes and latitudes, degrees; west is larger than east where it crosses the 180th meridian."""

    west: float
    south: float
    east: float
    north: float

    @property
    def is_on_earth(self) -> bool:
        """Whether its sides are degrees in their order."""
        return all(abs(lon) <= 180 for lon in (self.west, self.east)) and -90 <= self.south <= self.north <= 90

    @property
    def parts(self) -> list[tuple[float, float, float, float]]:
        """Its boxes among -180 to 540 degrees: what crosses the meridian lies beyond 180."""
        spans = [(self.west, self.east), (self.west + 360.0, self.east + 360.0)]
        if self.west > self.east:
            spans = [(self.west, self.east + 360.0), (-180.0, self.east)]
        return [(west, self.south, east, self.north) for west, east in spans]


async def _box(
    bbox: Annotated[
        str | None,
        Query(
            pattern=BOX,
            description="Only what touches this box: west,south,east,north in degrees (WGS 84); of six numbers heights "
            "are ignored. West is larger than east across the 180th meridian.",
            examples=["8.41,49.00,8.45,49.03"],
        ),
    ] = None,
) -> Box | None:
    if bbox is None:
        return None
    numbers = [float(part) for part in bbox.split(",")]
    half = len(numbers) // 2
    box = Box(*numbers[:2], *numbers[half : half + 2])
    if not box.is_on_earth:
        raise refusal(REQUEST_NOT_VALID, "query.bbox", f"found {bbox!r}; expected {EXPECTED[BOX]}.")
    return box


BoxFilter = Annotated[Box | None, Depends(_box)]


OF_ITS_DATA = {"x-parameters-of-its-data": True}
"""``openapi_extra`` of an operation that has the parameters of its data, too: it calls `refuse_others` itself."""


async def refuse_unknown_parameters(request: Request) -> None:
    """Refuse (400) a query parameter that the address does not have: it would be a filter that does nothing."""
    if not (request.scope["route"].openapi_extra or {}).keys() & OF_ITS_DATA.keys():
        refuse_others(request, ())


def refuse_others(request: Request, names: Collection[str]) -> None:
    """Refuse a query parameter that is neither one of the address nor one of these, as `refuse_unknown_parameters`."""
    if not request.query_params:
        return
    known = sorted({*_names(request.scope["route"].dependant), *names})
    for name in request.query_params:
        if name not in known:
            expected = f"Expected one of {', '.join(known)}" if known else "Expected none"
            raise refusal(UNKNOWN_PARAMETER, f"query.{name[:80]}", f"There is no such parameter. {expected}.")
        if name not in names and len(request.query_params.getlist(name)) > 1:
            raise refusal(UNKNOWN_PARAMETER, f"query.{name}", "It comes twice, and one value counts.")


def _names(dependant: Dependant) -> Iterator[str]:
    """Yield the names of the query parameters of an endpoint and of all that it depends on."""
    yield from (field.alias for field in dependant.query_params)
    for each in dependant.dependencies:
        yield from _names(each)


def refusal(kind: ProblemType, path: str, message: str) -> Problem:
    """Return the problem of a parameter, given as ``query.NAME``."""
    problem = Finding("error", path, message)
    return Problem(kind, f"{path}: {message}", problems=[problem])


_CURSOR = r"^([0-9]{1,12}\.[0-9]{1,20})_([0-9a-f]{1,32})$"

After = Annotated[
    str | None,
    Query(max_length=100, description="`next` of the previous page.", json_schema_extra={"pattern": _CURSOR}),
]
"""Where a page begins."""

Moment = Literal["created_at", "deleted_at"]
"""Columns that lists are ordered by."""


def answer_page(request: Request, page: BaseModel) -> Response:
    """Answer with a page of a list and its ETag: 304 where the client has the same."""
    return answer_tagged(request, page.model_dump_json().encode())


def newest_first(table: type[Drive | Job], by: Moment = "created_at") -> tuple[Any, Any]:
    """Return what rows are ordered by: those that were made, or deleted, last come first."""
    return getattr(table, by).desc(), table.id.desc()


def cursor_of(row: Drive | Job, by: Moment = "created_at") -> str:
    """Return the cursor of a page that ends with this row, in the order of `newest_first`."""
    return cursor_at(getattr(row, by), row.id)


def cursor_at(time: float, row_id: str) -> str:
    """Return the cursor of a page that ends with a row of this time and id; `place_of` reads it."""
    return f"{time!r}_{row_id}"


def rows_after(table: type[Drive | Job], cursor: str, by: Moment = "created_at") -> ColumnElement[bool]:
    """Return the condition that a row comes after a cursor (else a 422), in the order of `newest_first`."""
    time, (last_time, last_id) = getattr(table, by), place_of(cursor)
    return or_(time < last_time, and_(time == last_time, table.id < last_id))


def place_of(cursor: str) -> tuple[float, str]:
    """Return the time and the id in a cursor (else a 422)."""
    if (match := re.fullmatch(_CURSOR, cursor)) is None:
        raise Problem(
            REQUEST_NOT_VALID,
            f"after={cursor[:80]!r} is not the `next` of a list. Leave it out to begin with the first page.",
        )
    return float(match[1]), match[2]


def has_part(column: Any, part: str) -> ColumnElement[bool]:  # noqa: ANN401 - a column, or a member of one
    """Return the condition that a text holds a part, in upper or lower case."""
    return func.lower(column).contains(part.lower(), autoescape=True)
