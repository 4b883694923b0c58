"""The whole method on ideal roads, and scan by scan."""

import itertools
import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from interloc.arrays import Float32Array, FloatArray
from interloc.config import DEFAULT, PAPER, DetectorConfig
from interloc.detection.detector import Detector, KeyframeDetections
from interloc.detection.scan import Scan
from interloc.errors import ConfigError, DriveError
from tests.small_drives import level_poses

Polyline = tuple[tuple[float, float], ...]

O = (0.0, 0.0)


def draw_roads(*roads: Polyline, width_m: float, turned_deg: float = 0.0, extent_m: float = 62.0) -> Float32Array:
    """Return one point a 16 cm cell on all that lies within half a width of one of the polylines, (N, 3).

    The whole is turned counter-clockwise about the origin. It covers the window around a vehicle at the origin.
    """
    resolution_m = 0.16
    half = int(extent_m / resolution_m)
    centres = (np.arange(-half, half) + 0.5) * resolution_m
    c, s = np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))
    is_road = np.zeros((2 * half, 2 * half), np.bool_)
    for road in roads:
        ends = np.array(road, np.float64) @ np.array([[c, s], [-s, c]])
        for a, b in pairwise(ends):
            left, low = np.searchsorted(centres, np.minimum(a, b) - width_m)
            right, high = np.searchsorted(centres, np.maximum(a, b) + width_m)
            x, y = centres[None, left:right], centres[low:high, None]
            (ax, ay), (dx, dy) = a, b - a
            along = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0, 1)
            is_near = (x - ax - along * dx) ** 2 + (y - ay - along * dy) ** 2 <= width_m**2 / 4
            is_road[low:high, left:right] |= is_near
    rows, cols = np.nonzero(is_road)
    return np.column_stack([centres[cols], centres[rows], np.full(rows.size, -1.73)]).astype(np.float32)


def detect(points: Float32Array, config: DetectorConfig = DEFAULT, number: int = 0) -> KeyframeDetections:
    """Push one scan taken at the origin of W; one point makes a cell road, the image of keyframe 0 is not turned."""
    found = Detector(causal(config), first=number).push(Scan(0, np.eye(4), points))
    assert found is not None
    return found


def arm(angle_deg: float, length_m: float = 90.0) -> tuple[float, float]:
    return (length_m * math.cos(math.radians(angle_deg)), length_m * math.sin(math.radians(angle_deg)))


def x_shape(angle_deg: float) -> list[Polyline]:
    return [(arm(0), arm(180)), (arm(angle_deg), arm(angle_deg + 180))]


def t_shape(angle_deg: float) -> list[Polyline]:
    return [(arm(0), arm(180)), (O, arm(angle_deg))]


def y_shape(angle_deg: float) -> list[Polyline]:
    """A road that forks into two with this angle between them."""
    return [(O, arm(180)), (O, arm(angle_deg / 2)), (O, arm(-angle_deg / 2))]


SHAPES = {"X": (x_shape, 4), "T": (t_shape, 3), "Y": (y_shape, 3)}


# --- junctions on ideal roads ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle_deg", [45, 60, 90, 120])
@pytest.mark.parametrize("shape", SHAPES)
def test_roads_meet_at_one_point(shape: str, angle_deg: int) -> None:
    roads_of, branch_count = SHAPES[shape]
    wrong = {}
    for width_m in (6, 9, 12):
        for turned_deg in (0, 17, 45, 80):
            found = detect(draw_roads(*roads_of(angle_deg), width_m=width_m, turned_deg=turned_deg))
            errors_m = np.hypot(*found.world_xy.T).round(2).tolist()
            counts = [len(angles) for angles in found.branch_angles_rad]
            if counts != [branch_count] or errors_m[0] >= (0.4 if shape == "Y" else 0.3):  # surfaces of arms bend
                wrong[width_m, turned_deg] = errors_m
    assert wrong == {}


