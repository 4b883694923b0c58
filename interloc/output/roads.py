"""Roads as layers: those of a drive with junctions and surface; those of a map, with buildings: a map without tiles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import Beside, expect
from interloc.geometry import enu_from_lonlat, middle_of, tree_of
from interloc.mapping.mosaic import Mosaic
from interloc.osm.graph import Bounds, RoadGraph, within
from interloc.osm.intersections import road_ways
from interloc.output.geojson import Feature, as_printed, positions
from interloc.output.layers import LAYERS
from interloc.output.layout import BUILDINGS
from interloc.output.road import mosaic_of
from interloc.results import DriveResult
from interloc.roadmap.network import RoadNetwork

if TYPE_CHECKING:
    import shapely  # slow to import


def roads(result: DriveResult, mosaic: Mosaic | None = None, *, beside: Beside | None = None) -> RoadNetwork:
    """Make the map of the roads that a drive saw: centrelines, widths, junctions and surface.

    Parameters
    ----------
    result
        Of `detect`, or read from a folder, whose `road.tif` is taken. Its intersections become the nodes, where its
        files have them: a run and its result folder have the same roads.
    mosaic
        That of the run, where it was made before.
    beside
        Collects what could not be made, instead of an error.

    Returns
    -------
    RoadNetwork
        In metres of a UTM zone, or of W without georeference. Empty where no road was kept.

    Raises
    ------
    DamagedResultError
        `road.tif` of the folder is damaged.
    """
    from interloc.roadmap.extract import extract_roads  # noqa: PLC0415 - Shapely is slow to import

    expect(result, DriveResult)
    return extract_roads(as_printed(result), mosaic_of(result) if mosaic is None else mosaic, beside=beside)


def road_features(network: RoadNetwork) -> dict[str, list[Feature]]:
    """Return the GeoJSON features of the layers `roads`, `junctions` and `road_surface`."""
    kinds = {node.id: node.kind for node in network.nodes}
    ends = [end for edge in network.edges for end in (edge.start, edge.end)]
    areas = [(node, node.area) for node in network.nodes if node.area is not None]
    edges = network.edges
    return {
        "roads": LAYERS["roads"].features(
            [_line(network, edge.xy) for edge in edges],
            id=[edge.id for edge in edges],
            start_node=[edge.start for edge in edges],
            end_node=[edge.end for edge in edges],
            start_kind=[kinds[edge.start] for edge in edges],
            end_kind=[kinds[edge.end] for edge in edges],
            length_m=[edge.length_m for edge in edges],
            width_m=[edge.width_m for edge in edges],
            width_p10_m=[edge.width_p10_m for edge in edges],
            width_p90_m=[edge.width_p90_m for edge in edges],
            width_profile_m=[edge.profile_m.tolist() for edge in edges],
            is_driven=[edge.is_driven for edge in edges],
            seen=[edge.seen for edge in edges],
            keyframes=[edge.keyframes for edge in edges],
            offset_std_m=[edge.offset_std_m for edge in edges],
        ),
        "junctions": LAYERS["junctions"].features(
            [_rings(network, area) for _, area in areas],
            id=[node.id for node, _ in areas],
            kind=[node.kind for node, _ in areas],
            intersections=[list(node.intersections) for node, _ in areas],
            roads=[ends.count(node.id) for node, _ in areas],
            area_m2=[area.area for _, area in areas],
        ),
        "road_surface": LAYERS["road_surface"].features(
            [_rings(network, each) for each in network.surface],
            id=list(range(1, len(network.surface) + 1)),
            area_m2=[each.area for each in network.surface],
        ),
    }


def _line(network: RoadNetwork, xy: FloatArray) -> list[list[float]]:
    return positions(network.lonlat(xy), local=network.epsg is None)


def _rings(network: RoadNetwork, polygon: shapely.Polygon) -> list[list[list[float]]]:
    """Return the rings of a polygon, the outer one counter-clockwise (RFC 7946, 3.1.6)."""
    import shapely  # noqa: PLC0415

    turned = shapely.orient_polygons(polygon)
    return [_line(network, np.asarray(ring.coords)) for ring in (turned.exterior, *turned.interiors)]


# a map around a drive -------------------------------------------------------------------------------------------------

SEEN = ("seen_m", "mapped", "offset_m", "width_m", "is_driven")
"""What an evaluation tells of the ways that the drive saw."""

NEAR_M = 80.0
"""Buildings further from the track are not drawn: a LiDAR at street level sees the first row."""


def osm_road_features(
    graph: RoadGraph, bounds: Bounds, seen: Mapping[int, Mapping[str, Any]] | None = None
) -> list[Feature]:
    """Return the ways that come into bounds (degrees) as features of the layer `osm_roads`.

    The edges of a way that touch the bounds are kept, whole. `seen` tells by row what a drive saw of ways, as `SEEN`.
    """
    import shapely  # noqa: PLC0415

    lines: Any = shapely.linestrings(graph.lonlat[graph.edges])
    if bounds[0] <= bounds[2]:
        near = np.flatnonzero(shapely.intersects(lines, shapely.box(*bounds)))
    else:  # across the 180th meridian, where the plane of degrees ends
        near = np.flatnonzero(within(bounds, graph.lonlat)[graph.edges].any(axis=1))
    if len(near) == 0:
        return []
    order = near[np.argsort(graph.edge_way[near], kind="stable")]
    ways, first = np.unique(graph.edge_way[order], return_index=True)
    pieces: list[tuple[int, list[list[float]]]] = []
    sense = np.where(graph.ways.direction < 0, -1, 1).tolist()
    for way, edges in zip(ways.tolist(), np.split(lines[order], first[1:]), strict=True):
        joined: Any = shapely.line_merge(shapely.multilinestrings(edges))
        parts = (shapely.get_coordinates(line)[:: sense[way]] for line in shapely.get_parts(joined))
        pieces += [(way, positions(lonlat, local=False)) for lonlat in parts]
    rows = [way for way, _ in pieces]
    return LAYERS["osm_roads"].features(
        [line for _, line in pieces],
        osm_id=graph.ways.id[rows],
        highway=[graph.ways.highway[row] for row in rows],
        name=[graph.ways.name[row] or None for row in rows],
        is_drivable=road_ways(graph, "drive+service")[rows],
        is_one_way=(graph.ways.direction != 0)[rows],
        **{name: [seen.get(row, {}).get(name) if seen else None for row in rows] for name in SEEN},
    )


def building_features(graph: RoadGraph, lonlat: FloatArray) -> list[Feature]:
    """Return the buildings near (N, 2) longitudes and latitudes as Polygon features of the layer `osm_buildings`."""
    import shapely  # noqa: PLC0415

    buildings = graph.buildings
    if len(buildings) == 0 or len(lonlat) == 0:
        return []
    lon, lat = middle_of(lonlat)
    corners = enu_from_lonlat(lat, lon, np.concatenate(buildings.outlines))
    distance, _ = tree_of(enu_from_lonlat(lat, lon, lonlat)).query(corners, distance_upper_bound=NEAR_M)
    first = np.cumsum([0, *(len(ring) for ring in buildings.outlines[:-1])])
    near = np.flatnonzero(np.minimum.reduceat(distance, first) < NEAR_M)
    turned = shapely.orient_polygons([shapely.Polygon(buildings.outlines[row]) for row in near])
    polygons = [[positions(shapely.get_coordinates(each), local=False)] for each in turned]
    return LAYERS[BUILDINGS].features(polygons, osm_id=buildings.id[near], osm_type=["way"] * len(near))
