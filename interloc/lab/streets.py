"""The streets of an OSM file as the simulator sees them: classes, cross-sections, and which pass over each other."""

import heapq
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import osmium
import shapely
from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from interloc.arrays import FloatArray
from interloc.errors import MapError
from interloc.lab.config import StreetConfig
from interloc.lab.tracks import LocalFrame
from interloc.osm.graph import layer_of
from interloc.osm.untrusted import read_prolog

FOOTWAYS = {"footway", "cycleway", "pedestrian", "path"}
URBAN_DISTANCE_M = 45.0
SIDEWALK_M, _BAY_M = 1.9, 2.1  # widths of sidewalks and of marked bays
TWIN_DISTANCE_M = 25.0
CLEARANCE_M = 25.0


class StreetClass(NamedTuple):
    """Defaults of a highway class."""

    width_m: float
    """Road surface of a two-way street, kerb to kerb."""
    oneway_lanes: int
    """Lanes of a one-way carriageway without `lanes`."""
    corner_radius_m: float
    """Radius of the kerb where such a street joins a larger one."""
    sidewalk: bool
    parking: bool
    """Whether sidewalks and cars at the kerb are usual in a town."""
    marked: bool
    """Whether the lanes are marked."""


STREET_CLASSES: dict[str, StreetClass] = {
    "motorway": StreetClass(15.0, 3, 12.0, False, False, True),
    "trunk": StreetClass(11.0, 2, 12.0, False, False, True),
    "primary": StreetClass(10.0, 2, 9.0, True, False, True),
    "secondary": StreetClass(8.5, 2, 8.0, True, False, True),
    "tertiary": StreetClass(7.5, 1, 7.0, True, True, True),
    "motorway_link": StreetClass(7.0, 1, 12.0, False, False, True),
    "trunk_link": StreetClass(7.0, 1, 10.0, False, False, True),
    "primary_link": StreetClass(6.5, 1, 8.0, True, False, False),
    "secondary_link": StreetClass(6.5, 1, 8.0, True, False, False),
    "tertiary_link": StreetClass(6.5, 1, 7.0, True, False, False),
    "unclassified": StreetClass(6.5, 1, 6.0, True, False, False),
    "residential": StreetClass(6.5, 1, 5.5, True, True, False),
    "living_street": StreetClass(5.5, 1, 4.0, False, True, False),
    "road": StreetClass(6.5, 1, 6.0, True, False, False),
    "service": StreetClass(4.0, 1, 3.0, False, False, False),
}
"""Highways that a car drives on; not footways, paths and tracks."""

YARD_SERVICES = {"driveway", "parking_aisle", "drive-through"}
"""`service=` ways that count as parking: SemanticKITTI labels private drives and the lanes of car parks so."""

_LANE_M = 3.25
_ONEWAY_LANE_M = 3.5


def road_width_m(tags: Mapping[str, str]) -> float:
    """Return the width of the road surface of a driven way, kerb to kerb.

    `width` counts if plausible; then `lanes`; then the class. A one-way carriageway has 3.5 m per lane and, with a
    single lane, room to pass a stopped car (5 m in all).
    """
    street, tagged, lanes = STREET_CLASSES[tags["highway"]], _number(tags.get("width")), _number(tags.get("lanes"))
    if tagged is not None and 2.5 <= tagged <= 30:
        return tagged
    if tags["highway"] == "service":
        return 3.5 if tags.get("service") in YARD_SERVICES else street.width_m
    if is_oneway(tags):
        count = lanes if lanes is not None and 1 <= lanes <= 6 else street.oneway_lanes
        return max(count * _ONEWAY_LANE_M, 5.0)
    if lanes is None or not 1 <= lanes <= 8 or lanes == 2:
        return street.width_m
    return min(street.width_m, 4.5) if lanes < 2 else max(lanes * _LANE_M, street.width_m)


def is_oneway(tags: Mapping[str, str]) -> bool:
    """Tell whether a way is one carriageway for one direction."""
    value = tags.get("oneway")
    if value is None:
        return tags.get("junction") in {"roundabout", "circular"} or tags.get("highway") == "motorway"
    return value in {"yes", "true", "1", "-1"}


def sidewalk_sides(tags: Mapping[str, str]) -> tuple[bool, bool]:
    """Return whether a street has a sidewalk to the left and to the right of its direction."""
    value = tags.get("sidewalk")
    if value is None:
        usual = STREET_CLASSES[tags["highway"]].sidewalk
        return usual, usual
    return value in {"left", "both", "yes"}, value in {"right", "both", "yes"}


def _number(text: str | None) -> float | None:
    match = re.match(r"\s*(-?\d+(?:\.\d+)?)\s*(?:m|$)", text or "")
    return float(match.group(1)) if match else None


