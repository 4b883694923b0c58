"""A part of a layer: the features that touch a box, or the first ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.http.parameters import Box
from interloc.output.geojson import box_around, encode, flat_positions, read_json

MAX_FEATURES = 10_000

MAX_BYTES_AT_ONCE = 1024**2
"""Size of a file up to which the server reads it itself: a layer takes ten times that in memory, and a while."""


def select_features(path: Path, box: Box | None, limit: int | None) -> bytes:
    """Return a GeoJSON file with only some of its features, in the same order.

    Parameters
    ----------
    path
        A file of `interloc.output.geojson.write_collection`.
    box
        Only features whose own box touches this one; None: all.
    limit
        Maximum number of features; None: all.
    """
    collection = read_json(path)
    features: list[dict[str, Any]] = collection.pop("features")
    if box is not None:
        features = [feature for feature in features if _touches(_extent(feature), box)]
    kept = features if limit is None else features[:limit]
    collection.pop("bbox", None)
    around = box_around(feature["geometry"] for feature in kept)
    if around is not None:
        collection["bbox"] = around
    counts = {"numberMatched": len(features), "numberReturned": len(kept)}
    return encode({**collection, **counts, "features": kept}).encode()


def _extent(feature: dict[str, Any]) -> Box | None:
    """Return the box around a geometry, None where there is none; across the antimeridian west is larger than east."""
    geometry = feature["geometry"]
    if geometry is None:
        return None
    positions = flat_positions(geometry)
    lon, lat = [each[0] for each in positions], [each[1] for each in positions]
    west, east = min(lon), max(lon)
    if geometry["type"].startswith("Multi"):
        west, east = min(each for each in lon if each > 0.0), max(each for each in lon if each <= 0.0)
    return Box(west, min(lat), east, max(lat))


def _touches(extent: Box | None, box: Box) -> bool:
    if extent is None or extent.north < box.south or extent.south > box.north:
        return False
    after_west, before_east = extent.east >= box.west, extent.west <= box.east
    across = (extent.west > extent.east) + (box.west > box.east)
    return across == 2 or (after_west or before_east if across else after_west and before_east)
