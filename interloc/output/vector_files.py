"""A result as GeoPackage, FlatGeobuf or KML, for QGIS, Google Earth and other GIS.

The layers are those of the GeoJSON files, position for position and property for property; lists are JSON text.
"""

from __future__ import annotations

import io
import json
import os
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from interloc.errors import ConfigError, GeoreferenceError, OutputError
from interloc.files import atomic_write, reason_of
from interloc.output.geojson import read_json
from interloc.output.layers import LAYERS, Layer, Rows
from interloc.output.layout import RUN_FILE, file_names

DRIVERS = {".gpkg": "GPKG", ".fgb": "FlatGeobuf", ".kml": "LIBKML"}
"""Suffix -> driver of GDAL. A GeoPackage holds all layers, the others hold one."""

PLACE_IT = (
    "Place it: `interloc locate DRIVE --osm MAP -o geo.csv` finds it by its roads, or put a geo.csv into the drive; "
    "then detect again"
)
"""What makes a result in metres one on the map."""

_DTYPES = {"int": "Int64", "float": "float64", "bool": "boolean", "text": "object", "list": "object"}
"""Kind of a property -> column of pandas; those with a capital letter and the objects know null."""

_KML_NAMES = {"id": "number", "name": "street"}
"""Properties that mean something else in KML -> what they are called there."""


def write_vector_file(result: Path, out: Path, *, layer: str | None = None) -> list[str]:
    """Write a result folder as one vector file, whole or not at all.

    Parameters
    ----------
    result
        Result folder. One without georeference is written in metres of its own frame, without a coordinate system.
    out
        ``.gpkg``, ``.fgb`` or ``.kml``; an older file of that name is replaced.
    layer : str or None
        One of `LAYERS`. None: all layers of the result in a GeoPackage, else the intersections.

    Returns
    -------
    list of str
        The layers written.

    Raises
    ------
    ConfigError
        The format or the layer is unknown, or the result has no such layer because it was not evaluated.
    GeoreferenceError
        The result is in local metres, and is to be written as KML.
    OutputError
        `result` is not a result folder, or `out` could not be written.
    """
    driver = DRIVERS.get(out.suffix.lower())
    if driver is None:
        raise ConfigError(f"{out}: unknown format {out.suffix!r}. Expected one of {', '.join(DRIVERS)}.")
    names = _choose(result, layer, driver)
    layers = [(LAYERS[name], LAYERS[name].read(_file_of(result, name))) for name in names]
    if driver == "GPKG":
        _write_database(out, layers)
        return names
    ((only, rows),) = layers
    buffer = io.BytesIO()  # GDAL's KML driver does not report a full disk
    _write_layer(buffer, driver, only, rows)
    with atomic_write(out) as file:
        file.write(buffer.getvalue())
    return names


def _write_database(out: Path, layers: list[tuple[Layer, Rows]]) -> None:
    """Write a GeoPackage: SQLite needs a file that it can seek in, and others beside it."""
    prefix = f".{out.name[:100]}.partial-"
    try:
        with TemporaryDirectory(prefix=prefix, dir=out.parent, ignore_cleanup_errors=True) as folder:
            database = Path(folder) / out.name
            for number, (layer, rows) in enumerate(layers):
                _write_layer(database, "GPKG", layer, rows, append=number > 0)
            with database.open("rb") as file:
                os.fsync(file.fileno())
            database.replace(out)
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    except RuntimeError as error:  # of GDAL
        reason = str(error).replace(folder, str(out.parent))
        raise OutputError(f"{out} could not be written: {reason}") from error


def _choose(result: Path, layer: str | None, driver: str) -> list[str]:
    """Return the names of the layers to write."""
    wanted = None if layer is None else layer.replace("-", "_")
    if wanted is not None and wanted not in LAYERS:
        raise ConfigError(f"{layer!r} is not a layer. Expected one of {', '.join(LAYERS)}.")
    if is_local(result) and driver == "LIBKML":
        raise GeoreferenceError(
            f"{result} is in metres of its own frame, and KML knows longitude and latitude only: the drive has no "
            f"georeference. {PLACE_IT}, or write a .gpkg or .fgb, in metres."
        )
    there = [name for name in LAYERS if _file_of(result, name).exists()]
    if wanted is None:
        return there if driver == "GPKG" else ["intersections"]
    if wanted not in there:
        raise ConfigError(
            f"{result} has no {wanted}.geojson. It was not scored against a map: `interloc evaluate` does that."
        )
    return [wanted]


def is_local(result: Path) -> bool:
    """Return whether a result folder is in metres of its own frame, for want of a georeference."""
    return not read_json(result / RUN_FILE).get("georeferenced")


def _file_of(result: Path, name: str) -> Path:
    """Return the file of a layer, which has another name where it is in metres."""
    local = result / file_names(georeferenced=False).get(name, "")
    return local if local.is_file() else result / f"{name}.geojson"


def _write_layer(sink: Path | io.BytesIO, driver: str, layer: Layer, rows: Rows, *, append: bool = False) -> None:
    """Write a layer, or add it to a file."""
    table = _table(layer, rows)
    if driver == "LIBKML":  # what Google Earth shows beside the point
        # GDAL's KML driver writes integers of 64 bits as text.
        small = {name: "Int32" for name, kind in layer.fields.items() if kind == "int" and name != "osm_id"}
        table = table.astype(small).rename(columns=_KML_NAMES)
        table.insert(0, "Name", [layer.label.format(**vars(feature.properties)) for feature in rows.features])
    metadata = {"TITLE": layer.title, "ATTRIBUTION": layer.attribution}
    title = {"GPKG": "IDENTIFIER", "FlatGeobuf": "TITLE", "LIBKML": "NAME"}[driver]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "'crs' was not provided")  # metres claim no place
        table.to_file(
            sink,
            driver=driver,
            engine="pyogrio",
            mode="a" if append else "w",
            layer=layer.name,
            geometry_type=layer.geometry,
            layer_metadata=metadata if driver == "GPKG" else None,
            layer_options={title: layer.title, "DESCRIPTION": layer.attribution},
        )


def _table(layer: Layer, rows: Rows) -> Any:  # noqa: ANN401 - geopandas has no types
    """Return a GeoDataFrame with the properties of the layer, null where they are null, and lists as JSON text."""
    import shapely  # noqa: PLC0415 - slow to import
    from geopandas import GeoDataFrame  # noqa: PLC0415

    places: Any
    if layer.geometry == "Point":
        places = shapely.points(rows.points())
    else:
        places = [f.geometry and shapely.LineString(f.geometry.coordinates) for f in rows.features]
    columns = {name: rows.column(name) for name in layer.fields}
    for name, kind in layer.fields.items():
        if kind == "list":
            columns[name] = [json.dumps(value, separators=(",", ":")) for value in columns[name]]
    local = rows.path.name in file_names(georeferenced=False).values()
    table = GeoDataFrame(columns, geometry=places, crs=None if local else "EPSG:4326")
    return table.astype({name: _DTYPES[kind] for name, kind in layer.fields.items()})
