"""The folder of a map of many drives."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from interloc.city.citymap import merge
from interloc.city.drives import Pass
from interloc.city.folder import CITY_FILE, city_features, read_city, write_city
from interloc.errors import DamagedResultError, OutputError
from interloc.mapping.mosaic import Mosaic, Raster
from tests.city.towns import drive, town

NODES = town(np.random.default_rng(1), 12)


def test_a_map_goes_on_where_it_was_written(tmp_path: Path) -> None:
    drives = [drive(NODES, name, seen=0.9) for name in "abc"]
    city = merge(drives[:2])
    write_city(city, tmp_path / "city")
    again = read_city(tmp_path / "city")
    assert city_features(again) == city_features(city)
    for each in (city, again):
        each.add(drives[2])
    assert again.places.uid == city.places.uid
    assert_array_equal(again.places.xy, city.places.xy)
    write_city(again, tmp_path / "city")
    assert city_features(read_city(tmp_path / "city")) == city_features(city)
    assert len(list((tmp_path / "city" / "passes").iterdir())) == 3
    record = json.loads((tmp_path / "city" / CITY_FILE).read_text())
    assert (record["intersections"], record["seen_by_several"], len(record["drives"])) == (12, 12, 3)


def test_a_drive_comes_back_under_another_name_or_changed(tmp_path: Path) -> None:
    write_city(merge([drive(NODES, name, seen=0.9) for name in "ab"]), tmp_path / "city")
    city = read_city(tmp_path / "city")
    city.remove("a")
    city.replace(replace(drive(NODES, "a", seen=0.9), name="z"), replace(city.drives["b"].data, span_s=np.ones(2)))
    write_city(city, tmp_path / "city")
    again = read_city(str(tmp_path / "city"))
    assert list(again.drives) == ["b", "z"]
    assert again.drives["b"].data.span_s.tolist() == [1, 1]
    again.remove("z")


def test_the_ground_is_kept(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    road, other = Raster(0.5), Raster(0.5)
    for raster in (road, other):
        raster.add(-100, 300, rng.integers(0, 3, (700, 700)).astype(np.uint8))  # 16 tiles
    own = replace(drive(NODES, "a"), road=Mosaic(road, 32632, other))
    own.write(tmp_path / "a.npz")
    found = Pass.read(tmp_path / "a.npz").road
    assert (found.epsg, found.raster.cell_m) == (32632, 0.5)
    for raster, kept in ((road, found.raster), (other, found.other)):
        assert kept.tiles.keys() == raster.tiles.keys()
        assert all(np.array_equal(kept.tiles[key], cells) for key, cells in raster.tiles.items())


def test_what_is_no_map_or_damaged_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is not a map of many drives"):
        read_city(tmp_path)
    write_city(merge([drive(NODES, "a")]), tmp_path / "city")
    (tmp_path / "city" / "state.npz").write_bytes(b"PK")
    with pytest.raises(DamagedResultError, match="Merge its drives again"):
        read_city(tmp_path / "city")
