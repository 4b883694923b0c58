"""OGC API - Features: the pinned or best result of every drive at /ogc, and each result by itself."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request, Response

from app.context import ContextDep
from app.http.delivery import answer_tagged, service_address
from app.http.openapi import TAGGED, get_and_head, problems
from app.http.parameters import OF_ITS_DATA, refuse_others
from app.http.patterns import ID
from app.http.prices import priced
from app.http.problem_types import NO_SUCH_COLLECTION, NO_SUCH_FEATURE, NO_SUCH_MAP
from app.http.problems import Problem
from app.ogc.collections import Collection
from app.ogc.documents import GEOJSON, OPENAPI, SCHEMA, Place
from app.ogc.index import Extent, Source, extents, find_feature, find_page
from app.ogc.indexing import index_job, is_indexed
from app.ogc.parameters import MAX_LIMIT, AskedDep, page_token
from app.results.folder import ResultsDep
from app.results.routes.results import PROBLEMS, JobId
from app.store.models import CityMap

of_all = APIRouter(tags=["GIS"])
"""The result that stands for every drive; it has its own address beside the API."""

of_job = APIRouter(tags=["GIS"])
of_map = APIRouter(tags=["GIS"])

_CollectionId = Annotated[
    str, Path(description="Name of the collection, as listed.", max_length=100, examples=["intersections"])
]
MapId = Annotated[str, Path(pattern=ID, description="Id of the map; `default` holds all drives.")]
_FeatureId = Annotated[str, Path(description="Id of the feature.", max_length=400)]


class _Served:
    """A source of features, where it is shown, and its database."""

    def __init__(self, request: Request, context: ContextDep, source: Source, place: Place) -> None:
        self.request = request
        self.database = context.database
        self.source = source
        self.place = place

    def extents(self) -> dict[str, Extent]:
        """Return what the collections hold."""
        with self.database.reading() as session:
            return extents(session, self.source)

    def collection(self, name: str) -> Collection:
        """Return a collection; a 404 where there is none."""
        found = self.source.collections.get(name)
        if found is None or (not self.source.is_of_all and name not in self.extents()):
            known = ", ".join(self.extents())
            raise Problem(NO_SUCH_COLLECTION, f"There is no collection {name[:80]!r}. There are {known}.")
        return found

    def answer(self, document: dict[str, Any] | str, media_type: str = "application/json") -> Response:
        """Answer with a document."""
        content = document if isinstance(document, str) else json.dumps(document, ensure_ascii=False)
        return answer_tagged(self.request, content.encode(), media_type)


def _of_all(request: Request, context: ContextDep) -> _Served:
    place = Place(
        f"{service_address(request)}/ogc",
        "InterLoc",
        "Road intersections found in LiDAR drives: the pinned job of every drive, else its best.",
        service_address(request),
    )
    return _Served(request, context, Source(), place)


def _one_job(job_id: JobId, request: Request, context: ContextDep, results: ResultsDep) -> _Served:
    result = results.open(job_id)
    result.require_georeference("A GIS cannot show it")
    with context.database.reading() as session:
        is_there = is_indexed(session, job_id)
    if not is_there:  # of an older version, and the clean-up has not come to it yet
        index_job(context, job_id)
    description = f"Road intersections found by job {job_id} in drive {result.drive_name}."
    service = service_address(request)
    place = Place(f"{service}{result.address}/ogc", f"InterLoc: {result.drive_name}", description, service)
    return _Served(request, context, Source(job_id), place)


def _one_map(map_id: MapId, request: Request, context: ContextDep) -> _Served:
    with context.database.reading() as session:
        city = session.get(CityMap, map_id)
    if city is None:
        raise Problem(NO_SUCH_MAP, f"There is no map {map_id}. GET /api/v1/maps lists them.")
    description = f"Road intersections of many drives, fused, and what OpenStreetMap has wrong: map {city.name}."
    service = service_address(request)
    place = Place(f"{service}/api/v1/maps/{map_id}/ogc", f"InterLoc: {city.name}", description, service)
    return _Served(request, context, Source(map=map_id), place)


@priced("cheap")
def _landing(served: _Served) -> Response:
    """Lead to everything else: give this address to QGIS (OGC API - Features) or to GDAL (`OAPIF:` before it)."""
    return served.answer(served.place.landing())


@priced("cheap")
def _conformance(served: _Served) -> Response:
    """List the classes of OGC API - Features and CQL2 that the interface keeps to."""
    return served.answer(served.place.conformance())


@priced("cheap")
def _interface(served: _Served) -> Response:
    """Describe by OpenAPI 3.0 what can be asked of the collections, as far as GDAL and QGIS look at it."""
    known = [served.source.collections[name] for name in served.extents()]
    return served.answer(served.place.interface(known, MAX_LIMIT), OPENAPI)


@priced("cheap")
def _collections(served: _Served) -> Response:
    """List the layers with their extents in space and time."""
    return served.answer(served.place.collections(served.extents(), served.source.collections))


@priced("cheap")
def _collection(collection_id: _CollectionId, served: _Served) -> Response:
    """Describe a layer: what a feature is, its extent in space and time, whose data it is."""
    found = served.collection(collection_id)
    return served.answer(served.place.collection(found, served.extents()[found.id]))


@priced("cheap")
def _schema(collection_id: _CollectionId, served: _Served) -> Response:
    """Describe the properties of the features: type, unit, title and meaning."""
    found = served.collection(collection_id)
    return served.answer(found.schema(served.place.of_collection(found, "schema")), SCHEMA)


@priced("cheap")
def _feature_schema(collection_id: _CollectionId, served: _Served) -> Response:
    """Describe the features as they are in GeoJSON, for programs such as GDAL."""
    found = served.collection(collection_id)
    return served.answer(found.feature_schema(served.place.of_collection(found, "feature-schema")), SCHEMA)


@priced("cheap")
def _queryables(collection_id: _CollectionId, served: _Served) -> Response:
    """Describe what filters may name."""
    found = served.collection(collection_id)
    return served.answer(found.queryables_schema(served.place.of_collection(found, "queryables")), SCHEMA)


@priced("heavy", bound="a page, by its own parameters")
def _items(collection_id: _CollectionId, request: Request, served: _Served, asked: AskedDep) -> Response:
    """Give features as GeoJSON, page by page: follow the link `next`.

    All conditions must hold. A filter that is too large, too deep or takes too long is refused.
    """
    found = served.collection(collection_id)
    refuse_others(request, found.queryables)
    values = {name: value for name, value in request.query_params.items() if name in found.queryables}
    query = asked.of(found, values)
    with served.database.reading() as session:
        source = replace(served.source, until=asked.until).pinned(session)
        page = find_page(session, source, found, query)
    content = served.place.items(
        found, page, request.query_params.multi_items(), token=lambda key: page_token(key, source.until)
    )
    return served.answer(content, GEOJSON)


@priced("heavy", bound="one feature")
def _feature(collection_id: _CollectionId, feature_id: _FeatureId, served: _Served) -> Response:
    """Give one feature; its id stays the same for as long as there is its job."""
    found = served.collection(collection_id)
    with served.database.reading() as session:
        content = find_feature(session, served.source, found, feature_id)
    if content is None:
        hint = (
            ""
            if not served.source.is_of_all or "." in feature_id
            else " Ids of features of all drives begin with the job: JOB.ID."
        )
        raise Problem(NO_SUCH_FEATURE, f"{found.id} has no feature {feature_id[:80]!r}.{hint}")
    return served.answer(served.place.feature(found, feature_id, content), GEOJSON)


_JSON = "application/json"
_ONE = "/collections/{collection_id}"
_ADDRESSES: tuple[tuple[str, Callable[..., Response], str, str], ...] = (
    ("", _landing, _JSON, "Where a GIS begins"),
    ("/api", _interface, OPENAPI, "Describe what can be asked"),
    ("/conformance", _conformance, _JSON, "What the interface keeps to"),
    ("/collections", _collections, _JSON, "List the layers"),
    (_ONE, _collection, _JSON, "Describe a layer"),
    (f"{_ONE}/schema", _schema, SCHEMA, "Describe the features of a layer"),
    (f"{_ONE}/feature-schema", _feature_schema, SCHEMA, "Describe the GeoJSON of a layer"),
    (f"{_ONE}/queryables", _queryables, SCHEMA, "Describe what filters may name"),
    (f"{_ONE}/items", _items, GEOJSON, "Give the features of a layer"),
    (f"{_ONE}/items/{{feature_id}}", _feature, GEOJSON, "Give one feature"),
)
_MISSING = problems({404: "No such collection or feature."})


def _add(
    router: APIRouter, prefix: str, name: str, source: Callable[..., _Served], problems: dict[int | str, Any]
) -> None:
    """Register all addresses of a source of features."""
    for path, endpoint, media_type, summary in _ADDRESSES:
        answer = {"description": f"{summary}.", "content": {media_type: {"schema": {"type": "object"}}}}
        get_and_head(
            router,
            f"{prefix}{path}",
            summary=summary,
            operation_id=f"read_{name}{endpoint.__name__}",
            openapi_extra=OF_ITS_DATA if endpoint is _items else None,
            response_class=Response,
            responses={**TAGGED, 200: answer, **(_MISSING if "{" in path else {}), **problems},
        )(_bound(endpoint, source))


def _bound(endpoint: Callable[..., Response], source: Callable[..., _Served]) -> Callable[..., Response]:
    """Return an endpoint whose `served` comes from a source."""

    @wraps(endpoint)
    def bound(**arguments: Any) -> Response:  # noqa: ANN401 - those of the endpoint
        return endpoint(**arguments)

    signature = inspect.signature(endpoint, eval_str=True)
    own = signature.parameters["served"].replace(annotation=Annotated[_Served, Depends(source)])
    parameters = {**signature.parameters, "served": own}
    bound.__signature__ = signature.replace(parameters=list(parameters.values()))  # type: ignore[attr-defined]
    return bound


_add(of_all, "/ogc", "ogc", _of_all, {})
_add(of_job, "/jobs/{job_id}/ogc", "job_ogc", _one_job, PROBLEMS)
_add(of_map, "/maps/{map_id}/ogc", "map_ogc", _one_map, PROBLEMS)