@dataclass(frozen=True)
class Street:
    """A piece of a way from one junction (or end) to the next."""

    way_id: int
    part: int
    """Which piece of the way."""
    nodes: tuple[int, ...]
    xy: FloatArray
    """(N, 2) float64: their places in M, metres."""
    tags: dict[str, str]

    @property
    def level(self) -> int:
        """Vertical order: 0 on the ground, above on bridges, below in tunnels."""
        return layer_of(self.tags)


@dataclass
class StreetMap:
    """The world as the map knows it, in the plane M of `frame`."""

    frame: LocalFrame
    streets: list[Street] = field(default_factory=list)
    """Everything a car drives on."""
    footways: list[tuple[dict[str, str], FloatArray]] = field(default_factory=list)
    """list of (tags, (N, 2) float64)."""
    parking: list[tuple[dict[str, str], FloatArray]] = field(default_factory=list)
    buildings: list[tuple[dict[str, str], FloatArray]] = field(default_factory=list)
    """list of (tags, (N, 2) float64): closed outlines."""
    turning_circles: list[int] = field(default_factory=list)
    """Nodes where a dead end widens."""
    node_xy: dict[int, FloatArray] = field(default_factory=dict)
    """Place of every node of a street."""

    def arms(self) -> dict[int, list[tuple[Street, bool]]]:
        """Return for every end of a street the streets there, with True where the street starts at it."""
        arms: dict[int, list[tuple[Street, bool]]] = {}
        for street in self.streets:
            arms.setdefault(street.nodes[0], []).append((street, True))
            arms.setdefault(street.nodes[-1], []).append((street, False))
        return arms


@dataclass(frozen=True)
class MapWay:
    """A way: id, node ids, (N, 2) float64 longitudes and latitudes of the nodes, tags."""

    way_id: int
    nodes: list[int]
    lonlat: FloatArray
    tags: dict[str, str]


@dataclass(frozen=True)
class MapData:
    """What the simulator reads of a map, wherever the track will lie."""

    path: Path
    """OSM file with the streets."""
    ways: list[MapWay]
    """Those with one of the tags `highway`, `building` and `amenity`."""
    node_tags: dict[int, dict[str, str]] = field(default_factory=dict)
    """Tags of the nodes of these ways, by id of the node."""
    areas: list[MapWay] | None = None
    """Buildings and car parks of another file; None: they are among `ways`."""


def read_map(roads: Path, buildings: Path | None = None) -> MapData:
    """Read what the simulator draws of an OSM file; buildings and car parks of another one, if it is given."""
    if buildings is None:
        return MapData(Path(roads), *read_ways(roads, {"highway", "building", "amenity"}))
    return MapData(Path(roads), *read_ways(roads, {"highway"}), read_ways(buildings, {"building", "amenity"})[0])


def street_map_of(data: MapData, frame: LocalFrame, box: tuple[float, float, float, float] | None = None) -> StreetMap:
    """Sort the ways of a map into streets, footways, car parks and buildings, in the plane of a frame.

    What lies wholly outside of `box` (least x, least y, greatest x, greatest y in M, metres) is left out.
    """
    result = StreetMap(frame)
    driven = []
    for way, xy in _inside(data.ways, frame, box):
        kind = way.tags.get("highway")
        if kind in STREET_CLASSES and way.tags.get("area") != "yes":
            driven.append((way, xy))
        elif kind in FOOTWAYS and way.tags.get("area") != "yes":
            result.footways.append((way.tags, xy))
    result.streets = _split(driven)
    result.node_xy = {n: p for s in result.streets for n, p in zip(s.nodes, s.xy, strict=True)}
    result.turning_circles = [
        n for n, tags in data.node_tags.items() if tags.get("highway") == "turning_circle" and n in result.node_xy
    ]
    for way, xy in _inside(data.ways if data.areas is None else data.areas, frame, box):
        if len(xy) < 4 or way.nodes[0] != way.nodes[-1]:
            continue
        if way.tags.get("amenity") == "parking":
            result.parking.append((way.tags, xy))
        elif way.tags.get("building", "no") != "no":
            result.buildings.append((way.tags, xy))
    return result


def _inside(
    ways: Iterable[MapWay], frame: LocalFrame, box: tuple[float, float, float, float] | None
) -> Iterator[tuple[MapWay, FloatArray]]:
    """Yield ways with their points in M, unless they lie wholly outside a box."""
    for way in ways:
        xy = frame.xy(way.lonlat)
        low, high = xy.min(axis=0), xy.max(axis=0)
        if box is None or not (high[0] < box[0] or high[1] < box[1] or low[0] > box[2] or low[1] > box[3]):
            yield way, xy


