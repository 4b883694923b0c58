"""GeoJSON as RFC 7946 has it, at the antimeridian too."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.errors import DamagedResultError
from interloc.output.geojson import box_around, cut, joined, positions, write_collection
from interloc.output.layers import LAYERS, map_credit


def line(*coordinates: list[float]) -> dict[str, Any]:
    return {"type": "LineString", "coordinates": list(coordinates)}


@pytest.mark.parametrize(
    ("whole", "parts"),
    [
        ([[179.9, 0], [-179.9, 1]], [[[179.9, 0], [180, 0.5]], [[-180, 0.5], [-179.9, 1]]]),
        ([[-179.9, 0], [179.7, 4]], [[[-179.9, 0], [-180, 1]], [[180, 1], [179.7, 4]]]),
        (  # there and back: in the order of travel
            [[179.9, 0], [-179.9, 1], [179.9, 2]],
            [[[179.9, 0], [180, 0.5]], [[-180, 0.5], [-179.9, 1], [-180, 1.5]], [[180, 1.5], [179.9, 2]]],
        ),
    ],
)
def test_a_line_is_cut_and_joined_again(whole: list[list[float]], parts: list[list[list[float]]]) -> None:
    made = cut(line(*whole))
    assert made == {"type": "MultiLineString", "coordinates": parts}
    assert joined(made) == line(*whole)
    assert box_around([made])[0] > 179 > -179 > box_around([made])[2]  # type: ignore[index]  # RFC 7946, 5.2


def test_a_polygon_is_cut_and_joined_again() -> None:
    ring = [[179, -1], [-179, -1], [-179, 1], [179, 1], [179, -1]]
    hole = [[-179.8, 0], [179.8, 0.5], [179.8, -0.5], [-179.8, 0]]
    made = cut({"type": "Polygon", "coordinates": [ring, hole]})
    assert made["type"] == "MultiPolygon"
    west, east = (np.array(rings[0]) for rings in made["coordinates"])  # the hole reaches the cut: a notch
    assert (west.min(axis=0).tolist(), west.max(axis=0).tolist()) == ([179, -1], [180, 1])
    assert (east.min(axis=0).tolist(), east.max(axis=0).tolist()) == ([-180, -1], [-179, 1])
    whole = joined(cut({"type": "Polygon", "coordinates": [ring]}))
    assert {tuple(each) for each in map(tuple, ring)} <= {tuple(each) for each in whole["coordinates"][0]}
    assert cut(whole) == cut({"type": "Polygon", "coordinates": [ring]})


@pytest.mark.parametrize(
    "geometry",
    [
        None,
        {"type": "Point", "coordinates": [180.0, 0.0]},
        line([179.9, 0.0], [180.0, 0.0]),
        line([-80.0, 0.0], [90.0, 0.0]),
        {"type": "Polygon", "coordinates": [[[8.0, 49.0], [8.1, 49.0], [8.1, 49.1], [8.0, 49.0]]]},
    ],
)
def test_everything_else_stays_as_it_is(geometry: dict[str, Any] | None) -> None:
    assert cut(geometry) is geometry
    assert joined(geometry) is geometry


def test_a_vertex_on_the_antimeridian_is_kept_a_centimetre_beside_it() -> None:
    made = cut(line([179.9, 0.0], [-180.0, 0.0], [-179.9, 0.0]))
    assert joined(made) == line([179.9, 0.0], [179.9999999, 0.0], [-179.9, 0.0])


def test_positions_beyond_it_are_named_from_the_other_side() -> None:
    assert positions(np.array([[180.0001, 1.0], [-180.5, 2.0], [180.0, 0.0]]), local=False) == [
        [-179.9999, 1.0], [179.5, 2.0], [180.0, 0.0]
    ]  # fmt: skip
    assert positions(np.array([[180.0001, 1.0]]), local=True) == [[180.0001, 1.0]]


def test_a_file_has_parts_and_its_layer_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.geojson"
    made = LAYERS["trajectory"].features([[[179.9, 0], [-179.9, 1]]], scans=[2])
    write_collection(path, made, local=False)
    content = json.loads(path.read_text())
    assert content["bbox"] == [179.9, 0, -179.9, 1]
    assert content["features"][0]["geometry"]["type"] == "MultiLineString"
    (feature,) = LAYERS["trajectory"].read(path).features
    assert feature.geometry.coordinates == [(179.9, 0), (-179.9, 1)]
    path.write_text(path.read_text().replace("[[[", "[["))
    with pytest.raises(DamagedResultError, match="damaged"):
        LAYERS["trajectory"].read(path)


@pytest.mark.parametrize("local", [False, True])
def test_the_head_says_whose_data_it_is_and_what_the_numbers_are(tmp_path: Path, local: bool) -> None:
    write_collection(tmp_path / "a", [], local=local, credit=map_credit(is_made_up=False))
    head = json.loads((tmp_path / "a").read_text())
    assert "OpenStreetMap" in head["attribution"]
    assert "odbl" in head["license"]
    assert (head.get("local"), "units" in head) == (True if local else None, local)
