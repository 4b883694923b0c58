"""Several intersections in one blob of road."""

from dataclasses import replace

import numpy as np
import pytest

from interloc.detection.branches import Branches
from interloc.detection.compound import LINK_STD_M, join_halves, split_compound
from interloc.detection.lines import LINE
from interloc.detection.refinement import Junction, refine
from tests.images import binary_image

Branch = tuple[tuple[float, float], float]

SEPARATION_M, STRAIGHT_DEG = 7.0, 25.0


def blob(
    *branches: Branch, core: list[tuple[float, float]], inner: float = 15.0, resolution_m: float = 1.0
) -> Branches:
    """Lay a branch through each point (row, column), in the direction of an angle; a pixel is a metre, unless given."""
    points = np.array([point for point, _ in branches])
    angles = np.radians([angle for _, angle in branches])
    directions = np.column_stack([-np.sin(angles), np.cos(angles)])
    count = len(branches)
    lines = np.zeros(count, LINE)
    lines["point"], lines["direction"] = points, directions
    lines["length"], lines["weight"] = np.inf, 1.0
    return Branches(
        index=0,
        candidate=np.zeros(2),
        inner=inner,
        lines=lines,
        lengths=np.full(count, 30.0),
        reaches=np.full(count, 40.0),
        core=np.array(core).reshape(-1, 2),
        resolution_m=resolution_m,
    )


def split(branches: Branches, straight_deg: float = STRAIGHT_DEG) -> list[Branches]:
    return split_compound(branches, SEPARATION_M, straight_deg)


def places(parts: list[Branches]) -> list[list[float]]:
    return sorted(np.round(part.candidate, 6).tolist() for part in parts)


EAST: Branch = ((0.0, 20.0), 0)
WEST: Branch = ((0.0, -20.0), 180)


def north(column: float) -> Branch:
    return ((-20.0, column), 90)


def south(column: float) -> Branch:
    return ((20.0, column), 270)


ONE = {
    "a plain crossing": ([EAST, WEST, north(0), south(0)], [(0, -3), (0, 3)]),
    "three branches without two carriageways": ([EAST, WEST, north(3)], [(0, 3)]),
    "a place without a junction of the centerline": ([EAST, WEST, north(-6), south(6)], [(0, -6)]),
    "corners of Harris": ([EAST, WEST, north(-6), south(6)], []),
    "carriageways nearer than the separation, which end": ([EAST, north(-1), north(1)], []),
    "carriageways that lead on as one road": ([EAST, north(-6), north(6), ((20.0, 12.0), 270)], []),
    "branches of which none continue each other": (
        [((0, 20), 0), ((-15, 10), 60), ((-15, -10), 120), ((10, -15), 210)],
        [(0, -6), (0, 6)],
    ),
}


@pytest.mark.parametrize(("arms", "core"), ONE.values(), ids=ONE.keys())
def test_one_intersection_stays_one(arms: list[Branch], core: list[tuple[float, float]]) -> None:
    whole = blob(*arms, core=core)
    assert split(whole, 20.0) == [whole]


def test_staggered_side_roads_are_two_intersections_on_the_through_road() -> None:
    parts = split(blob(EAST, WEST, north(-6), south(6), core=[(0, -6), (0, 6)]))
    assert places(parts) == [[0, -6], [0, 6]]
    assert [part.count for part in parts] == [3, 3]


@pytest.mark.parametrize(("half_m", "count"), [(3.0, 1), (4.0, 2)])
def test_intersections_nearer_than_the_separation_are_one(half_m: float, count: int) -> None:
    core = [(0.0, -half_m), (0.0, half_m)]
    assert len(split(blob(EAST, WEST, north(-half_m), south(half_m), core=core))) == count


def test_two_carriageways_cross_a_road_twice() -> None:
    crossing = blob(EAST, WEST, north(-6), south(-6), north(6), south(6), core=[(0, -6), (0, 6)])
    parts = split(crossing)
    assert places(parts) == [[0, -6], [0, 6]]
    assert [part.count for part in parts] == [4, 4]


