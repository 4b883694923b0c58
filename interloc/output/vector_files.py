"""A result as a file for other programs: QGIS, Google Earth, spreadsheets, web maps, DuckDB.

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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

from interloc.errors import ConfigError, GeoreferenceError, OutputError
from interloc.files import atomic_write, reason_of, write_file
from interloc.output.derived import derive
from interloc.output.geojson import cut, read_file, read_json, write_collection
from interloc.output.geopackage import add_road, describe
from interloc.output.geoparquet import has_parquet, parquet_bytes, require_parquet
from interloc.output.kml import NAMES, pack_kmz, style_kml
from interloc.output.layers import BUILDINGS, DERIVED, LAYERS, PLACES, Layer, Rows
from interloc.output.layout import ROAD_FILE, ROAD_LAYERS, RUN_FILE, file_names, refuse_result_file
from interloc.output.properties import origin_of
from interloc.output.qgis_project import Source, project, write_qgz
from interloc.output.road import read_road
from interloc.output.vector_tiles import TiledLayer, write_tiles

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

_FORMULA = re.compile(r"[=+\-@\t\r](?![\d.,+-]*$)")
"""Start of a text that spreadsheets would run; plain numbers are harmless."""


def write_vector_file(result: Path, out: Path, *, layer: str | None = None) -> list[str]:
    """Write a result folder as one vector file, whole or not at all.

    Parameters
    ----------
    result
        Result folder. One without georeference is written in metres of its own frame, without a coordinate system.
    out
        Its suffix, one of `FORMATS`, says the format; an older file of that name is replaced.
    layer : str or None
        One of `EXPORTS`. None: all layers of the result where the format holds several, else the
        intersections.

    Returns
    -------
    list of str
        The layers written.

    Raises
    ------
    ConfigError
        The format or the layer is unknown, the result has no such layer because it was not evaluated, a format
        that holds all was to hold one, GeoParquet is asked for without the extra ``parquet``, or `out` is a file that
        makes up a result folder.
    GeoreferenceError
        The result is in local metres, and is to be written as KML or PMTiles.
    OutputError
        `result` is not a result folder, or `out` could not be written.
    """
    suffix = out.suffix.lower()
    if suffix not in FORMATS:
        raise ConfigError(
            f"{out}: unknown format {out.suffix!r}. Expected one of {', '.join(FORMATS)}, or .tif of the layer road."
        )
    refuse_result_file(out)
    if suffix == ".parquet":
        require_parquet()
    names = _choose(result, layer, suffix)
    FORMATS[suffix].write(_Export(result, out, [(EXPORTS[name], _read(result, name)) for name in names]))
    return names


def suffixes_here() -> list[str]:
    """Return those of `FORMATS` that this installation writes."""
    return [suffix for suffix in FORMATS if suffix != ".parquet" or has_parquet()]


def write_live_project(result: Path, out: Path, source_of: Callable[[Layer], Source]) -> None:
    """Write a project of QGIS (``.qgs``) whose layers are read from the service that has the result.

    Parameters
    ----------
    result
        Result folder with georeference.
    out
        File to write.
    source_of
        Tells where the service has a layer.

    Raises
    ------
    OutputError
        `result` is not a result folder, or `out` could not be written.
    """
    layers = [(EXPORTS[name], _read(result, name)) for name in _choose(result, None, ".qgz")]
    write_file(out, project(layers, _name_of(result), source_of))


def _read(result: Path, name: str) -> Rows:
    """Read a layer; what results of older versions, and what is made of them, do not say of themselves is added."""
    if name in DERIVED:
        rows = derive(name, LAYERS["intersections"].read(result / "intersections.geojson"))
    else:
        rows = LAYERS[name].read(_file_of(result, name))
    origin = origin_of(read_json(result / RUN_FILE), _name_of(result))
    for feature in rows.features:
        if feature.properties.drive is None or feature.properties.preset is None:
            feature.properties.__dict__.update(origin)
    return rows


def _name_of(result: Path) -> str:
    run = read_json(result / RUN_FILE)
    return str(run.get("drive_name") or run.get("drive") or result.resolve().name)


def _in_metres(rows: Rows) -> bool:
    return rows.path.name in file_names(georeferenced=False).values()


class _Export(NamedTuple):
    """Layers of a result folder, and the file that is made of them."""

    result: Path
    out: Path
    layers: list[tuple[Layer, Rows]]

    @property
    def name(self) -> str:
        return _name_of(self.result)

    def save(self, content: bytes) -> None:
        write_file(self.out, content)


def _write_database(export: _Export) -> None:
    """Write a GeoPackage or the project around it: SQLite needs a file to seek in, and others beside it."""
    layers, run = export.layers, read_file(export.result / RUN_FILE).decode()
    with _folder_beside(export.out) as folder:
        database = folder / "result.gpkg"
        for number, (layer, rows) in enumerate(layers):
            _write_layer(database, "GPKG", layer, rows, append=number > 0)
        describe(database, [(layer, rows.credit) for layer, rows in layers], run)
        road: Path | None = export.result / ROAD_FILE
        if road is not None and road.is_file():
            add_road(database, read_road(road))
        else:
            road = None
        if export.out.suffix.lower() == ".qgz":
            data, database = database, database.with_name("project")
            write_qgz(database, data, layers, export.name, local=_in_metres(layers[0][1]), road=road)
        with database.open("rb") as file:
            os.fsync(file.fileno())
        database.replace(export.out)


def _write_tiles(export: _Export) -> None:
    tiled = [TiledLayer(each, rows.credit, _table_of_texts(each, rows)) for each, rows in export.layers]
    with _folder_beside(export.out) as folder, atomic_write(export.out) as file:
        write_tiles(file, export.name, tiled, folder)


def _write_geojson(export: _Export) -> None:
    ((layer, rows),) = export.layers
    write_collection(export.out, _features(layer, rows), local=_in_metres(rows), credit=rows.credit)


def _write_kmz(export: _Export) -> None:
    export.save(
        pack_kmz([(_layer_bytes("LIBKML", each, rows), each, rows) for each, rows in export.layers], export.name)
    )


def _of_one_layer(content: Callable[[Layer, Rows], bytes]) -> Callable[[_Export], None]:
    """Return the writer of a format whose files hold one layer and are made in memory."""

    def write(export: _Export) -> None:
        ((layer, rows),) = export.layers
        export.save(content(layer, rows))

    return write


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
    wanted = None if layer is None else layer.replace("-", "_")
    if wanted is not None and wanted not in EXPORTS:
        raise ConfigError(f"{layer!r} is not a layer. Expected one of {', '.join(EXPORTS)}, or road as .tif.")
    local = is_local(result)
    if local and FORMATS[suffix].only_on_earth:
        raise GeoreferenceError(
            f"{result} is in metres of its own frame, and {FORMATS[suffix].only_on_earth} knows longitude and latitude "
            f"only: the drive has no georeference. {PLACE_IT}, or write a .gpkg or .fgb, in metres."
        )
    there = [name for name in LAYERS if _file_of(result, name).exists()]
    if not local:
        there += DERIVED
    if wanted is None:
        return ["intersections"] if FORMATS[suffix].layers == "one" else there
    if FORMATS[suffix].layers == "all":
        raise ConfigError(f"A {suffix} file holds {', '.join(there)}; leave --layer out, or write a .gpkg.")
    if wanted not in there:
        raise ConfigError(f"{result} has no {wanted}.geojson. {_why_missing(result, wanted)}")
    return [wanted]


def _why_missing(result: Path, layer: str) -> str:
    if is_local(result):
        return f"It is in metres of its own frame: the drive has no georeference. {PLACE_IT}."
    if layer == PLACES:
        return "Only a drive that was placed on the map by its roads has it: `interloc run --locate` does that."
    if layer in ROAD_LAYERS:
        return "An older version of InterLoc made it, without a map of the roads; `interloc detect` draws one."
    if (result / "report.json").exists():
        if layer == BUILDINGS and "buildings" in read_json(result / "report.json").get("osm", {}):
            return "The map that it was scored against has no buildings near the drive."
        return "An older version of InterLoc scored it; `interloc evaluate` writes the layer."
    return "It was not scored against a map: `interloc evaluate` does that."


def is_local(result: Path) -> bool:
    """Return whether a result folder is in metres of its own frame, for want of a georeference."""
    return not read_json(result / RUN_FILE).get("georeferenced")


def _file_of(result: Path, name: str) -> Path:
    """Return the file of a layer, which has another name where it is in metres."""
    local = result / file_names(georeferenced=False).get(name, "")
    return local if local.is_file() else result / f"{name}.geojson"


def _layer_bytes(driver: str, layer: Layer, rows: Rows) -> bytes:
    buffer = io.BytesIO()  # GDAL's KML driver does not report a full disk
    _write_layer(buffer, driver, layer, rows)
    return buffer.getvalue()


def _write_layer(sink: Path | io.BytesIO, driver: str, layer: Layer, rows: Rows, *, append: bool = False) -> None:
    table = _table(layer, rows)
    if driver == "LIBKML":  # what Google Earth shows beside the point
        # GDAL's KML driver writes integers of 64 bits as text.
        small = {name: "Int32" for name, kind in layer.fields.items() if kind == "int" and name != "osm_id"}
        table = table.astype(small).rename(columns=NAMES)
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
    places = [None if each.geometry is None else each.geometry.coordinates for each in rows.features]
    return layer.features(places, **{name: rows.column(name) for name in layer.fields})


def _csv(layer: Layer, rows: Rows) -> bytes:
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
    return text.getvalue().encode()


def _places(layer: Layer, rows: Rows) -> list[list[Any]]:
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
            columns[name] = [
                None if value is None else json.dumps(value, separators=(",", ":")) for value in columns[name]
            ]
        if kind == "time":
            columns[name] = pandas.to_datetime(columns[name], utc=True, format="ISO8601")
    table = GeoDataFrame(columns, geometry=places, crs=None if _in_metres(rows) else "EPSG:4326")
    return table.astype({name: _DTYPES[kind] for name, kind in layer.fields.items()})


def _table_of_texts(layer: Layer, rows: Rows) -> Any:  # noqa: ANN401 - geopandas has no types
    """Return the same with times as text, for formats that have no times."""
    times = [name for name, kind in layer.fields.items() if kind == "time"]
    return _table(layer, rows).assign(**{name: rows.column(name) for name in times})


class Format(NamedTuple):
    """How a file of a format is written, and what it holds."""

    write: Callable[[_Export], None]
    """Writes it, whole or not at all."""
    layers: Literal["one", "any", "all"] = "one"
    """{"one", "any", "all"}: one layer; all, unless one is named; or always all that belong into it."""
    only_on_earth: str = ""
    """Its name, where it knows longitude and latitude only."""


FORMATS = {
    ".gpkg": Format(_write_database, "any"),
    ".qgz": Format(_write_database, "all"),
    ".fgb": Format(_of_one_layer(partial(_layer_bytes, "FlatGeobuf"))),
    ".kml": Format(
        _of_one_layer(lambda layer, rows: style_kml(_layer_bytes("LIBKML", layer, rows), layer, rows)), "one", "KML"
    ),
    ".kmz": Format(_write_kmz, "any", "KML"),
    ".csv": Format(_of_one_layer(_csv)),
    ".geojson": Format(_write_geojson),
    ".parquet": Format(
        _of_one_layer(lambda layer, rows: parquet_bytes(_table(layer, rows), layer.description, rows.credit))
    ),
    ".pmtiles": Format(_write_tiles, "any", "PMTiles"),
}
"""Suffix -> format."""
