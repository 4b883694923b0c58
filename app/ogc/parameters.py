"""The parameters of queries for features."""

import math
import re
from datetime import UTC, datetime
from typing import Annotated, Literal

from fastapi import Depends
from fastapi import Query as Parameter

from app.http.parameters import BoxFilter, refusal
from app.http.problem_types import REQUEST_NOT_VALID
from app.http.problems import Problem
from app.ogc.filters import CRS84, Language, read_filter
from app.ogc.index import Interval, Key, Query

DEFAULT_LIMIT = 1000
"""Features on a page: QGIS 3.22 and GDAL 3.6 take the types of properties from the first one."""

MAX_LIMIT = 10_000

_TIME = re.compile(r"\d{4}-\d\d-\d\d([Tt ]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[+-]\d\d:\d\d))?")
_KEY = r"^(\d{1,9})\.(\d{1,9})(\.\d{1,17})?$"
_Crs84 = Literal["http://www.opengis.net/def/crs/OGC/1.3/CRS84", "http://www.opengis.net/def/crs/OGC/0/CRS84h"]


def _asked(
    bbox: BoxFilter,
    limit: Annotated[
        int, Parameter(ge=1, description=f"Maximum number of features; more than {MAX_LIMIT:,} are never sent at once.")
    ] = DEFAULT_LIMIT,
    _bbox_crs: Annotated[_Crs84 | None, Parameter(alias="bbox-crs", description=f"{CRS84}, the only one.")] = None,
    datetime_: Annotated[
        str | None,
        Parameter(
            alias="datetime",
            description="Only features of this time, or of an interval: 2026-01-31T12:00:00Z, 2026-01-31/2026-02-01, "
            "../2026-01-31.",
        ),
    ] = None,
    filter_: Annotated[
        str | None,
        Parameter(
            alias="filter",
            description="Only features for which this CQL2 expression is true, over the queryables of the collection. "
            "A queryable that must have one value can also be a parameter itself: outcome=wrong.",
            examples=["outcome = 'wrong' AND score > 0.9"],
        ),
    ] = None,
    filter_lang: Annotated[
        Language | None,
        Parameter(
            alias="filter-lang",
            description="By default by the first character of the filter. cql-text is what GDAL sends.",
        ),
    ] = None,
    _filter_crs: Annotated[_Crs84 | None, Parameter(alias="filter-crs", description=f"{CRS84}, the only one.")] = None,
    after: Annotated[
        str | None, Parameter(pattern=_KEY, description="Where the page begins: taken from the link `next`.")
    ] = None,
) -> Query:
    key, until = None, None
    if after is not None:
        layer, number, *ended = map(int, after.split("."))
        key, until = Key(layer, number), ended[0] / 1e6 if ended else None
    language: Language = filter_lang or ("cql2-json" if (filter_ or "").lstrip().startswith("{") else "cql2-text")
    return Query(
        area=bbox,
        interval=None if datetime_ is None else _interval(datetime_),
        filter=None if filter_ is None else read_filter(filter_, language),
        after=key,
        until=until,
        limit=min(limit, MAX_LIMIT),
    )


AskedDep = Annotated[Query, Depends(_asked)]


def _wrong(name: str, value: str, expected: str) -> Problem:
    return refusal(REQUEST_NOT_VALID, f"query.{name}", f"{value[:80]!r} is not valid. Expected {expected}.")


_EXPECTED_TIME = "a time as 2026-01-31T12:00:00Z, a date, or two of them as begin/end, where .. leaves one open"


def _interval(text: str) -> Interval:
    begin, slash, end = text.partition("/")
    first = _span(begin, text) if begin not in {"", ".."} or not slash else (-math.inf, -math.inf)
    last = first if not slash else _span(end, text) if end not in {"", ".."} else (math.inf, math.inf)
    if first[0] > last[1]:
        raise _wrong("datetime", text, "the begin of an interval before its end")
    return first[0], last[1]


def _span(text: str, whole: str) -> Interval:
    """Return the first and the last second of a time or a day."""
    try:
        time = datetime.fromisoformat(text.upper() if _TIME.fullmatch(text) else "")
        begin = (time if time.tzinfo is not None else time.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        raise _wrong("datetime", whole, _EXPECTED_TIME) from None
    return begin, begin if len(text) > 10 else begin + 86_400.0 - 1e-6


def page_token(key: Key, until: float | None) -> str:
    """Return `after` of the page behind a key, of jobs that had ended until then."""
    return str(key) if until is None else f"{key}.{math.floor(until * 1e6) + 2}"