@pytest.mark.parametrize("widths_m", [(14, 5), (10, 6)])
@pytest.mark.parametrize("angle_deg", [60, 90])
def test_narrow_road_meets_wide_one_on_its_axis(widths_m: tuple[float, float], angle_deg: float) -> None:
    main = draw_roads((arm(10), arm(190)), width_m=widths_m[0])
    side = draw_roads((O, arm(10 + angle_deg)), width_m=widths_m[1])
    found = detect(np.unique(np.concatenate([main, side]), axis=0))
    assert len(found.world_xy) == 1
    assert math.hypot(*found.world_xy[0]) < 0.3
    by_angle = np.argsort((np.degrees(found.branch_angles_rad[0]) - 5) % 360)  # main, side, main
    expected = [widths_m[0], widths_m[1], widths_m[0]]
    assert found.branch_widths_m[0][by_angle] == pytest.approx(expected, abs=0.5)


@pytest.mark.parametrize("bend_m", [25, 35, 40, 45])
def test_bends_beyond_the_junction_do_not_move_it(bend_m: float) -> None:
    west, east, north = (-bend_m, 0.0), (bend_m, 0.0), (0.0, bend_m)
    roads = [(O, west, (-90.0, 40.0)), (O, east, (90.0, -30.0)), (O, north, (40.0, 90.0))]
    errors_m = []
    for turned_deg in (0, 20, 45, 70):
        found = detect(draw_roads(*roads, width_m=8, turned_deg=turned_deg))
        assert len(found.world_xy) == 1
        errors_m.append(math.hypot(*found.world_xy[0]))
    assert max(errors_m) < 0.3


def bend(radius_m: float, from_deg: float, to_deg: float) -> Polyline:
    """Return an arc through the origin, at 180 degrees, around a centre east of it."""
    angles = np.radians(np.linspace(from_deg, to_deg, 65))
    x, y = radius_m * (1 + np.cos(angles)), radius_m * np.sin(angles)
    return tuple(zip(x.tolist(), y.tolist(), strict=True))


@pytest.mark.parametrize("width_m", [5, 7])
def test_arms_of_a_roundabout_meet_its_ring(width_m: float) -> None:
    centre = np.array([16.0, 0.0])
    ring = bend(16, 0, 360)
    nodes = [centre + arm(angle_deg, 16) for angle_deg in (0, 90, 180, 270)]
    arms = [(tuple(node), tuple(centre + 6 * (node - centre))) for node in nodes]
    found = detect(draw_roads(ring, *arms, width_m=width_m))
    off_m = np.hypot(*(found.world_xy[:, None] - np.array(nodes)).transpose(2, 0, 1))
    assert sorted(off_m.argmin(axis=1)) == [0, 1, 2, 3]
    assert off_m.min(axis=1).max() < 1.2


@pytest.mark.parametrize("radius_m", [20, 30])
@pytest.mark.parametrize("side_deg", [180, 0])
def test_side_road_of_a_bend_meets_the_bend(radius_m: float, side_deg: float) -> None:
    found = detect(draw_roads(bend(radius_m, 100, 260), (O, arm(side_deg)), width_m=7))
    assert np.hypot(*found.world_xy.T).min() < 0.6


def test_axis_ends_where_a_branch_with_ragged_edges_begins() -> None:
    smooth = draw_roads((O, arm(120)), (O, arm(0)), (O, arm(-60, 5)), width_m=8)
    places = [arm(-60, along_m) for along_m in range(5, 42, 6)]
    widths_m = itertools.cycle((6.6, 8.0, 9.4))
    pieces = zip(itertools.pairwise(places), widths_m, strict=False)
    ragged = [draw_roads(piece, width_m=width_m) for piece, width_m in pieces]
    found = detect(np.concatenate([smooth, *ragged]))
    assert np.hypot(*found.world_xy.T) == pytest.approx([0], abs=0.3)


