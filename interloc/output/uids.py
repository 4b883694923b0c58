"""Names of places that stay the same from run to run.

An intersection is numbered by the order of sight, so its `id` means nothing in another run. Its `uid` names the place:

- `n123`: the place of OpenStreetMap node 123. After an evaluation, for every intersection that is assigned to a node of
  the policy within 10 m, else to a junction of roads, service roads included. It stays however far the position moves
  as long as it stays nearest to the same node, and for as long as the map keeps the node.
- `49.01110,8.42040`: the centre (latitude, longitude) of the cell of a grid of `CELL_DEG`, about 22 m. Without a map,
  and where the map has nothing. `49.01110,8.42040-2` is the second intersection of one cell, from west to east.
- `x40y-20`: the centre of a cell of `CELL_M` in metres of W, for a drive without georeference; it holds for runs over
  this drive only.

Notes
-----
A grid has edges: a position that moves by a metre in any direction leaves its cell of 22 m in about 6 of 100 cases (and
of those cells that hold two intersections, a missing one renames the other). Larger cells would move less and hold
several intersections more often. Two runs are best joined after an evaluation, by nodes, which have no edges but the
line halfway to the next junction. Policy `consolidated` names a merged junction by its smallest node.
"""

import numpy as np

from interloc.arrays import FloatArray
from interloc.output.geojson import positions
from interloc.results import IntersectionTable

CELL_DEG = 0.0002
"""Height of a cell, degrees of latitude: 22 m. Its width is the same in metres."""

CELL_M = 20.0
"""Side of a cell in W, metres."""


def place_uids(intersections: IntersectionTable) -> list[str]:
    """Return the names of the places of intersections by their position alone, all different.

    The position counts as it is printed, so that a result that is read back has the same names.
    """
    if intersections.lonlat is None:
        xy = np.array(positions(intersections.world_xy, local=True)).reshape(-1, 2)
        cells = (np.floor(xy / CELL_M) * CELL_M + CELL_M / 2.0).astype(np.int64)
        return number_repeated([f"x{x}y{y}" for x, y in cells.tolist()], xy)
    lonlat = np.array(positions(intersections.lonlat, local=False)).reshape(-1, 2)
    return number_repeated([_cell_name(lon, lat) for lon, lat in lonlat.tolist()], lonlat)


def _cell_name(lon_deg: float, lat_deg: float) -> str:
    lat = (np.floor(lat_deg / CELL_DEG) + 0.5) * CELL_DEG
    # As many cells around the Earth as make them square at this latitude: no cell lies across the date line.
    columns = max(1, round(360.0 * np.cos(np.radians(lat)) / CELL_DEG))
    width = 360.0 / columns
    column = np.floor((lon_deg + 180.0) % 360.0 / width) % columns
    return f"{lat:.5f},{(column + 0.5) * width - 180.0:.5f}"


def number_repeated(names: list[str], xy: FloatArray) -> list[str]:
    """Add -2, -3, ... to names that come again, in the order of (N, 2) positions from west to east."""
    numbered = list(names)
    count: dict[str, int] = {}
    for row in np.lexsort((xy[:, 1], xy[:, 0])).tolist():
        name = names[row]
        count[name] = count.get(name, 0) + 1
        if count[name] > 1:
            numbered[row] = f"{name}-{count[name]}"
    return numbered
