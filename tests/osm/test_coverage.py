"""What an extract covers is told from its content."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.osm.graph import RoadGraph
from interloc.osm.reader import read_osm
from tests.osm_files import osm_text

LON, LAT = 8.4, 49.0
EAST, NORTH = 73150.0, 111200.0  # metres per degree there
BLOCKS = 8
STREET_M = 70.0

Keep = Callable[[FloatArray], bool]


def town(path: Path, inside: Keep, *, head: str = "", whole_ways: bool = True) -> RoadGraph:
    """Return a town of blocks, whose streets are ways from corner to corner, cut to those with a node inside."""
    corners = [(x, y) for x in range(-BLOCKS, BLOCKS + 1) for y in range(-BLOCKS, BLOCKS + 1)]
    number = {corner: row + 1 for row, corner in enumerate(corners)}
    is_in = {corner: inside(np.array(corner) * STREET_M) for corner in corners}
    ways = [(a, b) for a in corners for b in ((a[0] + 1, a[1]), (a[0], a[1] + 1)) if b in number]
    ways = [way for way in ways if any(is_in[corner] for corner in way)]
    used = {corner for way in ways for corner in way if whole_ways or is_in[corner]}
    nodes = (
        f'<node id="{number[x, y]}" lon="{LON + x * STREET_M / EAST:.7f}" lat="{LAT + y * STREET_M / NORTH:.7f}"/>'
        for x, y in sorted(used)
    )
    lines = (
        f'<way id="{row}"><nd ref="{number[a]}"/><nd ref="{number[b]}"/><tag k="highway" v="residential"/></way>'
        for row, (a, b) in enumerate(ways, 1)
    )
    path.write_text(f'<osm version="0.6">{head}{"".join(nodes)}{"".join(lines)}</osm>')
    return read_osm(path)


def at(*places_m: tuple[float, float]) -> FloatArray:
    return np.array([LON, LAT]) + np.array(places_m) / [EAST, NORTH]


@pytest.mark.parametrize("angle_deg", range(0, 360, 30))
@pytest.mark.parametrize("whole_ways", [True, False])
def test_what_lies_beyond_a_border_is_not_covered(tmp_path: Path, angle_deg: float, whole_ways: bool) -> None:
    out = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    box = '<bounds minlat="48.9" minlon="8.3" maxlat="49.1" maxlon="8.5"/>'  # larger than the town
    graph = town(tmp_path / "map.osm", lambda xy: bool(xy @ out < 10.0), head=box, whole_ways=whole_ways)
    places = at(*(along * out for along in (-200.0, 110.0)))
    assert graph.declares(places).all()
    assert graph.covers(places).tolist() == [True, False]


def test_a_whole_town_is_covered_to_its_edge_and_not_beyond(tmp_path: Path) -> None:
    graph = town(tmp_path / "map.osm", lambda _: True)
    edge = BLOCKS * STREET_M
    assert graph.covers(at((0, 0), (edge, 0), (-edge, edge), (edge + 900, 0))).tolist() == [True, True, True, False]


@pytest.mark.parametrize(
    "bounds", [("0", "0", "0", "0"), ("49.1", "8.3", "48.9", "8.5"), ("48.9", "8.5", "49.1", "8.3")]
)
def test_bounds_that_make_no_sense_are_left_out_and_told(tmp_path: Path, bounds: tuple[str, ...]) -> None:
    south, west, north, east = bounds
    head = f'<bounds minlat="{south}" minlon="{west}" maxlat="{north}" maxlon="{east}"/>'
    graph = town(tmp_path / "map.osm", lambda _: True, head=head)
    assert graph.areas == ()
    assert graph.covers(at((0, 0))).all()
    assert any("declares bounds" in warning for warning in graph.warnings)


def test_few_long_roads_are_no_cut_map(tmp_path: Path) -> None:
    """A crossing in the country: beyond every line there is road, and nothing is missing."""
    places = at((-900, 0), (0, 0), (900, 0), (0, 900), (0, -900))
    path = tmp_path / "map.osm"
    path.write_text(osm_text(places, [(1, 2, 3), (4, 2, 5)]))
    assert read_osm(path).covers(at((0, 0), (850, 20), (0, -850))).all()


def test_a_village_is_no_cut_map(tmp_path: Path) -> None:
    """A road through it that leads on far, and streets off it on both sides, which end where the fields begin."""
    street = [(-900, 0), *((x, 0) for x in range(0, 500, 100)), (1300, 0)]
    heads = [(x, side * 90 * (1 + x // 200)) for x in range(0, 500, 100) for side in (1, -1)]
    path = tmp_path / "map.osm"
    ways = [tuple(range(1, 8)), *((2 + i // 2, 8 + i) for i in range(len(heads)))]
    path.write_text(osm_text(at(*street, *heads), ways))
    assert read_osm(path).covers(at(*street, *heads)).all()
