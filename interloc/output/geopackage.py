"""What a GeoPackage says about its layers and fields beside the rows: titles, meanings, licence, the run, styles.

Tables of the standard (annexes F.6 metadata and F.9 schema) that GDAL's writer leaves out are added by SQL, and the
table in which QGIS keeps styles. The road seen by LiDAR is added as tiles.
"""

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from interloc.mapping.mosaic import TILE, Mosaic
from interloc.output.credits import OWN_CREDIT, Credit
from interloc.output.layers import Layer
from interloc.output.qgis import metadata, qml
from interloc.output.road import ROAD_LAYER, ROAD_TITLE, png_of

_JSON_URI = "https://www.rfc-editor.org/rfc/rfc8259"
_QGIS_URI = "http://mrcc.com/qgis.dtd"
"""Of layer metadata in the form that QGIS reads and shows."""

_TABLES = """
CREATE TABLE IF NOT EXISTS gpkg_extensions (
  table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL, definition TEXT NOT NULL, scope TEXT NOT NULL,
  CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name));
CREATE TABLE IF NOT EXISTS gpkg_data_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, name TEXT, title TEXT, description TEXT, mime_type TEXT,
  constraint_name TEXT, CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name),
  CONSTRAINT gdc_tn UNIQUE (table_name, name));
CREATE TABLE IF NOT EXISTS gpkg_data_column_constraints (
  constraint_name TEXT NOT NULL, constraint_type TEXT NOT NULL, value TEXT, min NUMERIC, min_is_inclusive BOOLEAN,
  max NUMERIC, max_is_inclusive BOOLEAN, description TEXT,
  CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value));
CREATE TABLE IF NOT EXISTS gpkg_metadata (
  id INTEGER CONSTRAINT m_pk PRIMARY KEY ASC NOT NULL, md_scope TEXT NOT NULL DEFAULT 'dataset',
  md_standard_uri TEXT NOT NULL, mime_type TEXT NOT NULL DEFAULT 'text/xml', metadata TEXT NOT NULL DEFAULT '');
CREATE TABLE IF NOT EXISTS gpkg_metadata_reference (
  reference_scope TEXT NOT NULL, table_name TEXT, column_name TEXT, row_id_value INTEGER,
  timestamp DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')), md_file_id INTEGER NOT NULL,
  md_parent_id INTEGER, CONSTRAINT crmr_mfi_fk FOREIGN KEY (md_file_id) REFERENCES gpkg_metadata(id),
  CONSTRAINT crmr_mpi_fk FOREIGN KEY (md_parent_id) REFERENCES gpkg_metadata(id));
CREATE TABLE IF NOT EXISTS layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256), f_table_schema TEXT(256),
  f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT, styleSLD TEXT,
  useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30), update_time DATETIME DEFAULT
  (strftime('%Y-%m-%dT%H:%M:%fZ','now')));
INSERT OR REPLACE INTO gpkg_contents (table_name, data_type, identifier, description)
  VALUES ('layer_styles', 'attributes', 'layer_styles', 'How QGIS draws the layers.');
"""

_TILES = """
CREATE TABLE IF NOT EXISTS gpkg_tile_matrix_set (
  table_name TEXT NOT NULL PRIMARY KEY, srs_id INTEGER NOT NULL, min_x DOUBLE NOT NULL, min_y DOUBLE NOT NULL,
  max_x DOUBLE NOT NULL, max_y DOUBLE NOT NULL);
CREATE TABLE IF NOT EXISTS gpkg_tile_matrix (
  table_name TEXT NOT NULL, zoom_level INTEGER NOT NULL, matrix_width INTEGER NOT NULL, matrix_height INTEGER NOT NULL,
  tile_width INTEGER NOT NULL, tile_height INTEGER NOT NULL, pixel_x_size DOUBLE NOT NULL, pixel_y_size DOUBLE NOT NULL,
  CONSTRAINT pk_ttm PRIMARY KEY (table_name, zoom_level));
CREATE TABLE road (
  id INTEGER PRIMARY KEY AUTOINCREMENT, zoom_level INTEGER NOT NULL, tile_column INTEGER NOT NULL,
  tile_row INTEGER NOT NULL, tile_data BLOB NOT NULL, UNIQUE (zoom_level, tile_column, tile_row));
"""
_MAX_LEVELS = 5

_EXTENSIONS = [
    (table, f"gpkg_{kind}", f"http://www.geopackage.org/spec121/#extension_{kind}")
    for kind, tables in {
        "schema": ("gpkg_data_columns", "gpkg_data_column_constraints"),
        "metadata": ("gpkg_metadata", "gpkg_metadata_reference"),
    }.items()
    for table in tables
]


