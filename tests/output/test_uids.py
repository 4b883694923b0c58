from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from interloc.output.write import place_uids
from interloc.results import IntersectionTable, moment
from tests.output.small import small_result


def table(lonlat: Any, *, local: bool = False) -> IntersectionTable:
    places = np.array(lonlat, dtype=np.float64).reshape(-1, 2)
    return replace(small_result().intersections, world_xy=places, lonlat=None if local else places)


def test_a_place_keeps_its_name_within_its_cell() -> None:
    (name,) = place_uids(table([(8.42063, 49.01110)]))
    assert name == "49.01110,8.42063"
    for east, north in ((1, 0), (0, 1), (-1, -1)):  # metres
        assert place_uids(table([(8.42063 + east / 73e3, 49.01110 + north / 111e3)])) == [name]


def test_a_metre_changes_the_name_of_few_places() -> None:
    rng = np.random.default_rng(0)
    places = np.stack([rng.uniform(8.0, 9.0, 4000), rng.uniform(48.0, 50.0, 4000)], axis=-1)
    angle = rng.uniform(0, 2 * np.pi, 4000)
    moved = places + np.stack([np.cos(angle) / 73e3, np.sin(angle) / 111e3], axis=-1)
    pairs = zip(place_uids(table(places)), place_uids(table(moved)), strict=True)
    assert 0.04 < np.mean([a != b for a, b in pairs]) < 0.08


def test_two_of_one_cell_are_numbered_from_west_to_east() -> None:
    east, west = (8.42066, 49.0111), (8.42060, 49.0111)
    assert place_uids(table([east, west])) == ["49.01110,8.42063-2", "49.01110,8.42063"]


@pytest.mark.parametrize("place", [(180.0, 0.0), (-180.0, 89.99999), (179.99999999, -90.0), (0.0, 90.0)])
def test_every_place_on_earth_has_a_name(place: tuple[float, float]) -> None:
    (name,) = place_uids(table([place]))
    lat, lon = (float(part) for part in name.split(","))
    assert abs(lat - place[1]) <= 0.0002
    assert -180.0 <= lon <= 180.0


def test_both_sides_of_the_date_line_have_one_name() -> None:
    assert place_uids(table([(180.0, 10.0)])) == place_uids(table([(-180.0, 10.0)]))


def test_without_georeference_the_cell_is_one_of_w() -> None:
    assert place_uids(table([(12.0, -3.0)], local=True)) == ["x10y-10"]


def test_a_moment_is_a_time_of_the_day_or_none() -> None:
    assert moment(1317386459.1234) == "2011-09-30T12:40:59.123Z"
    assert [moment(each) for each in (0.0, 12345.5, float("nan"), float("inf"), 1e15)] == [None] * 5
