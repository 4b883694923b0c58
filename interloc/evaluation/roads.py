"""The map of the roads against OpenStreetMap: which are there, how far they lie from its lines, how wide they are."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import shapely

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import nearest_of, projection
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import road_ways
from interloc.osm.policies import Policy
from interloc.roadmap.network import PROFILE_STEP_M, RoadNetwork

BUFFER_M = 3.0
"""Lines that are nearer than this to each other are the same road."""

_STEP_M = 2.0
_BESIDE_M, _PARALLEL_COS = 5.0, 0.8
_AROUND_M = 100.0


class WayScore(NamedTuple):
    """What was seen of a way of OpenStreetMap."""

    seen_m: float
    """Length of it that lies on ground that was seen as road."""
    mapped: float
    """Share of that which lies within `BUFFER_M` of a road, 0..1."""
    offset_m: float
    """Median distance of the road from it, positive to the left of the direction of the way; NaN for none."""
    width_m: float
    """Median width of the road beside it; NaN where it is not known."""
    is_driven: bool
    """The drive went along it; else the width is a minimum."""


@dataclass(frozen=True)
class RoadScores:
    """Heipke et al. (1997): Evaluation of automatic road extraction; of what was seen as road."""

    completeness: float
    """Share of the roads of the map that were seen and have a road within `BUFFER_M`."""
    correctness: float
    """Share of the roads within `BUFFER_M` of one of the map, service ways too."""
    quality: float
    """What is right, of that and all that is wrong or missing."""
    map_m: float
    roads_m: float
    """Lengths of both."""
    ways: dict[int, WayScore] = field(default_factory=dict)
    """By row of the ways of the graph; those of which nothing was seen are left out."""


def score_roads(network: RoadNetwork, graph: RoadGraph, policy: Policy) -> RoadScores | None:
    """Compare the roads of a drive with those of a map; None where no road was seen, or none of the map.

    The policy says which ways are roads; policies that choose nodes take those of `drive`.
    """
    if not network.edges or network.epsg is None:
        return None
    roads = _along_roads(network)
    places = _along_ways(graph, network)
    is_seen = np.zeros(len(places.xy), np.bool_)
    is_seen[shapely.STRtree(network.surface).query(shapely.points(places.xy), "intersects")[0]] = True
    wanted = road_ways(graph, policy)[places.owner] & is_seen
    known = road_ways(graph, "drive+service")[places.owner]
    if not wanted.any():
        return None
    is_mapped = nearest_of(places.xy, roads.xy)[0] <= BUFFER_M
    is_right = nearest_of(roads.xy, places.xy[known])[0] <= BUFFER_M
    right_m, missing_m = _STEP_M * is_right.sum(), _STEP_M * (wanted & ~is_mapped).sum()
    roads_m = _STEP_M * len(roads.xy)
    return RoadScores(
        completeness=float(is_mapped[wanted].mean()),
        correctness=float(is_right.mean()),
        quality=float(right_m / (roads_m + missing_m)),
        map_m=float(_STEP_M * wanted.sum()),
        roads_m=float(roads_m),
        ways=_ways(network, places, roads, is_seen & known, is_mapped),
    )


class _Places(NamedTuple):
    """Places along lines: (N, 2) metres, (N, 2) unit directions, (N,) rows of their owners, (N,) widths or NaN."""

    xy: FloatArray
    way: FloatArray
    owner: IntArray
    width_m: FloatArray


def _along_roads(network: RoadNetwork) -> _Places:
    parts = []
    for row, edge in enumerate(network.edges):
        line = shapely.LineString(edge.xy)
        at = np.arange(_STEP_M / 2, line.length, _STEP_M)
        ends = [
            shapely.get_coordinates(shapely.line_interpolate_point(line, np.clip(at + d, 0.0, line.length)))
            for d in (-0.5, 0.0, 0.5)
        ]
        profile = edge.profile_m[np.minimum((at / PROFILE_STEP_M).round().astype(int), len(edge.profile_m) - 1)]
        width = np.where(np.isnan(profile), edge.width_m, profile)
        parts.append(np.column_stack([ends[1], ends[2] - ends[0], np.full(len(at), row), width]))
    return _places(np.concatenate(parts))


def _along_ways(graph: RoadGraph, network: RoadNetwork) -> _Places:
    """Return places along the ways of a map around the roads."""
    corners = np.concatenate([edge.xy for edge in network.edges])
    low, high = corners.min(axis=0) - _AROUND_M, corners.max(axis=0) + _AROUND_M
    ends = projection(4326, network.epsg)(graph.lonlat)[graph.edges]
    back = graph.ways.direction[graph.edge_way] < 0
    ends[back] = ends[back, ::-1]
    near = np.all(ends.max(axis=1) > low, axis=1) & np.all(ends.min(axis=1) < high, axis=1)
    start, step, owner = ends[near, 0], ends[near, 1] - ends[near, 0], graph.edge_way[near]
    count = np.maximum(1, np.round(np.linalg.norm(step, axis=1) / _STEP_M)).astype(int)
    piece = np.repeat(np.arange(len(count)), count)
    within = (np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[piece]
    xy = start[piece] + within[:, None] * step[piece]
    return _places(np.column_stack([xy, step[piece], owner[piece], np.full(len(piece), np.nan)]))


def _places(table: FloatArray) -> _Places:
    way = table[:, 2:4] / np.maximum(np.linalg.norm(table[:, 2:4], axis=1), 1e-9)[:, None]
    return _Places(table[:, :2], way, table[:, 4].astype(np.int64), table[:, 5])


def _ways(
    network: RoadNetwork, places: _Places, roads: _Places, is_seen: BoolArray, is_mapped: BoolArray
) -> dict[int, WayScore]:
    distance, nearest = nearest_of(places.xy, roads.xy)
    parallel = np.abs(np.sum(places.way * roads.way[nearest], axis=1)) > _PARALLEL_COS
    is_beside = is_seen & parallel & (distance < _BESIDE_M)
    left = np.stack([-places.way[:, 1], places.way[:, 0]], axis=-1)
    offset = np.sum((roads.xy[nearest] - places.xy) * left, axis=1)
    driven = np.array([edge.is_driven for edge in network.edges])
    scores = {}
    for way in np.unique(places.owner[is_seen]).tolist():
        seen = is_seen & (places.owner == way)
        beside = seen & is_beside
        width = roads.width_m[nearest[beside]]
        scores[way] = WayScore(
            seen_m=float(_STEP_M * seen.sum()),
            mapped=float(is_mapped[seen].mean()),
            offset_m=float(np.median(offset[beside])) if beside.any() else np.nan,
            width_m=float(np.nanmedian(width)) if np.isfinite(width).any() else np.nan,
            is_driven=bool(driven[roads.owner[nearest[beside]]].mean() > 0.5) if beside.any() else False,
        )
    return scores