def test_staggered_side_roads_are_two_junctions() -> None:
    for gap_m in (9, 12, 16, 25):
        half = gap_m / 2
        roads = [((-90.0, 0.0), (90.0, 0.0)), ((-half, 0.0), (-half, 90.0)), ((half, 0.0), (half, -90.0))]
        for turned_deg in (0, 20, 45):
            found = detect(draw_roads(*roads, width_m=7, turned_deg=turned_deg))
            along = np.array([math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))])
            assert len(found.world_xy) == 2
            for place in (-half * along, half * along):
                assert np.hypot(*(found.world_xy - place).T).min() < 0.5


@pytest.mark.parametrize("turned_deg", [0, 30, 77])
@pytest.mark.parametrize(
    "roads",
    [
        [(arm(0), arm(180))],
        [(arm(0), O)],
        [(arm(0), O, arm(90))],
        [(arm(0), O, arm(135))],
        [tuple((60 * math.cos(a) - 60, 60 * math.sin(a)) for a in np.linspace(-1.5, 1.5, 40))],
        [(arm(0), arm(180)), ((-90.0, 20.0), (90.0, 20.0))],
    ],
    ids=["straight", "dead end", "corner", "bend", "curve", "two roads side by side"],
)
def test_where_no_three_roads_meet_there_is_no_intersection(roads: list[Polyline], turned_deg: float) -> None:
    assert len(detect(draw_roads(*roads, width_m=9, turned_deg=turned_deg)).world_xy) == 0


@pytest.mark.parametrize("config", [DEFAULT, PAPER], ids=["default", "paper"])
def test_scan_without_road_has_no_intersections(config: DetectorConfig) -> None:
    found = detect(np.empty((0, 3), np.float32), config)
    assert found.world_xy.shape == found.lidar_xy.shape == (0, 2)
    assert found.branch_angles_rad == []
    assert found.score.shape == (0,)


@pytest.mark.parametrize("config", [DEFAULT, PAPER], ids=["default", "paper"])
def test_road_everywhere_is_no_intersection(config: DetectorConfig) -> None:
    found = detect(draw_roads((arm(0), arm(180)), width_m=300), config)
    assert len(found.world_xy) == 0


@pytest.mark.parametrize("shape", SHAPES)
def test_paper_finds_right_angled_junctions(shape: str) -> None:
    roads_of, branch_count = SHAPES[shape]
    found = detect(draw_roads(*roads_of(90), width_m=8, turned_deg=17), PAPER)
    assert len(found.world_xy) == 1
    assert math.hypot(*found.world_xy[0]) < 0.3
    assert len(found.branch_angles_rad[0]) == branch_count


# --- what is told about each -----------------------------------------------------------------------------------------


def test_branches_point_along_the_roads() -> None:
    found = detect(draw_roads(*t_shape(70), width_m=8, turned_deg=20))
    angles = np.sort(np.degrees(found.branch_angles_rad[0]) % 360)
    np.testing.assert_allclose(angles, [20, 90, 200], atol=1.0)


@pytest.mark.parametrize("number", range(1, 8))
def test_images_of_other_keyframes_are_turned_and_tell_the_same(number: int) -> None:
    points = draw_roads(*[[(x + 4.0, y - 7.0) for x, y in road] for road in t_shape(70)], width_m=8)
    plain, turned = detect(points), detect(points, number=number)
    assert turned.world_xy.tobytes() != plain.world_xy.tobytes()
    np.testing.assert_allclose(turned.world_xy, [[4.0, -7.0]], atol=0.25)
    mine, theirs = (np.sort((each.branch_angles_rad[0] + 1.0) % (2.0 * np.pi)) for each in (turned, plain))
    np.testing.assert_allclose(mine, theirs, atol=math.radians(1.0))
    np.testing.assert_allclose(np.sort(turned.branch_widths_m[0]), np.sort(plain.branch_widths_m[0]), atol=0.5)
    assert detect(points, PAPER, number).world_xy.tobytes() == detect(points, PAPER).world_xy.tobytes()


