"""Branches around a candidate."""

import math

import cv2
import numpy as np
import pytest

from interloc.config import BranchConfig
from interloc.detection.branches import Branches, branches_of, inner_radius, segment_all, trace_pieces
from interloc.detection.candidates import Candidates
from interloc.detection.centerline import Centerline
from tests.images import binary_image

MIDDLE = (150.0, 150.0)
PAPER = BranchConfig()


def arms(*angles_deg: float, length: int = 140) -> Centerline:
    """Draw lines from the middle; a pixel is a metre wherever the tests take it so."""
    image = np.zeros((301, 301), np.uint8)
    for angle in angles_deg:
        end = (round(150 + length * math.cos(math.radians(angle))), round(150 - length * math.sin(math.radians(angle))))
        cv2.line(image, (150, 150), end, 1)
    line = binary_image(image)
    return Centerline.of(line, line)


def candidates(*positions: tuple[float, float], width: float = 20.0) -> Candidates:
    merged = [np.empty((0, 2))] * len(positions)
    return Candidates(np.array(positions), np.full(len(positions), width), merged, are_junctions=False)


def branches_at_the_middle(line: Centerline, config: BranchConfig, *others: tuple[float, float]) -> Branches:
    """Follow the branches of a candidate in the middle; they end before the others."""
    places = candidates(MIDDLE, *others)
    return branches_of(trace_pieces(places, 0, line, config), places, 0, line, config)


def angles_deg(branches: Branches) -> list[float]:
    angles = np.degrees(np.arctan2(-branches.lines["direction"][:, 0], branches.lines["direction"][:, 1])) % 360
    return sorted(angles.tolist())


# --- the inner circle ------------------------------------------------------------------------------------------------


def radius_m(config: BranchConfig, *others: tuple[float, float], width: float) -> float:
    """Return the inner circle of a candidate in the middle, with pixels of half a metre."""
    return inner_radius(candidates(MIDDLE, *others, width=width), 0, 0.5, config) * 0.5


def test_fixed_inner_circle_does_not_look_at_the_road() -> None:
    assert radius_m(BranchConfig(inner_radius_m=10), (150, 151), width=99) == 10


def test_inner_circle_follows_the_width_of_the_road() -> None:
    config = BranchConfig(inner_radius_m=15, inner_widths=1.5)
    assert radius_m(config, width=18) == 13.5
    assert radius_m(config, width=8) == 6
    assert radius_m(config, width=80) == 15  # a_i is its bound


def test_inner_circle_leaves_room_before_the_next_candidate() -> None:
    config = BranchConfig(inner_radius_m=15, inner_widths=1.0)
    assert radius_m(config, (150, 160), (190, 150), width=20) == pytest.approx(3)


# --- which pieces are branches ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("line", ["start_and_mean", "least_squares"])
def test_every_arm_is_a_branch_that_points_along_it(line: str) -> None:
    axes = arms(10, 100, 230)
    roads = Centerline.of(axes.image, binary_image(cv2.dilate(axes.image.to_array(), np.ones((9, 9), np.uint8))))
    found = branches_at_the_middle(roads, BranchConfig(line=line))
    np.testing.assert_allclose(angles_deg(found), [10, 100, 230], atol=1.5)
    assert found.count == 3
    assert found.inner == 10
    np.testing.assert_allclose(found.lengths, 30, atol=9)  # from circle to circle; diagonal steps are fewer


def test_lines_pass_through_start_and_mean() -> None:
    found = branches_at_the_middle(arms(0, 90), PAPER)
    assert sorted(found.lines["point"].tolist()) == [[139, 150], [150, 161]]  # the first pixels outside of the circle


def test_arm_that_ends_soon_is_no_branch() -> None:
    line = arms(0, 120, length=140)
    image = line.image.to_array()
    image[150:163, 150] = 1  # 12 pixels downwards
    short = Centerline.of(binary_image(image), line.occupancy)
    assert branches_at_the_middle(short, BranchConfig(min_reach_m=14)).count == 2
    assert branches_at_the_middle(short, BranchConfig(min_reach_m=12)).count == 3


