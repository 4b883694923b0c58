"""One point per physical intersection: simulated streams of detections whose truth is known, with hard bounds."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pydantic
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from interloc.arrays import FloatArray, IntArray
from interloc.config import CalibrationConfig, FusionConfig
from interloc.detection.detector import KeyframeDetections
from interloc.detection.keyframes import Keyframe
from interloc.drive import Georeference
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d, rotation_from_rpy
from interloc.mapping.clustering import assign, find_peaks, join_peaks, stand_for_two
from interloc.mapping.fusion import fuse
from interloc.mapping.georeferencing import build_tables
from interloc.results import DetectionTable, IntersectionTable, KeyframeTable
from tests.small_drives import level_poses

ORIGIN = (49.011, 8.42)  # latitude, longitude


def straight(start: tuple[float, float], end: tuple[float, float], step_m: float = 2.0) -> FloatArray:
    """Return keyframe positions from start to end, (K, 2)."""
    count = round(math.dist(start, end) / step_m) + 1
    return np.linspace(start, end, count)


@dataclass
class Stream:
    """A detector that is known to the metre, of intersections at (M, 2) nodes, ENU metres.

    The chance of a detection is `detected` within 20 m and falls to 0 at 50 m; `jitter_m` and `wander_m` are errors of
    single keyframes, and errors that stay for about a window (an AR(1) process per node); `bias_per_m` is how far a
    detection is pulled towards the vehicle, per metre of range beyond 15 m; `false_rate` is that of false detections
    per keyframe, uniform in the region of interest.
    """

    nodes: FloatArray
    detected: float = 0.9
    jitter_m: float = 0.2
    wander_m: float = 0.5
    bias_per_m: float = 0.0
    false_rate: float = 0.0
    seed: int = 0
    branches_deg: Sequence[float] = (0.0, 90.0, 180.0, 270.0)
    passes: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)

    def drive(self, track: FloatArray, *, drift: tuple[float, float] = (0.0, 0.0)) -> Stream:
        """Add a pass along (K, 2) positions; `drift` moves what the poses say, not what the fixes say."""
        self.passes.append((track, np.array(drift)))
        return self

    def tables(self, *, georeferenced: bool = True, gnss_m: float = 0.0) -> tuple[KeyframeTable, DetectionTable]:
        """Run the detector; `gnss_m` is the error of the fixes of a pass."""
        rng = np.random.default_rng(self.seed)
        rows: list[KeyframeDetections] = []
        fixes = []
        for track, drift in self.passes:
            heading = np.arctan2(*np.gradient(track, axis=0).T[::-1])
            offset = rng.normal(0, gnss_m, 2)
            wander = rng.normal(0, self.wander_m, self.nodes.shape)
            previous = track[0]
            for place, yaw in zip(track, heading, strict=True):
                keep = math.exp(-math.dist(place, previous) / 40.0)
                wander = keep * wander + math.sqrt(1 - keep**2) * rng.normal(0, self.wander_m, self.nodes.shape)
                previous = place
                seen = self._look(rng, place, wander)
                lidar = rotate_2d(seen - place, -yaw)
                angles = [np.radians(90.0 - np.array(self.branches_deg)) + rng.normal(0, 0.08) for _ in seen]
                rows.append(
                    KeyframeDetections(
                        Keyframe(3 * len(rows), level_poses(*(place + drift), yaw), 0.1 * len(rows)),
                        lidar_xy=lidar,
                        world_xy=seen + drift,
                        branch_angles_rad=angles,
                        score=rng.uniform(0.5, 1.0, len(seen)),
                        branch_widths_m=[np.full(len(each), np.nan) for each in angles],
                        std_m=1.0 + np.hypot(*lidar.T) / 25.0,
                    )
                )
                fixes.append((place + offset, yaw))
        if not georeferenced:
            return build_tables(rows, np.arange(len(rows)), None)
        places = lonlat_from_enu(*ORIGIN, np.array([p for p, _ in fixes]))
        yaws = np.array([y for _, y in fixes])
        rotations = rotation_from_rpy(np.zeros(len(yaws)), np.zeros(len(yaws)), yaws)
        fix = Georeference(places[:, 1], places[:, 0], np.zeros(len(yaws)), rotations, "simulated")
        return build_tables(rows, np.arange(len(rows)), fix)

    def _look(self, rng: np.random.Generator, place: FloatArray, wander: FloatArray) -> FloatArray:
        seen = []
        for node, error in zip(self.nodes, wander, strict=True):
            distance = math.dist(node, place)
            if rng.random() < self.detected * min(1.0, max(0.0, (50 - distance) / 30)):
                pull = self.bias_per_m * max(0.0, distance - 15) * (place - node) / max(distance, 1)
                seen.append(node + error * (1 + distance / 25) + pull + rng.normal(0, self.jitter_m, 2))
        seen += [place + rng.uniform(-55, 55, 2) for _ in range(rng.poisson(self.false_rate))]
        return np.array(seen).reshape(-1, 2)


def places(intersections: IntersectionTable) -> FloatArray:
    """Where the map puts them: ENU metres, or W."""
    if intersections.lonlat is None:
        return intersections.world_xy
    return enu_from_lonlat(*ORIGIN, intersections.lonlat)


def errors(intersections: IntersectionTable, nodes: FloatArray) -> FloatArray:
    """Distance of every intersection of the map to every node, (M, N)."""
    return np.linalg.norm(places(intersections)[:, None] - nodes[None], axis=2)


def check_form(intersections: IntersectionTable, assignment: np.ndarray, detections: DetectionTable) -> None:
    """What holds for every map."""
    count = len(intersections)
    assert_array_equal(intersections.id, np.arange(1, count + 1))
    assert assignment.shape == (len(detections),)
    assert_array_equal(np.bincount(assignment[assignment >= 0], minlength=count), intersections.observations)
    taken = np.stack([detections.keyframe, assignment])[:, assignment >= 0]
    assert len(np.unique(taken, axis=1).T) == taken.shape[1], "two detections of a keyframe became one intersection"
    assert np.all(np.diff(intersections.first_frame) >= 0)
    assert np.all(intersections.first_frame <= intersections.last_frame)
    assert np.all((intersections.confidence >= 0) & (intersections.confidence <= 1))
    assert np.all(np.isfinite(intersections.position_std_m))
    assert np.all(intersections.position_std_m > 0)
    for bearings in intersections.bearings_deg:
        assert np.all((bearings >= 0) & (bearings < 360))
        assert np.all(np.diff(bearings) > 0)


def run(stream: Stream, *, georeferenced: bool = True, gnss_m: float = 0.0) -> tuple[IntersectionTable, np.ndarray]:
    keyframes, detections = stream.tables(georeferenced=georeferenced, gnss_m=gnss_m)
    intersections, assignment = fuse(keyframes, detections)
    check_form(intersections, assignment, detections)
    return intersections, assignment


ONE = np.array([[50.0, 10.0]])
seeds = pytest.mark.parametrize("seed", range(5))
both = pytest.mark.parametrize("georeferenced", [True, False])


# a vehicle passes ----------------------------------------------------------------------------------------------------


@seeds
@both
def test_one_intersection_passed_once(seed: int, georeferenced: bool) -> None:
    intersections, assignment = run(Stream(ONE, seed=seed, wander_m=0.3).drive(straight((0, 0), (100, 0))),
                                    georeferenced=georeferenced)  # fmt: skip
    assert len(intersections) == 1
    assert errors(intersections, ONE)[0, 0] < 1.2
    assert intersections.confidence[0] > 0.5
    assert np.all(assignment == 0)
    (bearings,) = intersections.bearings_deg
    away = (bearings[:, None] - [0, 90, 180, 270] + 180) % 360 - 180
    assert len(bearings) == 4
    assert np.abs(away).min(axis=1).max() < 10


def test_a_false_detection_in_one_of_twenty_keyframes_has_little_confidence() -> None:
    """It is dropped by default, and shows with its confidence for who asks for everything."""
    keyframes, detections = Stream(ONE, detected=0.0, seed=1).drive(straight((0, 0), (100, 0))).tables()
    assert len(detections) == 0
    row = int(np.argmin(np.abs(keyframes.world_xy[:, 0] - 45)))
    once = seen_at(keyframes, np.array([row]), ONE)
    assert len(fuse(keyframes, once)[0]) == 0
    everything, assignment = fuse(keyframes, once, FusionConfig(min_observations=1, min_confidence=0))
    assert everything.observations.tolist() == [1]
    assert everything.confidence[0] < 0.1
    assert assignment.tolist() == [0]


def seen_at(
    keyframes: KeyframeTable,
    rows: IntArray,
    world_xy: FloatArray,
    *,
    score: float | FloatArray = 0.8,
    bearings: list[FloatArray] | None = None,
) -> DetectionTable:
    """Return detections at places of W, and on the globe where the keyframes are, of three branches unless given."""
    bearings = [np.array([0.0, 120.0, 240.0])] * len(rows) if bearings is None else bearings
    return DetectionTable(
        keyframe=rows,
        lidar_xy=world_xy - keyframes.world_xy[rows],
        world_xy=world_xy,
        lonlat=None if keyframes.lonlat is None else lonlat_from_enu(*ORIGIN, world_xy),
        bearings_deg=bearings,
        score=np.broadcast_to(score, len(rows)),
        intersection=np.full(len(rows), -1),
        widths_m=[np.full(len(each), np.nan) for each in bearings],
        position_std_m=np.ones(len(rows)),
    )


def test_a_place_falsely_seen_in_a_few_keyframes_of_many_is_dropped() -> None:
    """An artefact is seen in a row, while the keyframes nearer to it see nothing."""
    keyframes, detections = Stream(ONE, seed=2).drive(straight((0, 0), (150, 0))).tables(georeferenced=False)
    artefact = np.array([110.0, 8.0])
    rows = np.arange(44, 48)
    extra = seen_at(keyframes, rows, np.tile(artefact, (4, 1)))
    names = ("keyframe", "lidar_xy", "world_xy", "score", "intersection", "position_std_m")
    arrays = {name: np.concatenate([getattr(detections, name), getattr(extra, name)]) for name in names}
    lists = {name: getattr(detections, name) + getattr(extra, name) for name in ("bearings_deg", "widths_m")}
    intersections, assignment = fuse(keyframes, DetectionTable(**arrays, **lists, lonlat=None))
    assert len(intersections) == 1
    assert errors(intersections, ONE)[0, 0] < 2
    assert assignment[-4:].tolist() == [-1] * 4


@seeds
def test_an_intersection_seen_first_from_far_is_not_pulled_there(seed: int) -> None:
    """Detections at 50 m are 5 m off, towards the vehicle, which sees the intersection from one side only."""
    stream = Stream(ONE, seed=seed, bias_per_m=0.15, wander_m=0.1, jitter_m=0.1).drive(straight((0, 0), (50, 0)))
    keyframes, detections = stream.tables()
    intersections, _ = fuse(keyframes, detections)
    assert len(intersections) == 1
    assert detections.lonlat is not None
    plain_mean = enu_from_lonlat(*ORIGIN, detections.lonlat).mean(axis=0)
    assert errors(intersections, ONE)[0, 0] < 0.6 * math.dist(plain_mean, ONE[0])


def test_a_detection_counts_by_how_well_it_is_known_but_one_alone_moves_nothing() -> None:
    keyframes, _ = Stream(ONE).drive(straight((0, 0), (18, 0))).tables(georeferenced=False)
    places = np.array([[10.0, 5.0]] * 4 + [[10.0, 6.0]] * 6)
    detections = seen_at(keyframes, np.arange(10), places)
    known = replace(detections, position_std_m=np.where(places[:, 1] == 5.0, 0.1, 1.0))
    assert fuse(keyframes, detections)[0].world_xy[0, 1] == pytest.approx(5.6, abs=0.01)
    assert fuse(keyframes, known)[0].world_xy[0, 1] == pytest.approx(5.0, abs=0.05)
    alone = replace(known, world_xy=np.where(np.arange(10)[:, None] == 0, [[17.0, 8.0]], [[10.0, 6.0]]))
    assert fuse(keyframes, alone)[0].world_xy[0] == pytest.approx([10.0, 6.0], abs=0.3)


# two passes ----------------------------------------------------------------------------------------------------------


def two_passes(seed: int, drift: tuple[float, float]) -> Stream:
    """Along, away for minutes, and back across."""
    return (
        Stream(np.array([[50.0, 0.0], [50.0, 200.0]]), seed=seed, wander_m=0.3)
        .drive(straight((0, 0), (100, 0)))
        .drive(straight((100, 200), (0, 200)), drift=drift)
        .drive(straight((50, -60), (50, 60)), drift=drift)
    )


@seeds
@pytest.mark.parametrize("drift", [(0.0, 0.0), (5.0, 3.0), (-3.0, 7.0)])
def test_two_passes_with_drift_are_one_intersection_in_the_world(seed: int, drift: tuple[float, float]) -> None:
    intersections, assignment = run(two_passes(seed, drift), georeferenced=False)
    assert len(intersections) == 2
    assert np.mean(assignment >= 0) > 0.95
    assert errors(intersections, np.array([[50.0, 0.0]]))[0, 0] < math.hypot(*drift) + 1


@seeds
def test_two_passes_with_drift_are_exact_on_the_globe(seed: int) -> None:
    """The fixes do not drift with the poses; they are off by half a metre."""
    stream = two_passes(seed, (40.0, -30.0))
    intersections, _ = run(stream, gnss_m=0.3)
    assert len(intersections) == 2
    assert errors(intersections, stream.nodes).min(axis=1).max() < 1.5
    assert intersections.last_frame[0] > intersections.first_frame[1]  # the second pass belongs to the first one
    assert_allclose(intersections.world_xy[0], [50, 0], atol=1.5)  # W of the first pass
    assert_allclose(intersections.world_xy[1], [90, 170], atol=1.5)


@seeds
def test_a_pass_more_makes_the_position_surer(seed: int) -> None:
    once = Stream(ONE, seed=seed, wander_m=0.3).drive(straight((0, 0), (100, 0)))
    alone = run(once)[0].position_std_m[0]
    again = run(once.drive(straight((40, -60), (40, 60))))[0].position_std_m[0]
    assert again < 0.85 * alone


# two close intersections ---------------------------------------------------------------------------------------------


@seeds
@both
@pytest.mark.parametrize("pair", [((50, 6), (59, -6)), ((50, 6), (66, -6)), ((50, 4), (50, -4))])
def test_a_close_pair_stays_two(seed: int, georeferenced: bool, pair: tuple[tuple[float, float], ...]) -> None:
    """Nearer than the merge radius only seeing both at once tells them apart."""
    nodes = np.array(pair, dtype=np.float64)
    stream = Stream(nodes, seed=seed, wander_m=0.3).drive(straight((0, 0), (120, 0)))
    intersections, _ = run(stream, georeferenced=georeferenced)
    assert len(intersections) == 2
    assert errors(intersections, nodes).min(axis=0).max() < 1.5


@seeds
def test_a_staggered_pair_passed_twice_with_drift_stays_two(seed: int) -> None:
    """Half-way between the two the drifted second one of the first pass meets the first one of the second."""
    nodes = np.array([[50.0, 4.0], [66.0, -4.0]])
    stream = Stream(nodes, seed=seed, wander_m=0.3)
    stream.drive(straight((0, 0), (120, 0))).drive(straight((120, 0), (0, 0)), drift=(5.0, 0.0))
    intersections, _ = run(stream, georeferenced=False)
    assert len(intersections) == 2
    assert errors(intersections, nodes).min(axis=0).max() < 6.5


# sparse drives and towns ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_a_sparse_drive_keeps_its_intersections(seed: int) -> None:
    """A keyframe every 17 m: two to five sightings each."""
    nodes = np.array([[50.0, 6.0], [150.0, 0.0], [250.0, -8.0]])
    intersections, _ = run(Stream(nodes, seed=seed, detected=0.95).drive(straight((0, 0), (300, 0), step_m=17)))
    distance = errors(intersections, nodes)
    assert distance.shape[0] == 3
    assert distance.min(axis=0).max() < 3.5


def town(seed: int) -> Stream:
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(5)), axis=-1).reshape(-1, 2) * 100.0
    stream = Stream(grid + rng.uniform(-12, 12, grid.shape), seed=seed, false_rate=0.3, wander_m=0.3)
    for line in range(5):
        stream.drive(straight((-50, 100 * line), (450, 100 * line)), drift=(line / 2, -line / 3))
    return stream


@both
@pytest.mark.parametrize("seed", range(2))
def test_the_map_of_a_town_is_complete_and_right(seed: int, georeferenced: bool) -> None:
    """Twenty-five intersections, one false detection in every third keyframe: precision and recall of 95 %."""
    stream = town(seed)
    if not georeferenced:
        stream.passes = [(track, np.zeros(2)) for track, _ in stream.passes]
    intersections, _ = run(stream, georeferenced=georeferenced)
    distance = errors(intersections, stream.nodes)
    assert np.mean(distance.min(axis=1) < 5) >= 0.95
    assert np.mean(distance.min(axis=0) < 5) >= 0.95
    assert np.median(distance.min(axis=0)) < 0.7


def test_the_uncertainty_is_honest() -> None:
    """Over many intersections, errors are as large as said, though forty sightings a pass share their error."""
    squared = []
    for wander_m in (0.4, 0.8):
        for seed in range(25):
            stream = Stream(ONE, seed=seed, wander_m=wander_m).drive(straight((0, 0), (100, 0)))
            intersections, _ = run(stream)
            squared.append(errors(intersections, ONE)[0, 0] ** 2 / 2 / intersections.position_std_m[0] ** 2)
    assert 0.4 < np.mean(squared) < 2.5


def test_a_calibration_changes_what_is_said_of_intersections_not_where_they_are() -> None:
    keyframes, detections = town(0).tables()
    plain, labels = fuse(keyframes, detections)
    table, same = fuse(keyframes, detections, FusionConfig(), CalibrationConfig())
    assert_array_equal(same, labels)
    assert_array_equal(table.lonlat, plain.lonlat)
    assert_allclose(plain.covariances, plain.position_std_m[:, None, None] ** 2 * np.eye(2))
    assert_allclose(np.trace(table.covariances, axis1=1, axis2=2), 2 * table.position_std_m**2)
    doubted = replace(keyframes, is_doubtful=np.ones(len(keyframes), np.bool_))
    unsure, _ = fuse(doubted, detections, None, CalibrationConfig())
    assert (unsure.confidence < table.confidence).all()
    assert_array_equal(unsure.position_std_m, table.position_std_m)
    doubtful = CalibrationConfig(log_odds=1, log_odds_seen=1)  # less probable than their share of sightings
    bound = float(np.median(fuse(keyframes, detections, FusionConfig(), doubtful)[0].confidence))
    sure, assigned = fuse(keyframes, detections, FusionConfig(min_confidence=bound), doubtful)
    assert 0 < len(sure) < len(table)
    assert sure.confidence.min() >= bound
    assert sorted(set(assigned.tolist()) - {-1}) == list(range(len(sure)))


# whatever comes ------------------------------------------------------------------------------------------------------


def test_nothing_gives_nothing() -> None:
    for keyframes, detections in (
        build_tables([], np.arange(0), None),
        Stream(np.zeros((0, 2))).drive(straight((0, 0), (20, 0))).tables(),
    ):
        intersections, assignment = fuse(keyframes, detections)
        assert len(intersections) == len(assignment) == 0
        assert (intersections.lonlat is None) == (keyframes.lonlat is None)


def test_the_only_keyframe_of_a_drive_is_believed() -> None:
    """Two sightings are asked for only where two keyframes could have seen it."""
    keyframes, _ = Stream(ONE, detected=0.0).drive(straight((40, 0), (42, 0))).tables()
    single = keyframes.select(np.array([0]))
    assert len(fuse(single, seen_at(single, np.array([0]), ONE))[0]) == 1
    assert len(fuse(keyframes, seen_at(keyframes, np.array([0]), ONE))[0]) == 0


@pytest.mark.parametrize("seed", range(2))
def test_the_order_of_the_detections_does_not_matter(seed: int) -> None:
    keyframes, detections = town(seed).tables()
    assert detections.lonlat is not None
    order = np.random.default_rng(seed).permutation(len(detections))
    shuffled = detections.select(order)
    a, of_a = fuse(keyframes, detections)
    b, of_b = fuse(keyframes, shuffled)
    assert sorted(a.observations) == sorted(b.observations)
    assert_allclose(np.sort(b.lonlat[:, 0]), np.sort(a.lonlat[:, 0]), atol=1e-9)
    assert np.mean((of_b >= 0) == (of_a[order] >= 0)) == 1


def test_the_date_line_is_no_obstacle() -> None:
    keyframes, detections = Stream(ONE).drive(straight((0, 0), (100, 0))).tables()
    assert keyframes.lonlat is not None
    assert detections.lonlat is not None

    def moved(lonlat: FloatArray) -> FloatArray:
        lon = lonlat[:, 0] - ORIGIN[1] + 180.0 - 0.0006  # the line runs near x = 44 m
        return np.stack([(lon + 180) % 360 - 180, lonlat[:, 1]], axis=-1)

    expected, _ = fuse(keyframes, detections)
    there = replace(keyframes, lonlat=moved(keyframes.lonlat)), replace(detections, lonlat=moved(detections.lonlat))
    assert there[0].lonlat[:, 0].min() < -179
    found, _ = fuse(*there)
    assert expected.lonlat is not None
    _, _, error = pyproj.Geod(ellps="WGS84").inv(*found.lonlat[0], *moved(expected.lonlat)[0])
    assert error < 0.05


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_detections_make_a_map_of_the_right_form(data: st.DataObject) -> None:
    keyframes, _ = Stream(ONE, detected=0.0).drive(straight((0, 0), (60, 0), step_m=6)).tables(georeferenced=False)
    near = st.floats(-30, 90)
    n = data.draw(st.integers(0, 25))
    keyframe = np.sort(data.draw(st.lists(st.integers(0, len(keyframes) - 1), min_size=n, max_size=n)))
    xy = np.array(data.draw(st.lists(st.tuples(near, near), min_size=n, max_size=n))).reshape(-1, 2)
    bearing = st.lists(st.floats(0, 360, exclude_max=True), max_size=4)
    bearings = [np.array(data.draw(bearing)) for _ in range(n)]
    score = np.array(data.draw(st.lists(st.floats(0, 1), min_size=n, max_size=n)), dtype=float)
    detections = seen_at(keyframes, np.array(keyframe, dtype=np.int64), xy, score=score, bearings=bearings)
    for config in (FusionConfig(), FusionConfig(min_observations=1, min_confidence=0)):
        intersections, assignment = fuse(keyframes, detections, config)
        check_form(intersections, assignment, detections)
        if config.min_confidence == 0 and n:
            assert len(intersections) + intersections.bends > 0
        assert all(len(each) >= 3 for each in intersections.bearings_deg)


def test_thousands_of_detections_take_little_memory() -> None:
    """All at one place, where a byte for each pair of detections would be more."""
    rng = np.random.default_rng(0)
    keyframes, _ = Stream(np.zeros((0, 2))).drive(straight((0, 0), (10_000, 0))).tables(georeferenced=False)
    n = 5_000
    rows, lidar_xy = np.sort(rng.integers(0, len(keyframes), n)), rng.normal(0, 20, (n, 2))
    detections = seen_at(keyframes, rows, rng.normal(0, 3.0, (n, 2)), score=rng.random(n))
    detections = replace(detections, lidar_xy=lidar_xy)
    tracemalloc.start()
    fuse(keyframes, detections)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < n**2


def test_limits_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(pydantic.ValidationError, match=r"visible_limit_m \(10\) must be greater than visible_radius_m"):
        FusionConfig(visible_limit_m=10)
    with pytest.raises(pydantic.ValidationError, match="frozen"):
        FusionConfig().bandwidth_m = 3


def test_the_uncertainty_is_told_in_parts_of_what_is_shared() -> None:
    """The fix by a drive, the shape by all drives, the scatter by nothing: their sum is the covariance."""
    stream = Stream(np.array([[40.0, 0.0]])).drive(straight((0, 0), (80, 0)))
    keyframes, detections = stream.tables()
    table, _ = fuse(keyframes, detections, None, CalibrationConfig(fix_std_m=0.5))
    assert_allclose(table.parts.fix_std_m, 0.5)
    own = table.parts.fix_std_m**2 + table.parts.scatter_std_m**2
    assert_allclose(table.parts.shape_cov_m2 + own[:, None] * [1, 0, 1], table.position_cov_m2)
    local, _ = fuse(*stream.tables(georeferenced=False), None, CalibrationConfig(fix_std_m=0.5))
    assert_allclose(local.parts.fix_std_m, 0.0)
    without, _ = fuse(keyframes, detections)
    assert np.isnan(without.parts.scatter_std_m).all()


def test_peaks_of_two_heaps() -> None:
    xy = np.array([[0.0, 0.0], [0.4, 0.0], [0.0, 0.9], [8.0, 0.0], [8.3, 0.3], [30.0, 0.0]])
    assert find_peaks(xy, bandwidth_m=2.0).tolist() == [0, 0, 0, 1, 1, 2]


def test_heaps_join_unless_seen_side_by_side() -> None:
    xy = np.array([[0.0, 0.0], [0.0, 0.0], [6.0, 0.0], [6.0, 0.0]])
    labels = np.array([0, 0, 1, 1])

    def join(keyframe: list[int], radius_m: float = 10.0) -> list[int]:
        return join_peaks(labels, xy, np.array(keyframe), radius_m=radius_m, together=0.15).tolist()

    assert join([0, 1, 2, 3]) == [0, 0, 0, 0]
    assert join([0, 1, 1, 3]) == [0, 0, 1, 1]
    assert join([0, 1, 2, 3], radius_m=5.0) == [0, 0, 1, 1]


@pytest.mark.parametrize("saw_two", [2, 3])
def test_one_seen_between_two_as_often_stands_for_both(saw_two: int) -> None:
    xy = np.array([[0.2, 0.0], [0.0, 0.1], [-0.2, 0.0], *[[-4.0, 0.0], [4.0, 0.0]] * saw_two, [0.0, 3.0], [30.0, 0.0]])
    keyframe = np.array([0, 1, 2, *np.arange(3, 3 + saw_two).repeat(2), 8, 9])
    assert stand_for_two(xy, keyframe, radius_m=10.0).tolist() == [saw_two == 3] * 3 + [False] * (len(xy) - 3)
    assert not stand_for_two(xy, keyframe, radius_m=7.9).any()


def test_a_chain_does_not_grow_beyond_the_radius() -> None:
    xy = np.stack([np.arange(6) * 7.0, np.zeros(6)], axis=-1)
    joined = join_peaks(np.arange(6), xy, np.arange(6), radius_m=10.0, together=0.15)
    for group in range(joined.max() + 1):
        assert np.ptp(xy[joined == group, 0]) <= 10.0


def test_a_centre_takes_one_detection_of_a_keyframe() -> None:
    centres = np.array([[0.0, 0.0], [12.0, 0.0]])
    xy = np.array([[1.0, 0.0], [3.0, 0.0], [5.0, 0.0], [40.0, 0.0]])
    assert assign(xy, np.array([0, 0, 1, 1]), centres, radius_m=10.0).tolist() == [0, 1, 0, -1]
    assert assign(xy, np.array([0, 0, 1, 1]), centres[:1], radius_m=10.0).tolist() == [0, -1, 0, -1]
