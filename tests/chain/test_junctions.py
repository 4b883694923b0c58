"""One intersection, seen by a LiDAR without noise, from the scans to the map."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from interloc.arrays import FloatArray
from interloc.drives.open import open_drive
from interloc.pipeline import detect
from interloc.results import DriveResult

Find = Callable[[str, str, float], DriveResult]

BRANCHES = {"X": 4, "T": 3, "Y": 3}
BOUND_M = 0.3

NOT_YET = {("Y", "straight", 45)}
"""Far out on an arm that is only seen in passing one edge is seen better than the other, so that its line leans by a
degree; where arms meet at a sharp angle that moves the intersection along their bisector by half a metre."""


@pytest.fixture(scope="module")
def find(junction_drive: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Find:
    """Drive through a world with one intersection, and find it; each world once."""

    @cache
    def found(shape: str, route: str, angle_deg: float) -> DriveResult:
        out = tmp_path_factory.mktemp(f"{shape}{angle_deg}") / "drive"
        return detect(open_drive(junction_drive(out, shape, angle_deg, route)))

    return found


@pytest.mark.parametrize("angle_deg", [45, 60, 90, 120])
@pytest.mark.parametrize("route", ["straight", "turning"])
@pytest.mark.parametrize("shape", ["X", "T", "Y"])
def test_there_is_one_intersection_with_all_its_arms(find: Find, shape: str, route: str, angle_deg: float) -> None:
    found = find(shape, route, angle_deg).intersections
    assert [len(bearings) for bearings in found.bearings_deg] == [BRANCHES[shape]]


@pytest.mark.parametrize("angle_deg", [45, 60, 90, 120])
@pytest.mark.parametrize("route", ["straight", "turning"])
@pytest.mark.parametrize("shape", ["X", "T", "Y"])
def test_it_is_where_the_streets_meet(
    find: Find,
    from_origin: Callable[[FloatArray], FloatArray],
    request: pytest.FixtureRequest,
    shape: str,
    route: str,
    angle_deg: float,
) -> None:
    if (shape, route, angle_deg) in NOT_YET:
        reason = "the line of an arm that is seen in passing leans towards its ragged end"
        request.applymarker(pytest.mark.xfail(strict=True, reason=reason))
    found = find(shape, route, angle_deg).intersections
    assert found.lonlat is not None
    assert from_origin(found.lonlat).max() <= BOUND_M
