"""Worlds without noise, made by the simulator, whose intersections are known exactly."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.drives.open import open_drive
from interloc.geometry import enu_from_lonlat
from interloc.lab.config import (
    LidarConfig,
    RoadsideConfig,
    SceneConfig,
    SimulationOptions,
    StreetConfig,
    TrackConfig,
)
from interloc.lab.drive import Trip, simulate
from interloc.lab.streets import read_map
from interloc.lab.town import Town
from interloc.lab.tracks import LocalFrame, track_from_line
from interloc.pipeline import detect
from interloc.results import DriveResult

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
    for number, angles in enumerate(ARMS[shape](angle_deg), start=1):
        points = [arm(angles[0]), (0.0, 0.0), *map(arm, angles[1:])]
        refs = "".join(f'<nd ref="{nodes.setdefault(point, len(nodes) + 1)}"/>' for point in points)
        ways.append(f'<way id="{number}" version="1">{refs}<tag k="highway" v="residential"/></way>')
    places = [(number, *FRAME.lonlat(np.array(point))) for point, number in nodes.items()]
    text = "".join(f'<node id="{n}" version="1" lat="{lat:.9f}" lon="{lon:.9f}"/>' for n, lon, lat in places)
    return f'<?xml version="1.0"?><osm version="0.6">{text}{"".join(ways)}</osm>'


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


@pytest.fixture(scope="session")
def town_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive through the plain part of the made-up town, its map beside it."""
    out = tmp_path_factory.mktemp("town") / "plain"
    options = SimulationOptions(keyframes_only=True, ground_only=True, scene=BARE_SCENE, sensor=EXACT_LIDAR)
    simulate(Town("plain").trip(TrackConfig(speed_mps=8.2)), out, options)
    return out


@pytest.fixture(scope="session")
def town_result(town_drive: Path) -> DriveResult:
    """What the default preset finds in it."""
    return detect(open_drive(town_drive, check=False))
