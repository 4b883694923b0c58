"""The tables of features: a layer is a table, as in a GeoPackage, and its properties are the columns.

Filters are SQL over typed columns; properties as JSON took ten times as long. The rows of a layer of a result lie side
by side, by the key, and one index finds them by their west: a box is a range of it, since `FeatureLayer.width` says how
far to the west of a box a feature can begin that touches it. The tables hold nothing that the results do not: where
properties differ from those of this version they are made anew, empty, and a start of the server fills them in.
"""

from typing import Any

from sqlalchemy import BigInteger, Boolean, Column, Connection, Float, ForeignKey, Index, Integer, Table, Text, inspect
from sqlalchemy import delete as delete_rows

from app.store.models import Base, FeatureLayer
from app.work.layers import RESULT_LAYERS
from interloc.output.layers import CITY_LAYERS, Layer

_TEXT = Text().with_variant(Text(collation="C"), "postgresql")  # compared by code points, as SQLite does
_TYPES: dict[str, Any] = {"int": BigInteger, "float": Float, "bool": Boolean, "text": _TEXT, "time": _TEXT}
SOUGHT = ("outcome", "osm_id")
"""Properties that have an index: what features are asked for by most."""


def _table(prefix: str, layer: Layer) -> Table:
    """Return the table of a layer; lists and geometries are JSON, those of points only their west and south."""
    name = f"{prefix}_{layer.name}"
    is_point = layer.geometry == "Point"
    box = ["west", "south"] if is_point else ["west", "south", "east", "north"]
    attributes = layer.attributes
    return Table(
        name,
        Base.metadata,
        Column("layer_id", Integer, ForeignKey(FeatureLayer.id, ondelete="CASCADE"), primary_key=True),
        Column("number", Integer, primary_key=True, autoincrement=False),
        *(Column(side, Float) for side in box),
        *(Column(each.name, _TYPES[each.kind]) for each in attributes if each.kind != "list"),
        Column("feature_id", _TEXT, nullable=False),
        *(Column(each.name, Text) for each in attributes if each.kind == "list"),
        *([] if is_point else [Column("geometry", Text)]),
        Index(f"ix_{name}", "layer_id", *box),
        *(Index(f"ix_{name}_{each}", "layer_id", each, *box) for each in SOUGHT if each in layer.fields),
        sqlite_with_rowid=False,
    )


OF_RESULTS = {name: _table("features", layer) for name, layer in RESULT_LAYERS.items()}
OF_MAPS = {name: _table("features_of_map", layer) for name, layer in CITY_LAYERS.items()}
_TABLES = {table.name: table for table in (*OF_RESULTS.values(), *OF_MAPS.values())}


def make_tables(connection: Connection) -> None:
    """Make the tables anew, empty, unless all are there with the columns of this version."""
    there = inspect(connection).get_multi_columns(filter_names=list(_TABLES))
    columns = {str(name): {each["name"] for each in found} for (_, name), found in there.items()}
    if columns != {name: set(table.columns.keys()) for name, table in _TABLES.items()}:
        Base.metadata.drop_all(connection, tables=list(_TABLES.values()))
        connection.execute(delete_rows(FeatureLayer))
        Base.metadata.create_all(connection, tables=list(_TABLES.values()))
