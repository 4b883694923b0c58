"""A result as a file for other programs: QGIS, Google Earth, spreadsheets, web maps, navigation devices, DuckDB.

The layers are those of the GeoJSON files, position for position and property for property, and those that are made of
them (`interloc.output.derived`). Lists are JSON text, but in GeoJSON.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import sqlite3
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from interloc.errors import ConfigError, GeoreferenceError, OutputError
from interloc.files import atomic_write, reason_of
from interloc.output.derived import derive
from interloc.output.geojson import cut, read_file, read_json, write_collection
from interloc.output.geopackage import describe
from interloc.output.geoparquet import has_parquet, parquet_bytes, require_parquet
from interloc.output.gpx import GPX_LAYERS, write_gpx
from interloc.output.layers import DERIVED, LAYERS, PLACES, Layer, Rows
from interloc.output.layout import RUN_FILE, file_names
from interloc.output.vector_tiles import TiledLayer, write_tiles

DRIVERS = {".gpkg": "GPKG", ".fgb": "FlatGeobuf", ".kml": "LIBKML"}
"""Suffix -> driver of GDAL."""

SUFFIXES = (*DRIVERS, ".csv", ".geojson", ".parquet", ".pmtiles", ".gpx")
"""A GeoPackage and PMTiles hold all layers, a GPX file the track and the intersections, the others one layer."""

_WHOLE = {".gpkg", ".pmtiles"}
_NEED_PLACE = {".kml": "KML", ".pmtiles": "PMTiles", ".gpx": "GPX"}

EXPORTS = LAYERS | DERIVED

PLACE_IT = (
    "Place it: `interloc locate DRIVE --osm MAP -o geo.csv` finds it by its roads, or put a geo.csv into the drive; "
    "then detect again"
)
"""What makes a result in metres one on the map."""

_DTYPES = {
    "int": "Int64",
    "float": "float64",
    "bool": "boolean",
    "text": "object",
    "time": "datetime64[ms, UTC]",
    "list": "object",
}
"""Kind of a property -> column of pandas; those with a capital letter and the objects know null."""

_KML_NAMES = {"id": "number", "name": "street", "time": "timestamp", "first_time": "begin", "last_time": "end"}
"""Properties that mean something else in KML, or something that KML has a name for -> what they are called there."""

_FORMULA = re.compile(r"[=+\-@\t\r](?![\d.,+-]*$)")
"""Start of a text that spreadsheets would run; plain numbers are harmless."""


def write_vector_file(result: Path, out: Path, *, layer: str | None = None) -> list[str]:
    """Write a result folder as one vector file, whole or not at all.

    Parameters
    ----------
    result
        Result folder. One without georeference is written in metres of its own frame, without a coordinate system.
    out
        Its suffix, one of `SUFFIXES`, says the format; an older file of that name is replaced.
    layer : str or None
        One of `EXPORTS`; in GPX one of `GPX_LAYERS`. None: all layers of the result in a GeoPackage and in PMTiles,
        those two in GPX, else the intersections.

    Returns
    -------
    list of str
        The layers written.

    Raises
    ------
    ConfigError
        The format or the layer is unknown, or the result has no such layer because it was not evaluated; or
        GeoParquet is asked for without the extra ``parquet``.
    GeoreferenceError
        The result is in local metres, and is to be written as KML, PMTiles or GPX.
    OutputError
        `result` is not a result folder, or `out` could not be written.
    """
    suffix = out.suffix.lower()
    if suffix not in SUFFIXES:
        raise ConfigError(f"{out}: unknown format {out.suffix!r}. Expected one of {', '.join(SUFFIXES)}.")
    if suffix == ".parquet":
        require_parquet()
    names = _choose(result, layer, suffix)
    layers = [(EXPORTS[name], _read(result, name)) for name in names]
    if suffix == ".gpkg":
        _write_database(out, layers, read_file(result / RUN_FILE).decode())
        return names
    drive = str(read_json(result / RUN_FILE).get("drive_name", result.name))
    if suffix == ".pmtiles":
        tiled = [TiledLayer(each, rows.credit, _table_of_texts(each, rows)) for each, rows in layers]
        with _folder_beside(out) as folder, atomic_write(out) as file:
            write_tiles(file, drive, tiled, folder)
        return names
    if suffix == ".gpx":
        found = dict(zip(names, (rows for _, rows in layers), strict=True))
        track = (found["trajectory"], _read(result, "keyframes")) if "trajectory" in found else None
        with atomic_write(out) as file:
            file.write(write_gpx(drive, track=track, waypoints=found.get("intersections")).encode())
        return names
    ((only, rows),) = layers
    if suffix == ".geojson":
        write_collection(out, _features(only, rows), local=_in_metres(rows), credit=rows.credit)
        return names
    buffer = io.BytesIO()  # GDAL's KML driver does not report a full disk
    if suffix == ".csv":
        buffer.write(_csv(only, rows).encode())
    elif suffix == ".parquet":
        buffer.write(parquet_bytes(_table(only, rows), only.description, rows.credit))
    else:
        _write_layer(buffer, DRIVERS[suffix], only, rows)
    with atomic_write(out) as file:
        file.write(buffer.getvalue())
    return names


def suffixes_here() -> list[str]:
    """Return those of `SUFFIXES` that this installation writes."""
    return [suffix for suffix in SUFFIXES if suffix != ".parquet" or has_parquet()]


def _read(result: Path, name: str) -> Rows:
    if name in DERIVED:
        return derive(name, LAYERS["intersections"].read(result / "intersections.geojson"))
    return LAYERS[name].read(_file_of(result, name))


def _in_metres(rows: Rows) -> bool:
    return rows.path.name in file_names(georeferenced=False).values()


def _write_database(out: Path, layers: list[tuple[Layer, Rows]], run: str) -> None:
    """Write a GeoPackage: SQLite needs a file that it can seek in, and others beside it."""
    with _folder_beside(out) as folder:
        database = folder / out.name
        for number, (layer, rows) in enumerate(layers):
            _write_layer(database, "GPKG", layer, rows, append=number > 0)
        describe(database, [(layer, rows.credit) for layer, rows in layers], run)
        with database.open("rb") as file:
            os.fsync(file.fileno())
        database.replace(out)


@contextmanager
def _folder_beside(out: Path) -> Iterator[Path]:
    """Make a folder for what becomes a file; what GDAL, SQLite or the system could not write is an OutputError."""
    prefix = f".{out.name[:100]}.partial-"
    try:
        with TemporaryDirectory(prefix=prefix, dir=out.parent, ignore_cleanup_errors=True) as folder:
            yield Path(folder)
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    except (RuntimeError, sqlite3.Error) as error:  # of GDAL, of SQLite
        reason = str(error).replace(folder, str(out.parent))
        raise OutputError(f"{out} could not be written: {reason}") from error


def _choose(result: Path, layer: str | None, suffix: str) -> list[str]:
    """Return the names of the layers to write."""
    wanted = None if layer is None else layer.replace("-", "_")
    if wanted is not None and wanted not in EXPORTS:
        raise ConfigError(f"{layer!r} is not a layer. Expected one of {', '.join(EXPORTS)}.")
    local = is_local(result)
    if local and suffix in _NEED_PLACE:
        raise GeoreferenceError(
            f"{result} is in metres of its own frame, and {_NEED_PLACE[suffix]} knows longitude and latitude only: the "
            f"drive has no georeference. {PLACE_IT}, or write a .gpkg or .fgb, in metres."
        )
    if suffix == ".gpx" and wanted not in {None, *GPX_LAYERS}:
        raise ConfigError(f"A GPX file has no layer {wanted}. Expected {' or '.join(GPX_LAYERS)}, or none for both.")
    there = [name for name in LAYERS if _file_of(result, name).exists()]
    if not local:
        there += DERIVED
    if wanted is None:
        if suffix == ".gpx":
            return list(GPX_LAYERS)
        return there if suffix in _WHOLE else ["intersections"]
    if wanted not in there:
        raise ConfigError(f"{result} has no {wanted}.geojson. {_why_missing(result, wanted)}")
    return [wanted]


def _why_missing(result: Path, layer: str) -> str:
    if is_local(result):
        return f"It is in metres of its own frame: the drive has no georeference. {PLACE_IT}."
    if layer == PLACES:
        return "Only a drive that was placed on the map by its roads has it: `interloc run --locate` does that."
    if (result / "report.json").exists():
        return "An older version of InterLoc scored it; `interloc evaluate` writes the layer."
    return "It was not scored against a map: `interloc evaluate` does that."


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
    told = f"{layer.description} {rows.credit.attribution}"
    title = {"GPKG": "IDENTIFIER", "FlatGeobuf": "TITLE", "LIBKML": "NAME"}[driver]
    is_database = driver == "GPKG"
    is_cut = bool(table.geom_type.str.startswith("Multi").any())  # at the antimeridian
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "'crs' was not provided")  # metres claim no place
        table.to_file(
            sink,
            driver=driver,
            engine="pyogrio",
            mode="a" if append else "w",
            layer=layer.name,
            geometry_type=f"Multi{layer.geometry}" if is_cut else layer.geometry,
            promote_to_multi=is_cut,
            # GDAL before 3.7, as in Debian 12, warns of version 1.4.
            dataset_options={"VERSION": "1.3"} if is_database and not append else None,
            layer_options={title: layer.title, "DESCRIPTION": told},
        )


def _features(layer: Layer, rows: Rows) -> list[dict[str, Any]]:
    """Return rows as GeoJSON features again."""
    places = [None if each.geometry is None else each.geometry.coordinates for each in rows.features]
    return layer.features(places, **{name: rows.column(name) for name in layer.fields})


def _csv(layer: Layer, rows: Rows) -> str:
    """Return rows as RFC 4180 with a head: points with `lon`, `lat` or `x_m`, `y_m`, others with `wkt`; null is empty.

    Where the rows hold data of OpenStreetMap, the last column says so.
    """
    text = io.StringIO()
    writer = csv.writer(text)
    point = ["x_m", "y_m"] if _in_metres(rows) else ["lon", "lat"]
    place = point if layer.geometry == "Point" else ["wkt"]
    credit = [] if rows.credit.license is None else [rows.credit.attribution]
    writer.writerow([*place, *layer.fields, *(["attribution"] if credit else [])])
    for feature, where in zip(rows.features, _places(layer, rows), strict=True):
        values = [_cell(getattr(feature.properties, name)) for name in layer.fields]
        writer.writerow([*where, *values, *credit])
    return text.getvalue()


def _places(layer: Layer, rows: Rows) -> list[list[Any]]:
    """Return the cells of the place of each row."""
    if layer.geometry == "Point":
        return rows.points().tolist()  # type: ignore[no-any-return]
    import shapely  # noqa: PLC0415 - slow to import

    return [
        ["" if shape is None else shapely.to_wkt(shapely.geometry.shape(shape), rounding_precision=7, trim=False)]
        for shape in _shapes(layer, rows)
    ]


def _shapes(layer: Layer, rows: Rows) -> list[dict[str, Any] | None]:
    """Return lines or polygons as GeoJSON geometries, cut at the antimeridian."""
    lines = [
        each.geometry and {"type": layer.geometry, "coordinates": each.geometry.coordinates} for each in rows.features
    ]
    return lines if _in_metres(rows) else [cut(line) for line in lines]


def _cell(value: Any) -> Any:  # noqa: ANN401
    """Return a value as a cell; a text that spreadsheets would run as a formula gets an apostrophe in front."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return json.dumps(value, separators=(",", ":"))
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def _table(layer: Layer, rows: Rows) -> Any:  # noqa: ANN401 - geopandas has no types
    """Return a GeoDataFrame with the properties of the layer, null where they are null, and lists as JSON text."""
    import pandas  # noqa: PLC0415, ICN001 - slow to import
    import shapely  # noqa: PLC0415
    from geopandas import GeoDataFrame  # noqa: PLC0415

    places: Any
    if layer.geometry == "Point":
        places = shapely.points(rows.points())
    else:
        places = [shape and shapely.geometry.shape(shape) for shape in _shapes(layer, rows)]
    columns = {name: rows.column(name) for name in layer.fields}
    for name, kind in layer.fields.items():
        if kind == "list":
            columns[name] = [json.dumps(value, separators=(",", ":")) for value in columns[name]]
        if kind == "time":
            columns[name] = pandas.to_datetime(columns[name], utc=True, format="ISO8601")
    table = GeoDataFrame(columns, geometry=places, crs=None if _in_metres(rows) else "EPSG:4326")
    return table.astype({name: _DTYPES[kind] for name, kind in layer.fields.items()})


def _table_of_texts(layer: Layer, rows: Rows) -> Any:  # noqa: ANN401 - geopandas has no types
    """Return the same with times as text, for formats that have no times."""
    times = [name for name, kind in layer.fields.items() if kind == "time"]
    return _table(layer, rows).assign(**{name: rows.column(name) for name in times})
