"""Buildings of the map around a drive: which are read, and which are drawn."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from interloc.osm import reader
from interloc.osm.reader import read_osm
from interloc.output.roads import building_features

BOUNDS = (8.39, 48.99, 8.42, 49.02)
CORNERS = [(8.4, 49.0), (8.4, 49.0001), (8.4002, 49.0001), (8.4002, 49.0)]  # clockwise
OUTER = [(8.4005, 49.0001), (8.4009, 49.0001), (8.4009, 49.0002), (8.4005, 49.0002)]
INNER = [(8.4006, 49.00012), (8.4008, 49.00012), (8.4007, 49.00018)]
SECOND = [(8.401, 49.0001), (8.4012, 49.0001), (8.4011, 49.0002)]
FAR = [(8.41, 49.0), (8.4102, 49.0), (8.4102, 49.0001)]


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """A street; of the buildings three are whole, one of them far from the street, one a relation."""
    nodes = [*CORNERS, *FAR, (8.4, 49.0003), (8.402, 49.0003), *OUTER, *INNER, *SECOND]
    lines = [f'<node id="{i}" lat="{lat}" lon="{lon}"/>' for i, (lon, lat) in enumerate(nodes, 1)]
    ways = [
        (20, [1, 2, 3, 4, 1], ("building", "yes")),
        (21, [5, 6, 7, 5], ("building", "church")),
        (22, [1, 2, 3, 4], ("building", "yes")),  # open
        (23, [1, 2, 99, 4, 1], ("building", "yes")),  # a node is missing
        (24, [1, 2, 3, 1], ("building", "no")),
        (25, [1, 2, 1], ("building", "yes")),  # no area
        (30, [8, 9], ("highway", "residential")),
        (40, [10, 11, 12], ("name", "front")),
        (41, [10, 13, 12], ("building", "yes")),
        (42, [14, 15, 16, 14], ("building", "yes")),  # a shed in the yard
        (43, [17, 18, 19, 17], ("building", "yes")),
    ]
    around = [(40, "outer"), (41, ""), (42, "inner"), (43, "outer")]
    relations = [
        (50, around, {"type": "multipolygon", "building": "yes"}),
        (51, [*around, (60, "outer")], {"type": "multipolygon", "building": "yes"}),  # a way is missing
        (52, [(40, "outer")], {"type": "multipolygon", "building": "yes"}),  # open
        (53, around, {"type": "multipolygon", "building": "no"}),
        (54, around, {"type": "site", "building": "yes"}),
    ]
    for way, refs, (key, value) in ways:
        inside = "".join(f'<nd ref="{ref}"/>' for ref in refs)
        lines.append(f'<way id="{way}">{inside}<tag k="{key}" v="{value}"/></way>')
    for relation, members, tags in relations:
        inside = "".join(f'<member type="way" ref="{ref}" role="{role}"/>' for ref, role in members)
        inside += "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
        lines.append(f'<relation id="{relation}">{inside}</relation>')
    path = tmp_path / "map.osm"
    path.write_text(f'<osm version="0.6">{"".join(lines)}</osm>')
    return path


def test_buildings_near_the_track_are_polygons(town: Path) -> None:
    graph = read_osm(town, BOUNDS)
    assert graph.buildings.id.tolist() == [20, 21, 42, 50, 50]  # way 43 is an outline of relation 50
    feature, *_ = building_features(graph, np.array([[8.4, 49.0003], [8.402, 49.0003]]))
    assert feature["properties"] == {"osm_id": "20", "osm_type": "way"}
    outline = shapely.geometry.shape(feature["geometry"])
    assert outline.equals(shapely.Polygon(CORNERS))
    assert outline.exterior.is_ccw
    assert building_features(graph, np.array([[8.3, 49.0]])) == []


def test_a_relation_is_put_together_from_its_ways(town: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    features = building_features(read_osm(town, BOUNDS), np.array([[8.4, 49.0003], [8.402, 49.0003]]))
    assert [feature["id"] for feature in features] == ["20", "42", "50-1", "50-2"]
    house, annex = (shapely.geometry.shape(feature["geometry"]) for feature in features[2:])
    assert house.equals(shapely.Polygon(OUTER, [INNER]))
    assert annex.equals(shapely.Polygon(SECOND))
    assert house.exterior.is_ccw
    assert not house.interiors[0].is_ccw
    assert features[2]["properties"] == {"osm_id": "50", "osm_type": "relation"}
    monkeypatch.setattr(reader, "MAX_NODES_OF_RELATIONS", 13)  # it has 14
    assert read_osm(town, BOUNDS).buildings.id.tolist() == [20, 21, 42, 43]


def test_buildings_are_left_out_where_they_would_take_long(town: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(read_osm(town).buildings) == 0  # not of a whole map
    monkeypatch.setattr(reader, "MAX_NODES_WITH_BUILDINGS", 8)
    assert len(read_osm(town, BOUNDS).buildings) == 0
