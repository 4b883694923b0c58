"""A result as a file for other programs: QGIS, Google Earth, spreadsheets, web maps, DuckDB.

The layers are those of the GeoJSON files, position for position and property for property, and those that are made of
them (`interloc.output.layers`). Lists are JSON text, but in GeoJSON. `FORMATS` says how each format is written.
"""

import csv
import errno
import importlib.util
import io
import json
import os
import re
import sqlite3
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple
from xml.sax.saxutils import escape
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from interloc.errors import ConfigError, GeoreferenceError, OutputError, install
from interloc.files import reason_of
from interloc.output.credits import OWN_CREDIT
from interloc.output.geojson import cut, read_json, write_collection
from interloc.output.layers import DERIVED, LAYERS, MAIN_LAYERS, Layer, Rows, derived_features
from interloc.output.layout import BUILDINGS, PLACES, ROAD_FILE, ROAD_LAYERS, RUN_FILE, file_names, refuse_result_file
from interloc.output.properties import origin_of
from interloc.output.qgis import qml, write_qgz

_STYLES = """
CREATE TABLE IF NOT EXISTS layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256), f_table_schema TEXT(256),
  f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT,
  useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30), update_time DATETIME DEFAULT
  (strftime('%Y-%m-%dT%H:%M:%fZ','now')));
INSERT OR REPLACE INTO gpkg_contents (table_name, data_type, identifier, description)
  VALUES ('layer_styles', 'attributes', 'layer_styles', 'How QGIS draws the layers.');
"""
"""The table of a GeoPackage in which QGIS keeps styles."""


def add_styles(database: Path, layers: Sequence[Layer]) -> None:
    """Add to a GeoPackage how QGIS draws its layers; a full disk is an sqlite3.Error."""
    with closing(sqlite3.connect(database)) as connection, connection as sql:
        sql.executescript(_STYLES)
        sql.executemany(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, styleName, "
            "styleQML, useAsDefault, description, owner) VALUES ('', '', ?, 'geom', 'InterLoc', ?, 1, ?, '')",
            [(layer.name, qml(layer), layer.title) for layer in layers],
        )


EXPORTS = LAYERS | DERIVED
ALL = "all"
"""Names all layers of a result, where a file would hold the main ones only."""

PLACE_IT = (
    "Place it: `interloc locate DRIVE --osm MAP -o geo.csv` finds it by its roads, or put a geo.csv into the drive; "
    "then run it again"
)
"""What makes a result in metres one on the map."""


class Format(NamedTuple):
    """How a file of a format is written, and what it holds."""

    write: "Callable[[_Export, Path], None]"
    layers: Literal["one", "any", "all"] = "one"
    """{"one", "any", "all"}: one layer; the main ones, unless others are named; or always all."""
    only_on_earth: str = ""
    """Its name, where it knows longitude and latitude only."""


class _Export(NamedTuple):
    """Layers of a result folder that become a file."""

    result: Path
    layers: list[tuple[Layer, Rows]]
    name: str

    @property
    def origin(self) -> dict[str, str | None]:
        """Drive, job, preset and labels."""
        return origin_of(read_json(self.result / RUN_FILE), self.name)

    def about(self, title: str, layer: Layer, rows: Rows) -> dict[str, str]:
        """Return the options of GDAL that name a layer, by the word that a driver has for its title."""
        told = [f"{name} {value}" for name, value in self.origin.items() if value]
        return {title: layer.title, "DESCRIPTION": f"{layer.description} {rows.credit.attribution} ({', '.join(told)})"}


def write_vector_file(result: Path, out: Path, *, layer: str | None = None, drive: str | None = None) -> list[str]:
    """Write a result folder as one vector file, whole or not at all, and return the names of the layers written.

    The suffix of `out` says the format. Without georeference it is in metres, without a coordinate system. `layer`
    None: the main layers of the result where the format holds several, else the intersections; `ALL`: all. `drive` is
    its name where it has another one than when it was run. What cannot be had is a ConfigError; longitude and latitude
    of a result in metres a GeoreferenceError; what could not be read or written an OutputError.
    """
    suffix = out.suffix.lower()
    if suffix not in FORMATS:
        raise ConfigError(
            f"{out}: unknown format {out.suffix!r}. Expected one of {', '.join(FORMATS)}, or for the roads (`interloc "
            f"export`) .nav2.geojson, .osm, .xodr; the raster of the road seen by LiDAR is {result / ROAD_FILE}."
        )
    refuse_result_file(out)
    if suffix == ".parquet" and not has_parquet():
        raise ConfigError(f"GeoParquet needs pyarrow, which is not installed: {install('parquet')}")
    names = _choose(result, layer, suffix)
    export = _Export(result, [(EXPORTS[name], _read(result, name)) for name in names], drive or _name_of(result))
    with _written_beside(out) as path:
        FORMATS[suffix].write(export, path)
    return names


