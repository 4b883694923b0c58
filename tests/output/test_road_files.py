"""Roads for robots, vehicles and simulators, opened by their own readers or held against the rules of these."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose

from interloc.errors import GeoreferenceError
from interloc.output.road_files import Traffic, lanelet2_map, nav2_graph, opendrive_map, write_road_file
from interloc.output.traffic import Side, one_way_roads, side_of
from interloc.roadmap.extract import extract_roads
from interloc.roadmap.network import RoadNetwork
from tests.output.small import small_result, with_roads, write_folder
from tests.roadmap.streets import draw, drive, street


@pytest.fixture(scope="module")
def network() -> RoadNetwork:
    """A block of four streets around a bend, one of them narrow, and a dead end; in zone 32."""
    corners = [(0.0, 0.0), (150.0, 0.0), (190.0, 90.0), (0.0, 110.0)]
    ground = street(*corners, corners[0]) | street((-80.0, 0.0), (0.0, 0.0)) | street((150.0, 0.0), (260.0, -60.0))
    ground |= street((60.0, 0.0), (60.0, 103.0), width_m=4)
    result = drive([*corners, corners[0]], [corners[0], corners[1], (60.0, 0.0), (60.0, 104.0)])
    found = extract_roads(result, draw(ground))
    origin = np.array([457_000.0, 5_428_000.0])
    edges = [replace(each, xy=each.xy + origin) for each in found.edges]
    nodes = [replace(each, xy=each.xy + origin) for each in found.nodes]
    return RoadNetwork(nodes, edges, [], 32632)


def test_nav2_reads_the_graph(network: RoadNetwork) -> None:
    """The rules of `GeoJsonGraphFileLoader` (nav2_route/src/plugins/graph_file_loaders, ros-navigation/navigation2)."""
    graph = json.loads(nav2_graph(network, Traffic()))
    points = [each for each in graph["features"] if each["geometry"]["type"] == "Point"]
    lines = [each for each in graph["features"] if each["geometry"]["type"] == "LineString"]
    assert len(points) + len(lines) == len(graph["features"])
    assert points
    assert lines  # "Is does not contain nodes or edges" otherwise
    ids = [each["properties"]["id"] for each in (*points, *lines)]
    assert len(set(ids)) == len(ids)
    assert all(isinstance(each, int) and 0 <= each < 2**32 for each in ids)  # read as unsigned int
    at = {each["properties"]["id"]: each["geometry"]["coordinates"] for each in points}
    joined: dict[int, set[int]] = {each: set() for each in at}
    for each in lines:
        properties = each["properties"]
        start, end = properties["startid"], properties["endid"]
        joined[start].add(end)  # KeyError: "Start id does not exist", which throws
        assert each["geometry"]["coordinates"] == [at[start], at[end]]  # the loader does not read it, people do
        for value in properties["metadata"].values():  # setPrimitiveType throws at null and at objects in lists
            assert isinstance(value, (bool, int, float, str))
    for place in at.values():  # coordinates become float, 32 bit
        assert_allclose(np.array(place, np.float32), place, atol=1e-4)
    assert {each["properties"]["frame"] for each in points} == {"map"}
    reached, stack = {min(at)}, [min(at)]
    while stack:
        new = joined[stack.pop()] - reached
        reached |= new
        stack += new
    assert reached == set(at)
    assert all(start in joined[end] for start, ends in joined.items() for end in ends)  # both ways, an edge each
    assert graph["origin"] == {"x_m": 456_900.0, "y_m": 5_427_900.0, "crs": "EPSG:32632"}


Way = tuple[int, int]  # id of a road; 1 from its start to its end, -1 back
Move = tuple[Way, Way]  # across a junction


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("roads", "direction"), [(0, 0), (1, 1), (1, -1), (3, -1), (20, 1)])
def test_routers_go_the_same_ways_and_never_against_a_one_way_street(
    network: RoadNetwork, tmp_path: Path, side: Side, roads: int, direction: int
) -> None:
    """As `lanelet2` routes, along the directed edges of Nav2, and by the lanes and junctions of OpenDRIVE."""
    one_way = {edge.id: direction for edge in network.edges[:roads]}
    traffic = Traffic(side, one_way)
    moves = nav2_moves(network, traffic)
    assert len(moves) > 5
    assert all(one_way.get(road, way) == way for move in moves for road, way in move)
    assert opendrive_moves(network, traffic) == moves
    pytest.importorskip("lanelet2", reason="lanelet2 has no wheel for this Python")
    assert lanelet2_moves(network, traffic, tmp_path / "roads.osm") == moves


def nav2_moves(network: RoadNetwork, traffic: Traffic) -> set[Move]:
    ends = {edge.id: (edge.start, edge.end) for edge in network.edges}
    into: dict[int, list[Way]] = {}
    out_of: dict[int, list[Way]] = {}
    for feature in json.loads(nav2_graph(network, traffic))["features"]:
        if "startid" in (edge := feature["properties"]):
            road = edge["metadata"]["road"]
            for found, end, first in ((into, "endid", 1), (out_of, "startid", 0)):
                if edge[end] in ends[road]:  # else a bend of the road
                    found.setdefault(edge[end], []).append((road, 1 if ends[road][first] == edge[end] else -1))
    return {(a, b) for node, ways in into.items() for a in ways for b in out_of.get(node, ()) if a[0] != b[0]}


def opendrive_moves(network: RoadNetwork, traffic: Traffic) -> set[Move]:
    root = ET.fromstring(opendrive_map(network, traffic, "a"))  # noqa: S314 - our own
    roads = {road.get("id"): road for road in root.iter("road")}
    moves = set()
    for connection in root.findall("junction/connection"):
        turn, lanes = roads[connection.get("connectingRoad")], connection.find("laneLink").attrib
        assert 1 in ways_along(turn, lanes["to"])
        move = []
        for end, ahead in (("predecessor", "end"), ("successor", "start")):
            link, lane = turn.find(f"link/{end}"), turn.find(f"lanes/laneSection/*/lane/link/{end}").get("id")
            way = 1 if link.get("contactPoint") == ahead else -1
            assert way in ways_along(roads[link.get("elementId")], lane)
            move.append((int(link.get("elementId")), way))
        assert (connection.get("incomingRoad"), lanes["from"]) == (
            str(move[0][0]),
            turn.find("lanes/laneSection/*/lane/link/predecessor").get("id"),
        )
        moves.add((move[0], move[1]))
    return moves


def ways_along(road: ET.Element, number: str) -> tuple[int, ...]:
    """Return the directions of a lane, which has to be there: right of the middle people drive along a road by RHT."""
    (lane,) = (each for each in road.findall("lanes/laneSection/*/lane") if each.get("id") == number)
    if lane.get("type") == "bidirectional":
        return (1, -1)
    assert lane.get("type") == "driving"
    return ((1 if int(number) < 0 else -1) * (1 if road.get("rule") == "RHT" else -1),)


def lanelet2_moves(network: RoadNetwork, traffic: Traffic, path: Path) -> set[Move]:
    """Return the ways of its routing; lanes of roads lie on their side of them."""
    from lanelet2 import io, projection, routing, traffic_rules  # noqa: PLC0415

    path.write_bytes(lanelet2_map(network, traffic))
    lon, lat = network.lonlat(network.nodes[0].xy[None])[0].tolist()
    loaded, errors = io.loadRobust(str(path), projection.UtmProjector(io.Origin(lat, lon)))
    assert list(errors) == []
    rules = traffic_rules.create(traffic_rules.Locations.Germany, traffic_rules.Participants.Vehicle)
    graph = routing.RoutingGraph(loaded, rules)
    assert list(graph.checkValidity()) == []
    ways: dict[tuple[int, bool], Way] = {}
    lanes = {}
    for lane in loaded.laneletLayer:
        for edge in network.edges:
            line = edge.xy - network.nodes[0].xy
            if is_on(lane, line):
                ahead, place = lane_ahead(lane), lane_points(lane)
                way = 1 if ahead @ (line[-1] - line[0]) > 0 else -1
                ways[lane.id, False] = (edge.id, way)
                lanes[lane.id, False] = lane
                if not rules.isOneWay(lane):
                    ways[lane.id, True], lanes[lane.id, True] = (edge.id, -way), lane.invert()
                elif edge.id not in traffic.one_way:
                    middle = line[len(line) // 2]
                    beside = place[np.hypot(*(place - middle).T).argmin()] - middle
                    assert (ahead[0] * beside[1] - ahead[1] * beside[0] > 0) == (traffic.side == "left")
    return {
        (way, ways[after.id, after.inverted()])
        for key, way in ways.items()
        for turn in graph.following(lanes[key])
        for after in graph.following(turn)
    }


def lane_points(lane: Any) -> np.ndarray:
    return np.array([(point.x, point.y) for point in lane.centerline])


def lane_ahead(lane: Any) -> np.ndarray:
    points = lane_points(lane)
    return (points[-1] - points[0]) / np.hypot(*(points[-1] - points[0]))


def is_on(lane: Any, line: np.ndarray) -> bool:
    """Whether a lane runs beside all of a line, but for the mouths of its junctions."""
    points = lane_points(lane)
    near = shapely.distance(shapely.LineString(line), shapely.points(points))
    reach = np.hypot(*np.diff(points, axis=0).T).sum()
    return bool(near.max() < 4.0 and reach > 0.3 * np.hypot(*np.diff(line, axis=0).T).sum())


def test_a_road_is_one_way_where_all_ways_of_the_map_beside_it_lead_one_way(network: RoadNetwork) -> None:
    (edge, *_) = network.edges
    ahead, back = edge.xy + 1.0, edge.xy[::-1] - 1.0
    yes, no = np.array([True]), np.array([False])
    assert one_way_roads(network, [ahead], yes) == {edge.id: 1}
    assert one_way_roads(network, [back], yes) == {edge.id: -1}
    assert one_way_roads(network, [back], no) == {}
    assert one_way_roads(network, [ahead, back], np.array([True, True])) == {}  # two carriageways of one road
    assert one_way_roads(network, [ahead + 30.0], yes) == {}  # another street


@pytest.mark.parametrize(
    ("lonlat", "side"),
    [
        ((8.4, 49.0), "right"),
        ((0.12, 52.2), "left"),
        ((1.61, 50.73), "right"),  # Boulogne, in sight of Dover
        ((102.6, 17.97), "right"),  # Vientiane, and across the Mekong Nong Khai
        ((102.74, 17.87), "left"),
        ((139.7, 35.7), "left"),
        ((126.9, 37.5), "right"),
        ((178.02, -38.66), "left"),
        ((24.27, -17.5), "left"),  # the Caprivi Strip
        ((-75.8, 20.0), "right"),
    ],
)
def test_the_side_of_traffic_is_that_of_the_place(lonlat: tuple[float, float], side: Side) -> None:
    assert side_of(np.array(lonlat)) == side


@pytest.mark.parametrize("traffic", [Traffic(), Traffic("left", {1: -1, 2: 1})])
def test_opendrive_is_without_a_gap(network: RoadNetwork, traffic: Traffic) -> None:
    """Ends of reference lines meet where their links say so, within a millimetre; lanes have the same widths there."""
    along = "-1" if traffic.side == "right" else "1"
    root = ET.fromstring(opendrive_map(network, traffic, "Straße <1> & Co"))  # noqa: S314 - our own
    header = root.find("header")
    assert header.get("name") == "Straße <1> & Co"
    assert header.findtext("geoReference") == "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs"
    roads = {road.get("id"): road for road in root.iter("road")}
    places, widths = {}, {}
    for number, road in roads.items():
        pieces = road.findall("planView/geometry")
        for one, other in pairwise(pieces):
            assert_allclose(end_of(one), start_of(other), atol=1e-3)
        assert sum(float(piece.get("length", "")) for piece in pieces) == pytest.approx(float(road.get("length", "")))
        places[number] = {"start": start_of(pieces[0]), "end": end_of(pieces[-1])}
        lanes = road.findall("lanes/laneSection/*/lane")
        widths[number] = {lane.get("id"): lane.find("width") for lane in lanes}
    turns = 0
    for number, road in roads.items():
        if road.get("junction") == "-1":
            continue
        for mine, end in (("start", "predecessor"), ("end", "successor")):
            link = road.find(f"link/{end}")
            lane = road.find(f"lanes/laneSection/*/lane/link/{end}")
            other = link.get("elementId")
            assert_allclose(places[number][mine], places[other][link.get("contactPoint")], atol=1e-3)
            width, there = widths[number][along], widths[other][lane.get("id")]
            s = 0.0 if mine == "start" else float(road.get("length", ""))
            assert float(width.get("a")) + s * float(width.get("b")) == pytest.approx(float(there.get("a")), abs=1e-4)
            turns += 1
    connections = root.findall("junction/connection")
    assert turns == 2 * len(connections) > 20
    assert {each.get("incomingRoad") for each in connections} <= roads.keys()


def start_of(piece: ET.Element) -> list[float]:
    return [float(piece.get(name, "")) for name in ("x", "y")]


def end_of(piece: ET.Element) -> list[float]:
    polynomial = piece.find("paramPoly3")
    u, v = (sum(float(polynomial.get(f"{a}{axis}", "")) for a in "abcd") for axis in "UV")
    x, y, angle = (float(piece.get(name, "")) for name in ("x", "y", "hdg"))
    return [x + np.cos(angle) * u - np.sin(angle) * v, y + np.sin(angle) * u + np.cos(angle) * v]


@pytest.mark.parametrize("ending", [".nav2.geojson", ".osm", ".xodr"])
def test_files_are_written_as_far_as_a_result_knows_its_place(ending: str, tmp_path: Path) -> None:
    placed = write_folder(tmp_path / "placed", with_roads(small_result()), scored=False)
    write_road_file(placed, tmp_path / f"a{ending}")
    assert (tmp_path / f"a{ending}").stat().st_size > 1000
    local = write_folder(tmp_path / "local", with_roads(small_result(local=True)), scored=False)
    if ending == ".osm":
        with pytest.raises(GeoreferenceError, match="Lanelet2 knows longitude and latitude only"):
            write_road_file(local, tmp_path / f"b{ending}")
    else:
        write_road_file(local, tmp_path / f"b{ending}")
    empty = write_folder(tmp_path / "empty", small_result(empty=True), scored=False)
    write_road_file(empty, tmp_path / f"c{ending}")
    assert (tmp_path / f"c{ending}").is_file()
