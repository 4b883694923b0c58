from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.errors import ConfigError
from interloc.osm.graph import RoadGraph, Ways
from interloc.osm.intersections import intersection_nodes, road_ways
from interloc.osm.policies import POLICIES, Policy
from interloc.osm.reader import read_osm
from tests.osm_files import road_graph


def graph(places: list[tuple[float, float]], ways: list[tuple[Any, ...]], *, areas: tuple[int, ...] = ()) -> RoadGraph:
    """Make a map of places (east, north in metres, roughly) and ways, as `road_graph` takes them."""
    lonlat = np.array([[8.4 + x / 73_100, 49.0 + y / 111_200] for x, y in places])
    return road_graph(lonlat, ways, 1000, "by hand", areas)


STAR = [(0.0, 0.0), (50.0, 0.0), (-50.0, 0.0), (0.0, 50.0), (0.0, -50.0)]


@pytest.mark.parametrize(
    ("third", "counted"),
    [
        ("residential", {"drive", "drive+service", "all", "consolidated"}),
        ("trunk_link", {"drive", "drive+service", "all", "consolidated"}),
        ("service", {"drive+service", "all"}),
        ("footway", {"all"}),
    ],
)
def test_a_side_road_makes_an_intersection_where_the_policy_takes_it(third: str, counted: set[Policy]) -> None:
    roads = graph(STAR, [("tertiary", [1, 0, 2]), (third, [0, 3])])
    assert {policy for policy in POLICIES if len(intersection_nodes(roads, policy))} == counted


def test_a_bend_and_a_change_of_name_are_no_intersection() -> None:
    roads = graph(STAR, [("tertiary", [1, 0]), ("secondary", [0, 3])])
    assert len(intersection_nodes(roads, "all")) == 0


def test_a_way_mapped_twice_counts_once() -> None:
    roads = graph(STAR, [("tertiary", [1, 0, 2]), ("tertiary", [2, 0, 1]), ("tertiary", [0, 0])])
    assert len(intersection_nodes(roads)) == 0


def test_the_edge_of_a_square_is_no_road_to_drive() -> None:
    roads = graph(STAR, [("residential", [1, 0, 2]), ("residential", [0, 3, 4, 0])], areas=(1,))
    assert [len(intersection_nodes(roads, policy)) for policy in POLICIES] == [0, 0, 1, 0]


def test_an_unknown_policy_names_the_known_ones() -> None:
    roads = graph(STAR, [("residential", [1, 0])])
    with pytest.raises(ConfigError, match="drive, drive\\+service, all, consolidated"):
        intersection_nodes(roads, "walk")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="tolerance_m is 0"):
        intersection_nodes(roads, "consolidated", tolerance_m=0)


