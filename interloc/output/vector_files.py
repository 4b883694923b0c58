"""A result as GeoPackage, FlatGeobuf or KML, for QGIS, Google Earth and other GIS.

The layers are those of the GeoJSON files, position for position and property for property; lists are JSON text.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from interloc.arrays import BoolArray
from interloc.errors import ConfigError, GeoreferenceError, OutputError
from interloc.files import atomic_write, reason_of
from interloc.output.geojson import Collection, read_collection, read_json
from interloc.output.layers import LAYERS, Layer
from interloc.output.layout import RUN_FILE, file_names

DRIVERS = {".gpkg": "GPKG", ".fgb": "FlatGeobuf", ".kml": "LIBKML"}
"""Suffix -> driver of GDAL. A GeoPackage holds all layers, the others hold one."""

_KML_NAMES = {"id": "number", "name": "street"}
"""Properties that mean something else in KML -> what they are called there."""


def write_vector_file(result: Path, out: Path, *, layer: str | None = None) -> list[str]:
    """Write a result folder as one vector file, whole or not at all.

    Parameters
    ----------
    result
        Result folder of a georeferenced drive.
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
        No such format or layer; the result was not evaluated, so it has no such layer.
    GeoreferenceError
        The result is in local metres.
    OutputError
        `result` is no result folder, or `out` could not be written.
    """
    driver = DRIVERS.get(out.suffix.lower())
    if driver is None:
        raise ConfigError(f"{out}: unknown format {out.suffix!r}. Expected one of {', '.join(DRIVERS)}.")
    names = _choose(result, layer, driver)
    layers = [(LAYERS[name], read_collection(result / f"{name}.geojson")) for name in names]
    if driver == "GPKG":
        _write_database(out, layers)
        return names
    ((only, collection),) = layers
    buffer = io.BytesIO()  # GDAL's KML driver says nothing of a full disk
    _write_layer(buffer, driver, only, collection)
    with atomic_write(out) as file:
        file.write(buffer.getvalue())
    return names


def _write_database(out: Path, layers: list[tuple[Layer, Collection]]) -> None:
    """Write a GeoPackage: SQLite needs a file that it can seek in, and others beside it."""
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name[:100]}.partial-", dir=out.parent))
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    try:
        for number, (layer, collection) in enumerate(layers):
            _write_layer(folder / out.name, "GPKG", layer, collection, append=number > 0)
        with (folder / out.name).open("rb") as file:
            os.fsync(file.fileno())
        (folder / out.name).replace(out)
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    except RuntimeError as error:  # of GDAL
        reason = str(error).replace(str(folder), str(out.parent))
        raise OutputError(f"{out} could not be written: {reason}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _choose(result: Path, layer: str | None, driver: str) -> list[str]:
    """Return the names of the layers to write."""
    wanted = None if layer is None else layer.replace("-", "_")
    if wanted is not None and wanted not in LAYERS:
        raise ConfigError(f"{layer!r} is no layer. Expected one of {', '.join(LAYERS)}.")
    if not read_json(result / RUN_FILE).get("georeferenced"):
        local = file_names(georeferenced=False)["intersections"]
        raise GeoreferenceError(
            f"{result} is in metres of its own frame, not in longitude and latitude: the drive has no georeference. "
            f"{local} holds the same."
        )
    there = [name for name in LAYERS if (result / f"{name}.geojson").exists()]
    if wanted is None:
        return there if driver == "GPKG" else ["intersections"]
    if wanted not in there:
        raise ConfigError(
            f"{result} has no {wanted}.geojson. It was not scored against a map: `interloc evaluate` does that."
        )
    return [wanted]


def _write_layer(
    sink: Path | io.BytesIO, driver: str, layer: Layer, collection: Collection, *, append: bool = False
) -> None:
    """Write a layer, or add it to a file."""
    from pyogrio.raw import write  # noqa: PLC0415 - GDAL is slow to load

    rows = [feature["properties"] for feature in collection.features]
    columns = _columns(layer, rows)
    if driver == "LIBKML":  # what Google Earth shows beside the point
        columns = {"Name": ("text", [_label(layer, row) for row in rows])} | {
            # GDAL writes 64 bit integers as text.
            _KML_NAMES.get(name, name): ("int32" if kind == "int" and name != "osm_id" else kind, values)
            for name, (kind, values) in columns.items()
        }
    data, masks = zip(*(_column(kind, values) for kind, values in columns.values()), strict=True)
    about = {"TITLE": layer.title, "ATTRIBUTION": layer.attribution}
    options = {
        "GPKG": {"IDENTIFIER": layer.title, "DESCRIPTION": layer.attribution},
        "FlatGeobuf": {"TITLE": layer.title, "DESCRIPTION": layer.attribution},
        "LIBKML": {"NAME": layer.title, "DESCRIPTION": layer.attribution},
    }[driver]
    write(
        sink,
        _geometries(layer, collection),
        data,
        list(columns),
        field_mask=masks,
        layer=layer.name,
        driver=driver,
        geometry_type=layer.geometry,
        crs="EPSG:4326",
        append=append,
        layer_metadata=about if driver == "GPKG" else None,
        layer_options=options,
    )


def _geometries(layer: Layer, collection: Collection) -> NDArray[np.object_]:
    """Return the geometries as WKB, (N,); None where a feature has none."""
    import shapely  # noqa: PLC0415 - slow to load

    make = shapely.Point if layer.geometry == "Point" else shapely.LineString
    places = [collection.geometry(row, layer.geometry) for row in range(len(collection))]
    geometries = np.empty(len(places), dtype=object)
    geometries[:] = [None if place is None else make(place) for place in places]
    return shapely.to_wkb(geometries).astype(np.object_)


def _columns(layer: Layer, rows: list[dict[str, Any]]) -> dict[str, tuple[str, list[Any]]]:
    """Return kind and values of each property: those that the layer is known for, then others in their order."""
    names = dict.fromkeys([*layer.fields, *(name for row in rows for name in row)])
    columns = {}
    for name in names:
        values = [row.get(name) for row in rows]
        columns[name] = (layer.fields.get(name) or _kind_of(values), values)
    return columns


def _kind_of(values: list[Any]) -> str:
    types = {type(value) for value in values if value is not None}
    for kind, allowed in (("bool", {bool}), ("int", {int}), ("float", {int, float}), ("list", {list, dict})):
        if types and types <= allowed:
            return kind
    return "text"


def _column(kind: str, values: list[Any]) -> tuple[NDArray[Any], BoolArray | None]:
    """Return the values as GDAL takes them, and which of them are null."""
    null = np.array([value is None for value in values], dtype=np.bool_)
    if kind in {"list", "text"}:
        texts = np.empty(len(values), dtype=object)
        texts[:] = [
            v if v is None else json.dumps(v, separators=(",", ":")) if kind == "list" else str(v) for v in values
        ]
        return texts, None
    dtype = {"int": np.int64, "int32": np.int32, "float": np.float64, "bool": np.bool_}[kind]
    return np.array([0 if value is None else value for value in values], dtype=dtype), null if null.any() else None


def _label(layer: Layer, properties: dict[str, Any]) -> str:
    try:
        return layer.label.format(**properties)
    except KeyError:
        return layer.title
