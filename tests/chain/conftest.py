"""Worlds without noise, made by the simulator, whose intersections are known exactly."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import enu_from_lonlat
from interloc.lab.config import LidarConfig, RoadsideConfig, SceneConfig, SimulationOptions, StreetConfig, TrackConfig
from interloc.lab.drive import Trip, simulate
from interloc.lab.streets import read_map
from interloc.lab.tracks import LocalFrame, track_from_line
from tests.osm_files import osm_text

Point = tuple[float, float]

FRAME = LocalFrame(49.0, 8.4)
TURNED_DEG = 17.0  # the whole world, counter-clockwise from east
ARM_M = 80.0

EXACT_LIDAR = LidarConfig(
    columns=512, max_range_m=90, range_noise_m=0, surface_noise=0, dropout=0, road_half_range_m=None
)
BARE_SCENE = SceneConfig(
    flat=True,
    cell_m=0.0625,  # every cell that a road touches is painted: with cells twice as large its axis is up to 7 cm off
    track_half_width_m=0,
    streets=StreetConfig(corner_radius_factor=0, parking_bay_share=0),
    roadside=RoadsideConfig(parked_car_density=0, hedge_share=0, buildings="none"),
)
TRACK = TrackConfig(speed_mps=8.2, rate_hz=4, offset_m=1.7)  # each scan is a keyframe, none lies on the grid of cells

ARMS: dict[str, Callable[[float], list[list[float]]]] = {
    "X": lambda angle: [[180, 0], [180 + angle, angle]],
    "T": lambda angle: [[180, 0], [angle]],
    "Y": lambda angle: [[180], [angle / 2], [-angle / 2]],
}
"""Directions (degrees, counter-clockwise) of the ends of each street through the node at the origin."""

ROUTES: dict[tuple[str, str], tuple[Callable[[float], float], Callable[[float], float]]] = {
    ("X", "straight"): (lambda _: 180, lambda _: 0),
    ("X", "turning"): (lambda _: 180, lambda angle: angle),
    ("T", "straight"): (lambda _: 180, lambda _: 0),
    ("T", "turning"): (lambda _: 180, lambda angle: angle),
    ("Y", "straight"): (lambda _: 180, lambda angle: angle / 2),
    ("Y", "turning"): (lambda angle: angle / 2, lambda angle: -angle / 2),
}
"""The arm that is driven in on, and the one that is driven out on."""


def arm(angle_deg: float, length_m: float = ARM_M) -> Point:
    turned = math.radians(angle_deg + TURNED_DEG)
    return length_m * math.cos(turned), length_m * math.sin(turned)


def one_junction(shape: str, angle_deg: float) -> str:
    """Return an OSM file with one intersection at the origin of `FRAME`, and 80 m of each of its arms."""
    nodes: dict[Point, int] = {(0.0, 0.0): 1}
    ways = []
    for angles in ARMS[shape](angle_deg):
        points = [arm(angles[0]), (0.0, 0.0), *map(arm, angles[1:])]
        ways.append([nodes.setdefault(point, len(nodes) + 1) for point in points])
    return osm_text(FRAME.lonlat(np.array(list(nodes))), ways)


def route_line(shape: str, angle_deg: float, route: str) -> FloatArray:
    """Return the longitudes and latitudes of 45 m in and 45 m out, a point every metre or so."""
    start, end = (arm(bearing(angle_deg), 45.0) for bearing in ROUTES[shape, route])
    way_in, way_out = np.linspace(start, (0.0, 0.0), 40, endpoint=False), np.linspace((0.0, 0.0), end, 41)
    return FRAME.lonlat(np.concatenate([way_in, way_out]))


def junction_drive(
    out: Path, shape: str, angle_deg: float, route: str, *, sensor: LidarConfig = EXACT_LIDAR, ground_only: bool = True
) -> Path:
    """Simulate a drive through a world with one intersection; the map lies beside it as `map.osm`."""
    out.parent.mkdir(parents=True, exist_ok=True)
    roads = out.parent / "map.osm"
    roads.write_text(one_junction(shape, angle_deg))
    track = track_from_line(route_line(shape, angle_deg, route), None, TRACK)
    options = SimulationOptions(keyframes_only=True, ground_only=ground_only, scene=BARE_SCENE, sensor=sensor)
    simulate(Trip(track, read_map(roads)), out, options)
    return out


def from_origin(lonlat: FloatArray) -> FloatArray:
    """Return the distances in metres of places from the intersection of a one-junction world."""
    distances: FloatArray = np.hypot(*enu_from_lonlat(FRAME.lat_deg, FRAME.lon_deg, lonlat).T)
    return distances
