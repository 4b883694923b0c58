"""Roads as OpenDRIVE 1.7 (``.xodr``), for simulators. Lanes are assumed, see `interloc.output.lanes`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

import numpy as np
import shapely

from interloc.arrays import FloatArray
from interloc.output.lanes import ASSUMED, Arm, LaneRoad, arms_of, hermite, lane_roads, turns
from interloc.roadmap.network import RoadNetwork

_PIECE_M = 8.0
_ORIGIN_M = 100.0
_DATE = "1970-01-01T00:00:00"  # the same bytes for the same roads


def opendrive_map(network: RoadNetwork, name: str) -> bytes:
    """Return the roads, with a junction at each node where they meet.

    Parameters
    ----------
    network
    name
        Of the drive.
    """
    roads = lane_roads(network)
    every = np.concatenate([road.xy for road in roads]) if roads else np.zeros((1, 2))
    origin = np.floor(every.min(axis=0) / _ORIGIN_M) * _ORIGIN_M
    root = ET.Element("OpenDRIVE")
    _add_header(root, network.epsg, name, origin, every - origin)
    arms = {node: ends for node, ends in arms_of(roads).items() if len(ends) > 1}
    for road in roads:
        _add_road(root, road, origin, arms)
    number = max((road.edge.id for road in roads), default=0)
    junctions = []
    for node, ends in arms.items():
        junction = ET.Element("junction", {"name": f"node {node}", "id": str(node), "type": "default"})
        for count, (first, second) in enumerate(turns(ends)):
            number += 1
            _add_turn(root, first, second, number, node, origin)
            connection = {"id": str(count), "incomingRoad": str(first.road.edge.id), "connectingRoad": str(number)}
            link = ET.SubElement(junction, "connection", {**connection, "contactPoint": "start"})
            ET.SubElement(link, "laneLink", {"from": str(_lane(first, inbound=True)), "to": "-1"})
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
        told = f"+proj=utm +zone={epsg % 100} {south_of}+datum=WGS84 +units=m +no_defs"
        ET.SubElement(header, "geoReference").text = told
    moved = {"x": f"{origin[0]:.1f}", "y": f"{origin[1]:.1f}", "z": "0.0", "hdg": "0.0"}
    ET.SubElement(header, "offset", moved)
    ET.SubElement(header, "userData", {"code": "lanes", "value": ASSUMED})


def _lane(arm: Arm, *, inbound: bool) -> int:
    """Return the lane that leads into the node, or out of it: -1 in the direction of the road, 1 against it."""
    return -1 if inbound == arm.at_end else 1


def _contact(arm: Arm) -> str:
    return "end" if arm.at_end else "start"


def _add_road(root: ET.Element, road: LaneRoad, origin: FloatArray, arms: Mapping[int, Sequence[Arm]]) -> None:
    line = shapely.LineString(road.xy - origin)
    count = max(1, round(line.length / _PIECE_M))
    at = np.linspace(0.0, line.length, count + 1)
    knots = shapely.get_coordinates(shapely.line_interpolate_point(line, at))
    way = np.gradient(knots, axis=0)
    way[0], way[-1] = (np.array([n[1], -n[0]]) for n in (road.normal[0], road.normal[-1]))
    way /= np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    element, link = _new_road(root, road.edge.id, "-1", knots, way, f"road {road.edge.id}")
    for end, node in (("predecessor", road.edge.start), ("successor", road.edge.end)):
        if node in arms:
            ET.SubElement(link, end, {"elementType": "junction", "elementId": str(node)})
    _add_lanes(element, dict.fromkeys((1, -1), (road.width_m / 2.0, road.width_m / 2.0)), {})


def _add_turn(root: ET.Element, first: Arm, second: Arm, number: int, node: int, origin: FloatArray) -> None:
    knots = np.stack([first.place(0), second.place(0)]) - origin
    way = np.stack([first.way_in, -second.way_in])
    element, link = _new_road(root, number, str(node), knots, way, f"turn {number}")
    for end, arm in (("predecessor", first), ("successor", second)):
        to = {"elementType": "road", "elementId": str(arm.road.edge.id), "contactPoint": _contact(arm)}
        ET.SubElement(link, end, to)
    lanes = {"predecessor": _lane(first, inbound=True), "successor": _lane(second, inbound=False)}
    _add_lanes(element, {-1: (first.road.width_m / 2.0, second.road.width_m / 2.0)}, lanes)


def _new_road(
    root: ET.Element, number: int, junction: str, knots: FloatArray, way: FloatArray, name: str
) -> tuple[ET.Element, ET.Element]:
    """Add a road along cubic pieces; return it, and its link."""
    pieces = [_piece(*knots[k : k + 2], *way[k : k + 2]) for k in range(len(knots) - 1)]
    length = math.fsum(float(piece["length"]) for _, piece in pieces)
    about = {"name": name, "length": f"{length:.12g}", "id": str(number), "junction": junction, "rule": "RHT"}
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


def _add_lanes(road: ET.Element, widths: Mapping[int, tuple[float, float]], links: Mapping[str, int]) -> None:
    """Add lanes by id, each with its width at the start and at the end; `links` are those of the lane -1."""
    length = float(road.get("length", "1"))
    section = ET.SubElement(ET.SubElement(road, "lanes"), "laneSection", {"s": "0"})
    for name, number in (("left", 1), ("center", 0), ("right", -1)):
        if number and number not in widths:
            continue
        kind = "driving" if number else "none"
        lane = ET.SubElement(ET.SubElement(section, name), "lane", {"id": str(number), "type": kind, "level": "false"})
        if number == -1 and links:
            link = ET.SubElement(lane, "link")
            for end, other in links.items():
                ET.SubElement(link, end, {"id": str(other)})
        if number:
            first, last = widths[number]
            slope = {"a": f"{first:.9g}", "b": f"{(last - first) / length:.12g}", "c": "0", "d": "0"}
            ET.SubElement(lane, "width", {"sOffset": "0", **slope})
