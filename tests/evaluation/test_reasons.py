"""One small map per rule: roads drawn by hand, a place, and what must be said about it."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from pyproj import Transformer

from interloc.evaluation.evidence import MapEvidence
from interloc.evaluation.reasons import (
    KINDS,
    FalseKind,
    FoundByDrive,
    MissKind,
    Reason,
    count_kinds,
    explain_false,
    explain_missed,
)
from interloc.geometry import lonlat_from_enu
from interloc.mapping.mosaic import Mosaic, Raster
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import intersection_nodes
from interloc.osm.policies import Policy
from tests.osm_files import road_graph

Line = tuple[str, list[tuple[float, float]]]

CROSSING: list[Line] = [("residential", [(-90, 0), (0, 0), (90, 0)]), ("residential", [(0, -90), (0, 0), (0, 90)])]
STREET: Line = ("residential", [(-90, 0), (0, 0), (90, 0)])


def lonlat(xy: Any) -> np.ndarray:
    return lonlat_from_enu(49.0, 8.4, np.asarray(xy, dtype=np.float64).reshape(-1, 2))


def draw_map(lines: Sequence[Line]) -> RoadGraph:
    """Ways that meet where they share a place; node ids are 100, 101, ... in the order of the places."""
    places = {place: row for row, place in enumerate(dict.fromkeys(p for _, line in lines for p in line))}
    ways = [(highway, [places[p] for p in line], {"name": f"Way {row}"}) for row, (highway, line) in enumerate(lines)]
    return road_graph(lonlat(list(places)), ways, 100, "drawn")


def evidence_of(lines: Sequence[Line], policy: Policy = "drive", layers: Sequence[int] | None = None) -> MapEvidence:
    graph = draw_map(lines)
    if layers is not None:
        graph = replace(graph, ways=replace(graph.ways, layer=np.array(layers)))
    return MapEvidence(graph, intersection_nodes(graph, policy), lonlat([(0, 0)]))


def why_false(lines: Sequence[Line], place: tuple[float, float], **options: Any) -> Reason:
    evidence = evidence_of(lines, options.pop("policy", "drive"))
    taken = [(7, node) for node in range(len(evidence.nodes))] if options.pop("taken", False) else []
    (reason,) = explain_false(evidence, evidence.plane(lonlat(place)), [7], taken, 10.0)
    return reason


CORNER: list[Line] = [("residential", [(-90, 0), (0, 0), (0, 90)])]
ROUNDED = [(round(20 * math.sin(a) - 20, 3), round(20 * math.cos(a), 3)) for a in np.linspace(0, np.pi / 2, 9)]
BESIDE: list[Line] = [
    ("residential", [(-90, 0), (0, 0), (14, 0), (90, 0)]),
    ("residential", [(0, -90), (0, 0), (0, 90)]),
    ("service", [(14, 0), (14, 60)]),
]


SIDE: Line = ("service", [(0, 0), (0, 60)])
FOOTWAY: Line = ("footway", [(0, 0), (0, 60)])
FORK: list[Line] = [STREET, ("residential", [(0, 0), (86, 50)])]  # 30 degrees
SLIP: list[Line] = [
    ("residential", [(-90, 0), (0, 0), (30, 0), (90, 0)]),
    ("residential", [(0, -90), (0, -30), (0, 0), (0, 90)]),
    ("primary_link", [(0, -30), (30, 0)]),
]


@pytest.mark.parametrize(
    ("lines", "place", "kind", "sentence"),
    [
        (CORNER, (-2, 2), "bend", ""),
        (CORNER, (-60, 2), "nothing", ""),
        ([("residential", [(-90, 0), (0, 0), (90, 30)])], (0, 2), "nothing", ""),  # a bend by 18 degrees
        ([("residential", [(-90, 20), *ROUNDED, (0, -90)])], ROUNDED[4], "bend", ""),
        ([STREET], (88, 3), "road_end", ""),
        ([STREET], (0, 5), "nothing", "nothing in OpenStreetMap within 20 m explains it: worth a look"),
        (
            [STREET, SIDE],
            (0.6, 0.5),
            "left_out",
            'junction with highway=service "Way 1", 0.8 m away, which policy drive leaves out',
        ),
        ([STREET, SIDE], (0, -10.5), "nothing", ""),
        (BESIDE, (5, 0), "off", ""),  # a counted node that is nearer comes before a service road
        (BESIDE, (9, 0), "left_out", ""),
        (CROSSING, (12, 5), "off", "off by 13.0 m from node 101; 10 m are allowed"),
        (FORK, (14, 4), "fork", "roads part by only 30 degrees at node 101, 14.6 m away"),
        (FORK, (-14, 0), "off", ""),
        ([STREET, ("residential", [(0, 0), (60, 90)])], (12, 5), "off", ""),  # 56 degrees
        (SLIP, (18, -10), "slip_road", 'highway=primary_link "Way 2"'),
        (SLIP, (-12, 0), "off", ""),
        ([STREET, FOOTWAY], (1, 1), "path", 'highway=footway "Way 1" meets a road, 1.4 m away'),
        ([STREET, FOOTWAY], (7, 1), "nothing", ""),  # explains only what is very near
        ([*CROSSING, ("residential", [(0, 0), (45, 0.3)])], (14, 0), "fork", "run 0.3 m apart: drawn twice?"),
    ],
)
def test_what_a_wrong_intersection_is(lines: list[Line], place: tuple[float, float], kind: str, sentence: str) -> None:
    reason = why_false(lines, place)
    assert reason.kind == kind
    assert sentence in reason.sentence


def test_a_road_that_the_policy_counts_is_not_left_out() -> None:
    assert why_false([STREET, FOOTWAY], (12, 0), policy="all").kind == "off"


def test_beside_a_node_that_another_stands_for_it_is_the_second() -> None:
    reason = why_false(CROSSING, (12, 5), taken=True)
    assert reason.kind == "second"
    assert "node 101, 13.0 m away" in reason.sentence


def test_a_node_counts_as_taken_only_in_the_same_group() -> None:
    evidence = evidence_of(CROSSING)
    (reason,) = explain_false(evidence, evidence.plane(lonlat((12, 5))), [8], [(7, 0)], 5.0)
    assert reason.kind == "off"


@pytest.mark.parametrize(
    ("side", "layers", "sentence"),
    [
        ([(0.1, 0), (0, 60)], None, "nodes 101 and 103 lie at the same place and are not joined"),
        ([(40, -0.2), (40, 60)], None, 'node 103 lies on highway=residential "Way 0" and is not joined to it'),
        ([(40, -60), (40, 60)], None, 'highway=residential "Way 0" and highway=residential "Way 1" cross on one level'),
        ([(40, -60), (40, 60)], (0, 1), None),  # a bridge
        ([(0.1, 0), (0, 60)], (0, -1), None),
        ([(0.1, 0), (90, 0.1)], None, None),  # a road drawn twice
    ],
)
def test_a_slip_of_the_map_hides_a_junction(side: Any, layers: tuple[int, ...] | None, sentence: str | None) -> None:
    evidence = evidence_of([STREET, ("residential", side)], layers=layers)
    (reason,) = explain_false(evidence, evidence.plane(lonlat((side[0][0], 3.0))), [7], [], 10.0)
    assert (reason.kind in {"not_joined", "no_node"}) == (sentence is not None)
    assert sentence is None or sentence in reason.sentence


def test_what_is_near_a_node_of_a_merged_place_is_told_the_place_and_how_far_its_middle_is() -> None:
    ring: Line = ("residential", [(25, 0), (0, 25), (-25, 0), (0, -25), (25, 0)])
    streets: list[Line] = [("residential", [(25, 0), (90, 0)]), ("residential", [(0, 25), (0, 90)])]
    graph = draw_map([ring, *streets, ("residential", [(-25, 0), (-90, 0)])])
    graph = replace(graph, ways=replace(graph.ways, tags=({"junction": "roundabout"}, {}, {}, {})))
    evidence = MapEvidence(graph, intersection_nodes(graph, "consolidated"), lonlat([(0, 0)]))
    (reason,) = explain_false(evidence, evidence.plane(lonlat((26, 0))), [7], [], 10.0)
    assert reason == Reason(
        "off", "off by 26.0 m from the middle of nodes 100, 101 and 102 (one place); 10 m are allowed"
    )


def test_a_ring_whose_nodes_lie_in_one_place_is_not_walked_for_ever() -> None:
    ring = draw_map([("residential", [(0, 0), (1, 0), (0, 1), (0, 0)])])
    graph = replace(ring, lonlat=np.repeat(ring.lonlat[:1], 3, axis=0))
    evidence = MapEvidence(graph, intersection_nodes(graph), lonlat([(0, 0)]))
    (reason,) = explain_false(evidence, evidence.plane(lonlat((2, 0))), [7], [], 10.0)
    assert reason.kind == "nothing"


def why_missed(lines: Sequence[Line], node: int, **found: Any) -> Reason:
    """What is said of the node with this id; `found` are places, and nodes of intersections by their row."""
    evidence = evidence_of(lines, layers=found.pop("layers", None))

    def plane(name: str) -> np.ndarray:
        return evidence.plane(lonlat(found.get(name, [])))

    detections, intersections = plane("detections"), plane("intersections")
    seen = FoundByDrive(
        keyframe_xy=evidence.plane(lonlat(found.get("keyframes", [(-5, 0), (5, 0)]))),
        detection_xy=detections,
        detection_keyframe=np.arange(len(detections)),
        detection_intersection=np.array(found.get("members", [-1] * len(detections)), dtype=np.int64),
        intersection_xy=intersections,
        intersection_id=1 + np.arange(len(intersections)),
        intersection_node=np.array(found.get("nodes", [-1] * len(intersections)), dtype=np.int64),
        gate_m=10.0,
    )
    (row,) = np.flatnonzero(evidence.nodes.osm_id == node)
    return explain_missed(evidence, seen, int(row))


STAGGERED: list[Line] = [
    ("residential", [(-90, 0), (0, 0), (16, 0), (90, 0)]),
    ("residential", [(0, 0), (0, 90)]),
    ("residential", [(16, 0), (16, -90)]),
]


MOVED: dict[str, Any] = {"intersections": [(15, 0)], "nodes": [1], "detections": [(3, 0)]}
SHORT: list[Line] = [STREET, ("residential", [(0, 0), (0, 12)]), ("residential", [(-90, 0), (-90, 40)])]
VIADUCT: list[Line] = [STREET, ("motorway", [(2, -90), (2, 4), (2, 90)]), ("motorway_link", [(2, 4), (60, 60)])]
ABOVE: dict[str, Any] = {"layers": [0, 2, 2], "keyframes": [(-8, 0), (0, 0), (9, 0)]}
TWICE: list[Line] = [("residential", [(-90, 0), (0, 0), (20, 0.4), (90, 0)]), ("residential", [(0, 0), (90, 0)])]


@pytest.mark.parametrize(
    ("lines", "node", "found", "kind", "sentence"),
    [
        (STAGGERED, 101, {"intersections": [(8.5, 0)], "nodes": [1]}, "merged", "node 102, 16.0 m away"),
        (STAGGERED, 101, {**MOVED, "members": [0]}, "merged", ""),  # its detections went to the neighbour
        (STAGGERED, 101, {**MOVED, "members": [-1]}, "too_few", ""),
        (CROSSING, 101, {"intersections": [(12, 5)]}, "misplaced", "intersection 1 lies 13.0 m off; 10 m are allowed"),
        (CROSSING, 101, {"detections": [(1, 0), (0, 2)]}, "too_few", "detected at keyframes: 2;"),
        (CROSSING, 101, {"keyframes": [(-40, 17), (40, 17)]}, "not_driven", ""),
        (CROSSING, 101, {"keyframes": [(0, 14)]}, "not_seen", ""),
        (CROSSING, 101, {}, "not_seen", "what road was seen is not known"),
        (SHORT, 101, {}, "short", "12, 15, 15 m"),
        (CROSSING, 101, {"layers": [0, 1]}, "levels", "roads on layers 0 and 1 share this node"),
        # a bridge that begins at the junction
        ([STREET, ("residential", [(0, 0), (0, 90)])], 101, {"layers": [0, 1]}, "not_seen", ""),
        (VIADUCT, 104, ABOVE, "levels", "its roads lie on layer 2, the road driven on layer 0: it passes above"),
        (TWICE, 101, {}, "twice", "two of its roads, to nodes 102 and 103, run 0.4 m apart: drawn twice?"),
    ],
)
def test_why_a_node_was_missed(lines: list[Line], node: int, found: dict[str, Any], kind: str, sentence: str) -> None:
    reason = why_missed(lines, node, **found)
    assert reason.kind == kind
    assert sentence in reason.sentence


def test_a_missed_node_says_which_of_its_branches_were_seen() -> None:
    evidence = evidence_of(CROSSING)
    road, other = Raster(0.5), Raster(0.5)
    east, north = Transformer.from_crs(4326, 32632, always_xy=True).transform(*lonlat((0, 0))[0])
    row, col = -round(north / 0.5), round(east / 0.5)
    road.add(row - 4, col - 60, np.ones((8, 90), np.uint8))  # west, and east to 15 m
    other.add(row - 60, col - 4, np.ones((60, 8), np.uint8))  # north
    assert evidence.branches_seen(0, Mosaic(road, 32632, other)) == (
        "of its 4 branches the LiDAR saw 2 as road, 1 as other ground, 1 not"
    )


def test_streets_that_meet_are_named_in_the_order_of_the_alphabet() -> None:
    evidence = evidence_of([*CROSSING, ("footway", [(0, 0), (50, 50)])])
    places = np.array([[0.0, 0.0], [40.0, 3.0], [40.0, 40.0]])
    assert evidence.streets(places, np.array([0.5, 10.0, 10.0])) == ["Way 0 / Way 1", "Way 0", None]


def test_every_kind_has_its_meaning_and_is_counted() -> None:
    assert set(KINDS) == {*get_args(FalseKind), *get_args(MissKind)}
    counts = count_kinds([Reason("off", ""), None, Reason("off", ""), Reason("bend", "")], FalseKind)
    assert set(counts) == set(get_args(FalseKind))
    assert (counts["off"], counts["bend"], counts["nothing"]) == (2, 1, 0)


def test_nothing_wrong_needs_no_map() -> None:
    assert explain_false(evidence_of([STREET]), np.empty((0, 2)), [], [], 5.0) == []
