"""Roads of ground that was drawn: where they lie, how wide they are, what they join."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose

import interloc
from interloc.mapping.mosaic import TILE, Mosaic, Raster
from interloc.roadmap.extract import extract_roads
from interloc.roadmap.graph import Edge
from tests.output.small import small_result, with_roads
from tests.roadmap.streets import away, draw, drive, joined, roads_of, street, turned

EAST, NORTH = ((-100.0, 0.0), (100.0, 0.0)), ((0.0, -80.0), (0.0, 80.0))


def test_two_streets_meet_at_the_intersection_of_the_result() -> None:
    lines = [turned(20, *EAST), turned(20, *NORTH)]
    network = roads_of(street(*lines[0], width_m=8) | street(*lines[1], width_m=6), lines[0], [(0.1, -0.2)])
    (node,) = (each for each in network.nodes if each.kind == "intersection")
    assert node.intersections == (1,)
    assert_allclose(node.xy, (0.1, -0.2))  # where the intersection is, not where the lines meet
    assert node.area.contains(shapely.Point(0, 0))
    assert sorted(each.kind for each in network.nodes) == ["dead_end"] * 2 + ["end_of_view"] * 2 + ["intersection"]
    for edge in network.edges:
        line, width = (lines[0], 8) if edge.is_driven else (lines[1], 6)
        assert away(edge, *line) < 0.25
        assert edge.width_m == pytest.approx(width, abs=0.25)
        assert edge.keyframes == 6
        assert edge.seen == 1
        assert np.nanmax(np.abs(edge.profile_m - width)) < 0.4
    assert sum(each.area for each in network.surface) == pytest.approx(8 * 200 + 6 * 160 - 48, rel=0.02)


def test_the_seams_of_blocks_do_not_show() -> None:
    bend = [(-170.0, -140.0), (-20.0, -30.0), (0.0, 0.0), (65.0, 160.0)]
    side = [(-110.0, 110.0), (0.0, 0.0), (150.0, -20.0)]
    yard = shapely.box(60.0, 50.0, 100.0, 100.0)
    mosaic, result = draw(street(*bend) | street(*side) | yard), drive(bend, [(0.0, 0.0)])
    whole, cut = (extract_roads(result, mosaic, block=block) for block in (8 * TILE, TILE))
    assert len(whole.surface) < len(cut.surface)
    assert len(whole.edges) == len(cut.edges) > 3
    for one, other in zip(whole.edges, cut.edges, strict=True):
        assert_allclose(one.xy, other.xy, atol=1e-6)
        assert one.width_m == other.width_m
    areas = [sum(each.area for each in network.surface) for network in (whole, cut)]
    assert areas[0] == pytest.approx(areas[1], rel=5e-3)


def test_parked_cars_do_not_narrow_a_street() -> None:
    ground = street(*EAST, width_m=8)
    for x in range(-80, 80, 16):
        ground -= shapely.box(x, 2.0, x + 5, 4.0)
    (edge,) = roads_of(ground, EAST).edges
    assert edge.width_m == pytest.approx(8, abs=0.3)
    assert away(edge, *EAST) < 0.3


@pytest.mark.parametrize("offset_m", [0.0, -2.0])
def test_a_lay_by_does_not_pull_the_road(offset_m: float) -> None:
    line = ((-150.0, 0.0), (150.0, 0.0))
    ground = street(*line) | shapely.box(-30.0, 0.0, 30.0, 9.0)
    (edge,) = roads_of(ground, [(x, y + offset_m) for x, y in line]).edges
    assert away(edge, *line) < 0.6
    assert edge.width_m == pytest.approx(7, abs=0.2)


def test_an_open_place_is_an_area_without_lines() -> None:
    place = shapely.box(-30.0, -30.0, 30.0, 30.0)
    west, east = ((-150.0, 10.0), (-20.0, 10.0)), ((20.0, -15.0), (150.0, -15.0))
    network = roads_of(place | street(*west) | street(*east), [*west, *east])
    (node,) = (each for each in network.nodes if each.kind == "place")
    assert len(network.edges) == 2
    assert node.area.area == pytest.approx(3600, rel=0.06)
    assert all(node.id in {edge.start, edge.end} for edge in network.edges)
    lines = shapely.MultiLineString([edge.xy for edge in network.edges])
    assert lines.intersection(node.area).length < 2


def test_a_road_over_another_has_no_node_there() -> None:
    network = roads_of(street(*EAST) | street(*NORTH), EAST)
    assert {each.kind for each in network.nodes} == {"dead_end", "end_of_view"}
    assert len(network.edges) == 2


def test_carriageways_are_two_roads_where_the_median_is_seen() -> None:
    lines = [[(-200.0, y), (200.0, y)] for y in (-6.0, 6.0)]
    links = [street((x, -6.0), (x, 6.0)) for x in (-150.0, 150.0)]
    places = [(x, y) for x in (-150.0, 150.0) for y in (-6.0, 6.0)]
    network = roads_of(street(*lines[0]) | street(*lines[1]) | shapely.union_all(links), lines[0], places)
    assert joined(network) == {frozenset(pair) for pair in ((1, 2), (3, 4), (1, 3), (2, 4))}


@pytest.mark.parametrize("west", [[(-8, 9), (-8, -9)], [(-20, 4), (-3, -2), (-3, -9)]])  # the latter hides a flank
def test_a_gap_between_two_ends_that_face_each_other_is_bridged(west: list[tuple[float, float]]) -> None:
    (edge,) = roads_of(street(*EAST) - shapely.Polygon([*west, *((-x, -y) for x, y in west)]), EAST).edges
    assert 0.8 < edge.seen < 0.99
    assert edge.length_m > 190


def test_a_line_that_is_tied_to_a_node_makes_no_detour() -> None:
    edge = Edge(0, 1, np.array([(0.0, 6.0), (0.0, 2.0), (9.0, 2.0)]), np.ones(3), np.ones(3, np.bool_))
    assert_allclose(edge.beginning_at(2, np.zeros(2)).xy, [(0, 0), (0, 2), (9, 2)])
    assert_allclose(edge.beginning_at(2, np.array([0.0, 8.0])).xy, [(0, 8), *edge.xy])


def test_a_road_was_driven_between_keyframes_that_are_far_apart() -> None:
    for every_m, driven in ((20.0, True), (1000.0, False)):  # the second stands, and turns
        (edge,) = extract_roads(drive(EAST, every_m=every_m), draw(street(*EAST))).edges
        assert edge.is_driven == driven


def test_no_road_gives_an_empty_map() -> None:
    assert extract_roads(drive(EAST), Mosaic(Raster(0.5), None)).edges == []
    network = interloc.roads(small_result())
    assert (network.nodes, network.edges, network.surface) == ([], [], [])


def test_a_result_in_memory_and_one_read_from_a_folder_have_the_same_roads(tmp_path: Path) -> None:
    result = with_roads(small_result())
    interloc.write_results(result, tmp_path)
    read = interloc.read_results(tmp_path)
    here, there = interloc.roads(result), interloc.roads(read)
    assert len(here.edges) == len(there.edges) == 4
    assert here.epsg == there.epsg == 32632
    for one, other in zip(here.edges, there.edges, strict=True):
        assert_allclose(one.xy, other.xy, atol=0.05)
    interloc.write_results(read, tmp_path)  # into the same folder, from its own road.tif
    assert (tmp_path / "road.tif").is_file()
    table = read.geodataframe("roads")
    assert (len(table), table.crs) == (4, "EPSG:4326")
    (tmp_path / "road.tif").unlink()
    assert interloc.roads(replace(read, road_file=None)).edges == []
