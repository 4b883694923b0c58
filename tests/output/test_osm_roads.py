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
FAR = [(8.41, 49.0), (8.4102, 49.0), (8.4102, 49.0001)]


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """A street; of the buildings two are whole, one of them far from the street."""
    nodes = [*CORNERS, *FAR, (8.4, 49.0003), (8.402, 49.0003)]
    lines = [f'<node id="{i}" lat="{lat}" lon="{lon}"/>' for i, (lon, lat) in enumerate(nodes, 1)]
    ways = [
        (20, [1, 2, 3, 4, 1], ("building", "yes")),
        (21, [5, 6, 7, 5], ("building", "church")),
        (22, [1, 2, 3, 4], ("building", "yes")),  # open
        (23, [1, 2, 99, 4, 1], ("building", "yes")),  # a node is missing
        (24, [1, 2, 3, 1], ("building", "no")),
        (25, [1, 2, 1], ("building", "yes")),  # no area
        (30, [8, 9], ("highway", "residential")),
    ]
    for way, refs, (key, value) in ways:
        inside = "".join(f'<nd ref="{ref}"/>' for ref in refs)
        lines.append(f'<way id="{way}">{inside}<tag k="{key}" v="{value}"/></way>')
    path = tmp_path / "map.osm"
    path.write_text(f'<osm version="0.6">{"".join(lines)}</osm>')
    return path


def test_buildings_near_the_track_are_polygons(town: Path) -> None:
    graph = read_osm(town, BOUNDS)
    assert graph.buildings.id.tolist() == [20, 21]
    feature, *_ = building_features(graph, np.array([[8.4, 49.0003], [8.402, 49.0003]]))
    assert feature["properties"] == {"osm_id": "20", "osm_type": "way"}
    outline = shapely.geometry.shape(feature["geometry"])
    assert outline.equals(shapely.Polygon(CORNERS))
    assert outline.exterior.is_ccw
    assert building_features(graph, np.array([[8.3, 49.0]])) == []


def test_buildings_are_left_out_where_they_would_take_long(town: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(read_osm(town).buildings) == 0  # not of a whole map
    monkeypatch.setattr(reader, "MAX_NODES_WITH_BUILDINGS", 8)
    assert len(read_osm(town, BOUNDS).buildings) == 0
