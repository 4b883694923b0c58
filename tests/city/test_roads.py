"""What several drives saw of a road is one road, with the spread of its width."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from interloc.city.citymap import merge
from interloc.city.folder import read_city, write_city
from interloc.city.passes import Pass
from interloc.city.roads import fuse_roads
from interloc.geometry import lonlat_from_enu
from tests.city.towns import ORIGIN, drive


def passed(name: str, bias_m: tuple[float, float], width_m: float, *, is_driven: bool = True) -> Pass:
    """Drive past three intersections in a row, and see the road between the first two, and one to the north."""
    nodes = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
    between, north = np.array([[2.0, 1.0], [50.0, 1.0], [98.0, -1.0]]), np.array([[100.0, 40.0], [100.0, 2.0]])
    lines = tuple(lonlat_from_enu(*ORIGIN, line + bias_m) for line in (between, north))
    seen = drive(nodes, name, bias_m=bias_m, noise_m=0.1)
    wide, driven = np.array([width_m, np.nan]), np.array([is_driven, False])
    return replace(seen, roads_lonlat=lines, road_width_m=wide, road_driven=driven)


def test_roads_of_several_drives_are_fused(tmp_path: Path) -> None:
    city = merge(
        [passed("a", (1.0, 0.0), 6.0), passed("b", (0.0, 1.0), 7.0), passed("c", (0.0, 0.0), 3.0, is_driven=False)]
    )
    write_city(city, tmp_path / "city")
    north, between = sorted(fuse_roads(read_city(tmp_path / "city")), key=lambda road: road.length_m)
    assert (between.drives, between.is_driven, between.end is None) == (("a", "b", "c"), True, False)
    assert (between.width_m, between.width_std_m) == pytest.approx((6.5, np.sqrt(0.5)))  # c did not go along it
    assert between.length_m == pytest.approx(96, abs=0.5)
    assert (north.drives, north.end) == (("a", "b", "c"), None)
    assert np.isnan(north.width_m)
