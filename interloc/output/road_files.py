"""The roads of a result as files for robots, vehicles and simulators: Nav2, Lanelet2, OpenDRIVE.

How many lanes a road has is assumed from its width, and is the same in all of them: less than 4.5 m is one lane for
both directions, any other has two. One-way streets, of one lane, are those of the map that the result was scored
against, and the side of traffic is that of the place (`interloc.output.traffic`). Roads end before their junctions,
across which curves lead from each lane to those of the other roads.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from shapely.ops import substring

from interloc.arrays import FloatArray, JsonObject
from interloc.errors import GeoreferenceError
from interloc.files import write_file
from interloc.geometry import middle_of, projection
from interloc.output.geojson import Feature, encode
from interloc.output.layers import LAYERS
from interloc.output.read import read_results
from interloc.output.roads import roads
from interloc.output.traffic import Side, one_way_roads, side_of
from interloc.output.vector_files import PLACE_IT
from interloc.results import DriveResult
from interloc.roadmap.network import RoadEdge, RoadNetwork

_ORIGIN_M = 100.0  # files in metres count from a round place of the map
_MIN_SEEN = 0.5  # share of a road that was seen: others are left out


@dataclass(frozen=True)
class Traffic:
    """How people drive on the roads of a network."""

    side: Side = "right"
    one_way: Mapping[int, int] = field(default_factory=dict)
    """Ids of one-way roads: 1 from start to end, -1 back."""
    source: str = "assumed"
    """Where the side is known from."""
    has_map: bool = False
    """Whether a map said which streets are one-way."""

    def __str__(self) -> str:
        streets = "no map said which streets are one-way: both directions are assumed everywhere"
        if self.has_map:
            count = len(self.one_way)
            streets = (
                f"{count} of the roads {'is' if count == 1 else 'are'} one-way, by the map that it was scored with"
            )
        other = "right" if self.side == "left" else "left"
        return (
            f"Lanes are assumed from the widths; traffic keeps to the {self.side}, {self.source} (else give --traffic "
            f"{other}); {streets}."
        )


def _traffic(result: Path, run: DriveResult, network: RoadNetwork, side: Side | None) -> Traffic:
    """Tell how people drive where a result lies, from its place and from the ways of the map beside it."""
    source = "as given"
    if side is None and run.keyframes.lonlat is not None and len(run.keyframes.lonlat):
        side, source = side_of(np.array(middle_of(run.keyframes.lonlat))), "by the place"
    path = result / "osm_roads.geojson"
    ways = LAYERS["osm_roads"].read(path).features if path.is_file() and network.epsg is not None else []
    ways = [each for each in ways if each.geometry is not None and each.properties.is_drivable]
    known = [each for each in ways if each.properties.is_one_way is not None]
    one_way = dict[int, int]()
    if known:
        to_plane = projection(4326, network.epsg or 4326)
        lines = [to_plane(np.array(each.geometry.coordinates)[:, :2]) for each in known]
        one_way = one_way_roads(network, lines, np.array([each.properties.is_one_way for each in known]))
    return Traffic(side or "right", one_way, source if side else "assumed", has_map=bool(known))


def road_ending(out: Path) -> str | None:
    """Return which of `ROAD_FORMATS` a file name asks for."""
    return next((ending for ending in ROAD_FORMATS if out.name.lower().endswith(ending)), None)


def write_road_file(result: Path, out: Path, side: Side | None = None) -> str:
    """Write the roads of a result folder, made of its `road.tif`, in the format that the ending of `out` names.

    `side` of traffic: by default that of the place. Returns what was assumed, in words. Lanelet2 knows longitude and
    latitude only: of a result in local metres it is a GeoreferenceError.
    """
    ending = road_ending(out)
    assert ending is not None
    run = read_results(result)
    if ending == ".osm" and not run.is_georeferenced:
        raise GeoreferenceError(
            f"{result} is in metres of its own frame, and Lanelet2 knows longitude and latitude only: the drive has no "
            f"georeference. {PLACE_IT}, or write a .xodr or .nav2.geojson, in metres."
        )
    network = roads(run)
    traffic = _traffic(result, run, network, side)
    write_file(out, ROAD_FORMATS[ending](network, traffic, run.drive))
    return str(traffic)


# lanes ----------------------------------------------------------------------------------------------------------------

TWO_LANES_M = 4.5
"""Width from which a road has a lane for each direction."""

ASSUMED = "assumed"
"""Mark of lanes in files."""

_MOUTH_HALVES, _MOUTH_M = 1.2, 5.0  # a road ends so far before its node: half widths of the widest, and metres
_MOUTH_SHARE = 0.35  # of its length, at most
_UNKNOWN_WIDTH_M = 6.0
_CURVE = 8  # pieces of a curve


@dataclass(frozen=True)
class LaneRoad:
    """A road between the mouths of its junctions."""

    edge: RoadEdge
    xy: FloatArray
    """(N, 2) float64: centreline, metres."""
    normal: FloatArray
    """(N, 2) float64: unit vectors to the left of it."""
    width_m: float
    one_way: int
    """1 from start to end, -1 back, 0: both directions."""

    @property
    def is_single(self) -> bool:
        """One lane, for both directions or a one-way street."""
        return bool(self.one_way) or self.width_m < TWO_LANES_M

    @property
    def lanes(self) -> tuple[int, ...]:
        """Directions of the lanes, 1 from start to end, -1 back; a single lane for both is 1."""
        return (self.one_way or 1,) if self.is_single else (1, -1)

    def border(self, side: int) -> FloatArray:
        """Return the left (1), the middle (0) or the right (-1) line, (N, 2)."""
        return self.xy + side * self.width_m / 2.0 * self.normal


class Arm(NamedTuple):
    """An end of a road at a node."""

    road: LaneRoad
    at_end: bool

    @property
    def way_in(self) -> FloatArray:
        """Unit direction of the road towards the node."""
        n = self.road.normal[-1 if self.at_end else 0]
        along = np.array([n[1], -n[0]])
        return along if self.at_end else -along

    def place(self, side: int) -> FloatArray:
        """Return the place of a line at this end: left (1), middle (0), right (-1) of the direction of the road."""
        place: FloatArray = self.road.border(side)[-1 if self.at_end else 0]
        return place

    def direction(self, *, inbound: bool) -> int:
        """Return how the lane into the node, or out of it, runs along the road: 1 from start to end, -1 back."""
        return 1 if inbound == self.at_end else -1

    def has_lane(self, *, inbound: bool) -> bool:
        """Tell whether people may drive into the node here, or out of it."""
        return self.road.one_way in (0, self.direction(inbound=inbound))

    def sides(self, side: Side, *, inbound: bool) -> tuple[int, int]:
        """Return which lines of the road bound its lane into the node, or out of it: to the left and to the right."""
        return lane_sides(self.road, side, self.direction(inbound=inbound))


def lane_sides(road: LaneRoad, side: Side, direction: int) -> tuple[int, int]:
    """Return the lines to the left and right of a lane: left (1), middle (0), right (-1) of the road."""
    if road.is_single:
        return direction, -direction
    return (0, -direction) if side == "right" else (direction, 0)


def lane_roads(network: RoadNetwork, one_way: Mapping[int, int]) -> list[LaneRoad]:
    """Return the roads that have lanes: those of which half or more was seen."""
    edges = [edge for edge in network.edges if edge.seen >= _MIN_SEEN and edge.length_m > 1.0]
    areas = {node.id for node in network.nodes if node.area is not None and node.kind == "place"}
    widths = {edge.id: _UNKNOWN_WIDTH_M if np.isnan(edge.width_m) else edge.width_m for edge in edges}
    at_node: dict[int, list[float]] = {}
    for edge in edges:
        for end in (edge.start, edge.end):
            at_node.setdefault(end, []).append(widths[edge.id])
    roads = []
    for edge in edges:
        line = shapely.LineString(edge.xy)
        cuts = []
        for end in (edge.start, edge.end):
            mouth = _MOUTH_HALVES * max(at_node[end]) / 2.0 + _MOUTH_M
            is_cut = len(at_node[end]) > 1 and end not in areas
            cuts.append(min(mouth, _MOUTH_SHARE * line.length) if is_cut else 0.0)
        xy = shapely.get_coordinates(substring(line, cuts[0], line.length - cuts[1]))
        roads.append(LaneRoad(edge, xy, _normals(xy), widths[edge.id], one_way.get(edge.id, 0)))
    return roads


def arms_of(roads: Sequence[LaneRoad]) -> dict[int, list[Arm]]:
    """Return the ends of roads by the id of their node."""
    arms: dict[int, list[Arm]] = {}
    for road in roads:
        arms.setdefault(road.edge.start, []).append(Arm(road, at_end=False))
        arms.setdefault(road.edge.end, []).append(Arm(road, at_end=True))
    return arms


def turns(arms: Sequence[Arm]) -> Iterator[tuple[Arm, Arm]]:
    """Yield each way across a node, from one arm to another one, that one-way streets allow; there are no U-turns."""
    for first, second in permutations(arms, 2):
        if first.has_lane(inbound=True) and second.has_lane(inbound=False):
            yield first, second


def curve(start: FloatArray, way: FloatArray, end: FloatArray, way_on: FloatArray) -> FloatArray:
    """Return a smooth curve (Hermite) from a place in one direction to a place in another one, (9, 2)."""
    t = np.linspace(0.0, 1.0, _CURVE + 1)[:, None]
    reach = float(np.linalg.norm(end - start))
    polynomial = hermite(start, reach * way, end, reach * way_on)
    return np.asarray(sum(coefficient * t**k for k, coefficient in enumerate(polynomial)), np.float64)


def hermite(start: FloatArray, tangent: FloatArray, end: FloatArray, tangent_on: FloatArray) -> list[FloatArray]:
    """Return the four coefficients, each (2,), of the cubic between two places with two tangents."""
    step = end - start
    return [start, tangent, 3.0 * step - 2.0 * tangent - tangent_on, tangent + tangent_on - 2.0 * step]


def _normals(xy: FloatArray) -> FloatArray:
    way = np.diff(xy, axis=0)
    way /= np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    tangent = np.vstack([way[:1], way[:-1] + way[1:], way[-1:]])
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-9)[:, None]
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)


# Nav2 -----------------------------------------------------------------------------------------------------------------

_BEND_M = 0.3  # a road may leave the straight line by


def nav2_graph(network: RoadNetwork, traffic: Traffic) -> bytes:
    """Return a route graph of Nav2 as GeoJSON: points are nodes, lines of two positions edges with their ids.

    Its loader (`nav2_route`, `geojson_graph_file_loader.cpp`) goes straight from node to node, whatever the geometry of
    an edge: roads are cut where they bend. Edges lead one way: each is there twice, but for one-way streets.
    Coordinates are read as 32-bit numbers: they are metres from a round place of the map, which `origin` tells. What is
    unknown is left out, since null is refused.
    """
    places = {node.id: node.xy for node in network.nodes}
    origin = np.floor(np.min(list(places.values()), axis=0) / _ORIGIN_M) * _ORIGIN_M if places else np.zeros(2)
    edges: list[Feature] = []
    number = max(places, default=0)
    used = set[int]()
    for edge in network.edges:
        if edge.seen < _MIN_SEEN:
            continue
        bends = shapely.get_coordinates(shapely.simplify(shapely.LineString(edge.xy), _BEND_M))
        inner = [xy for xy in bends if min(np.linalg.norm(xy - places[end]) for end in (edge.start, edge.end)) > 0.01]
        stops = [edge.start, *range(number + 1, number + 1 + len(inner)), edge.end]
        number += len(inner)
        places |= dict(zip(stops[1:-1], inner, strict=True))
        used |= set(stops)
        known = {"width_m": edge.width_m, "width_p10_m": edge.width_p10_m, "seen": edge.seen}
        metadata: JsonObject = {"road": edge.id, "is_driven": edge.is_driven}
        metadata |= {name: round(float(value), 2) for name, value in known.items() if np.isfinite(value)}
        directions = (1, -1) if not traffic.one_way.get(edge.id) else (traffic.one_way[edge.id],)
        for pair in (pair[::way] for pair in pairwise(stops) for way in directions):
            line = [_position(places[stop] - origin) for stop in pair]
            properties = {"startid": pair[0], "endid": pair[1], "metadata": metadata}
            edges.append(_feature("LineString", line, properties))
    for edge_number, feature in enumerate(edges, number + 1):
        feature["properties"]["id"] = edge_number
    kinds = {node.id: node.kind for node in network.nodes}
    nodes = [
        _feature(
            "Point",
            _position(places[stop] - origin),
            {"id": stop, "frame": "map", "metadata": {"kind": kinds.get(stop, "bend")}},
        )
        for stop in sorted(used)
    ]
    head = {
        "type": "FeatureCollection",
        "name": "roads",
        "description": str(traffic),
        "origin": {"x_m": origin[0], "y_m": origin[1]},
    }
    if network.epsg is not None:
        head["origin"]["crs"] = f"EPSG:{network.epsg}"  # type: ignore[index]
    return encode({**head, "features": [*nodes, *edges]}).encode() + b"\n"


def _feature(kind: str, coordinates: Any, properties: JsonObject) -> Feature:  # noqa: ANN401 - of GeoJSON
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


def _position(xy: Any) -> list[float]:  # noqa: ANN401 - two numbers
    return [round(float(value), 3) for value in xy]


# Lanelet2 -------------------------------------------------------------------------------------------------------------

_SOLID, _VIRTUAL = {"type": "line_thin", "subtype": "solid"}, {"type": "virtual"}
_LANE = {"type": "lanelet", "subtype": "road", "location": "urban", "lanes": ASSUMED}


class _Writer:
    """Elements of a file of OpenStreetMap with ids of their own; nodes in longitude and latitude."""

    def __init__(self, to_lonlat: Callable[[FloatArray], FloatArray]) -> None:
        self._to_lonlat = to_lonlat
        self._nodes: list[FloatArray] = []
        self._others: list[ET.Element] = []

    def nodes(self, xy: FloatArray) -> list[int]:
        """Add places; return their ids."""
        first = len(self._nodes) + 1
        self._nodes += list(xy)
        return list(range(first, first + len(xy)))

    def way(self, nodes: list[int], tags: dict[str, str]) -> int:
        """Add a line through nodes."""
        way = self._element("way", tags)
        for node in nodes:
            ET.SubElement(way, "nd", {"ref": str(node)})
        return len(self._others)

    def lanelet(self, left: int, right: int, *, one_way: bool) -> None:
        """Add a lanelet between two ways."""
        relation = self._element("relation", {**_LANE, "one_way": "yes" if one_way else "no"})
        for role, way in (("left", left), ("right", right)):
            ET.SubElement(relation, "member", {"type": "way", "ref": str(way), "role": role})

    def _element(self, kind: str, tags: dict[str, str]) -> ET.Element:
        element = ET.Element(kind, {"id": str(len(self._others) + 1), "version": "1", "visible": "true"})
        for key, value in tags.items():
            ET.SubElement(element, "tag", {"k": key, "v": value})
        self._others.append(element)
        return element

    def document(self) -> bytes:
        """Return the file: nodes, ways, relations; tags behind the references, as readers expect."""
        root = ET.Element("osm", {"version": "0.6", "generator": "InterLoc", "upload": "false"})
        places = self._to_lonlat(np.array(self._nodes).reshape(-1, 2))
        for number, (lon, lat) in enumerate(places.tolist(), 1):
            place = {"lat": f"{lat:.9f}", "lon": f"{lon:.9f}"}
            ET.SubElement(root, "node", {"id": str(number), **place, "version": "1", "visible": "true"})
        for kind in ("way", "relation"):
            root.extend(each for each in self._others if each.tag == kind)
        ET.indent(root, " ")
        text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
        return text + b"\n"


def lanelet2_map(network: RoadNetwork, traffic: Traffic) -> bytes:
    """Return a map of Lanelet2: roads as lanelets, and one from each lane to each other one across a junction."""
    writer = _Writer(network.lonlat)
    roads = lane_roads(network, traffic.one_way)
    corner: dict[tuple[int, int, bool], int] = {}  # (road, side, at its end) -> node
    for road in roads:
        ways = {side: _border(writer, road, side, corner) for side in ((1, -1) if road.is_single else (1, 0, -1))}
        for direction in road.lanes:
            left, right = lane_sides(road, traffic.side, direction)
            writer.lanelet(ways[left], ways[right], one_way=bool(road.one_way) or not road.is_single)
    for arms in arms_of(roads).values():
        for first, second in turns(arms):
            lines = []
            side = traffic.side
            for a, b in zip(first.sides(side, inbound=True), second.sides(side, inbound=False), strict=True):
                between = curve(first.place(a), first.way_in, second.place(b), -second.way_in)[1:-1]
                start, end = corner[first.road.edge.id, a, first.at_end], corner[second.road.edge.id, b, second.at_end]
                lines.append(writer.way([start, *writer.nodes(between), end], _VIRTUAL))
            writer.lanelet(lines[0], lines[1], one_way=True)
    return writer.document()


def _border(writer: _Writer, road: LaneRoad, side: int, corner: dict[tuple[int, int, bool], int]) -> int:
    nodes = writer.nodes(road.border(side))
    corner[road.edge.id, side, False], corner[road.edge.id, side, True] = nodes[0], nodes[-1]
    return writer.way(nodes, _SOLID if side else _VIRTUAL)


# OpenDRIVE ------------------------------------------------------------------------------------------------------------

_PIECE_M = 8.0
_DATE = "1970-01-01T00:00:00"  # the same bytes for the same roads


def opendrive_map(network: RoadNetwork, traffic: Traffic, name: str) -> bytes:
    """Return OpenDRIVE 1.7 with the name of the drive: the roads, and a junction at each node where they meet.

    Where traffic keeps to the right, lanes with negative ids lead along the road, else those with positive ones. A
    single lane lies across the middle, by an offset; one for both directions is `bidirectional`.
    """
    roads, along = lane_roads(network, traffic.one_way), -1 if traffic.side == "right" else 1
    every = np.concatenate([road.xy for road in roads]) if roads else np.zeros((1, 2))
    origin = np.floor(every.min(axis=0) / _ORIGIN_M) * _ORIGIN_M
    root = ET.Element("OpenDRIVE")
    _add_header(root, network.epsg, name, origin, every - origin)
    arms = {node: ends for node, ends in arms_of(roads).items() if len(ends) > 1}
    for road in roads:
        _add_road(root, road, origin, arms, along)
    number = max((road.edge.id for road in roads), default=0)
    junctions = []
    for node, ends in arms.items():
        junction = ET.Element("junction", {"name": f"node {node}", "id": str(node), "type": "default"})
        for count, (first, second) in enumerate(turns(ends)):
            number += 1
            _add_turn(root, first, second, number, node, origin, along)
            connection = {"id": str(count), "incomingRoad": str(first.road.edge.id), "connectingRoad": str(number)}
            link = ET.SubElement(junction, "connection", {**connection, "contactPoint": "start"})
            ET.SubElement(link, "laneLink", {"from": str(_lane(first, along, inbound=True)), "to": str(along)})
        junctions.append(junction)
    root.extend(junctions)
    ET.indent(root, " ")
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _add_header(root: ET.Element, epsg: int | None, name: str, origin: FloatArray, xy: FloatArray) -> None:
    (west, south), (east, north) = xy.min(axis=0).tolist(), xy.max(axis=0).tolist()
    bounds = {"north": north, "south": south, "east": east, "west": west}
    about = {"revMajor": "1", "revMinor": "7", "name": name, "version": "1.0", "date": _DATE, "vendor": "InterLoc"}
    header = ET.SubElement(root, "header", about | {side: f"{value:.3f}" for side, value in bounds.items()})
    if epsg is not None:
        south_of = "+south " if epsg // 100 == 327 else ""
        crs_text = f"+proj=utm +zone={epsg % 100} {south_of}+datum=WGS84 +units=m +no_defs"
        ET.SubElement(header, "geoReference").text = crs_text
    moved = {"x": f"{origin[0]:.1f}", "y": f"{origin[1]:.1f}", "z": "0.0", "hdg": "0.0"}
    ET.SubElement(header, "offset", moved)
    ET.SubElement(header, "userData", {"code": "lanes", "value": ASSUMED})


def _lane(arm: Arm, along: int, *, inbound: bool) -> int:
    """Return the lane that leads into the node, or out of it; `along` is the one in the direction of the road."""
    directions = arm.road.lanes
    return along * (directions[0] if len(directions) == 1 else arm.direction(inbound=inbound))


def _add_road(
    root: ET.Element, road: LaneRoad, origin: FloatArray, arms: Mapping[int, Sequence[Arm]], along: int
) -> None:
    line = shapely.LineString(road.xy - origin)
    count = max(1, round(line.length / _PIECE_M))
    at = np.linspace(0.0, line.length, count + 1)
    knots = shapely.get_coordinates(shapely.line_interpolate_point(line, at))
    way = np.gradient(knots, axis=0)
    way[0], way[-1] = (np.array([n[1], -n[0]]) for n in (road.normal[0], road.normal[-1]))
    way /= np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    element, link = _new_road(root, road.edge.id, "-1", knots, way, along)
    for end, node in (("predecessor", road.edge.start), ("successor", road.edge.end)):
        if node in arms:
            ET.SubElement(link, end, {"elementType": "junction", "elementId": str(node)})
    lanes = [along * direction for direction in road.lanes]
    width = road.width_m / len(lanes)
    kind = "bidirectional" if road.is_single and not road.one_way else "driving"
    _add_lanes(element, dict.fromkeys(lanes, (width, width)), {}, kind, [-sum(lanes) * width / 2.0] * 2)


def _add_turn(
    root: ET.Element, first: Arm, second: Arm, number: int, node: int, origin: FloatArray, along: int
) -> None:
    knots = np.stack([first.place(0), second.place(0)]) - origin
    way = np.stack([first.way_in, -second.way_in])
    element, link = _new_road(root, number, str(node), knots, way, along)
    for end, arm in (("predecessor", first), ("successor", second)):
        to = {
            "elementType": "road",
            "elementId": str(arm.road.edge.id),
            "contactPoint": "end" if arm.at_end else "start",
        }
        ET.SubElement(link, end, to)
    lanes = {"predecessor": _lane(first, along, inbound=True), "successor": _lane(second, along, inbound=False)}
    widths = [arm.road.width_m / len(arm.road.lanes) for arm in (first, second)]
    offsets = [
        -along * width / 2.0 if arm.road.is_single else 0.0 for arm, width in zip((first, second), widths, strict=True)
    ]
    _add_lanes(element, {along: widths}, lanes, offsets_m=offsets)


def _new_road(
    root: ET.Element, number: int, junction: str, knots: FloatArray, way: FloatArray, along: int
) -> tuple[ET.Element, ET.Element]:
    """Add a road along cubic pieces; return it, and its link."""
    pieces = [_piece(*knots[k : k + 2], *way[k : k + 2]) for k in range(len(knots) - 1)]
    length = math.fsum(float(piece["length"]) for _, piece in pieces)
    name, rule = f"{'road' if junction == '-1' else 'turn'} {number}", "RHT" if along < 0 else "LHT"
    about = {"name": name, "length": f"{length:.12g}", "id": str(number), "junction": junction, "rule": rule}
    road = ET.SubElement(root, "road", about)
    link = ET.SubElement(road, "link")
    plan, s = ET.SubElement(road, "planView"), 0.0
    for polynomial, piece in pieces:
        geometry = ET.SubElement(plan, "geometry", {"s": f"{s:.12g}", **piece})
        ET.SubElement(geometry, "paramPoly3", {**polynomial, "pRange": "normalized"})
        s += float(piece["length"])
    return road, link


def _piece(start: FloatArray, end: FloatArray, way: FloatArray, way_on: FloatArray) -> tuple[dict[str, str], ...]:
    """Return the polynomial of a piece in its own frame, and its place, direction and length."""
    reach = float(np.linalg.norm(end - start))
    heading = math.atan2(way[1], way[0])
    turn = np.array([[way[0], way[1]], [-way[1], way[0]]])
    coefficients = hermite(np.zeros(2), reach * way, end - start, reach * way_on)
    u_v = [turn @ each for each in coefficients]
    polynomial = {f"{a}{axis}": f"{u_v[k][row]:.12g}" for row, axis in enumerate("UV") for k, a in enumerate("abcd")}
    nodes, weights = np.polynomial.legendre.leggauss(16)
    t = (nodes[:, None] + 1.0) / 2.0
    speed = coefficients[1] + 2.0 * coefficients[2] * t + 3.0 * coefficients[3] * t**2
    length = float(weights @ np.linalg.norm(speed, axis=1)) / 2.0
    place = {"x": f"{start[0]:.9f}", "y": f"{start[1]:.9f}", "hdg": f"{heading:.12g}", "length": f"{length:.12g}"}
    return polynomial, place


def _add_lanes(
    road: ET.Element,
    widths: Mapping[int, Sequence[float]],
    links: Mapping[str, int],
    kind: str = "driving",
    offsets_m: Sequence[float] = (0.0, 0.0),
) -> None:
    """Add lanes by id, each with its width at the start and at the end; `links` are those of the only one.

    The lanes are moved to the left by offsets at the start and at the end.
    """
    length = float(road.get("length", "1"))
    lanes = ET.SubElement(road, "lanes")
    if any(offsets_m):
        first, last = offsets_m
        ET.SubElement(lanes, "laneOffset", {"s": "0", **_linear(first, last, length)})
    section = ET.SubElement(lanes, "laneSection", {"s": "0"})
    for name, number in (("left", 1), ("center", 0), ("right", -1)):
        if number and number not in widths:
            continue
        about = {"id": str(number), "type": kind if number else "none", "level": "false"}
        lane = ET.SubElement(ET.SubElement(section, name), "lane", about)
        if number and links:
            link = ET.SubElement(lane, "link")
            for end, other in links.items():
                ET.SubElement(link, end, {"id": str(other)})
        if number:
            first, last = widths[number]
            ET.SubElement(lane, "width", {"sOffset": "0", **_linear(first, last, length)})


def _linear(first: float, last: float, length: float) -> dict[str, str]:
    """Return the polynomial of what grows from one value to another along a road."""
    return {"a": f"{first:.9g}", "b": f"{(last - first) / length:.12g}", "c": "0", "d": "0"}


ROAD_FORMATS: dict[str, Callable[[RoadNetwork, Traffic, str], bytes]] = {
    ".nav2.geojson": lambda network, traffic, _: nav2_graph(network, traffic),
    ".osm": lambda network, traffic, _: lanelet2_map(network, traffic),
    ".xodr": opendrive_map,
}
"""Ending -> format: route graph of Nav2, map of Lanelet2, OpenDRIVE."""
