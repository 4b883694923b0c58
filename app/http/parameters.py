"""Query parameters that several addresses share, and the refusal of those that an address does not have."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, NamedTuple

from fastapi import Depends, Query, Request
from fastapi.dependencies.models import Dependant
from pydantic import AwareDatetime

from app.http.patterns import BOX, EXPECTED, TEXT
from app.http.problem_types import REQUEST_NOT_VALID, UNKNOWN_PARAMETER, ProblemType
from app.http.problems import FileProblem, Problem

NamePart = Annotated[
    str | None,
    Query(
        max_length=200,
        pattern=TEXT,
        description="Only those with this in their name, in upper or lower case.",
    ),
]
CreatedAfter = Annotated[
    AwareDatetime | None,
    Query(description="Only those made at this time or later, as 2026-01-31T12:00:00Z."),
]
CreatedBefore = Annotated[
    AwareDatetime | None, Query(description="Only those made before this time, as 2026-01-31T12:00:00Z.")
]


class Box(NamedTuple):
    """A box of longitudes and latitudes, degrees; west is larger than east where it crosses the 180th meridian."""

    west: float
    south: float
    east: float
    north: float

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
    is_on_earth = all(abs(lon) <= 180 for lon in (box.west, box.east)) and -90 <= box.south <= box.north <= 90
    if not is_on_earth:
        raise refusal(REQUEST_NOT_VALID, "query.bbox", f"found {bbox!r}; expected {EXPECTED[BOX]}.")
    return box


BoxFilter = Annotated[Box | None, Depends(_box)]


OF_ITS_DATA = {"x-parameters-of-its-data": True}
"""``openapi_extra`` of an operation that has the parameters of its data, too: it calls `refuse_others` itself."""


async def refuse_unknown_parameters(request: Request) -> None:
    """Refuse (400) a query parameter that the address does not have: it would be a filter that does nothing."""
    if not (request.scope["route"].openapi_extra or {}).keys() & OF_ITS_DATA.keys():
        refuse_others(request, ())


def refuse_others(request: Request, names: Iterable[str]) -> None:
    """Refuse a query parameter that is neither one of the address nor one of these, as `refuse_unknown_parameters`."""
    if not request.query_params:
        return
    known = sorted({*_names(request.scope["route"].dependant), *names})
    for name in request.query_params:
        if name not in known:
            expected = f"Expected one of {', '.join(known)}" if known else "Expected none"
            raise refusal(UNKNOWN_PARAMETER, f"query.{name[:80]}", f"There is no such parameter. {expected}.")


def _names(dependant: Dependant) -> Iterator[str]:
    """Yield the names of the query parameters of an endpoint and of all that it depends on."""
    yield from (field.alias for field in dependant.query_params)
    for each in dependant.dependencies:
        yield from _names(each)


def refusal(kind: ProblemType, path: str, message: str, *, status: int | None = None) -> Problem:
    """Return the problem of a parameter, given as ``query.NAME``."""
    problem = FileProblem(severity="error", path=path, message=message)
    return Problem(kind, f"{path}: {message}", status=status, problems=[problem])
