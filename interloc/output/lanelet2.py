"""Roads as a map of Lanelet2 (``.osm``), for automated vehicles. Lanes are assumed, see `interloc.output.lanes`."""

from __future__ import annotations

from collections.abc import Callable
from xml.etree import ElementTree as ET

import numpy as np

from interloc.arrays import FloatArray
from interloc.output.lanes import ASSUMED, LaneRoad, arms_of, curve, lane_roads, turns
from interloc.roadmap.network import RoadNetwork

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


def lanelet2_map(network: RoadNetwork) -> bytes:
    """Return the roads as lanelets, and one lanelet from each lane to each other one across a junction.

    Parameters
    ----------
    network
        With georeference.
    """
    writer = _Writer(network.lonlat)
    roads = lane_roads(network)
    corner: dict[tuple[int, int, bool], int] = {}  # (road, side, at its end) -> node
    for road in roads:
        ways = {side: _border(writer, road, side, corner) for side in ((1, -1) if road.is_single else (1, 0, -1))}
        if road.is_single:
            writer.lanelet(ways[1], ways[-1], one_way=False)
        else:
            writer.lanelet(ways[0], ways[-1], one_way=True)
            writer.lanelet(ways[0], ways[1], one_way=True)
    for arms in arms_of(roads).values():
        for first, second in turns(arms):
            lines = []
            for a, b in zip(first.sides(inbound=True), second.sides(inbound=False), strict=True):
                between = curve(first.place(a), first.way_in, second.place(b), -second.way_in)[1:-1]
                start, end = corner[first.road.edge.id, a, first.at_end], corner[second.road.edge.id, b, second.at_end]
                lines.append(writer.way([start, *writer.nodes(between), end], _VIRTUAL))
            writer.lanelet(lines[0], lines[1], one_way=True)
    return writer.document()


def _border(writer: _Writer, road: LaneRoad, side: int, corner: dict[tuple[int, int, bool], int]) -> int:
    nodes = writer.nodes(road.border(side))
    corner[road.edge.id, side, False], corner[road.edge.id, side, True] = nodes[0], nodes[-1]
    return writer.way(nodes, _SOLID if side else _VIRTUAL)
