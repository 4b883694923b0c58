"""Pages of lists, the newest first: where one ends, the next one begins."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime
from typing import Annotated, Any, Literal, Protocol
from urllib.parse import quote, urlencode

from fastapi import Query, Request, Response
from sqlalchemy import ColumnElement, and_, func, or_

from app.http.delivery import answer_tagged
from app.http.gate import path_of
from app.http.parameters import Box
from app.http.problem_types import REQUEST_NOT_VALID
from app.http.problems import Problem
from app.store.models import Drive, Job

_CURSOR = r"^([0-9]{1,12}\.[0-9]{1,20})_([0-9a-f]{1,32})$"

After = Annotated[
    str | None,
    Query(max_length=100, description="`next` of the previous page.", json_schema_extra={"pattern": _CURSOR}),
]
"""Where a page begins."""

Moment = Literal["created_at", "deleted_at"]
"""Columns that lists are ordered by."""


class Page(Protocol):
    """A page of a list."""

    next: str | None

    def model_dump_json(self) -> str:
        """Return it as JSON."""


def answer_page(request: Request, page: Page) -> Response:
    """Answer with a page and its ETag: 304 where the client has the same; the header Link names the next (RFC 8288)."""
    return answer_tagged(request, page.model_dump_json().encode(), **next_link(request, page.next))


def next_link(request: Request, cursor: str | None) -> dict[str, str]:
    """Return the header that names the next page of a list, with all filters of this one; none on the last page."""
    if cursor is None:
        return {}
    same = [(name, value) for name, value in request.query_params.multi_items() if name != "after"]
    path = quote(f"{request.scope.get('root_path', '')}{path_of(request.scope)}")
    return {"link": f'<{path}?{urlencode([*same, ("after", cursor)])}>; rel="next"'}


def newest_first(table: type[Drive | Job], by: Moment = "created_at") -> tuple[Any, Any]:
    """Return what rows are ordered by: those that were made, or deleted, last come first."""
    return getattr(table, by).desc(), table.id.desc()


def cursor_of(row: Drive | Job, by: Moment = "created_at") -> str:
    """Return the cursor of a page that ends with this row, in the order of `newest_first`."""
    return f"{getattr(row, by)!r}_{row.id}"


def rows_after(table: type[Drive | Job], cursor: str, by: Moment = "created_at") -> ColumnElement[bool]:
    """Return the condition that a row comes after a cursor (else a 422), in the order of `newest_first`."""
    match = re.fullmatch(_CURSOR, cursor)
    if match is None:
        raise Problem(
            REQUEST_NOT_VALID,
            f"after={cursor[:80]!r} is not the `next` of a list. Leave it out to begin with the first page.",
        )
    time, last_time, last_id = getattr(table, by), float(match[1]), match[2]
    return or_(time < last_time, and_(time == last_time, table.id < last_id))


def made_between(
    table: type[Drive | Job], after: datetime | None, before: datetime | None
) -> Iterator[ColumnElement[bool]]:
    """Yield the conditions that a row was made at or after a time, and before another one."""
    if after is not None:
        yield table.created_at >= after.timestamp()
    if before is not None:
        yield table.created_at < before.timestamp()


def has_part(column: Any, part: str) -> ColumnElement[bool]:  # noqa: ANN401 - a column, or a member of one
    """Return the condition that a text holds a part, in upper or lower case."""
    found: ColumnElement[bool] = func.lower(column).contains(part.lower(), autoescape=True)
    return found


def lies_in(box: Box) -> ColumnElement[bool]:
    """Return the condition that a drive touches a box; one that is not ready or has no georeference touches none."""
    join = and_ if box.west <= box.east else or_  # across the 180th meridian
    return and_(
        Drive.south <= box.north, Drive.north >= box.south, join(Drive.east >= box.west, Drive.west <= box.east)
    )
