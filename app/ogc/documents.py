"""The documents that lead to the features: landing page, conformance, collections; all links are absolute."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from urllib.parse import quote, urlencode

from app.ogc.collections import KINDS, Collection
from app.ogc.filters import CRS84
from app.ogc.index import Extent, Page
from interloc.arrays import JsonObject
from interloc.output.credits import ODBL
from interloc.output.geojson import encode

GEOJSON = "application/geo+json"
SCHEMA = "application/schema+json"
OPENAPI = "application/vnd.oai.openapi+json;version=3.0"

_PART_1 = "http://www.opengis.net/spec/ogcapi-features-1/1.0/conf"
_PART_3 = "http://www.opengis.net/spec/ogcapi-features-3/1.0/conf"
_CQL2 = "http://www.opengis.net/spec/cql2/1.0/conf"
_COMMON = "http://www.opengis.net/spec/ogcapi-common"

CONFORMS_TO = [
    f"{_COMMON}-1/1.0/conf/core",
    f"{_COMMON}-2/1.0/conf/collections",
    *(f"{_PART_1}/{name}" for name in ("core", "geojson")),
    *(f"{_PART_3}/{name}" for name in ("queryables", "filter", "features-filter")),
    *(
        f"{_CQL2}/{name}"
        for name in (
            "cql2-text",
            "cql2-json",
            "basic-cql2",
            "advanced-comparison-operators",
            "case-insensitive-comparison",
            "basic-spatial-functions",
            "property-property",
        )
    ),
]


@dataclass(frozen=True)
class Place:
    """Where the documents of a source stand."""

    address: str
    """Of the landing page."""
    title: str
    description: str
    service: str
    """Address of the service."""

    def landing(self) -> JsonObject:
        """Return the landing page."""
        return {
            "title": self.title,
            "description": self.description,
            "links": [
                _link("self", self.address, "application/json", "This document"),
                _link("service-desc", f"{self.address}/api", OPENAPI, "What can be asked of the collections"),
                _link("service-doc", f"{self.service}/docs", "text/html", "The interface, for people"),
                _link("conformance", f"{self.address}/conformance", "application/json", "What this keeps to"),
                _link("data", f"{self.address}/collections", "application/json", "The collections"),
            ],
        }

    def interface(self, known: Iterable[Collection], max_limit: int) -> JsonObject:
        """Return as much of OpenAPI 3.0 as GDAL and QGIS look for: by which parameters they may ask for features.

        Without it they fetch all of a collection, in small pages, and filter by themselves.
        """
        languages = {"type": "string", "enum": ["cql-text", "cql2-text", "cql2-json"]}
        texts = dict.fromkeys(("bbox", "datetime", "filter", "after"), "string")
        limit = {"name": "limit", "in": "query", "schema": {"type": "integer", "minimum": 1, "maximum": max_limit}}
        paths = {}
        for each in known:
            named = {"filter-lang": languages}
            types = {name: KINDS[kind]["type"] for name, kind in each.queryables.items()}
            named |= {name: {"type": kind} for name, kind in {**texts, **types}.items()}
            parameters: list[JsonObject] = [{"$ref": "#/components/parameters/limit"}]  # as GDAL looks for it
            parameters += [{"name": name, "in": "query", "schema": schema} for name, schema in named.items()]
            answers = {"200": {"description": "GeoJSON."}}
            paths[f"/collections/{each.id}/items"] = {"get": {"parameters": parameters, "responses": answers}}
        return {
            "openapi": "3.0.3",
            "info": {"title": self.title, "version": "1"},
            "servers": [{"url": self.address}],
            "paths": paths,
            "components": {"parameters": {"limit": limit}},
        }

    def conformance(self) -> JsonObject:
        """Return what the service keeps to."""
        return {"links": [_self(f"{self.address}/conformance")], "conformsTo": CONFORMS_TO}

    def collections(self, found: Mapping[str, Extent], known: Mapping[str, Collection]) -> JsonObject:
        """Return the list of collections."""
        return {
            "links": [_self(f"{self.address}/collections")],
            "collections": [self._collection(known[name], extent) for name, extent in found.items()],
        }

    def collection(self, collection: Collection, extent: Extent) -> JsonObject:
        """Return the description of a collection."""
        described = self._collection(collection, extent)
        address = f"{self.address}/collections/{collection.id}"
        return {**described, "links": [_self(address), *described["links"][1:]]}

    def of_collection(self, collection: Collection, name: str) -> str:
        """Return the address of a document of a collection, for example of its schema."""
        return f"{self.address}/collections/{collection.id}/{name}"

    def _collection(self, collection: Collection, extent: Extent) -> JsonObject:
        address = f"{self.address}/collections/{collection.id}"
        found: JsonObject = {}
        if extent.box is not None:
            found["spatial"] = {"bbox": [list(extent.box)], "crs": CRS84}
        if extent.times is not None:
            times = (datetime.fromtimestamp(each, UTC).isoformat().replace("+00:00", "Z") for each in extent.times)
            found["temporal"] = {
                "interval": [list(times)],
                "trs": "http://www.opengis.net/def/uom/ISO-8601/0/Gregorian",
            }
        license_ = [] if extent.license is None else [_link("license", ODBL, "text/html", "Open Database License")]
        return {
            "id": collection.id,
            "title": collection.layer.title,
            "description": collection.layer.description,
            "attribution": extent.attribution,
            **({"extent": found} if found else {}),
            "itemType": "feature",
            "crs": [CRS84],
            "itemCount": extent.count,
            "links": [
                _link("self", address, "application/json", collection.layer.title),
                _link("items", f"{address}/items", GEOJSON, "The features"),
                _link("describedBy", f"{address}/feature-schema", SCHEMA, "Schema of the GeoJSON"),  # as GDAL spells it
                _link("http://www.opengis.net/def/rel/ogc/1.0/queryables", f"{address}/queryables", SCHEMA, "Filters"),
                *license_,
            ],
        }

    def items(self, collection: Collection, page: Page, asked: list[tuple[str, str]], following: str | None) -> str:
        """Return a page of features; `asked` are the parameters of the request, `following` is `after` of the next."""
        address = f"{self.address}/collections/{collection.id}"
        links = [
            _link("self", f"{address}/items{_query(asked)}", GEOJSON, "This document"),
            _link("collection", address, "application/json", collection.layer.title),
            _link("describedby", f"{address}/feature-schema", SCHEMA, "Schema of the GeoJSON"),
        ]
        if following is not None:
            rest = [(name, value) for name, value in asked if name != "after"]
            links.append(_link("next", f"{address}/items{_query([*rest, ('after', following)])}", GEOJSON, "Next page"))
        head = {
            "type": "FeatureCollection",
            "links": links,
            "numberMatched": page.matched,
            "numberReturned": len(page.features),
        }
        return f'{encode(head)[:-1]},"features":[{",".join(page.features)}]}}'

    def feature(self, collection: Collection, feature_id: str, feature: str) -> str:
        """Return one feature."""
        address = f"{self.address}/collections/{collection.id}"
        links = [
            _self(f"{address}/items/{quote(feature_id, safe='')}", GEOJSON),
            _link("collection", address, "application/json", collection.layer.title),
        ]
        return f'{feature[:-1]},"links":{encode(links)}}}'


def _link(relation: str, href: str, media_type: str, title: str) -> dict[str, str]:
    return {"rel": relation, "href": href, "type": media_type, "title": title}


def _self(address: str, media_type: str = "application/json") -> dict[str, str]:
    return _link("self", address, media_type, "This document")


def _query(parameters: list[tuple[str, str]]) -> str:
    return f"?{urlencode(parameters)}" if parameters else ""
