"""On which side of the road a place drives, and which roads of a result are one-way streets."""

from collections.abc import Sequence
from functools import cache
from typing import Any, Literal

import numpy as np
import shapely

from interloc.arrays import BoolArray, FloatArray
from interloc.roadmap.network import RoadNetwork

Side = Literal["right", "left"]

_LEFT = """
British Isles: -11 49.7, -5 49.8, -2.9 49.2, -1.9 49.1, -1.9 49.8, .3 50.4, 1.2 50.85, 1.55 51.1, 2 52, 2 61, -11 61
Malta: 14.1 35.7, 14.7 36.1
Cyprus: 32.2 34.5, 34.7 35.75
South Asia: 61.6 24.9, 61.8 26.2, 63.2 26.6, 62.8 28.3, 60.9 29.8, 62.5 29.4, 66.3 29.9, 66.4 30.95, 67.6 31.4,
 69.3 31.9, 69.5 33.1, 70.3 33.4, 69.9 34, 71.1 34.2, 71.6 35.2, 71.5 36.2, 72.5 36.9, 74.5 37.05, 75.4 36.9,
 76.1 35.9, 77.8 35.5, 78.3 34.6, 79 33.2, 78.8 31.3, 81 30.2, 82 30.3, 83.9 29.3, 85.2 28.5, 86 27.95, 87 27.95,
 88.1 27.9, 88.8 28.05, 88.9 27.4, 89.5 28.2, 90.4 28.2, 91.7 27.8, 93.2 28.6, 94.3 29.2, 95.4 29.1, 96.2 29.4,
 97.3 28.2, 97 27.5, 95.1 26, 94.6 25.2, 94.3 24.2, 93.4 24, 93.3 23, 92.9 22, 92.3 20.8, 92.3 20.5, 88 18, 83 10,
 82.5 5.5, 72 -1, 71 8, 68 20
Andaman Islands: 91.8 6.5, 94.2 14
Thailand: 99.9 20.44, 100.08 20.36, 100.42 20.27, 100.5 19.5, 101.2 19.5, 101.2 18.4, 101 17.9, 102.1 18.2,
 102.55 17.95, 102.75 17.89, 103.2 18.35, 103.97 18.3, 104.8 17.4, 104.73 16.55, 105.5 15.5, 105.55 14.5, 104.5 14.4,
 103.2 14.35, 102.54 13.67, 102.35 13.3, 102.7 12.6, 102.9 11.65, 102.5 11, 103.5 6.5, 97.9 6.5, 98.58 9.97, 98.8 10.4,
 99.65 11.8, 99.1 13.1, 98.2 15.1, 98.54 16.7, 97.75 17.6, 97.6 18.4, 97.8 19.6, 99 20.05, 99.5 20.35
Malay Archipelago, Australia, New Zealand: 92 7, 98 6.5, 103.5 6.5, 110 7.6, 116.6 7.6, 117.6 7.2, 119.3 5.3,
 119.4 4.6, 124.8 4.9, 127.2 5, 132 1.5, 142 0, 160 -4, 171 -10, 171 -12.7, 165.5 -12.7, 155 -14, 156 -30, 170 -28.5,
 180 -33, 180 -54, 110 -54, 95 -13
Chatham Islands: -178 -45, -175 -43
Fiji: 176.5 -21.5, 180 -12
Fiji, east: -180 -21.5, -178 -15
Tuvalu: 176 -11, 180 -5
Tonga: -176.5 -23, -173.5 -15
Samoa: -173 -14.1, -171.35 -13.3
Nauru: 166.8 -.7, 167.1 -.4
Kiribati, west: 172.5 -3, 177 4
Kiribati, east: -161 1.5, -157 5
Cook Islands: -166 -22.1, -157.2 -8.8
Niue: -170.1 -19.2, -169.7 -18.9
Japan: 122.8 24, 131.5 24, 142 30, 146.2 43.2, 145.4 44.4, 141.9 45.65, 139 43, 137 38.5, 132 37, 129.2 34.85,
 128 32.5, 127 29
Hong Kong: 113.82 22.13, 114.52 22.13, 114.5 22.5, 114.25 22.56, 114.15 22.54, 114.08 22.51, 113.98 22.5, 113.87 22.42
Macau: 113.528 22.18, 113.553 22.105, 113.605 22.105, 113.605 22.187, 113.563 22.216, 113.54 22.216
Southern and East Africa: 11.3 -17.25, 14 -17.4, 18.4 -17.4, 20.8 -18, 23.3 -17.6, 22 -16.2, 22 -13, 24 -13, 24 -10.9,
 25.3 -11.6, 26.9 -11.95, 27.75 -12.25, 28.4 -12.5, 29 -13.4, 29.8 -13.4, 29.8 -12.2, 28.4 -11.9, 28.4 -9.2,
 28.9 -8.45, 30.75 -8.3, 29.5 -6, 29.4 -4.45, 30 -4.2, 30.8 -3.1, 30.55 -2.4, 30.85 -2.3, 30.85 -1.5, 30.45 -1.06,
 29.85 -1.4, 29.6 -1.39, 29.6 -.6, 29.75 .15, 30.1 .9, 31.3 2.15, 30.75 2.5, 30.85 3.5, 31.9 3.6, 34 4.2, 34.4 4.6,
 35.9 4.65, 36.9 4.4, 38.1 3.6, 39.5 3.45, 40.8 4.2, 41.85 3.95, 40.98 2.8, 40.98 -.9, 41.6 -1.7, 41.5 -10.5, 41.2 -15,
 36 -20, 36 -27, 33 -30, 28 -35.5, 17 -35.5, 11 -20
Seychelles: 46 -10.5, 56.5 -3.5
Mauritius: 57.2 -20.6, 63.6 -19.6
Saint Helena: -6 -16.2, -5.4 -15.7
Falkland Islands: -61.5 -52.6, -57.5 -50.9
Bermuda: -65 32.2, -64.6 32.5
Bahamas, Turks and Caicos: -79.4 23.7, -77 22.6, -75.2 21.9, -73.8 20.8, -71 21, -71 22.5, -75 26, -77 27.5, -79.4 27.2
Jamaica: -78.5 17.6, -76.1 18.6
Cayman Islands: -81.5 19.2, -79.7 19.8
Virgin Islands: -65.1 17.6, -64.2 18.8
Anguilla: -63.3 18.15, -62.9 18.65
Saint Kitts and Nevis: -62.9 17.05, -62.5 17.45
Antigua and Barbuda: -62 16.95, -61.6 17.8
Montserrat: -62.3 16.65, -62.1 16.85
Dominica: -61.55 15.15, -61.2 15.7
Saint Lucia: -61.15 13.65, -60.85 14.15
Grenada and Saint Vincent: -61.9 11.9, -61.05 13.45
Barbados: -59.75 13, -59.35 13.4
Trinidad and Tobago: -61.95 10, -60.4 11.4
Guyana and Suriname: -60 8.6, -57 6.3, -54 6.1, -54.05 5.6, -54.45 4.8, -54 3.6, -54.3 2.4, -56 1.85, -57.5 1.9,
 -58.8 1.3, -59.7 1.8, -59.85 2.7, -59.82 3.4, -59.8 4.4, -60.1 5.1, -60.75 5.2, -61.35 5.95, -60.7 6.8, -60.4 8
"""
"""Where traffic keeps to the left: longitude and latitude of the corners of outlines in the sea and along borders, to
some ten kilometres; two corners are a box."""