def has_parquet() -> bool:
    """Return whether the extra is installed that writes GeoParquet; the GDAL of pyogrio has no driver of it."""
    return importlib.util.find_spec("pyarrow") is not None


def suffixes_here() -> list[str]:
    """Return those of `FORMATS` that this installation writes."""
    return [suffix for suffix in FORMATS if suffix != ".parquet" or has_parquet()]


def is_local(result: Path) -> bool:
    """Return whether a result folder is in metres of its own frame, for want of a georeference."""
    return not read_json(result / RUN_FILE).get("georeferenced")


# which layers ---------------------------------------------------------------------------------------------------------


def _choose(result: Path, layer: str | None, suffix: str) -> list[str]:
    wanted = None if layer is None else layer.replace("-", "_")
    if wanted not in {None, ALL, *EXPORTS}:
        raise ConfigError(f"{layer!r} is not a layer. Expected one of {', '.join(EXPORTS)}, {ALL}.")
    local = is_local(result)
    if local and FORMATS[suffix].only_on_earth:
        raise GeoreferenceError(
            f"{result} is in metres of its own frame, and {FORMATS[suffix].only_on_earth} knows longitude and latitude "
            f"only: the drive has no georeference. {PLACE_IT}, or write a .gpkg or .fgb, in metres."
        )
    there = [name for name in LAYERS if _file_of(result, name).exists()]
    if not local:
        there += DERIVED
    holds = FORMATS[suffix].layers
    if wanted == ALL and holds == "one":
        raise ConfigError(f"A {suffix} file holds one layer. Name it, or write a .gpkg.")
    if wanted is None or wanted == ALL:
        every = wanted == ALL or holds == "all"
        return ["intersections"] if holds == "one" else [name for name in there if every or name in MAIN_LAYERS]
    if holds == "all":
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
        return "An older version of InterLoc made it, without a map of the roads; `interloc run` draws one."
    if (result / "report.json").exists():
        if layer == BUILDINGS and "buildings" in read_json(result / "report.json").get("osm", {}):
            return "The map that it was scored against has no buildings near the drive, or was read without bounds."
        return "An older version of InterLoc scored it; `interloc evaluate` writes the layer."
    return "It was not scored against a map: `interloc evaluate` does that."


def _read(result: Path, name: str) -> Rows:
    if name in DERIVED:
        intersections = LAYERS["intersections"].read(result / "intersections.geojson")
        return DERIVED[name].rows(derived_features(name, intersections), OWN_CREDIT, intersections.path)
    return LAYERS[name].read(_file_of(result, name))


def _name_of(result: Path) -> str:
    run = read_json(result / RUN_FILE)
    return str(run.get("drive_name") or run.get("drive") or result.resolve().name)


def _file_of(result: Path, name: str) -> Path:
    """Return the file of a layer, which has another name where it is in metres."""
    local = result / file_names(georeferenced=False).get(name, "")
    return local if local.is_file() else result / f"{name}.geojson"


def _in_metres(rows: Rows) -> bool:
    return rows.path.name in file_names(georeferenced=False).values()


# tables ---------------------------------------------------------------------------------------------------------------

_DTYPES = {
    "int": "Int64",
    "float": "float64",
    "bool": "boolean",
    "text": "object",
    "time": "datetime64[ms, UTC]",
    "list": "object",
}
"""Kind of a property -> column of pandas; those with a capital letter and the objects know null."""


def _table(layer: Layer, rows: Rows, *, has_times: bool = True) -> Any:  # noqa: ANN401 - geopandas has no types
    """Return a GeoDataFrame with the properties of the layer, null where they are null, and lists as JSON text.

    Where a format has no times, they are text.
    """
    import pandas  # noqa: PLC0415, ICN001 - slow to import
    from geopandas import GeoDataFrame  # noqa: PLC0415

    columns = {name: rows.column(name) for name in layer.fields}
    kinds = {name: "text" if kind == "time" and not has_times else kind for name, kind in layer.fields.items()}
    for name, kind in kinds.items():
        if kind == "list":
            columns[name] = [None if value is None else _json(value) for value in columns[name]]
        if kind == "time":
            columns[name] = pandas.to_datetime(columns[name], utc=True, format="ISO8601")
    table = GeoDataFrame(columns, geometry=_geometries(layer, rows), crs=None if _in_metres(rows) else "EPSG:4326")
    return table.astype({name: _DTYPES[kind] for name, kind in kinds.items()})


