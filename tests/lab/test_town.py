"""The made-up town: its map is its truth."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Polygon

from interloc.errors import ConfigError
from interloc.lab.config import TrackConfig
from interloc.lab.streets import read_map, street_map_of
from interloc.lab.town import ROUTES, Part, Town
from interloc.osm.intersections import intersection_nodes
from interloc.osm.reader import read_osm
from tests.towns import junctions_of


@pytest.mark.parametrize("part", ROUTES)
def test_the_junctions_of_the_map_are_those_of_the_plan(part: Part, tmp_path: Path) -> None:
    town = Town(part)
    (tmp_path / "town.osm").write_text(town.osm())
    nodes = intersection_nodes(read_osm(tmp_path / "town.osm"), "drive")
    truth = {junction.node_id: junction.lonlat for junction in junctions_of(town).values()}
    assert set(nodes.osm_id.tolist()) == set(truth)
    for node_id, lonlat in zip(nodes.osm_id.tolist(), nodes.lonlat, strict=True):
        assert np.allclose(lonlat, truth[node_id], atol=1e-9)


def test_every_shape_is_there() -> None:
    town = Town("full")
    junctions = junctions_of(town)
    kinds = {junction.kind for junction in junctions.values()}
    assert kinds == {"X", "T", "Y", "staggered", "roundabout", "dual", "compound"}
    assert 15 <= np.hypot(*(junctions["stagS"].xy - junctions["stagN"].xy)) <= 25
    text = town.osm()
    for tag in ("junction", "bridge", "layer", "oneway", "turning_circle", "parking_aisle", "driveway", 'v="parking"'):
        assert tag in text


@pytest.mark.parametrize(
    ("part", "low", "high", "not_passed"),
    [
        ("plain", 600, 700, {"T45"}),
        ("full", 3000, 6000, {"T45"}),
        ("quarter", 2000, 2200, {"hill1", "hill2", "bank1", "bank2"}),
    ],
)
def test_the_route_runs_along_the_streets(part: Part, low: float, high: float, not_passed: set[str]) -> None:
    town = Town(part)
    track = town.track(TrackConfig(rate_hz=2))
    xy = town.frame.xy(np.column_stack([track.lon_deg, track.lat_deg]))
    assert low < np.hypot(*np.diff(xy, axis=0).T).sum() < high
    for name, junction in junctions_of(town).items():
        assert name in not_passed or np.hypot(*(xy - junction.xy).T).min() < 18, name


def test_streets_of_the_quarter_are_free_and_the_route_stays_on_them() -> None:
    town = Town("quarter")
    drawn = street_map_of(town.map_data(), town.frame)
    roads = shapely.union_all([LineString(street.xy).buffer(3.25) for street in drawn.streets])
    houses = [Polygon(xy) for _, xy in drawn.buildings]
    assert len(houses) > 150
    assert not any(roads.intersects(house) for house in houses)
    track = town.track(TrackConfig(rate_hz=2))
    assert roads.contains(LineString(town.frame.xy(np.column_stack([track.lon_deg, track.lat_deg]))))
    assert all(street.tags["name"] for street in drawn.streets)


@pytest.mark.parametrize("part", ROUTES)
def test_what_is_driven_through_is_what_the_map_says(part: Part, tmp_path: Path) -> None:
    town = Town(part, seed=3)
    (tmp_path / "map.osm").write_text(town.osm())
    ways = [way for way in town.map_data().ways if way.tags.keys() & {"highway", "building", "amenity"}]
    read = read_map(tmp_path / "map.osm")
    assert [(way.nodes, way.tags) for way in read.ways] == [(way.nodes, way.tags) for way in ways]
    assert all(np.array_equal(one.lonlat, other.lonlat) for one, other in zip(read.ways, ways, strict=True))
    assert "town:" not in town.osm()


def test_the_map_depends_on_the_seed_alone() -> None:
    assert Town("plain", seed=1).osm() == Town("plain", seed=1).osm()
    assert Town("plain", seed=1).osm() != Town("plain", seed=2).osm()


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(ConfigError, match="plain"):
        Town("north")  # type: ignore[arg-type]
