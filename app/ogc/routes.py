"""OGC API - Features: the pinned or best result of every drive at /ogc, and each result and each map by itself."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated, Literal, cast

from fastapi import Depends, Path, Request, Response
from fastapi import Query as Parameter

from app.context import ContextDep
from app.http.delivery import answer_tagged, service_address
from app.http.fields import ID
from app.http.parameters import OF_ITS_DATA, BoxFilter, refusal, refuse_others
from app.http.prices import priced
from app.http.problem_types import NO_SUCH_COLLECTION, NO_SUCH_FEATURE, NO_SUCH_MAP, REQUEST_NOT_VALID
from app.http.problems import Problem
from app.http.routing import API, ApiRouter
from app.ogc.collections import Collection
from app.ogc.documents import GEOJSON, OPENAPI, SCHEMA, Place
from app.ogc.filters import CRS84, Language, equals, read_filter
from app.ogc.index import Extent, Interval, Key, Query, Source, extents, find_feature, find_page
from app.results.folder import ResultsDep
from app.results.routes.results import JobId
from app.store.models import CityMap
from interloc.arrays import JsonObject

DEFAULT_LIMIT = 1000
"""Features on a page: QGIS 3.22 and GDAL 3.6 take the types of properties from the first one."""

MAX_LIMIT = 10_000

_TIME = re.compile(r"\d{4}-\d\d-\d\d([Tt ]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|[+-]\d\d:\d\d))?")
_KEY = r"^(\d{1,9})\.(\d{1,9})$"
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
    language: Language = filter_lang or ("cql2-json" if (filter_ or "").lstrip().startswith("{") else "cql2-text")
    return Query(
        area=bbox,
        interval=None if datetime_ is None else _interval(datetime_),
        filter=None if filter_ is None else read_filter(filter_, language),
        after=None if after is None else Key(*map(int, after.split("."))),
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


_CollectionId = Annotated[
    str, Path(description="Name of the collection, as listed.", max_length=100, examples=["intersections"])
]
MapId = Annotated[str, Path(pattern=ID, description="Id of the map; `default` holds all drives.")]
_FeatureId = Annotated[str, Path(description="Id of the feature.", max_length=400)]


class _Served:
    """A source of features, where it is shown, and its database."""

    def __init__(
        self, request: Request, context: ContextDep, source: Source, path: str, title: str, description: str
    ) -> None:
        service = service_address(request)
        self.request, self.database, self.source = request, context.database, source
        self.place = Place(f"{service}{path}/ogc", title, description, service)

    def extents(self) -> dict[str, Extent]:
        """Return what the collections hold."""
        with self.database.reading() as session:
            return extents(session, self.source)

    def collection(self, name: str) -> Collection:
        """Return a collection, empty where no rows were written yet; a 404 where there is none."""
        found = self.source.collections.get(name)
        known = self.source.collections if self.source.is_of_all else self.extents()
        if found is None or name not in known:
            raise Problem(NO_SUCH_COLLECTION, f"There is no collection {name[:80]!r}. There are {', '.join(known)}.")
        return found

    def answer(self, document: JsonObject | str, media_type: str = "application/json") -> Response:
        """Answer with a document."""
        content = document if isinstance(document, str) else json.dumps(document, ensure_ascii=False)
        return answer_tagged(self.request, content.encode(), media_type)


def _serve_all(request: Request, context: ContextDep) -> None:
    description = "Road intersections found in LiDAR drives: the pinned job of every drive, else its best."
    request.state.served = _Served(request, context, Source(), "", "InterLoc", description)


def _serve_job(job_id: JobId, request: Request, context: ContextDep, results: ResultsDep) -> None:
    result = results.open(job_id)
    result.require_georeference("A GIS cannot show it")
    description = f"Road intersections found by job {job_id} in drive {result.drive_name}."
    title = f"InterLoc: {result.drive_name}"
    request.state.served = _Served(request, context, Source(job_id), result.address, title, description)


def _serve_map(map_id: MapId, request: Request, context: ContextDep) -> None:
    with context.database.reading() as session:
        city = session.get(CityMap, map_id)
    if city is None:
        raise Problem(NO_SUCH_MAP, f"There is no map {map_id}. GET /api/v1/maps lists them.")
    description = f"Road intersections of many drives, fused, and what OpenStreetMap has wrong: map {city.name}."
    path, title = f"/api/v1/maps/{map_id}", f"InterLoc: {city.name}"
    request.state.served = _Served(request, context, Source(map=map_id), path, title, description)


def _as_json(
    _format: Annotated[
        Literal["json", "geojson"] | None, Parameter(alias="f", description="The form that every answer has.")
    ] = None,
) -> None:
    """Take the parameter that many clients send to name the form they want."""


def _served(request: Request) -> _Served:
    """Return what the dependency of the router has put there: nothing where an id of the address is refused."""
    return cast("_Served", getattr(request.state, "served", None))


_ServedDep = Annotated[_Served, Depends(_served)]


@priced("cheap")
def _landing(served: _ServedDep) -> Response:
    """Lead to everything else: give this address to QGIS (OGC API - Features) or to GDAL (`OAPIF:` before it)."""
    return served.answer(served.place.landing())


@priced("cheap")
def _conformance(served: _ServedDep) -> Response:
    """List the classes of OGC API - Features and CQL2 that the interface keeps to."""
    return served.answer(served.place.conformance())


@priced("cheap")
def _interface(served: _ServedDep) -> Response:
    """Describe by OpenAPI 3.0 what can be asked of the collections, as far as GDAL and QGIS look at it."""
    known = [served.source.collections[name] for name in served.extents()]
    return served.answer(served.place.interface(known, MAX_LIMIT), OPENAPI)


@priced("cheap")
def _collections(served: _ServedDep) -> Response:
    """List the layers with their extents in space and time."""
    return served.answer(served.place.collections(served.extents(), served.source.collections))


@priced("cheap")
def _collection(collection_id: _CollectionId, served: _ServedDep) -> Response:
    """Describe a layer: what a feature is, its extent in space and time, whose data it is."""
    found = served.collection(collection_id)
    return served.answer(served.place.collection(found, served.extents()[found.id]))


@priced("cheap")
def _feature_schema(collection_id: _CollectionId, served: _ServedDep) -> Response:
    """Describe the features as they are in GeoJSON, for programs such as GDAL."""
    found = served.collection(collection_id)
    return served.answer(found.feature_schema(served.place.of_collection(found, "feature-schema")), SCHEMA)


@priced("cheap")
def _queryables(collection_id: _CollectionId, served: _ServedDep) -> Response:
    """Describe what filters may name."""
    found = served.collection(collection_id)
    return served.answer(found.queryables_schema(served.place.of_collection(found, "queryables")), SCHEMA)


@priced("heavy", bound="a page, by its own parameters")
def _items(collection_id: _CollectionId, request: Request, served: _ServedDep, asked: AskedDep) -> Response:
    """Give features as GeoJSON, page by page: follow the link `next`.

    All conditions must hold. A filter that is too large, too deep or takes too long is refused.
    """
    found = served.collection(collection_id)
    refuse_others(request, found.queryables)
    named = [(name, value) for name, value in request.query_params.multi_items() if name in found.queryables]
    if named:  # a property that must have one value
        parts = [equals(name, value, found.queryables[name]) for name, value in named]
        asked = replace(asked, filter={"op": "and", "args": [*parts, True if asked.filter is None else asked.filter]})
    with served.database.reading() as session:
        page = find_page(session, served.source, found, asked)
    following = None if page.next is None else str(page.next)
    return served.answer(served.place.items(found, page, request.query_params.multi_items(), following), GEOJSON)


@priced("heavy", bound="one feature")
def _feature(collection_id: _CollectionId, feature_id: _FeatureId, served: _ServedDep) -> Response:
    """Give one feature; its id stays the same for as long as there is its job."""
    found = served.collection(collection_id)
    with served.database.reading() as session:
        content = find_feature(session, served.source, found, feature_id)
    if content is None:
        is_job_missing = served.source.is_of_all and "." not in feature_id
        hint = " Ids of features of all drives begin with the job: JOB.ID." if is_job_missing else ""
        raise Problem(NO_SUCH_FEATURE, f"{found.id} has no feature {feature_id[:80]!r}.{hint}")
    return served.answer(served.place.feature(found, feature_id, content), GEOJSON)


_ONE = "/collections/{collection_id}"
_ADDRESSES: dict[str, Callable[..., Response]] = {
    "": _landing,
    "/api": _interface,
    "/conformance": _conformance,
    "/collections": _collections,
    _ONE: _collection,
    f"{_ONE}/feature-schema": _feature_schema,
    f"{_ONE}/queryables": _queryables,
    f"{_ONE}/items": _items,
    f"{_ONE}/items/{{feature_id}}": _feature,
}


def _router(prefix: str, name: str, source: Callable[..., None]) -> ApiRouter:
    """Return all addresses of a source of features."""
    router = ApiRouter(prefix, tags=["GIS"])
    for path, endpoint in _ADDRESSES.items():
        router.get_and_head(
            path,
            summary="Where a GIS begins",
            operation_id=f"read_{name}{endpoint.__name__}",
            openapi_extra=OF_ITS_DATA if endpoint is _items else None,
            dependencies=[Depends(source), Depends(_as_json)],
        )(endpoint)
    return router


of_all = _router("/ogc", "ogc", _serve_all)
"""The result that stands for every drive; it has its own address beside the API."""

of_job = _router(f"{API}/jobs/{{job_id}}/ogc", "job_ogc", _serve_job)
of_map = _router(f"{API}/maps/{{map_id}}/ogc", "map_ogc", _serve_map)
