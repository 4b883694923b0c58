"""The parameters of queries for features. The standard wants 400 where a value is wrong: they come as plain text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Annotated, cast, get_args

from fastapi import Depends, Query

from app.http.parameters import refusal
from app.http.patterns import BOX, EXPECTED
from app.http.problem_types import REQUEST_NOT_VALID
from app.http.problems import Problem
from app.ogc import index
from app.ogc.collections import Collection
from app.ogc.filters import CRS84, Language, read_filter
from app.ogc.index import Key

DEFAULT_LIMIT = 1000
"""Features on a page: QGIS 3.22 and GDAL 3.6 take the types of properties from the first one."""

MAX_LIMIT = 10_000

_NUMBER = r"[+-]?(\d{1,12}(\.\d{0,30})?|\.\d{1,30})([eE][+-]?\d{1,3})?"
_CRS84H = "http://www.opengis.net/def/crs/OGC/0/CRS84h"
_TIME = re.compile(r"\d{4}-\d\d-\d\d([Tt ]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[+-]\d\d:\d\d))?")
_KEY = re.compile(r"(\d{1,9})\.(\d{1,9})(?:\.(\d{1,17}))?")


@dataclass(frozen=True)
class Asked:
    """What is asked for, of whatever collection."""

    query: index.Query
    """Without its filter, which depends on the collection."""
    filter: str | None
    language: Language
    until: float | None
    """Until when jobs had ended whose features are asked for, seconds since 1970, as the first page had them."""

    def of(self, collection: Collection, values: Mapping[str, str]) -> index.Query:
        """Return what is asked for of a collection, with values that queryables must have; a 400 where one is wrong."""
        if self.filter is None and not values:
            return self.query
        return replace(self.query, filter=read_filter(self.filter, self.language, collection, values))


async def _asked(
    limit: Annotated[
        str | None,
        Query(
            description=f"Maximum number of features, {DEFAULT_LIMIT:,} by default; more than {MAX_LIMIT:,} are never "
            "sent at once.",
            json_schema_extra={"type": "integer", "minimum": 1, "maximum": MAX_LIMIT},
        ),
    ] = None,
    bbox: Annotated[
        str | None,
        Query(
            description="Only features that touch this box: west,south,east,north in degrees (with 6 numbers heights "
            "are ignored); west is larger than east across the 180th meridian.",
            examples=["8.41,49.00,8.45,49.03"],
        ),
    ] = None,
    bbox_crs: Annotated[str | None, Query(alias="bbox-crs", description=f"{CRS84}, the only one.")] = None,
    datetime_: Annotated[
        str | None,
        Query(
            alias="datetime",
            description="Only features of this time, or of an interval: 2026-01-31T12:00:00Z, 2026-01-31/2026-02-01, "
            "../2026-01-31.",
        ),
    ] = None,
    filter_: Annotated[
        str | None,
        Query(
            alias="filter",
            description="Only features for which this CQL2 expression is true, over the queryables of the collection. "
            "A queryable that must have one value can also be a parameter itself: outcome=wrong.",
            examples=["outcome = 'wrong' AND score > 0.9"],
        ),
    ] = None,
    filter_lang: Annotated[
        str | None,
        Query(
            alias="filter-lang",
            description="cql2-text or cql2-json; by default by its first character. cql-text is what GDAL sends.",
            json_schema_extra={"enum": list(get_args(Language))},
        ),
    ] = None,
    filter_crs: Annotated[str | None, Query(alias="filter-crs", description=f"{CRS84}, the only one.")] = None,
    after: Annotated[str | None, Query(description="Where the page begins: taken from the link `next`.")] = None,
    offset: Annotated[
        str | None,
        Query(
            description="Leave out so many features, for clients that count pages by themselves. The link `next` is "
            "better: it stays with the jobs of the first page though others end meanwhile.",
            json_schema_extra={"type": "integer", "minimum": 0},
        ),
    ] = None,
) -> Asked:
    for name, crs in (("bbox-crs", bbox_crs), ("filter-crs", filter_crs)):
        if crs not in {None, CRS84, _CRS84H}:
            raise _wrong(name, str(crs), CRS84)
    key, until = (None, None) if after is None else _page_after(after)
    query = index.Query(
        area=None if bbox is None else _area(bbox),
        interval=None if datetime_ is None else _interval(datetime_),
        after=key,
        offset=_offset(offset, after),
        limit=_limit(limit),
    )
    return Asked(query, filter_, _language(filter_lang, filter_), until)


AskedDep = Annotated[Asked, Depends(_asked)]


def _wrong(name: str, value: str, expected: str) -> Problem:
    return refusal(REQUEST_NOT_VALID, f"query.{name}", f"{value[:80]!r} is not valid. Expected {expected}.", status=400)


def _limit(text: str | None) -> int:
    if text is None:
        return DEFAULT_LIMIT
    if not re.fullmatch(r"\+?\d{1,18}", text) or int(text) < 1:
        raise _wrong("limit", text, f"a whole number from 1 to {MAX_LIMIT:,}")
    return min(int(text), MAX_LIMIT)


def _area(text: str) -> index.Area:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) not in {4, 6} or not all(re.fullmatch(_NUMBER, part) for part in parts):
        raise _wrong("bbox", text, EXPECTED[BOX])
    half = len(parts) // 2
    west, south, east, north = (float(parts[i]) for i in (0, 1, half, half + 1))
    if not (abs(west) <= 180 and abs(east) <= 180 and -90 <= south <= north <= 90):
        raise _wrong("bbox", text, EXPECTED[BOX])
    return index.Area(west, south, east, north)


def _interval(text: str) -> index.Interval:
    begin, is_interval, end = text.partition("/")
    first, last = _span(begin, text), _span(end, text) if is_interval else None
    if last is None:
        if math.isinf(first[0]):
            raise _wrong("datetime", text, _EXPECTED_TIME)
        return first
    interval = first[0], last[1]
    if interval[0] > interval[1]:
        raise _wrong("datetime", text, "the begin of an interval before its end")
    return interval


_EXPECTED_TIME = "a time as 2026-01-31T12:00:00Z, a date, or two of them as begin/end, where .. leaves one open"


def _span(text: str, whole: str) -> index.Interval:
    """Return the first and the last second of a time or a day; all of time where it is open."""
    if text in {"", ".."} and whole != text:
        return -math.inf, math.inf
    if _TIME.fullmatch(text) is None:
        raise _wrong("datetime", whole, _EXPECTED_TIME)
    try:
        time = datetime.fromisoformat(text.upper())
        begin = (time if time.tzinfo is not None else time.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        raise _wrong("datetime", whole, _EXPECTED_TIME) from None
    return begin, begin if len(text) > 10 else begin + 86_400.0 - 1e-6


def _language(asked: str | None, text: str | None) -> Language:
    if asked is None:
        return "cql2-json" if (text or "").lstrip().startswith("{") else "cql2-text"
    if asked not in get_args(Language):
        raise _wrong("filter-lang", asked, ", ".join(get_args(Language)))
    return cast("Language", asked)


def _offset(text: str | None, after: str | None) -> int:
    if text is None:
        return 0
    if after is not None or not re.fullmatch(r"\d{1,12}", text):
        raise _wrong("offset", text, "a whole number from 0, and no `after` beside it")
    return int(text)


def page_token(key: Key, until: float | None) -> str:
    """Return `after` of the page behind a key, of jobs that had ended until then."""
    return str(key) if until is None else f"{key}.{math.floor(until * 1e6) + 2}"


def _page_after(text: str) -> tuple[Key, float | None]:
    match = _KEY.fullmatch(text)
    if match is None:
        raise _wrong("after", text, "what the link `next` holds; leave it out to begin with the first page")
    return Key(int(match[1]), int(match[2])), None if match[3] is None else int(match[3]) / 1e6
