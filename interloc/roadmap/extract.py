"""From the mosaic of a drive and its intersections to the network of its roads; the method on one page."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import shapely

from interloc.arrays import FloatArray
from interloc.errors import Beside
from interloc.geometry import projection, travelled
from interloc.kernels.streets import nearest
from interloc.mapping.mosaic import Mosaic
from interloc.results import DriveResult
from interloc.roadmap.fit import STEP_M, Street, fit
from interloc.roadmap.graph import Graph, trace
from interloc.roadmap.network import PROFILE_STEP_M, NodeKind, RoadEdge, RoadNetwork, RoadNode
from interloc.roadmap.surface import BLOCK, Ground, survey
from interloc.roadmap.topology import connect, strokes

_TRACK_STEP_M = 2.0
_DRIVEN_M = 4.0  # from the track
_NEAR_TRACK_M = 25.0  # of a dead end: what is behind it was in view
_MIN_STATIONS = 10
_MOUTH_M = 5.0  # beyond the edge of the widest road of a junction
_DEFAULT_HALF_M = 3.0
_SIMPLIFIED_M = 0.03
_GRID_M = 0.01
_TIED_M = 2.0  # a line goes straight to its node from that distance, or from twice as far as the node lies aside
_THROUGH_STD_M, _ENDING_STD_M = 0.15, 0.6  # of a street's line at a fork
_FORK_STD_M = 2.0  # of a node that only the skeleton has
_MAX_SHIFT_M, _REACH = 8.0, round(10.0 / STEP_M)  # of a fork; stations that tell a direction
_OFFSET_STD_M = {True: 0.13, False: 0.37}  # of the line of a whole street, by whether it was driven: as simulated


def extract_roads(
    result: DriveResult, mosaic: Mosaic, *, block: int = BLOCK, beside: Beside | None = None
) -> RoadNetwork:
    """Make the map of the roads of a drive: of the mosaic that it saw, its intersections (the nodes), and its track.

    The squares that are worked on have `block` cells per side, a multiple of the side of a tile. With `beside`, what
    fails of surface, roads and areas of junctions is missing; without, it is an error.
    """
    beside = beside or Beside(is_strict=True)
    network = RoadNetwork(epsg=mosaic.epsg)
    if not mosaic.raster.tiles or not len(result.keyframes):
        return network
    with beside.part("roads and the surface of the roads"):
        ground = survey(mosaic.raster, block)
        network = replace(network, surface=ground.surface)
        with beside.part("roads"):
            network = _lines(result, mosaic, ground, network, beside)
    return network


def _lines(result: DriveResult, mosaic: Mosaic, ground: Ground, network: RoadNetwork, beside: Beside) -> RoadNetwork:
    """Return the network with its nodes and edges."""
    fused_xy, track_xy = _places(mosaic.epsg, result)
    graph = trace(ground)
    connect(graph, fused_xy, ground.places)
    streets = fit(mosaic.raster, graph, strokes(graph), track_xy)
    _move_nodes(graph, streets)
    ids = {node: number for number, node in enumerate(graph.nodes, 1)}
    found = [edge for street in streets for edge in _edges(street, graph, ids, track_xy, ground.places)]
    # Of a loop within reach of its node nothing is left.
    edges = [replace(edge, id=number) for number, edge in enumerate((e for e in found if e.length_m > 0.0), 1)]
    fused_id = result.intersections.id
    nodes = [
        RoadNode(ids[n], _kind(graph, n, track_xy), node.xy, tuple(fused_id[node.intersections].tolist()))
        for n, node in graph.nodes.items()
    ]
    network = replace(network, nodes=nodes, edges=edges)
    with beside.part("the areas of junctions"):
        areas = _areas(graph, ids, edges, ground)
        return replace(network, nodes=[replace(node, area=areas.get(node.id)) for node in nodes])


def _places(epsg: int | None, result: DriveResult) -> tuple[FloatArray, FloatArray]:
    """Return intersections and track in metres of the mosaic."""
    found, track = result.intersections, result.keyframes
    if epsg is None or found.lonlat is None or track.lonlat is None:
        return found.world_xy, _filled(track.world_xy)
    project = projection(4326, epsg)
    return project(found.lonlat), _filled(project(track.lonlat))


def _filled(track_xy: FloatArray) -> FloatArray:
    """Return the track with a place at least every two metres."""
    along = travelled(track_xy)
    at = np.union1d(along, np.arange(0.0, along[-1], _TRACK_STEP_M))
    return np.stack([np.interp(at, along, track_xy[:, k]) for k in (0, 1)], axis=-1)


def _areas(
    graph: Graph, ids: Mapping[int, int], edges: Sequence[RoadEdge], ground: Ground
) -> dict[int, shapely.Polygon | None]:
    """Return the ground of each node where roads meet, by its id."""
    surface = shapely.STRtree(ground.surface)
    arms: dict[int, list[RoadEdge]] = {}
    for edge in edges:
        for end in {edge.start, edge.end}:
            arms.setdefault(end, []).append(edge)
    areas: dict[int, shapely.Polygon | None] = {}
    for number, node in graph.nodes.items():
        if node.place is not None:
            areas[ids[number]] = ground.places[node.place]
        elif graph.degree(number) > 1 and ids[number] in arms:
            areas[ids[number]] = _junction(node.xy, arms[ids[number]], ids[number], surface)
    return areas


def _kind(graph: Graph, number: int, track: FloatArray) -> NodeKind:
    node = graph.nodes[number]
    if node.intersections:
        return "intersection"
    if node.place is not None:
        return "place"
    if graph.degree(number) > 1:
        return "fork"
    return "dead_end" if np.linalg.norm(track - node.xy, axis=1).min() < _NEAR_TRACK_M else "end_of_view"


def _move_nodes(graph: Graph, streets: Sequence[Street]) -> None:
    """Move each node that is no intersection: a fork to where the lines of its streets meet, an end to where one ends.

    Intersections are known better than the lines say that were laid through the mosaic, and have one place in a result.
    """
    lines: dict[int, list[tuple[FloatArray, FloatArray, float]]] = {}
    for street in streets:
        used = np.flatnonzero(street.is_used)
        if len(used) < _MIN_STATIONS:
            continue
        for k, (number, row) in enumerate(zip(street.nodes, street.rows, strict=True)):
            if not graph.nodes[number].is_free:
                continue
            is_end = k in {0, len(street.nodes) - 1}
            at = int(used[np.argmin(np.abs(used - row))])
            way = street.xy[min(at + _REACH, len(street.xy) - 1)] - street.xy[max(0, at - _REACH)]
            normal = np.array([-way[1], way[0]]) / max(float(np.linalg.norm(way)), 1e-9)
            here = street.xy[at] if is_end and graph.degree(number) > 1 else street.xy[row]
            lines.setdefault(number, []).append((here, normal, _ENDING_STD_M if is_end else _THROUGH_STD_M))
    for number, found in lines.items():
        node = graph.nodes[number]
        if graph.degree(number) == 1:
            node.xy = found[0][0]
            continue
        normals = np.array([normal / std for _, normal, std in found])
        misses = np.array([normal @ (here - node.xy) / std for here, normal, std in found])
        shift = np.linalg.solve(normals.T @ normals + np.eye(2) / _FORK_STD_M**2, normals.T @ misses)
        node.xy = node.xy + shift * min(1.0, _MAX_SHIFT_M / max(float(np.linalg.norm(shift)), 1e-9))


def _edges(
    street: Street, graph: Graph, ids: Mapping[int, int], track: FloatArray, places: Sequence[shapely.Polygon]
) -> list[RoadEdge]:
    """Return the edges of a street, the ends of each tied to its nodes."""
    is_driven = np.isfinite(nearest(street.xy, track, _DRIVEN_M)[0][:, 0])
    last, edges = len(street.nodes) - 2, []
    for k, (start, end) in enumerate(pairwise(street.nodes)):
        rows = np.arange(street.rows[k], street.rows[k + 1] + 1)
        used = rows[street.is_used[rows]]
        line = street.xy[rows]
        if len(used):  # where a street ends, its line is known as far as it was measured
            first = used[0] - rows[0] if k == 0 and graph.degree(start) > 1 else 0
            stop = used[-1] - rows[0] + 1 if k == last and graph.degree(end) > 1 else len(rows)
            line = line[first : max(stop, first + 1)]
        ends = np.stack([graph.nodes[start].xy, graph.nodes[end].xy])
        near = street.xy[[street.rows[k], street.rows[k + 1]]]
        at_place = [graph.nodes[n].place for n in (start, end)]  # a line ends at its edge, wherever its middle lies
        aside_m = np.linalg.norm(ends - near, axis=1) * [place is None for place in at_place]
        apart = (np.linalg.norm(line[:, None] - near, axis=2) > np.maximum(_TIED_M, 2.0 * aside_m)).all(axis=1)
        line = _outside(np.vstack([ends[0], line[apart], ends[1]]), at_place, places)
        width, at = street.left_m[used] + street.right_m[used], rows[:: round(PROFILE_STEP_M / STEP_M)]
        enough = len(used) >= _MIN_STATIONS
        low, median, high = np.percentile(width, (10.0, 50.0, 90.0)) if enough else (np.nan,) * 3
        went = bool(np.mean(is_driven[rows]) > 0.5)
        edges.append(
            RoadEdge(
                id=0,
                start=ids[start],
                end=ids[end],
                xy=shapely.get_coordinates(shapely.simplify(shapely.LineString(line), _SIMPLIFIED_M)),
                width_m=float(median),
                width_p10_m=float(low),
                width_p90_m=float(high),
                profile_m=np.where(street.is_used[at], street.left_m[at] + street.right_m[at], np.nan),
                seen=float(np.mean(street.is_seen[rows])),
                keyframes=int(np.median(street.level[rows])),
                offset_std_m=float(np.hypot(street.scatter_m, _OFFSET_STD_M[went])) if enough else np.nan,
                is_driven=went,
            )
        )
    return edges


def _outside(line: FloatArray, ends: Sequence[int | None], places: Sequence[shapely.Polygon]) -> FloatArray:
    """Return a line as far as it lies outside of the open places at its ends."""
    inside = np.zeros(len(line), np.bool_)
    for place in {each for each in ends if each is not None}:
        inside |= shapely.contains_xy(places[place], line)
    runs = np.split(np.arange(len(line)), np.flatnonzero(np.diff(inside)) + 1)
    longest = max(runs, key=lambda run: 0 if inside[run[0]] else len(run))
    return line if inside[longest[0]] or len(longest) < 2 else line[longest]


def _junction(xy: FloatArray, arms: Sequence[RoadEdge], node: int, surface: shapely.STRtree) -> shapely.Polygon | None:
    """Return the ground where the roads of a node meet: the road between their mouths."""
    half_m = [_DEFAULT_HALF_M if np.isnan(edge.width_m) else edge.width_m / 2.0 for edge in arms]
    reach = max(half_m) + _MOUTH_M
    corners = [xy]
    for edge, half in zip(arms, half_m, strict=True):
        line = shapely.LineString(edge.xy if edge.start == node else edge.xy[::-1])
        at = min(reach, 0.45 * line.length)
        mouth = shapely.get_coordinates(shapely.line_interpolate_point(line, [at, at + 0.5]))
        way = (mouth[1] - mouth[0]) / max(float(np.linalg.norm(mouth[1] - mouth[0])), 1e-9)
        side = half * np.array([-way[1], way[0]])
        corners += [mouth[0] + side, mouth[0] - side]
    hull = shapely.MultiPoint(corners).convex_hull
    if not isinstance(hull, shapely.Polygon):
        return None
    near = surface.geometries[surface.query(hull, predicate="intersects")]
    ground = shapely.get_parts(shapely.intersection(shapely.union_all(near, grid_size=_GRID_M), hull))
    polygons = [each for each in ground if isinstance(each, shapely.Polygon)]
    return max(polygons, key=lambda each: each.area, default=hull)