_STEP_M = 2.0
_SAME_WAY = 0.8  # cosine
_BESIDE_M = 2.0  # a way of the map may lie so far beside the road that was seen
_SHARE = 0.8


def side_of(lonlat: FloatArray) -> Side:
    """Return on which side people drive at a place, (2,) degrees; near a border of the table it may be the other."""
    return "left" if bool(shapely.intersects_xy(_areas(), *lonlat).any()) else "right"


@cache
def _areas() -> Any:  # noqa: ANN401 - of shapely
    areas = []
    for line in _LEFT.strip().replace(",\n", ",").splitlines():
        corners = np.array([pair.split() for pair in line.rpartition(":")[2].split(",")], dtype=np.float64)
        areas.append(shapely.box(*corners.ravel()) if len(corners) == 2 else shapely.Polygon(corners))
    return np.array(areas)


def one_way_roads(network: RoadNetwork, lines: Sequence[FloatArray], is_one_way: BoolArray) -> dict[int, int]:
    """Return the roads of a network along which the ways of a map, (N, 2) metres each, are one-way, by id.

    1: from start to end, -1: back. Where ways of both directions run along a road, it has both.
    """
    if not is_one_way.any():
        return {}
    start, end = (np.concatenate([line[part] for line in lines]) for part in (slice(None, -1), slice(1, None)))
    one_way = np.repeat(is_one_way, [len(line) - 1 for line in lines])
    ahead = (end - start) / np.maximum(np.hypot(*(end - start).T), 1e-9)[:, None]
    pieces: Any = shapely.linestrings(np.stack([start, end], axis=1))
    tree = shapely.STRtree(pieces)
    found = {}
    for edge in network.edges:
        line = shapely.LineString(edge.xy)
        at = np.arange(_STEP_M / 2.0, line.length, _STEP_M)
        before, here, behind = (
            shapely.get_coordinates(shapely.line_interpolate_point(line, at + each)) for each in (-0.5, 0.0, 0.5)
        )
        along = (behind - before) / np.maximum(np.hypot(*(behind - before).T), 1e-9)[:, None]
        reach_m = max(np.nan_to_num(edge.width_m), 6.0) / 2.0 + _BESIDE_M
        spot, way = tree.query(shapely.points(here), "dwithin", distance=reach_m)
        cosine = (along[spot] * ahead[way]).sum(axis=1)
        beside = np.abs(cosine) > _SAME_WAY
        spot, sense = spot[beside], np.where(one_way[way], np.sign(cosine), 0.0)[beside]
        known = len(np.unique(spot))
        for direction in (1, -1):
            others = len(np.unique(spot[sense != direction]))
            if 2 * known >= len(at) > 0 and known - others >= _SHARE * known:
                found[edge.id] = direction
    return found
