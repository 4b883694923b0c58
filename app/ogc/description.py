"""The interface of one source as a document of OpenAPI 3.0, whose addresses begin at its landing page.

The document of the whole service is of OpenAPI 3.1, and has the interface below other addresses. GDAL and QGIS look for
``/collections/{id}/items`` in the one that the landing page names: for its largest page, and for what may be asked of
the service, so that filters need not be worked on by themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from app.ogc.collections import Collection, schema_of

_COLLECTION = "/collections/{collection_id}"
_ITEMS = f"{_COLLECTION}/items"
_PASSWORD = {"type": "http", "scheme": "basic", "description": "Any user name, and the token as the password."}


def describe_interface(
    document: Mapping[str, Any], prefix: str, collections: Mapping[str, Collection], address: str
) -> dict[str, Any]:
    """Return the part of a description of OpenAPI 3.1 that is about a source, as one of OpenAPI 3.0.

    Parameters
    ----------
    document
        Describes the service.
    prefix
        Where the landing page is in it.
    collections
        Those of the source.
    address
        Of the landing page.
    """
    paths: dict[str, Any] = {}
    for path, operations in document["paths"].items():
        if path == prefix or path.startswith(f"{prefix}/"):
            paths[path.removeprefix(prefix) or "/"] = _older(operations)
    items = paths.pop(_ITEMS)["get"]
    names = {"type": "string", "enum": list(collections)}
    given = {"collection_id", *(part[1:-1] for part in prefix.split("/") if part.startswith("{"))}
    for operations in paths.values():
        operation = operations["get"]
        operation["parameters"] = [
            {**each, "schema": names} if each["name"] == "collection_id" else each
            for each in operation.get("parameters", ())
            if each["name"] not in given - {"collection_id"}
        ]
    shared = {each["name"]: each for each in items["parameters"] if each["name"] not in given}
    for name, collection in collections.items():
        paths[_ITEMS.format(collection_id=name)] = {
            "get": {
                **items,
                "operationId": f"{items['operationId']}_of_{name}",
                "summary": f"{items['summary']}: {collection.layer.title}",
                "parameters": [
                    *({"$ref": f"#/components/parameters/{each}"} for each in shared),
                    *_queryables(collection),
                ],
            }
        }
    for path, operations in paths.items():
        own = operations["get"].get("security", ())
        paths[path] = {"get": {**operations["get"], "security": [*own, {"password": []}]}}
    return {
        "openapi": "3.0.3",
        "info": {name: text for name, text in document["info"].items() if name in {"title", "version"}},
        "servers": [{"url": address}],
        "paths": paths,
        "components": {**_components(document["components"], paths), "parameters": shared},
    }


def _older(node: Any) -> Any:  # noqa: ANN401 - JSON
    """Return a description as OpenAPI 3.0 has it: it does not know the type null, const and examples of schemas."""
    if isinstance(node, list):
        return [_older(each) for each in node]
    if not isinstance(node, dict):
        return node
    found = {name: _older(each) for name, each in node.items()}
    if {"type": "null"} in found.get("anyOf", ()):
        (only,) = (each for each in found.pop("anyOf") if each != {"type": "null"})
        found = {**only, **found, "nullable": True}
    if isinstance(found.get("const"), str):
        found["enum"] = [found.pop("const")]
    if isinstance(found.get("examples"), list):
        found["example"] = found.pop("examples")[0]
    return found


def _queryables(collection: Collection) -> Iterator[dict[str, Any]]:
    for attribute in collection.attributes:
        if attribute.name in collection.queryables:
            described = schema_of(attribute)
            yield {
                "name": attribute.name,
                "in": "query",
                "description": described["description"],
                "required": False,
                "style": "form",
                "explode": False,
                "schema": {name: value for name, value in described.items() if name in {"type", "format"}},
            }


def _components(components: Mapping[str, Any], paths: Mapping[str, Any]) -> dict[str, Any]:
    """Return the components that these addresses refer to."""
    found: dict[str, dict[str, Any]] = {}
    wanted = list(_references(paths))
    while wanted:
        _, _, kind, name = wanted.pop().split("/")
        if kind != "parameters" and name not in found.setdefault(kind, {}):
            found[kind][name] = _older(components[kind][name])
            wanted += _references(found[kind][name])
    return {**found, "securitySchemes": {**_older(components["securitySchemes"]), "password": _PASSWORD}}


def _references(node: Any) -> Iterator[str]:  # noqa: ANN401 - JSON
    if isinstance(node, dict):
        if "$ref" in node:
            yield node["$ref"]
        node = list(node.values())
    if isinstance(node, list):
        for each in node:
            yield from _references(each)
