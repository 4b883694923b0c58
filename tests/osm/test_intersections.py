from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from interloc.errors import ConfigError
from interloc.osm.graph import RoadGraph, Ways
from interloc.osm.intersections import intersection_nodes, road_ways
from interloc.osm.policies import POLICIES, Policy
from interloc.osm.reader import read_osm


def graph(
    places: list[tuple[float, float]], ways: list[tuple[str, list[int]]], *, areas: tuple[int, ...] = ()
) -> RoadGraph:
    """Make a map of places (east, north in metres, roughly) and ways (highway, places)."""
    pieces = [(a, b, way) for way, (_, nodes) in enumerate(ways) for a, b in pairwise(nodes)]
    table = np.array(pieces, dtype=np.int64)
    return RoadGraph(
        node_id=np.arange(len(places)) + 1000,
        lonlat=np.array([[8.4 + x / 73_100, 49.0 + y / 111_200] for x, y in places]),
        edges=table[:, :2],
        edge_way=table[:, 2],
        ways=Ways(
            id=np.arange(len(ways)),
            highway=tuple(highway for highway, _ in ways),
            name=("",) * len(ways),
            is_area=np.array([way in areas for way in range(len(ways))]),
        ),
        source="by hand",
    )


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


def dual_carriageway(gap_m: float) -> RoadGraph:
    """Two one-way roads, a street across both: two nodes of four neighbours."""
    places = [(0.0, 0.0), (0.0, gap_m), (99.0, 0.0), (-99.0, 0.0), (99.0, gap_m), (-99.0, gap_m), (0.0, -99.0)]
    places += [(0.0, gap_m + 99.0), (0.0, gap_m / 2)]
    return graph(places, [("primary", [2, 0, 3]), ("primary", [4, 1, 5]), ("residential", [6, 0, 8, 1, 7])])


def test_the_two_nodes_of_a_dual_carriageway_become_one() -> None:
    roads = dual_carriageway(gap_m=14.0)
    assert intersection_nodes(roads).degree.tolist() == [4, 4]
    merged = intersection_nodes(roads, "consolidated", tolerance_m=10.0)
    assert (merged.osm_id.tolist(), merged.degree.tolist(), merged.tolerance_m) == ([1000], [6], 10.0)
    assert merged.lonlat[0] == pytest.approx(roads.lonlat[[0, 1]].mean(axis=0), abs=1e-7)


def test_nodes_further_apart_than_twice_the_tolerance_stay() -> None:
    assert len(intersection_nodes(dual_carriageway(gap_m=24.0), "consolidated", tolerance_m=10.0)) == 2


def test_a_bridge_above_a_crossing_is_not_merged_with_it() -> None:
    """Close, but no road leads from one to the other."""
    places = [*STAR, *((x, y + 5.0) for x, y in STAR)]
    roads = graph(
        places,
        [
            ("residential", [1, 0, 2]),
            ("residential", [0, 3]),
            ("residential", [6, 5, 7]),
            ("residential", [5, 8]),
        ],
    )
    assert len(intersection_nodes(roads, "consolidated")) == 2


def test_kitti_00_has_the_known_number_of_nodes(data: Callable[[str], Path]) -> None:
    roads = read_osm(data("kitti/osm/00.osm.gz"))
    counts = {policy: len(intersection_nodes(roads, policy)) for policy in POLICIES}
    assert counts == {"all": 333, "drive+service": 119, "drive": 83, "consolidated": 70}


def test_consolidation_keeps_clear_of_what_lies_outside_the_bounds(data: Callable[[str], Path]) -> None:
    roads = read_osm(data("kitti/osm_buildings/00.osm.gz"))
    inside = intersection_nodes(roads, "drive")
    merged = intersection_nodes(roads, "consolidated")
    assert len(merged) < len(inside)
    assert np.isin(merged.osm_id, inside.osm_id).all()
    assert (merged.degree >= 2).all()


@pytest.mark.parametrize("highway", ["proposed", "construction", "razed", "platform"])
def test_what_is_not_there_is_no_way(highway: str) -> None:
    ways = Ways(np.array([1, 2]), ("residential", highway), ("", ""), np.array([False, False]))
    graph = RoadGraph(np.array([1]), np.zeros((1, 2)), np.empty((0, 2), int), np.empty(0, int), ways, "map.osm")
    assert road_ways(graph, "all").tolist() == [True, False]