def test_short_arm_must_be_wide_unless_few_scans_saw_it() -> None:
    image = arms(0, 120).image.to_array()
    image[150:171, 150] = 1  # 20 pixels downwards, ten of them outside of the inner circle
    line = binary_image(image)
    narrow = Centerline.of(line, line)
    wide = Centerline.of(line, binary_image(cv2.dilate(image, np.ones((5, 5), np.uint8))))
    config = BranchConfig(min_surface_m2=40)
    assert branches_at_the_middle(narrow, config).count == 2
    assert branches_at_the_middle(wide, config).count == 3
    few = trace_pieces(candidates(MIDDLE), 0, narrow, config, 0.25)
    assert np.count_nonzero(few.is_branch) == 3
    assert branches_at_the_middle(narrow, config, (170.0, 150.0)).count == 3  # it leads to another


def test_arm_that_ends_at_another_candidate_is_a_branch_however_short() -> None:
    found = branches_at_the_middle(arms(0, 120, 240), PAPER, (150.0, 163.0))
    assert found.count == 3
    assert found.lengths.min() <= 2


def test_candidate_that_is_no_intersection_ends_branches_too() -> None:
    (found,) = segment_all(candidates(MIDDLE, (150.0, 175.0)), arms(0, 120, 240), BranchConfig()).branches
    assert found.index == 0
    assert found.lengths.min() <= 20


def test_every_candidate_keeps_the_pieces_that_it_was_judged_by() -> None:
    line = arms(0, 120, 240)
    found = segment_all(candidates(MIDDLE, (150.0, 163.0)), line, BranchConfig(min_branches=2))
    assert len(found.branches) == 2
    for branches, pieces in zip(found.branches, found.pieces, strict=True):
        taken = [piece for piece in pieces if piece.is_branch]
        assert [len(piece.pixels) for piece in taken] == branches.lengths.tolist()
        assert [piece.reach for piece in taken] == branches.reaches.tolist()
        place = np.column_stack([line.rows, line.cols]) - branches.candidate
        for piece in pieces:
            assert np.hypot(*place[piece.pixels].T).max() == piece.reach
            assert np.hypot(*place[piece.pixels].T).min() > branches.inner


def test_two_arms_that_leave_the_circle_as_one_are_one() -> None:
    image = np.zeros((301, 301), np.uint8)
    for end in (150, 150), (290, 90), (290, 210):
        cv2.line(image, (170, 150), end, 1)
    line = binary_image(image)
    assert branches_at_the_middle(Centerline.of(line, line), PAPER).count == 1


def test_line_through_the_circle_that_misses_the_middle_is_two_branches() -> None:
    image = np.zeros((301, 301), np.uint8)
    image[145, :] = 1
    line = binary_image(image)
    found = branches_at_the_middle(Centerline.of(line, line), PAPER)
    np.testing.assert_allclose(angles_deg(found), [0, 180], atol=1e-9)


def test_branch_without_a_line_leads_from_the_candidate_through_its_mean() -> None:
    config = BranchConfig(line="least_squares", stop_m=2)
    line, place = arms(0, 120, 240), candidates(MIDDLE, (150.0, 162.0))
    pieces = trace_pieces(place, 0, line, config)
    found = branches_of(pieces, place, 0, line, config)
    assert np.count_nonzero(found.has_line) == 2
    bare = ~found.has_line
    for struck, piece in zip(found.lines[bare], pieces.table[pieces.is_branch][bare], strict=True):
        assert struck["point"].tolist() == piece["mean"].tolist()
        away = piece["mean"] - found.candidate
        np.testing.assert_allclose(struck["direction"], away / np.hypot(*away))


def test_paper_weighs_all_lines_alike() -> None:
    found = branches_at_the_middle(arms(0, 120, 240), PAPER, (150.0, 175.0))
    assert found.lines["weight"].tolist() == [1, 1, 1]


def test_no_line_no_branches() -> None:
    assert branches_at_the_middle(arms(), PAPER).lines["direction"].shape == (0, 2)
