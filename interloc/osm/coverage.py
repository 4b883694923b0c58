"""What an extract of OpenStreetMap covers, told from what lies in it, whatever its head declares.

Extracts are cut by boxes and by borders, mostly with whole ways: a way that touches the region is in the file to its
end, and one that does not is missing. Beyond the cut, therefore, roads go on bare: every way there comes across the
cut, and no way lies there as a whole. Where a file has so much road beyond a line that several whole ways would be
expected, and has none, it ends at that line. Files whose ways were cut at the border have ways that lack nodes there,
or several dead ends on one line. The score, its reasons, and the audit ask `RoadGraph.covers`;
there is no other answer.
"""

from functools import cached_property
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import enu_from_lonlat, middle_of

FAR_M = 300.0
"""Nothing is known of a place that is further from all highways of the file."""

_TILE_M, _REACH_M = 250.0, 600.0  # places of one tile ask the ways so near its middle: borders are not straight
_STEP_DEG = 5.0
_ENOUGH = 12  # ways around a place, at least: of fewer nothing follows, as in a village of five streets
_CROSSING = 5  # ways across a line, at least
_EXPECTED = 4.0  # whole ways expected beyond a line, by its length of road and the mean way
_ON_LINE_M = 1.0
_AT_LINE_M = 20.0  # the last junction that is whole lies on the line, and what is detected of it on either side


class Content:
    """The ways of a map in a plane, to tell where the file ends."""

    def __init__(
        self,
        lonlat: FloatArray,
        edges: IntArray,
        edge_way: IntArray,
        loose_ends: IntArray,
        degree: IntArray,
        *,
        is_made_up: bool,
    ) -> None:
        self._is_made_up = is_made_up  # the simulator cuts nothing, and its streets are as long as the town
        self._lon, self._lat = middle_of(lonlat)
        self._xy = self._plane(lonlat)
        self._edges = edges[np.argsort(edge_way, kind="stable")]
        self._way, self._first = np.unique(np.sort(edge_way), return_index=True)
        self._loose = loose_ends
        self._degree = degree

    def _plane(self, lonlat: FloatArray) -> FloatArray:
        return enu_from_lonlat(self._lat, self._lon, lonlat)

    @cached_property
    def _tree(self) -> Any:  # noqa: ANN401 - shapely has no types
        import shapely  # noqa: PLC0415 - the server does without

        lines: Any = shapely.linestrings(self._xy[self._edges])
        return shapely.STRtree(lines)

    def covers(self, lonlat: FloatArray) -> BoolArray:
        """Return which (N, 2) places the content covers."""
        import shapely  # noqa: PLC0415

        xy = self._plane(lonlat)
        known = np.zeros(len(xy), dtype=np.bool_)
        known[self._tree.query(shapely.points(xy), "dwithin", distance=FAR_M)[0]] = True
        if self._is_made_up:
            return known
        tiles, tile_of = np.unique(np.floor(xy / _TILE_M).astype(np.int64), axis=0, return_inverse=True)
        for number, tile in enumerate(tiles):
            rows = np.flatnonzero(known & (tile_of.ravel() == number))
            if len(rows):
                directions, limits = self._borders((tile + 0.5) * _TILE_M)
                known[rows] = (xy[rows] @ directions.T <= limits).all(axis=1)
        return known

    def _borders(self, middle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lines at which the file ends around a place, (2,): unit vectors (B, 2) out of it, and how far.

        Half planes along unit vectors in all directions are looked at, each beginning where its innermost whole way
        does: beyond that line no way lies as a whole.
        """
        import shapely  # noqa: PLC0415

        near = self._tree.query(shapely.Point(middle), "dwithin", distance=_REACH_M)
        ways = np.unique(np.searchsorted(self._first, near, side="right") - 1)
        if len(ways) < _ENOUGH:
            return np.empty((0, 2)), np.empty(0)
        stops = np.append(self._first[1:], len(self._edges))
        counts = stops[ways] - self._first[ways]
        starts = np.cumsum(counts) - counts
        edges = self._edges[np.repeat(self._first[ways] - starts, counts) + np.arange(counts.sum())]
        a, b = self._xy[edges[:, 0]], self._xy[edges[:, 1]]
        length = np.hypot(*(b - a).T)
        usual_m = length.sum() / len(ways)  # the mean: of long ways there is more road, and more crosses a line
        is_near = np.hypot(*((a + b) / 2.0 - middle).T) <= _REACH_M
        loose_xy = self._xy[self._loose[:, 0]]
        loose_xy = loose_xy[np.hypot(*(loose_xy - middle).T) <= 2.0 * _REACH_M]
        is_cut = np.isin(self._way[ways], self._loose[:, 2])
        if is_cut.all():
            return np.empty((0, 2)), np.empty(0)
        ends = np.unique(edges[self._degree[edges] == 1])
        ends_xy = self._xy[ends[np.hypot(*(self._xy[ends] - middle).T) <= 2.0 * _REACH_M]]

        directions = _directions(ends_xy)
        at_a, at_b = a @ directions.T, b @ directions.T
        begins = np.minimum.reduceat(np.minimum(at_a, at_b), starts)
        reaches = np.maximum.reduceat(np.maximum(at_a, at_b), starts)
        limits = begins[~is_cut].max(axis=0)
        high, low = np.maximum(at_a, at_b) - limits, np.minimum(at_a, at_b) - limits
        share = np.clip(high / np.maximum(high - low, 1e-9), 0.0, 1.0)
        bare_m = (share * (length * is_near)[:, None]).sum(axis=0)
        is_loose_beyond = loose_xy @ directions.T > limits - _ON_LINE_M
        expected = bare_m / usual_m + is_loose_beyond.sum(axis=0)
        crossing = (reaches > limits + _ON_LINE_M).sum(axis=0) + is_loose_beyond.sum(axis=0)
        is_border = (crossing >= _CROSSING) & (expected >= _EXPECTED)
        furthest = reaches.max(axis=0)
        on_line = (ends_xy @ directions.T > furthest - _ON_LINE_M).sum(axis=0) >= _CROSSING
        limits = np.where(is_border, limits, furthest) + _AT_LINE_M
        return directions[is_border | on_line], limits[is_border | on_line]


def _directions(ends_xy: FloatArray) -> FloatArray:
    """Return unit vectors all around, and across the sides of the hull of dead ends, on which a cut may lie, (D, 2)."""
    import shapely  # noqa: PLC0415

    angles = np.radians(np.arange(0.0, 360.0, _STEP_DEG))
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    hull = shapely.convex_hull(shapely.multipoints(ends_xy))
    if not isinstance(hull, shapely.Polygon):
        return around
    side = np.diff(shapely.get_coordinates(shapely.orient_polygons(hull)), axis=0)
    across = np.stack([side[:, 1], -side[:, 0]], axis=-1) / np.hypot(*side.T)[:, None]
    return np.concatenate([around, across])