def test_position_is_told_in_the_frame_of_the_vehicle_too() -> None:
    road = draw_roads(*x_shape(90), width_m=8)
    T = level_poses(12.0, -5.0, math.radians(30))
    points = ((road - T[:3, 3]) @ T[:3, :3]).astype(np.float32)
    found = Detector(causal(DEFAULT)).push(Scan(7, T, points, 0.7))
    assert (found.keyframe.frame, found.keyframe.time_s) == (7, 0.7)
    assert math.hypot(*found.world_xy[0]) < 0.3
    np.testing.assert_allclose(T[:2, :2] @ found.lidar_xy[0] + T[:2, 3], found.world_xy[0], atol=1e-9)


def test_score_lies_between_0_and_1_and_is_high_for_an_ideal_junction() -> None:
    (score,) = detect(draw_roads(*x_shape(90), width_m=8)).score
    assert 0.9 < score <= 1


# --- scan by scan ----------------------------------------------------------------------------------------------------


def causal(config: DetectorConfig) -> DetectorConfig:
    return config.model_copy(
        update={
            "keyframes": config.keyframes.model_copy(update={"lookahead": 0}),
            "bev": config.bev.model_copy(update={"min_points": 1}),
        }
    )


def quick(lookahead: int | None) -> DetectorConfig:
    """Return settings for the small scans of `drive_along`."""
    values = DEFAULT.model_dump()
    values["bev"] |= {"resolution_m": 0.4, "min_points": 1}
    values["keyframes"] |= {"window": 5, "lookahead": lookahead}
    return DetectorConfig.model_validate(values)


@pytest.fixture(scope="module")
def drive() -> list[Scan]:
    """40 scans, 1 m apart, past a junction 20 m ahead; each sees 30 m."""
    world = draw_roads((arm(0), arm(180)), ((20.0, 0.0), (20.0, 90.0)), width_m=8)[::5]
    scans = []
    for frame, T in enumerate(level_poses(np.arange(40))):
        local = world - T[:3, 3].astype(np.float32)
        scans.append(Scan(frame, T, local[np.hypot(local[:, 0], local[:, 1]) < 30]))
    return scans


def key(found: KeyframeDetections) -> tuple[int, bytes, bytes, bytes, bytes]:
    """Return all that was found, bit by bit."""
    angles = b"|".join(a.tobytes() for a in found.branch_angles_rad)
    return found.keyframe.frame, found.world_xy.tobytes(), found.lidar_xy.tobytes(), angles, found.score.tobytes()


@pytest.mark.parametrize(("lookahead", "behind"), [(0, 0), (3, 3), (None, 5)])
def test_detections_come_back_after_the_lookahead(drive: list[Scan], lookahead: int | None, behind: int) -> None:
    detector = Detector(quick(lookahead))
    keyframes: list[int] = []
    for scan in drive:
        found = detector.push(scan)
        if scan.frame % 3 == 0:  # more than 2 m since the last one
            keyframes.append(scan.frame)
            assert (None if found is None else found.keyframe.frame) == (
                keyframes[-1 - behind] if len(keyframes) > behind else None
            )
        else:
            assert found is None
    rest = [found.keyframe.frame for found in detector.finish()]
    assert rest == keyframes[len(keyframes) - behind :]
    assert list(detector.finish()) == []


def test_junction_ahead_is_found_from_every_keyframe_near_it(drive: list[Scan]) -> None:
    detector = Detector(quick(None))
    found = [f for scan in drive if (f := detector.push(scan)) is not None] + list(detector.finish())
    for detections in found:
        if detections.keyframe.frame >= 6:
            assert len(detections.world_xy) == 1
            assert math.dist(detections.world_xy[0], (20, 0)) < 0.5