def test_two_carriageways_joined_across_are_two_intersections() -> None:
    joined = blob(north(-6), south(-6), north(6), south(6), core=[(0, -6), (0, 6)])
    parts = split(joined)
    assert places(parts) == [[0, -6], [0, 6]]
    for part in parts:  # both ways along the carriageway, and the road to the other one, known to a metre
        assert part.count == 3
        assert part.lines["weight"].tolist() == [1, 1, LINK_STD_M**-2]
        np.testing.assert_allclose(part.lines["direction"][2], [0, -np.sign(part.candidate[1])], atol=1e-9)


FAR_EAST: Branch = ((-12.0, 20.0), 0)


def test_carriageway_of_which_one_half_is_not_seen_crosses_too() -> None:
    arms = north(3), south(-3)
    seen_from_the_east = blob(EAST, WEST, FAR_EAST, *arms, core=[(0, -3), (-12, 3)])
    far, near = sorted(split(seen_from_the_east), key=lambda part: part.candidate[0])
    assert places([far, near]) == [[-12, 3], [0, -3]]
    assert far.lines["point"].tolist()[:2] == [[-12, 20], [-20, 3]]  # itself, and the arm that meets it first
    assert near.lines["point"].tolist()[:3] == [[0, 20], [0, -20], [20, -3]]
    beside = ((-6.0, 20.0), 0)  # nearer than roads that are told apart
    assert len(split(blob(EAST, WEST, beside, *arms, core=[(0, -3), (-6, 3)]))) == 1


def test_centerline_of_a_wide_blob_says_where_the_link_lies_not_where_on_it_the_roads_meet() -> None:
    core = [(-3.0, 0.0), (-9.0, 0.0)]  # both branch within the blob, off the lines of the carriageways
    bulging = blob(EAST, WEST, FAR_EAST, north(4), south(-4), core=core)
    road = binary_image(np.ones((9, 9), np.uint8))
    rows = {}
    for part in split(bulging):
        assert part.is_part
        row, col = refine(part, prior_weight=4.0, occupancy=road).position
        rows[round(float(part.candidate[0]))] = row
        assert 0 < abs(col) < 4  # between the link and the arm
    assert rows[-3] == pytest.approx(0, abs=0.01)
    assert rows[-9] == pytest.approx(-12, abs=0.01)


def test_dual_carriageway_ends_at_the_road_across_it() -> None:
    # The northern carriageways end at a road that comes from the east and bends away to the south west.
    bend: Branch = ((12.0, -20.0), 215)
    parts = split(blob(EAST, north(-6), north(6), bend, core=[]))
    assert places(parts) == [[0, -6], [0, 6]]
    western, eastern = sorted(parts, key=lambda part: float(part.candidate[1]))
    assert [western.count, eastern.count] == [3, 3]  # the bend leaves at the western one, a short road joins both
    assert western.lines["point"][:, 1].min() == -20
    assert western.is_part
    assert eastern.is_part


def test_three_branches_are_two_intersections_where_a_dual_carriageway_ends() -> None:
    assert places(split(blob(EAST, north(-6), north(6), core=[]))) == [[0, -6], [0, 6]]


def test_distances_are_metres() -> None:
    for resolution_m, count in ((0.5, 1), (1.0, 2)):  # 12 pixels
        crossing = blob(EAST, WEST, north(-6), south(6), core=[(0, -6), (0, 6)], resolution_m=resolution_m)
        assert len(split(crossing)) == count


def test_an_acute_crossing_is_one_though_the_centerline_branches_twice() -> None:
    west = blob(((0.0, 0.0), 0), ((-10.0, -50.0), 160), ((10.0, -50.0), 200), core=[])
    east = blob(((0.0, 0.0), 180), ((-10.0, 50.0), 20), ((10.0, 50.0), 340), core=[])
    one, other = (replace(half, candidate=np.array([0.0, col])) for half, col in ((west, -20.0), (east, 20.0)))
    halves = [Junction(np.array([0.0, -1.0]), 1.0, 0.5, one), Junction(np.array([0.0, 3.0]), 1.0, 0.5, other)]
    (crossing,) = join_halves(halves, SEPARATION_M, STRAIGHT_DEG)
    assert crossing.position == pytest.approx([0.0, 1.0])
    assert crossing.branches.count == 4
    apart = [replace(half, position=half.branches.candidate * 0.8) for half in halves]
    assert len(join_halves(apart, SEPARATION_M, STRAIGHT_DEG)) == 2
