"""Maps that become scenes; the made-up town, whose plan is its map."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Polygon

from interloc.errors import ConfigError, MapError
from interloc.lab.config import RoadsideConfig, SceneConfig, TrackConfig
from interloc.lab.ground import Surface, beyond_ends, fit_heights, without_drift
from interloc.lab.raycast import surface_at
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import read_map, road_width_m, street_map_of
from interloc.lab.town import ROUTES, Part, Town
from interloc.lab.tracks import LidarTrack, track_from_line
from interloc.osm.intersections import intersection_nodes
from interloc.osm.reader import read_osm
from tests.lab.conftest import FRAME
from tests.towns import junctions_of

WriteMap = Callable[..., Path]
BARE = SceneConfig(roadside=RoadsideConfig(buildings="none", parked_car_density=0, hedge_share=0), flat=True)


def surface(scene: Scene, x: float, y: float, level: int = 0) -> Surface:
    px, py = scene.frame.xy(FRAME.lonlat([x, y]))
    scene.ground.show(px, py, 5.0, plan=level)
    return Surface(surface_at(scene.ground.tiles, scene.ground.index, *scene.ground.frame, px, py))


def test_it_stands_on_road_even_where_the_map_is_off(write_map: WriteMap) -> None:
    path = write_map(([(-80.0, 5.0), (80.0, 5.0)], {"highway": "residential"}))
    track = track_from_line(FRAME.lonlat([[-50, 0], [50, 0]]))
    assert surface(build_scene(track, read_map(path), config=BARE), 0.0, 0.0) == Surface.ROAD


def test_the_cross_section_of_a_street(street_scene: Scene) -> None:
    found = [surface(street_scene, 30.0, y) for y in (0.0, 3.0, 4.0, 5.0, 6.0, -4.0, -6.0)]
    assert found == [*[Surface.ROAD] * 2, *[Surface.SIDEWALK] * 2, Surface.TERRAIN, Surface.SIDEWALK, Surface.TERRAIN]


def test_kerbs_are_round_at_a_junction(straight_track: LidarTrack, write_map: WriteMap) -> None:
    path = write_map(
        ([(-150.0, 0.0), (0.0, 0.0), (150.0, 0.0)], {"highway": "residential", "sidewalk": "no"}),
        ([(0.0, 0.0), (0.0, 90.0)], {"highway": "residential", "sidewalk": "no"}),
    )
    scene = build_scene(straight_track, read_map(path), config=BARE)
    corner = 3.25  # of the straight kerbs; the arc of radius 5.5 m cuts it off by 2.3 m
    assert surface(scene, corner + 0.9, corner + 0.9) == Surface.ROAD
    assert surface(scene, corner + 2.0, corner + 2.0) == Surface.TERRAIN
    assert surface(scene, corner + 0.9, 30.0) == Surface.TERRAIN


def test_the_strip_between_two_carriageways_is_no_road(straight_track: LidarTrack, write_map: WriteMap) -> None:
    tags = {"highway": "secondary", "oneway": "yes"}
    path = write_map(
        ([(-150.0, 0.0), (0.0, 0.0), (150.0, 0.0)], tags),
        ([(150.0, 12.0), (0.0, 12.0), (-150.0, 12.0)], tags),
        ([(0.0, 0.0), (0.0, 12.0)], {"highway": "secondary"}),
    )
    scene = build_scene(straight_track, read_map(path), config=BARE)
    assert surface(scene, 60.0, 6.0) == Surface.TERRAIN
    assert surface(scene, 60.0, 4.0) == Surface.OTHER_GROUND
    assert surface(scene, 0.0, 6.0) == Surface.ROAD


def test_who_drives_over_a_bridge_does_not_see_the_road_below(write_map: WriteMap) -> None:
    path = write_map(
        ([(-150.0, 0.0), (-20.0, 0.0)], {"highway": "residential"}),
        ([(-20.0, 0.0), (20.0, 0.0)], {"highway": "residential", "bridge": "yes", "layer": "1"}),
        ([(20.0, 0.0), (150.0, 0.0)], {"highway": "residential"}),
        ([(0.0, -150.0), (0.0, 150.0)], {"highway": "residential"}),
    )
    over = build_scene(track_from_line(FRAME.lonlat([[-100, 0], [100, 0]])), read_map(path), config=BARE)
    under = build_scene(track_from_line(FRAME.lonlat([[0, -100], [0, 100]])), read_map(path), config=BARE)
    middle = len(over.level) // 2
    assert over.level[middle] == 1
    assert over.level[0] == 0
    assert not under.level.any()
    assert surface(over, 0.0, 15.0, level=1) == Surface.TERRAIN
    assert surface(over, 15.0, 0.0, level=1) == Surface.ROAD
    assert surface(under, 0.0, 15.0) == Surface.ROAD
    assert surface(under, 15.0, 0.0) == Surface.TERRAIN


@pytest.mark.parametrize(
    ("tags", "width"),
    [
        ({"highway": "residential"}, 6.5),
        ({"highway": "residential", "width": "5.2 m"}, 5.2),
        ({"highway": "residential", "width": "wide"}, 6.5),
        ({"highway": "residential", "lanes": "1"}, 4.5),
        ({"highway": "primary", "lanes": "4"}, 13.0),
        ({"highway": "primary", "oneway": "yes"}, 7.0),
        ({"highway": "tertiary", "oneway": "yes", "lanes": "1"}, 5.0),
        ({"highway": "service", "service": "driveway"}, 3.5),
    ],
)
def test_widths(tags: dict[str, str], width: float) -> None:
    assert road_width_m(tags) == pytest.approx(width)


def test_heights_follow_the_track_and_spread() -> None:
    x = np.linspace(0, 200, 201)
    field = fit_heights(np.column_stack([x, 0 * x, 50 + 0.05 * x]), margin_m=60)
    assert field.at(100, 0) == pytest.approx(55.0, abs=0.1)
    assert field.at(100, 50) == pytest.approx(55.0, abs=1.0)
    assert 49.5 < field.at(-50, -50) < 52


def test_the_ground_ahead_of_the_end_of_a_track_goes_on_as_it_rises() -> None:
    x = np.linspace(0, 100, 101)
    track = np.column_stack([x, 0 * x, 0.05 * x])
    ahead = beyond_ends(track)
    assert ahead[:, 2] == pytest.approx(0.05 * ahead[:, 0])
    assert (ahead[:, 0].min(), ahead[:, 0].max()) == pytest.approx((-36.0, 136.0), abs=0.1)
    assert len(beyond_ends(track[:5])) == 0


def test_heights_that_settle_are_no_hill() -> None:
    x = np.linspace(0, 100, 201)
    true = np.column_stack([x, 0 * x, 0.05 * x])
    drifted = true - np.where(x < 30, 30 - x, 0)[:, None] * [0.0, 0.0, 0.5]
    assert without_drift(drifted, np.full(201, 0.05)) == pytest.approx(true, abs=0.05)
    assert without_drift(true, np.full(201, 0.02)) == pytest.approx(true, abs=1e-12)


def test_a_map_of_another_place_is_refused(write_map: WriteMap) -> None:
    path = write_map(([(-150.0, 0.0), (150.0, 0.0)], {"highway": "residential"}))
    far = track_from_line(FRAME.lonlat([[5000, 0], [5100, 0]]))
    with pytest.raises(MapError, match=r"no street within reach of the track.*Usual cause"):
        build_scene(far, read_map(path))


def test_a_map_without_streets_is_refused(straight_track: LidarTrack, write_map: WriteMap) -> None:
    path = write_map(([(-150.0, 0.0), (150.0, 0.0)], {"highway": "footway"}))
    with pytest.raises(MapError, match="no street"):
        build_scene(straight_track, read_map(path))


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