def read_ways(path: Path, keys: set[str] | None = None) -> tuple[list[MapWay], dict[int, dict[str, str]]]:
    """Return the ways with any of the keys (None: all ways), and the tags of their nodes."""
    container = read_prolog(path).container  # refuses what is not a map before a parser sees it
    file = osmium.io.File(str(path), container)
    try:
        found: list[tuple[int, list[int], dict[str, str]]] = []
        ways: Any = osmium.FileProcessor(file, osmium.osm.WAY)
        for way in ways:
            tags = dict(way.tags)
            if keys is None or keys & tags.keys():
                found.append((way.id, [node.ref for node in way.nodes], tags))
        wanted = {node for _, nodes, _ in found for node in nodes}
        place: dict[int, tuple[float, float]] = {}
        node_tags: dict[int, dict[str, str]] = {}
        nodes: Any = osmium.FileProcessor(file, osmium.osm.NODE)
        for node in nodes:
            if node.id in wanted and node.location.valid():
                place[node.id] = (node.location.lon, node.location.lat)
                if node.tags:
                    node_tags[node.id] = dict(node.tags)
    except (RuntimeError, ValueError) as error:
        raise MapError(f"{path}: cannot be read as OpenStreetMap data ({error}).") from error
    result = []
    for way_id, refs, tags in found:
        known = [ref for ref in refs if ref in place]  # extracts are cut at their edge
        if len(known) > 1:
            result.append(MapWay(way_id, known, np.array([place[ref] for ref in known]), tags))
    return result, node_tags


def _split(driven: Iterable[tuple[MapWay, FloatArray]]) -> list[Street]:
    """Cut ways at every node that they share with another one, or visit twice."""
    driven = list(driven)
    uses = Counter(node for way, _ in driven for node in way.nodes)
    streets = []
    for way, xy in driven:
        cuts = [0, *(i for i in range(1, len(xy) - 1) if uses[way.nodes[i]] > 1), len(xy) - 1]
        for part, (a, b) in enumerate(pairwise(cuts)):
            piece = xy[a : b + 1]
            if float(np.ptp(piece, axis=0).max()) > 0:
                streets.append(Street(way.way_id, part, tuple(way.nodes[a : b + 1]), piece, way.tags))
    return streets


@dataclass(frozen=True)
class Profile:
    """Cross-section of a street, metres; left and right of the direction of its way."""

    street: Street
    line: LineString
    """Centre line in M."""
    half_m: float
    """Half the width of the road surface."""
    bay_left_m: float
    bay_right_m: float
    """Marked parking at the kerb; 0 where there is none."""
    walk_left_m: float
    walk_right_m: float
    """Sidewalks beyond; 0 where there is none."""
    median_left: bool
    """The left side belongs to the other carriageway or to the island of a roundabout."""
    oneway: bool
    urban: bool

    @property
    def kind(self) -> StreetClass:
        """Its class."""
        return STREET_CLASSES[self.street.tags["highway"]]

    @property
    def is_service(self) -> bool:
        """True for service ways of any kind."""
        return self.street.tags["highway"] == "service"

    def edge_m(self, *, left: bool) -> float:
        """Distance of the back edge of the sidewalk from the centre line."""
        if left:
            return self.half_m + self.bay_left_m + self.walk_left_m
        return self.half_m + self.bay_right_m + self.walk_right_m


@dataclass(frozen=True)
class Crossing:
    """A place where one street passes over another."""

    x_m: float
    y_m: float
    shown: int
    hidden: int
    """Indices of the streets; a vehicle on the ground sees `shown`: the lower of two, unless that is a tunnel."""

    @property
    def clearing(self) -> BaseGeometry:
        """The neighbourhood in which only one of the two exists."""
        return Point(self.x_m, self.y_m).buffer(CLEARANCE_M)


def street_profiles(street_map: StreetMap, config: StreetConfig, *, towns: bool, seed: int) -> list[Profile]:
    """Decide the cross-section of every street; the seed chooses those with marked bays.

    With `towns` every street runs through a town (no buildings are known, or they are made up along the streets), else
    those near buildings of the map.
    """
    lines = [LineString(s.xy) for s in street_map.streets]
    tree = shapely.STRtree(lines)
    centres = shapely.STRtree([Point(xy.mean(axis=0)) for _, xy in street_map.buildings])
    return [
        _profile(
            street,
            line,
            config,
            urban=towns or len(centres.query(line, predicate="dwithin", distance=URBAN_DISTANCE_M)) >= 2,
            median_left=_median_left(street, line, street_map.streets, tree),
            draw=np.random.default_rng([seed, street.way_id & 0x7FFFFFFF, 1]).random(2),
        )
        for street, line in zip(street_map.streets, lines, strict=True)
    ]