def _geometries(layer: Layer, rows: Rows) -> Any:  # noqa: ANN401 - of shapely
    """Return the geometries of a layer; lines and polygons are cut at the antimeridian."""
    import shapely  # noqa: PLC0415 - slow to import

    if layer.geometry == "Point":
        return shapely.points(rows.points())
    shapes: list[Any] = [
        each.geometry and {"type": layer.geometry, "coordinates": each.geometry.coordinates} for each in rows.features
    ]
    if not _in_metres(rows):
        shapes = [cut(shape) for shape in shapes]
    return [shape and shapely.geometry.shape(shape) for shape in shapes]


def _json(value: list[Any]) -> str:
    return json.dumps(value, separators=(",", ":"))


# formats --------------------------------------------------------------------------------------------------------------


@contextmanager
def _written_beside(out: Path) -> Iterator[Path]:
    """Yield where to write what becomes a file; what GDAL, SQLite or the system could not write is an OutputError."""
    try:
        with TemporaryDirectory(
            prefix=f".{out.name[:100]}.partial-", dir=out.parent, ignore_cleanup_errors=True
        ) as folder:
            path = Path(folder) / out.name
            yield path
            with path.open("rb") as file:
                os.fsync(file.fileno())
            path.replace(out)
    except OutputError as error:
        raise type(error)(str(error).replace(folder, str(out.parent))) from error
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    except (RuntimeError, sqlite3.Error) as error:  # of GDAL, of SQLite
        reason = str(error).replace(folder, str(out.parent)).rpartition("failed: ")[2][-300:]
        raise OutputError(f"{out} could not be written (usual cause: a full disk): {reason}") from error


def _write_by_gdal(
    sink: Path | io.BytesIO,
    driver: str,
    table: Any,  # noqa: ANN401 - a GeoDataFrame
    layer: Layer,
    *,
    append: bool = False,
    **options: dict[str, Any] | None,
) -> None:
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
            **options,
        )


def _write_geopackage(export: _Export, path: Path) -> None:
    for number, (layer, rows) in enumerate(export.layers):
        _write_by_gdal(
            path,
            "GPKG",
            _table(layer, rows),
            layer,
            append=number > 0,
            # GDAL before 3.7, as in Debian 12, warns of version 1.4.
            dataset_options={"VERSION": "1.3"} if number == 0 else None,
            layer_options=export.about("IDENTIFIER", layer, rows),
        )
    add_styles(path, [layer for layer, _ in export.layers])


def _write_project(export: _Export, path: Path) -> None:
    database = path.with_name("result.gpkg")
    _write_geopackage(export, database)
    road = export.result / ROAD_FILE
    local = _in_metres(export.layers[0][1])
    write_qgz(path, database, export.layers, export.name, local=local, road=road if road.is_file() else None)


def _write_flatgeobuf(export: _Export, path: Path) -> None:
    ((layer, rows),) = export.layers
    buffer = io.BytesIO()  # GDAL does not report a full disk
    _write_by_gdal(buffer, "FlatGeobuf", _table(layer, rows), layer, layer_options=export.about("TITLE", layer, rows))
    path.write_bytes(buffer.getvalue())


def _write_geojson(export: _Export, path: Path) -> None:
    ((layer, rows),) = export.layers
    places = [None if each.geometry is None else each.geometry.coordinates for each in rows.features]
    features = layer.features(places, **{name: rows.column(name) for name in layer.fields})
    write_collection(path, features, local=_in_metres(rows), credit=rows.credit, origin=export.origin)


_FORMULA = re.compile(r"[=@\t\r]|[+\-](?![\d.,+-]*$)")
"""Start of a text that spreadsheets would run; plain numbers are harmless."""


def _write_csv(export: _Export, path: Path) -> None:
    """Write rows as RFC 4180 with a head: points with `lon`, `lat` or `x_m`, `y_m`, others with `wkt`; null is empty.

    Where the rows hold data of OpenStreetMap, the last column says so.
    """
    import shapely  # noqa: PLC0415 - slow to import

    ((layer, rows),) = export.layers
    if layer.geometry == "Point":
        place = ["x_m", "y_m"] if _in_metres(rows) else ["lon", "lat"]
        places = rows.points().tolist()
    else:
        place = ["wkt"]
        shapes = _geometries(layer, rows)
        places = [[each and shapely.to_wkt(each, rounding_precision=7, trim=False)] for each in shapes]
    credit = {} if rows.credit.license is None else {"attribution": rows.credit.attribution}
    with path.open("w", encoding="utf-8-sig", newline="") as file:  # Excel takes it for UTF-8 by the mark
        writer = csv.writer(file)
        writer.writerow([*place, *layer.fields, *credit])
        for feature, where in zip(rows.features, places, strict=True):
            cells = [_cell(getattr(feature.properties, name)) for name in layer.fields]
            writer.writerow([*where, *cells, *credit.values()])


