"""What a map that cannot be used, or hardly, usually is: errors and warnings in words."""

from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.errors import MapError
from interloc.osm.graph import Bounds

_SEPARATE_STREETS = 5
"""So many streets and no common node among them is no chance."""

_OBJECTIONS = {
    "version attribute": "<osm> declares no version. Expected version 0.6; usual cause: a file that a program wrote",
    "with version": "the file is of an old version of the format. Expected version 0.6",
    "coordinate": "a coordinate is not in decimal degrees. Usual cause: commas for points, or a map in metres",
    "illegal id": "an id is not a whole number. Usual cause: a file that a program wrote",
    "nested too deep": "this is not the plain form of OSM XML. Usual cause: an augmented diff",
}
"""What libosmium says -> what it means."""


def not_read(path: Path, objection: str) -> MapError:
    """Return the error about a file at which libosmium stopped."""
    for words, meaning in _OBJECTIONS.items():
        if words in objection:
            return MapError(f"{path}: {meaning} ({objection}).")
    return MapError(
        f"{path}: is damaged ({objection}). Usual cause: a download or copy that was cut off; fetch it again."
    )


def history_file(path: Path) -> MapError:
    """Return the error about a file that holds every version of each object."""
    return MapError(
        f"{path}: is a full history file, with every version of each object. Expected a map of one day; make one of it "
        f"by: osmium time-filter {path.name} -o map.osm.pbf"
    )


def lanelet_map(path: Path) -> MapError:
    """Return the error about a map for automated driving, which is handed over for one of OpenStreetMap."""
    return MapError(
        f"{path}: is a Lanelet2 map, which has the form of OpenStreetMap and holds lanes, no streets. Expected an "
        "extract of OpenStreetMap of the same place, with highway=*."
    )


def no_nodes(path: Path, highways: int) -> MapError:
    """Return the error about a file of ways without places."""
    return MapError(
        f"{path}: holds {highways} highways but none of their nodes. Usual cause: a query without the nodes of the "
        "ways; in Overpass QL add (._;>;); before out."
    )


def no_highways(path: Path, bounds: Bounds | None, extent: Bounds | None) -> MapError:
    """Return the error about a map without highways within bounds; `extent`: of all its nodes."""
    text = f"{path}: holds no highways"
    if bounds is not None:
        text += f" within {_area(bounds)}"
        if extent is not None:
            text += f"; it covers {_area(extent)}"
    return MapError(
        f"{text}. Expected ways with a tag highway=*. Usual cause: an extract of another area, or of buildings or "
        "points only, or longitude and latitude swapped in geo.csv."
    )


def too_many(path: Path, what: str, most: int) -> MapError:
    """Return the error about a file that holds more than any place on Earth."""
    return MapError(
        f"{path}: holds more than {most:,} {what} around the drive, which no place on Earth has. "
        "Usual cause: several maps in one file, or a file that was made by a program."
    )


def odd_bounds(name: str, count: int) -> tuple[str, ...]:
    """Say that declared boxes were left out, which hold nothing of the map or are inverted."""
    if not count:
        return ()
    text = (
        f"{name} declares bounds that hold none of its nodes, or are inverted: they were left out, and what it covers "
        "was told from its highways. Usual cause: a program that wrote 0 0 0 0, or the corners in another order."
    )
    return (text,)


def oddities(name: str, way_id: IntArray, edges: IntArray, edge_way: IntArray) -> tuple[str, ...]:
    """Say what is odd about the highways of a map, by (W,) ids of ways, and (E, 2) nodes and (E,) ways of edges."""
    warnings = []
    ids, row = np.unique(way_id, return_inverse=True)
    if len(ids) < len(way_id):
        warnings.append(
            f"{name} holds {len(way_id) - len(ids)} highways under ids that others of the same version have, too: all "
            "were taken, as pieces of one road. Usual cause: an export by osmnx 0.x, or maps of two days joined "
            "without versions."
        )
    visits = np.unique(np.column_stack([edges.ravel(), np.repeat(row[edge_way], 2)]), axis=0)
    if len(ids) >= _SEPARATE_STREETS and len(np.unique(visits[:, 0])) == len(visits):
        warnings.append(
            f"None of the {len(ids)} highways of {name} has a node in common with another: it holds no junction, and "
            "nothing can be right. Usual cause: a map made from shapefiles or by ogr2osm, which gives each street "
            "nodes of its own; take an extract of OpenStreetMap."
        )
    return tuple(warnings)


def _area(bounds: Bounds) -> str:
    west, south, east, north = bounds
    return f"lon {west:.5f}..{east:.5f}, lat {south:.5f}..{north:.5f}"