def describe(database: Path, layers: Sequence[tuple[Layer, Credit]], run: str) -> None:
    """Add what is known about layers and fields, and the text of `run.json`, to a GeoPackage.

    The text is kept on one line, since tools print it before the fields. A full disk is an sqlite3.Error.
    """
    with _transaction(database) as sql:
        sql.executescript(_TABLES)
        sql.executemany(
            "INSERT INTO gpkg_extensions SELECT ?1, NULL, ?2, ?3, 'read-write' "
            "WHERE NOT EXISTS (SELECT 1 FROM gpkg_extensions WHERE table_name = ?1)",
            _EXTENSIONS,
        )
        sql.executemany(
            # GDAL takes the name here for the alias of a column; titles are unique within a layer.
            "INSERT OR REPLACE INTO gpkg_data_columns (table_name, column_name, name, title, description) "
            "VALUES (?1, ?2, ?3, ?3, ?4)",
            [(layer.name, each.name, each.title, each.description) for layer, _ in layers for each in layer.attributes],
        )
        sql.executemany(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, styleName, "
            "styleQML, useAsDefault, description, owner) VALUES ('', '', ?, 'geom', 'InterLoc', ?, 1, ?, '')",
            [(layer.name, qml(layer), layer.title) for layer, _ in layers],
        )
        told: list[tuple[str | None, ...]]
        told = [(_JSON_URI, "application/json", json.dumps(json.loads(run)), "geopackage", None)]
        told += [(_QGIS_URI, "text/xml", metadata(layer, credit), "table", layer.name) for layer, credit in layers]
        for number, (*text, scope, table) in enumerate(told, start=1):
            sql.execute("INSERT INTO gpkg_metadata VALUES (?, 'dataset', ?, ?, ?)", (number, *text))
            sql.execute(
                "INSERT INTO gpkg_metadata_reference (reference_scope, table_name, md_file_id) VALUES (?, ?, ?)",
                (scope, table, number),
            )


def add_road(database: Path, mosaic: Mosaic) -> None:
    """Add the road seen by LiDAR to a GeoPackage as tiles, as the page draws it, in cells of 0.5 m and coarser ones."""
    rasters = [mosaic.raster]
    while len(rasters[-1].tiles) > 1 and len(rasters) < _MAX_LEVELS:
        rasters.append(rasters[-1].coarser())
    step = 2 ** (len(rasters) - 1)  # every level must have the same corners
    top, left, bottom, right = mosaic.raster.extent()
    top, left = top // step, left // step
    rows, columns = bottom // step - top + 1, right // step - left + 1
    side = step * TILE * mosaic.raster.cell_m
    box = (left * side, -(top + rows) * side, (left + columns) * side, -top * side)
    srs = -1 if mosaic.epsg is None else mosaic.epsg
    with _transaction(database) as sql:
        sql.executescript(_TILES)
        if mosaic.epsg is not None:
            from pyproj import CRS  # noqa: PLC0415 - slow to import

            crs = CRS.from_epsg(mosaic.epsg)
            sql.execute(
                "INSERT OR IGNORE INTO gpkg_spatial_ref_sys (srs_name, srs_id, organization, organization_coordsys_id, "
                "definition) VALUES (?, ?2, 'EPSG', ?2, ?)",
                (crs.name, mosaic.epsg, crs.to_wkt("WKT1_GDAL")),
            )
        sql.execute(
            "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, min_x, min_y, max_x, "
            "max_y, srs_id) VALUES (?, 'tiles', ?, ?, ?, ?, ?, ?, ?)",
            (ROAD_LAYER, ROAD_TITLE, OWN_CREDIT.attribution, *box, srs),
        )
        sql.execute("INSERT INTO gpkg_tile_matrix_set VALUES (?, ?, ?, ?, ?, ?)", (ROAD_LAYER, srs, *box))
        for level, raster in enumerate(reversed(rasters)):
            many, cell = 2**level, raster.cell_m
            matrix = (ROAD_LAYER, level, columns * many, rows * many, TILE, TILE, cell, cell)
            sql.execute("INSERT INTO gpkg_tile_matrix VALUES (?, ?, ?, ?, ?, ?, ?, ?)", matrix)
            sql.executemany(
                "INSERT INTO road (zoom_level, tile_column, tile_row, tile_data) VALUES (?, ?, ?, ?)",
                (
                    (level, column - left * many, row - top * many, png_of(tile))
                    for (row, column), tile in raster.tiles.items()
                ),
            )


@contextmanager
def _transaction(database: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(database)) as connection, connection:
        yield connection