def _cell(value: Any) -> Any:  # noqa: ANN401
    """Return a value as a cell; a text that spreadsheets would run as a formula gets an apostrophe in front."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return _json(value)
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def _write_parquet(export: _Export, path: Path) -> None:
    """Write GeoParquet whose metadata name description, attribution and licence, and whose rows have boxes."""
    from pyarrow import parquet  # noqa: PLC0415 - an extra

    ((layer, rows),) = export.layers
    table, buffer = _table(layer, rows), io.BytesIO()
    texts = dict.fromkeys(table.select_dtypes("object"), "string")  # they would have no type where all are null
    table.astype(texts).to_parquet(buffer, schema_version="1.1.0", write_covering_bbox=True)
    columns = parquet.read_table(buffer)
    told = {"description": layer.description, **rows.credit.members}
    told |= {name: value for name, value in export.origin.items() if value}
    columns = columns.replace_schema_metadata({**columns.schema.metadata, **told})
    parquet.write_table(columns, path, compression="zstd")


_KML_NAMES = {"id": "number", "name": "street", "time": "timestamp", "first_time": "begin", "last_time": "end"}
"""Properties that mean something else in KML, or something that KML has a name for -> what they are called there."""


_CDATA, _CDATA_END = re.compile(rb"<!\[CDATA\[(.*?)\]\]>", re.DOTALL), "\ue000"


def _write_kml(export: _Export, path: Path) -> None:
    """Write layers by LIBKML; markup in texts is escaped, where it writes it raw, and any `]]>` of it ends a file."""
    for number, (layer, rows) in enumerate(export.layers):
        # GDAL writes integers of 64 bits as text, and before 3.12 reads no true.
        small = {name: "Int32" for name, kind in layer.fields.items() if kind in {"int", "bool"}}
        table = _table(layer, rows).astype(small).rename(columns=_KML_NAMES)
        table.insert(0, "Name", [layer.label.format(**vars(feature.properties)) for feature in rows.features])
        texts = [name for name in table.columns if table[name].dtype == object]
        table[texts] = table[texts].replace({"]]>": f"]]{_CDATA_END}"}, regex=True)
        about = {key: text.replace("]]>", f"]]{_CDATA_END}") for key, text in export.about("NAME", layer, rows).items()}
        _write_by_gdal(path, "LIBKML", table, layer, append=number > 0, layer_options=about)
        content = path.read_bytes()
        if not content.rstrip().endswith(b"</kml>"):  # GDAL does not report a full disk
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    escaped = _CDATA.sub(lambda found: escape(found[1].decode()).encode(), content)
    path.write_bytes(escaped.replace(_CDATA_END.encode(), b"&gt;"))


def _write_kmz(export: _Export, path: Path) -> None:
    document = path.with_name("doc.kml")  # GDAL cannot add a layer to a KMZ
    _write_kml(export, document)
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        archive.writestr(ZipInfo("doc.kml"), document.read_bytes(), ZIP_DEFLATED)


def _write_tiles(export: _Export, path: Path) -> None:
    ((layer, rows),) = export.layers
    table = _table(layer, rows, has_times=False)
    if all(each is None or ("Line" in each.geom_type and not each.length) for each in table.geometry):
        raise ConfigError(f"the result has no {layer.name}; PMTiles needs at least one. Write a .gpkg.")
    options = {
        "NAME": export.name,
        "DESCRIPTION": f"{layer.description} {rows.credit.attribution}",
        "MAXZOOM": 15,  # web maps enlarge the last tiles: 0.15 m fine at the equator, finer elsewhere
        "EXTENT": 8192,  # steps across a tile: as fine as MapLibre draws
        "MAX_SIZE": 10_000_000,  # GDAL leaves features out of a larger tile
    }
    buffer = io.BytesIO()  # GDAL does not report a full disk
    _write_by_gdal(buffer, "PMTiles", table, layer, dataset_options=options)
    path.write_bytes(buffer.getvalue())


FORMATS = {
    ".gpkg": Format(_write_geopackage, "any"),
    ".qgz": Format(_write_project, "all"),
    ".fgb": Format(_write_flatgeobuf),
    ".kml": Format(_write_kml, "one", "KML"),
    ".kmz": Format(_write_kmz, "any", "KML"),
    ".csv": Format(_write_csv),
    ".geojson": Format(_write_geojson),
    ".parquet": Format(_write_parquet),
    ".pmtiles": Format(_write_tiles, "one", "PMTiles"),
}
"""Suffix -> format."""