def _profile(
    street: Street, line: LineString, config: StreetConfig, *, urban: bool, median_left: bool, draw: FloatArray
) -> Profile:
    kind = STREET_CLASSES[street.tags["highway"]]
    half = road_width_m(street.tags) / 2
    left, right = sidewalk_sides(street.tags)
    if "sidewalk" not in street.tags and not urban:
        left = right = False
    bays = urban and kind.parking and kind.sidewalk and not kind.marked and draw[0] < config.parking_bay_share
    bay_left = _BAY_M if bays and draw[1] < 0.6 else 0.0
    bay_right = _BAY_M if bays and draw[1] > 0.3 else 0.0
    return Profile(
        street=street,
        line=line,
        half_m=min(half, 2.75) if bays else half,
        bay_left_m=bay_left,
        bay_right_m=bay_right,
        walk_left_m=SIDEWALK_M if left and not median_left else 0.0,
        walk_right_m=SIDEWALK_M if right else 0.0,
        median_left=median_left,
        oneway=is_oneway(street.tags),
        urban=urban,
    )


def _median_left(street: Street, line: LineString, streets: Sequence[Street], tree: shapely.STRtree) -> bool:
    """Tell whether the other carriageway of the same road, or the island of a roundabout, lies to the left."""
    if street.tags.get("junction") in {"roundabout", "circular"}:
        return True
    if not is_oneway(street.tags) or street.tags["highway"] in {"residential", "service", "living_street"}:
        return False
    middle = np.array(line.interpolate(0.5, normalized=True).coords[0])
    ahead = np.array(line.interpolate(min(0.5 + 1.0 / line.length, 1.0), normalized=True).coords[0])
    direction = (ahead - middle) / max(float(np.linalg.norm(ahead - middle)), 1e-9)
    probe = LineString([middle, middle + TWIN_DISTANCE_M * np.array([-direction[1], direction[0]])])
    for i in tree.query(probe, predicate="intersects"):
        other = streets[int(i)]
        if other is street or not is_oneway(other.tags) or other.tags["highway"] != street.tags["highway"]:
            continue
        along = other.xy[-1] - other.xy[0]
        if along @ direction < -0.7 * float(np.linalg.norm(along)):
            return True
    return False


def find_crossings(profiles: Sequence[Profile]) -> list[Crossing]:
    """Find the streets that pass over or under another one, without a node in common."""
    tree = shapely.STRtree([p.line for p in profiles])
    crossings = []
    for i, profile in enumerate(profiles):
        for j in map(int, tree.query(profile.line, predicate="intersects")):
            other = profiles[j]
            low, high = profile.street.level, other.street.level
            if low >= high or set(profile.street.nodes) & set(other.street.nodes):
                continue
            place = shapely.centroid(profile.line.intersection(other.line))
            shown, hidden = (i, j) if low >= 0 else (j, i)
            crossings.append(Crossing(place.x, place.y, shown, hidden))
    return crossings


def visible_lines(
    profiles: Sequence[Profile], crossings: Sequence[Crossing], *, from_hidden: bool
) -> list[BaseGeometry]:
    """Return the part of each centre line that exists for a vehicle on the usual level, or on the hidden one.

    Where streets cross on two levels, the other street and those that it continues into end before the crossing.
    """
    lines: list[BaseGeometry] = [p.line for p in profiles]
    for crossing in crossings:
        kept, gone = crossing.shown, crossing.hidden
        if from_hidden:
            kept, gone = gone, kept
        ends = {profiles[gone].street.nodes[0], profiles[gone].street.nodes[-1]}
        stays = {profiles[kept].street.nodes[0], profiles[kept].street.nodes[-1]}
        for i, profile in enumerate(profiles):
            own = {profile.street.nodes[0], profile.street.nodes[-1]}
            if i == gone or (own & ends and not own & stays and i != kept):
                lines[i] = lines[i].difference(crossing.clearing)
    return lines


def shortest_path(steps: Mapping[int, Iterable[tuple[int, float]]], start: int, goal: int) -> list[int] | None:
    """Return the nodes of the shortest path, by the nodes that each leads to and how far; None: there is none."""
    queue: list[tuple[float, list[int]]] = [(0.0, [start])]
    done: set[int] = set()
    while queue:
        length, path = heapq.heappop(queue)
        here = path[-1]
        if here == goal:
            return path
        if here not in done:
            done.add(here)
            for there, step in steps.get(here, ()):
                heapq.heappush(queue, (length + step, [*path, there]))
    return None
