"""Layers as vector tiles in one PMTiles archive, which web maps (MapLibre, Leaflet, OpenLayers) read by byte ranges."""

from __future__ import annotations

import gzip
import sqlite3
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from interloc.output.credits import Credit, joint_credit
from interloc.output.layers import Layer

MAX_ZOOM = 15
"""Web maps enlarge the tiles of the last zoom: at 15 they are 0.15 m fine at the equator, finer elsewhere."""

_EXTENT = 8192  # steps across a tile: as fine as MapLibre draws
_MAX_TILE_BYTES = 10_000_000  # GDAL leaves features out of a larger tile
_OVERVIEW = frozenset({"intersections", "trajectory", "places"})
_DETAIL_ZOOM = 13  # a branch is as long as a pixel: before it, hundreds of features would lie on each other
_TYPES = {"int": "Number", "float": "Number", "bool": "Boolean"}


@dataclass(frozen=True)
class TiledLayer:
    """A layer to be tiled."""

    layer: Layer
    credit: Credit
    table: Any
    """Its features in EPSG:4326."""

    @property
    def min_zoom(self) -> int:
        """The first zoom that has it."""
        return 0 if self.layer.name in _OVERVIEW else _DETAIL_ZOOM


def write_tiles(sink: IO[bytes], name: str, layers: Sequence[TiledLayer], folder: Path) -> None:
    """Write a PMTiles archive (version 3) of Mapbox Vector Tiles.

    Parameters
    ----------
    sink
        Written from its beginning to its end.
    name
        Of the archive.
    layers
        At least one.
    folder
        For intermediate files.

    Raises
    ------
    RuntimeError, sqlite3.Error, OSError
        GDAL, SQLite or the system could not write, as on a full disk.
    """
    from pmtiles.tile import zxy_to_tileid  # noqa: PLC0415 - needed for this alone
    from pmtiles.writer import Writer  # noqa: PLC0415

    parts: defaultdict[int, list[bytes]] = defaultdict(list)
    for each in layers:
        for (zoom, column, row), tile in _tiles(each, folder / f"{each.layer.name}.mbtiles"):
            parts[zxy_to_tileid(zoom, column, row)].append(tile)
    writer = Writer(sink)
    # The layers of a tile are messages in a row, so tiles are joined by putting them in a row. A file needs one tile.
    for number, tiles in sorted(parts.items()) or [(0, [b""])]:
        writer.write_tile(number, gzip.compress(b"".join(tiles), mtime=0))
    writer.finalize(_header(layers), _metadata(name, layers))


def _tiles(each: TiledLayer, database: Path) -> list[tuple[tuple[int, int, int], bytes]]:
    """Return zoom, column, row (from the north) and content of the tiles of a layer."""
    if each.table.geometry.isna().all():
        return []
    zooms = {"MINZOOM": each.min_zoom, "MAXZOOM": MAX_ZOOM}
    each.table.to_file(
        database,
        driver="MBTiles",
        engine="pyogrio",
        layer=each.layer.name,
        dataset_options={**zooms, "EXTENT": _EXTENT, "MAX_SIZE": _MAX_TILE_BYTES},
    )
    connection = sqlite3.connect(database)
    try:
        found = connection.execute("SELECT zoom_level, tile_column, tile_row, tile_data FROM tiles").fetchall()
    finally:
        connection.close()
    return [((z, x, (1 << z) - 1 - y), gzip.decompress(tile)) for z, x, y, tile in found]


def _header(layers: Sequence[TiledLayer]) -> dict[str, Any]:
    from pmtiles.tile import Compression, TileType  # noqa: PLC0415

    boxes = [each.table.total_bounds for each in layers if not each.table.geometry.isna().all()]
    west, south = (min((box[axis] for box in boxes), default=limit) for axis, limit in ((0, -180.0), (1, -85.0)))
    east, north = (max((box[axis] for box in boxes), default=limit) for axis, limit in ((2, 180.0), (3, 85.0)))
    is_across = east - west > 180.0  # both sides of the antimeridian
    return {
        "tile_type": TileType.MVT,
        "tile_compression": Compression.GZIP,
        "min_lon_e7": round(west * 1e7),
        "min_lat_e7": round(south * 1e7),
        "max_lon_e7": round(east * 1e7),
        "max_lat_e7": round(north * 1e7),
        "center_zoom": _DETAIL_ZOOM,
        "center_lon_e7": 1_800_000_000 if is_across else round((west + east) * 5e6),
        "center_lat_e7": round((south + north) * 5e6),
    }


def _metadata(name: str, layers: Sequence[TiledLayer]) -> dict[str, Any]:
    return {
        "name": name,
        "description": f"Road intersections in the LiDAR drive {name}.",
        "type": "overlay",
        "format": "pbf",
        **joint_credit(each.credit for each in layers).members,
        "vector_layers": [
            {
                "id": each.layer.name,
                "description": f"{each.layer.description} {each.credit.attribution}",
                "minzoom": each.min_zoom,
                "maxzoom": MAX_ZOOM,
                "fields": {name: _TYPES.get(kind, "String") for name, kind in each.layer.fields.items()},
            }
            for each in layers
        ],
    }