def test_points_are_asked_of_keyframes_only(drive: list[Scan]) -> None:
    class Guarded:
        def __init__(self, scan: Scan) -> None:
            self.frame, self.T_world_lidar, self.time_s, self._points = scan.frame, scan.T_world_lidar, None, scan
            self.other_points = None
            self.asked = 0

        @property
        def road_points(self) -> Float32Array:
            self.asked += 1
            return self._points.road_points

    guarded = [Guarded(scan) for scan in drive]
    detector = Detector(quick(0))
    for scan in guarded:
        detector.push(scan)
    assert [scan.asked for scan in guarded] == [int(frame % 3 == 0) for frame in range(40)]


def test_every_step_is_timed(drive: list[Scan]) -> None:
    detector = Detector(quick(0))
    detector.push(drive[0])
    stages = ["read", "accumulate", "bev", "occupancy", "centerline", "candidates", "refinement"]
    assert list(detector.stopwatch.seconds) == stages
    assert all(seconds >= 0 for seconds in detector.stopwatch.seconds.values())


def test_windows_stay_what_they_are_while_the_drive_goes_on(drive: list[Scan]) -> None:
    config = quick(3)
    online = Detector(config)
    pushed = [key(f) for scan in drive if (f := online.push(scan)) is not None] + [key(f) for f in online.finish()]
    windows = list(Detector(config).completed(drive))
    assert [key(window.detect()) for window in reversed(windows)] == pushed[::-1]


def test_a_refused_scan_does_not_count_and_the_caller_may_fill_one_array_again(drive: list[Scan]) -> None:
    detector, pose = Detector(DEFAULT), drive[0].T_world_lidar.copy()
    detector.push(replace(drive[0], T_world_lidar=pose))
    pose[:] = drive[4].T_world_lidar
    for points, keyframes in ((drive[4].road_points[:, :2], 1), (drive[4].road_points.tolist(), 2)):
        with pytest.raises(DriveError, match="expected") if keyframes == 1 else nullcontext():
            detector.push(replace(drive[4], T_world_lidar=pose, road_points=points))
        assert detector.keyframes == keyframes


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda T: T[:3], r"has the shape \(3, 4\); expected \(4, 4\)"),
        (lambda T: np.full_like(T, np.nan), "a number that is not finite"),
        (lambda T: T + np.array([[0, 0, 0, np.inf], *3 * [[0.0] * 4]]), "a number that is not finite"),
        (lambda T: T + np.array([[0, 0, 0, 1e13], *3 * [[0.0] * 4]]), "more than 10,000 km from the origin"),
        (np.zeros_like, "is not a rotation"),
        (lambda T: np.vstack([T[:3], np.full(4, 9.0)]), "over a row 0 0 0 1"),
        (lambda T: T @ np.diag([1.0, -1.0, 1.0, 1.0]), "is not a rotation"),
    ],
)
def test_a_scan_with_a_pose_that_is_none_is_refused_and_the_next_is_taken(
    drive: list[Scan], spoil: Callable[[FloatArray], FloatArray], words: str
) -> None:
    undisturbed, detector = Detector(causal(DEFAULT)), Detector(causal(DEFAULT))
    for scan in drive[:9:4]:
        with pytest.raises(DriveError, match=f"scan {scan.frame}: .*{words}"):
            detector.push(replace(scan, T_world_lidar=spoil(scan.T_world_lidar)))
        expected, found = undisturbed.push(scan), detector.push(scan)
        assert expected is not None
        assert found is not None
        assert key(found) == key(expected)


@pytest.mark.parametrize("points", [np.zeros((5, 2), np.float32), np.zeros(0, np.float32)])
def test_points_without_three_columns_are_refused(drive: list[Scan], points: Float32Array) -> None:
    for change in ({"road_points": points}, {"other_points": points}):
        with pytest.raises(DriveError, match=r"its points have the shape .*; expected \(N, 3\)"):
            Detector().push(replace(drive[0], **change))


def test_settings_that_are_none_are_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"expected settings, as interloc\.preset\('paper'\) returns; found str: 'paper'"
    ):
        Detector("paper")  # type: ignore[arg-type]