ONE_WAY = {"oneway": "yes"}
JOINED: dict[str, tuple[list[tuple[float, float]], list[tuple[Any, ...]]]] = {
    "carriageways": (
        [(0, 0), (0, 14), (99, 0), (-99, 0), (99, 14), (-99, 14), (0, -99), (0, 99), (1, 7)],
        [("primary", [2, 0, 3], {"oneway": "-1"}), ("primary", [4, 1, 5], ONE_WAY), ("residential", [6, 0, 8, 1, 7])],
    ),
    "island in a side road": (
        [(-8, 0), (8, 0), (0, -25), (-99, 0), (99, 0), (0, -99)],
        [("tertiary", [3, 0, 1, 4]), ("residential", [0, 2, 1], ONE_WAY), ("residential", [2, 5])],
    ),
    "slip lane": (
        [(0, 0), (-20, 0), (0, -20), (-99, 0), (99, 0), (0, -99)],
        [("primary", [3, 1, 0, 4]), ("primary", [0, 2, 5]), ("primary_link", [1, 2], ONE_WAY)],
    ),
    "roundabout": (
        [(40, 0), (0, 40), (-40, 0), (0, -40), (32, 24), (80, 0), (0, 140), (-140, 0), (0, -140), (140, 0)],
        [
            ("primary", [0, 1, 2, 3, 4, 0], {"junction": "roundabout"}),
            *(("primary", each, ONE_WAY) for each in ([4, 5], [5, 0])),
            *(("primary", each) for each in ([5, 9], [1, 6], [2, 7], [3, 8])),
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("kind", "degree", "middle"), [
    ("carriageways", 6, (0, 7)), ("island in a side road", 3, (0, 0)), ("slip lane", 3, None), ("roundabout", 4, None)
])  # fmt: skip
def test_nodes_of_one_place_become_one(kind: str, degree: int, middle: tuple[float, float] | None) -> None:
    roads = graph(*JOINED[kind])
    merged = intersection_nodes(roads, "consolidated")
    assert (merged.osm_id.tolist(), merged.degree.tolist(), merged.tolerance_m) == ([1000], [degree], 15.0)
    assert merged.members_of(0) == tuple(intersection_nodes(roads).osm_id.tolist())
    if middle is not None:
        assert merged.lonlat[0] == pytest.approx([8.4 + middle[0] / 73_100, 49.0 + middle[1] / 111_200], abs=1e-6)


def test_an_island_in_a_road_is_no_intersection() -> None:
    """Two roads leave it; the same of a roundabout that only one street reaches."""
    road = [("tertiary", [4, 0]), ("tertiary", [1, 5])]
    lanes = [("tertiary", [0, 3, 1], ONE_WAY), ("tertiary", [1, 2, 0], ONE_WAY)]
    island = graph([(-8, 0), (8, 0), (0, 2), (0, -2), (-99, 0), (99, 0)], [*road, *lanes])
    street = ("residential", [3, 0])
    ring = graph(
        [(0, 0), (9, 9), (18, 0), (-99, 0)], [("residential", [0, 1, 2, 0], {"junction": "roundabout"}), street]
    )
    assert [len(intersection_nodes(each)) for each in (island, ring)] == [2, 1]
    assert [len(intersection_nodes(each, "consolidated")) for each in (island, ring)] == [0, 0]


@pytest.mark.parametrize("tags", [({}, {}), ({"oneway": "yes", "name": "A"}, {"oneway": "-1", "name": "B"})])
def test_neighbours_that_a_street_joins_are_two(tags: tuple[dict[str, str], ...]) -> None:
    places = [(0.0, 0.0), (0.0, 14.0), (99.0, 0.0), (-99.0, 0.0), (99.0, 14.0), (-99.0, 14.0), (0.0, -99.0), (0, 99.0)]
    lines = ([2, 0, 3], [4, 1, 5], [6, 0, 1, 7])
    roads = graph(places, [("residential", line, each) for line, each in zip(lines, (*tags, {}), strict=True)])
    assert intersection_nodes(roads, "consolidated").degree.tolist() == [4, 4]


def test_neighbours_on_a_road_of_two_carriageways_are_two() -> None:
    places = [(x, y) for x in (-99.0, 0.0, 26.0, 99.0) for y in (0.0, 10.0)] + [(0.0, -99.0), (26.0, -99.0)]
    ways = [("primary", [0, 2, 4, 6], ONE_WAY), ("primary", [7, 5, 3, 1], ONE_WAY)]
    ways += [("residential", [8, 2, 3]), ("residential", [9, 4, 5])]
    merged = intersection_nodes(graph(places, ways), "consolidated")
    assert merged.members == ((1002, 1003), (1004, 1005))


@pytest.mark.parametrize("tags", [{"layer": "1"}, {"bridge": "yes"}, {"tunnel": "yes"}])
def test_carriageways_on_different_levels_are_two(tags: dict[str, str]) -> None:
    places, ways = JOINED["carriageways"]
    roads = graph(places, [(*ways[0][:2], ways[0][2] | tags), *ways[1:]])
    assert len(intersection_nodes(roads, "consolidated")) == 2


def test_a_bridge_above_a_crossing_is_not_merged_with_it() -> None:
    """Close, but no road leads from one to the other."""
    places = [*STAR, *((x, y + 5.0) for x, y in STAR)]
    roads = graph(
        places,
        [("residential", [1, 0, 2]), ("residential", [0, 3]), ("residential", [6, 5, 7]), ("residential", [5, 8])],
    )
    assert len(intersection_nodes(roads, "consolidated")) == 2


def test_kitti_00_has_the_known_number_of_nodes(data: Callable[[str], Path]) -> None:
    roads = read_osm(data("kitti/osm/00.osm.gz"))
    counts = {policy: len(intersection_nodes(roads, policy)) for policy in POLICIES}
    assert counts == {"all": 333, "drive+service": 119, "drive": 83, "consolidated": 79}


def test_consolidation_keeps_clear_of_what_lies_outside_the_bounds(data: Callable[[str], Path]) -> None:
    roads = read_osm(data("kitti/osm_buildings/00.osm.gz"))
    inside = intersection_nodes(roads, "drive")
    merged = intersection_nodes(roads, "consolidated")
    assert len(merged) < len(inside)
    assert np.isin(merged.osm_id, inside.osm_id).all()
    assert (merged.degree >= 2).all()


@pytest.mark.parametrize("highway", ["proposed", "construction", "razed", "platform"])
def test_what_is_not_there_is_no_way(highway: str) -> None:
    ways = Ways(
        np.array([1, 2]), ("residential", highway), ("", ""), np.array([False, False]), np.array([0, 0]), ({}, {})
    )
    graph = RoadGraph(np.array([1]), np.zeros((1, 2)), np.empty((0, 2), int), np.empty(0, int), ways, "map.osm")
    assert road_ways(graph, "all").tolist() == [True, False]
