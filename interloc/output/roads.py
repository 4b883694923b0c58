"""The map of the roads of a drive as layers: roads, junctions, surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import Beside, expect
from interloc.mapping.mosaic import Mosaic
from interloc.output.geojson import as_printed, positions
from interloc.output.layers import LAYERS
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
    from interloc.roadmap.extract import extract_roads  # noqa: PLC0415 - SciPy and Shapely are slow to import

    expect(result, DriveResult)
    return extract_roads(as_printed(result), mosaic_of(result) if mosaic is None else mosaic, beside=beside)


def road_features(network: RoadNetwork) -> dict[str, list[dict[str, Any]]]:
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
