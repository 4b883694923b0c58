"""The collections: the layers of results, with the schema of their features."""

from dataclasses import dataclass
from functools import cached_property

from sqlalchemy import Table

from app.store.models import OF_MAPS, OF_RESULTS
from app.work.requests import RESULT_LAYERS
from interloc.arrays import JsonObject
from interloc.output.layers import CITY_LAYERS, DERIVED, MAIN_LAYERS, Layer
from interloc.output.properties import Attribute, Origin, attributes_of

RESULT = attributes_of(Origin)
"""The properties that every feature of a result has beside its own; its table does not hold them."""

GEOMETRY = "geometry"
"""Name of the geometry in schemas and filters."""

KINDS: dict[str, JsonObject] = {
    "int": {"type": "integer"},
    "float": {"type": "number"},
    "bool": {"type": "boolean"},
    "text": {"type": "string"},
    "time": {"type": "string", "format": "date-time"},
    "list": {"type": "array", "items": {"type": "number"}},
}
_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_SHAPES = {"Point": "point", "LineString": "any", "Polygon": "any"}  # lines and areas may have several parts


@dataclass(frozen=True)
class Collection:
    """A layer as a collection."""

    id: str
    """Its name in addresses."""
    layer: Layer
    of_results: bool = True
    """Whether its features are of results of drives, and say of which."""

    @cached_property
    def attributes(self) -> list[Attribute]:
        """The properties of its features; `id` is that of the feature itself, of which GDAL would make two fields."""
        own = (each for each in self.layer.attributes if each.name != "id")
        return [*own, *(RESULT if self.of_results else ())]

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Its properties -> int, float, bool, text, time or list."""
        return {each.name: each.kind for each in self.attributes}

    @cached_property
    def queryables(self) -> dict[str, str]:
        """The properties that filters may name -> int, float, bool, text or time; the geometry is none of them."""
        return {name: kind for name, kind in self.kinds.items() if kind != "list"}

    @property
    def table(self) -> Table:
        """The table of its features."""
        return (OF_RESULTS if self.of_results else OF_MAPS)[self.layer.name]

    @property
    def is_point(self) -> bool:
        """Whether its features are points."""
        return self.layer.geometry == "Point"

    def feature_schema(self, address: str) -> JsonObject:
        """Return the JSON schema of its features as GeoJSON, from which GDAL takes the types of properties.

        Lists are left out: GDAL would take them for texts, where it knows better by looking at features.
        """
        return {
            **self._head(address),
            "required": ["type", "geometry", "properties"],
            "properties": {
                "type": {"type": "string", "const": "Feature"},
                "id": {"type": "string"},
                "geometry": {"$ref": f"https://geojson.org/schema/{'Point' if self.is_point else 'Geometry'}.json"},
                "properties": {"type": "object", "properties": self._described()},
            },
        }

    def queryables_schema(self, address: str) -> JsonObject:
        """Return the JSON schema of what filters may name (part 3), which stands at this address."""
        shape = {"x-ogc-role": "primary-geometry", "format": f"geometry-{_SHAPES[self.layer.geometry]}"}
        properties = {GEOMETRY: shape, **self._described()}
        return {**self._head(address), "properties": properties, "additionalProperties": False}

    def _described(self) -> JsonObject:
        return {each.name: schema_of(each) for each in self.attributes if each.kind != "list"}

    def _head(self, address: str) -> JsonObject:
        return {
            "$schema": _DRAFT,
            "$id": address,
            "title": self.layer.title,
            "description": self.layer.description,
            "type": "object",
        }


def schema_of(attribute: Attribute) -> JsonObject:
    """Return the JSON schema of a property."""
    described = {"title": attribute.title, "description": attribute.description, **KINDS[attribute.kind]}
    if attribute.unit is not None:
        described["x-ogc-unit"] = attribute.unit
    return described


OF_JOB = {name: Collection(name, layer) for name, layer in RESULT_LAYERS.items()}
"""The collections of one job, as far as its result has them, by their ids."""

OF_ALL = {name: OF_JOB[name] for name in (*MAIN_LAYERS, "detections", "keyframes", *DERIVED, "matches")}
"""The collections of the results that stand for all drives."""

OF_MAP = {name: Collection(name, layer, of_results=False) for name, layer in CITY_LAYERS.items()}
"""The collections of a map of many drives."""
