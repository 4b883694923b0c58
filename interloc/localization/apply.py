"""Puts a run where `locate` found it: every detection on the earth, a fair copy to score, the places as a layer."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, IntArray, JsonObject
from interloc.config import CalibrationConfig, FusionConfig
from interloc.drive import Drive, Georeference
from interloc.errors import LocationError
from interloc.geometry import ecef_from_geodetic, lonlat_from_enu, nearest_of, rotate_2d, wrap_bearing, yaw_of
from interloc.localization.locate import Location, locate
from interloc.mapping.estimation import members_of
from interloc.mapping.fusion import fuse
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import IntersectionNodes, intersection_nodes
from interloc.osm.policies import Policy
from interloc.output.geojson import positions, write_collection
from interloc.output.layers import LAYERS
from interloc.output.layout import PLACES
from interloc.output.properties import origin_of
from interloc.processes import Progress
from interloc.results import DriveResult

FAIR = (
    "The drive was placed on this very map by its roads, which flatters. Every OSM node is therefore scored with a fit "
    "that left this node out; the roads around it still took part."
)


@dataclass(frozen=True)
class PlacedRun:
    """A run that was placed on a map."""

    result: DriveResult
    """On the earth."""
    scored: DriveResult
    """The same with nothing near a node owing its position to that node; see `fair_result`."""
    location: Location


def place_run(
    result: DriveResult,
    drive: Drive,
    graph: RoadGraph,
    *,
    policy: Policy = "drive",
    tolerance_m: float = 15.0,
    near: tuple[float, float] | None = None,
    radius_m: float | None = None,
    progress: Progress | None = None,
) -> PlacedRun:
    """Place a run of `detect` on a map, and make a fair copy of it to score on the same map, by a policy."""
    location = locate(drive, graph, result=result, near=near, radius_m=radius_m, leave_one_out=True, progress=progress)
    georeference = require_found(location, drive.name)
    about = {"source": "map", **location.record()}
    placed = place_result(result, drive, georeference, about)
    nodes = intersection_nodes(graph, policy, tolerance_m)
    return PlacedRun(placed, fair_result(placed, drive, location, nodes), location)


def write_places(placed: PlacedRun, graph: RoadGraph, folder: Path) -> None:
    """Write the layer `places` into a result folder: the drive where it was found, and where it might have been."""
    places, result = placed.location.places, placed.result
    features = LAYERS[PLACES].features(
        [positions(place.track_lonlat, local=False) for place in places],
        rank=list(range(1, len(places) + 1)),
        score=[place.score for place in places],
        on_roads=[place.evidence.road for place in places],
        intersections_seen=[place.evidence.seen for place in places],
        intersections_at_nodes=[place.evidence.at_nodes for place in places],
        heading_deg=[place.heading_deg for place in places],
    )
    credit = LAYERS[PLACES].credit(features, made_up_map=graph.is_made_up)
    origin = origin_of(result.run, result.drive)
    write_collection(folder / f"{PLACES}.geojson", features, local=False, credit=credit, origin=origin)


def require_found(location: Location, drive: str) -> Georeference:
    """Return the georeference of a location, or raise an error that lists the places and says what would help."""
    if location.georeference is not None:
        return location.georeference
    decision = location.decision
    outcome = "its place is ambiguous" if decision.outcome == "ambiguous" else "it was not found on the map"
    listed = "; ".join(
        f"{place.lonlat[1]:.5f},{place.lonlat[0]:.5f} heading {place.heading_deg:.0f} (score {place.score:.2f}, "
        f"{100 * place.evidence.road:.0f} % on roads, {place.evidence.at_nodes} of {place.evidence.seen} intersections)"
        for place in location.places[:4]
    )
    places = f" Best places of its first scan: {listed}." if listed else ""
    raise LocationError(f"{drive}: {outcome}: {decision.reason}{places} {decision.advice}")


def place_result(result: DriveResult, drive: Drive, georeference: Georeference, about: JsonObject) -> DriveResult:
    """Put a run that was made without georeference on the earth, and fuse its detections anew.

    `about` is what `run.json` shall say of it, under `location`.
    """
    assert not result.is_georeferenced
    rows = np.searchsorted(drive.frames, result.keyframes.frame)
    lat, lon = georeference.lat_deg[rows], georeference.lon_deg[rows]
    yaw = yaw_of(georeference.R_enu_lidar[rows])
    turn_deg = np.degrees(yaw - result.keyframes.world_yaw_rad)
    std = georeference.position_std_m
    keyframes = replace(
        result.keyframes,
        lonlat=np.stack([lon, lat], axis=-1),
        enu_yaw_rad=yaw,
        position_std_m=None if std is None else std[rows],
    )
    table = result.detections
    of = table.keyframe
    bearings = [wrap_bearing(each - turn_deg[row]) for each, row in zip(table.bearings_deg, of.tolist(), strict=True)]
    lonlat = lonlat_from_enu(lat[of], lon[of], rotate_2d(table.lidar_xy, yaw[of]))
    detections = replace(table, lonlat=lonlat, bearings_deg=bearings)
    config = result.run["config"]
    fusion = FusionConfig.model_validate(config["fusion"])
    calibration = config.get("calibration")  # results of versions before have none
    intersections, intersection = fuse(
        keyframes, detections, fusion, None if calibration is None else CalibrationConfig.model_validate(calibration)
    )
    return replace(
        result,
        keyframes=keyframes,
        detections=replace(detections, intersection=intersection),
        intersections=intersections,
        trajectory_lonlat=georeference.lonlat,
        run=result.run | {"georeference": georeference.source, "location": about},
    )


def fair_result(placed: DriveResult, drive: Drive, location: Location, nodes: IntersectionNodes) -> DriveResult:
    """Return a placed run in which nothing near a node owes its position to that node.

    Each detection and each fused intersection moves to where the fit (of `locate` with `leave_one_out`) puts it that
    left out the node of the ground truth nearest to it.
    """
    rows = np.searchsorted(drive.frames, placed.keyframes.frame)
    detections, fused = placed.detections, placed.intersections
    of_detection = rows[detections.keyframe]
    of_fused = np.zeros(len(fused), dtype=np.int64)  # a scan in the middle of those that saw each
    for row, members in members_of(detections.intersection, len(fused)):
        of_fused[row] = of_detection[members[len(members) // 2]]
    lonlat, fused_lonlat = detections.degrees.copy(), fused.degrees.copy()
    nearest, nearest_fused = _nearest(detections.degrees, nodes), _nearest(fused.degrees, nodes)
    assert location.georeference is not None
    for osm_id, without in location.leaving_out.items():
        these = np.flatnonzero(nearest == osm_id)
        scans = of_detection[these]
        turned = rotate_2d(detections.lidar_xy[these], yaw_of(without.R_enu_lidar[scans]))
        lonlat[these] = lonlat_from_enu(without.lat_deg[scans], without.lon_deg[scans], turned)
        these = np.flatnonzero(nearest_fused == osm_id)
        scans = of_fused[these]
        fused_lonlat[these, 0] += without.lon_deg[scans] - location.georeference.lon_deg[scans]
        fused_lonlat[these, 1] += without.lat_deg[scans] - location.georeference.lat_deg[scans]
    return replace(
        placed,
        detections=replace(detections, lonlat=lonlat),
        intersections=replace(fused, lonlat=fused_lonlat),
        run=placed.run | {"location": placed.run["location"] | {"scored": FAIR}},
    )


def _nearest(lonlat: FloatArray, nodes: IntersectionNodes) -> IntArray:
    """Return the OSM id of the node nearest to each of (N, 2) points; -1 where there are no nodes."""
    points, truth = (ecef_from_geodetic(each[:, 1], each[:, 0]) for each in (lonlat, nodes.lonlat))
    return np.append(nodes.osm_id, -1)[nearest_of(points, truth)[1]]
