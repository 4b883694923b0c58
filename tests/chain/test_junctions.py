"""One intersection, seen by a LiDAR without noise, from the scans to the map."""

from pathlib import Path

import pytest

from interloc.drives.open import open_drive
from interloc.pipeline import detect
from tests.chain.conftest import from_origin, junction_drive

BRANCHES = {"X": 4, "T": 3, "Y": 3}
BOUND_M = 0.3
CASES = [  # every two of shape, angle and route meet
    (shape, angle_deg, ("straight", "turning")[(i + j) % 2])
    for i, shape in enumerate(BRANCHES)
    for j, angle_deg in enumerate((45, 60, 90, 120))
]


@pytest.mark.parametrize(("shape", "angle_deg", "route"), CASES)
def test_there_is_one_intersection_with_all_its_arms_where_the_streets_meet(
    tmp_path: Path, shape: str, angle_deg: float, route: str
) -> None:
    drive = open_drive(junction_drive(tmp_path / "drive", shape, angle_deg, route), check=False)
    found = detect(drive).intersections
    assert [len(bearings) for bearings in found.bearings_deg] == [BRANCHES[shape]]
    assert found.lonlat is not None
    assert from_origin(found.lonlat).max() <= BOUND_M
