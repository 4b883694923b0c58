"""The roads and intersections of OpenStreetMap around one keyframe, in W."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.explain.evidence import Evidence
from interloc.geometry import enu_from_lonlat, rotate_2d, yaw_of
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import intersection_nodes, road_ways
from interloc.osm.policies import Policy

_NEAR_DEG = 0.1  # the plane of a fix has an end


@dataclass(frozen=True)
class GroundTruth:
    """What the map says about the region of interest.

    Attributes
    ----------
    policy : Policy
    roads : (R, 2, 2) float64
        Ends of the road pieces; x, y along the axes of W from the vehicle, metres.
    nodes : (N, 2) float64
        Intersections in the region of interest, likewise.
    osm_id : (N,) int64
    """

    policy: Policy
    roads: FloatArray
    nodes: FloatArray
    osm_id: IntArray


def ground_truth(evidence: Evidence, georeference: Georeference, graph: RoadGraph, policy: Policy) -> GroundTruth:
    """Bring the map into W by the keyframe's own fix: the errors of the poses along the drive play no part.

    Raises
    ------
    ConfigError
        There is no such policy.
    """
    i = evidence.index
    lat_deg, lon_deg = georeference.lat_deg[i], georeference.lon_deg[i]
    turn = evidence.yaw_rad - yaw_of(georeference.R_enu_lidar[i])

    def place(lonlat: FloatArray) -> FloatArray:
        return rotate_2d(enu_from_lonlat(lat_deg, lon_deg, lonlat), turn)

    half_m = evidence.roi.size * evidence.roi.resolution_m / 2
    ends = graph.lonlat[graph.edges_of(road_ways(graph, policy))]
    ends = ends[(np.abs(ends - (lon_deg, lat_deg)) < _NEAR_DEG).all(axis=(1, 2))]
    roads = place(ends)
    crosses = (roads.min(axis=1) < half_m).all(axis=1) & (roads.max(axis=1) > -half_m).all(axis=1)
    nodes = intersection_nodes(graph, policy)
    near = (np.abs(nodes.lonlat - (lon_deg, lat_deg)) < _NEAR_DEG).all(axis=1)
    nodes_xy = place(nodes.lonlat[near])
    inside = (np.abs(nodes_xy) < half_m).all(axis=1)
    return GroundTruth(policy, roads[crosses], nodes_xy[inside], nodes.osm_id[near][inside])
