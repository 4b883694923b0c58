"""A session answers with the detections of `detect`, and its map becomes that of `detect`."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from interloc.config import DetectorConfig, preset
from interloc.detection.detector import KeyframeDetections
from interloc.detection.keyframes import Keyframe
from interloc.drives.folder import FolderDrive
from interloc.errors import DriveError, GeoreferenceError, InterLocError
from interloc.live.scan import Fix, LiveScan, live_scan, play
from interloc.live.session import Answer, GrowingMap, LiveSession
from interloc.pipeline import detect
from tests.crossing import pose_at


def drive_through(session: LiveSession, scans: list[LiveScan]) -> list[Answer]:
    return [*(session.push(scan) for scan in scans), *session.finish()]


@pytest.mark.parametrize("lookahead", [0, 6])
@pytest.mark.parametrize("is_local", [False, True])
def test_detections_and_map_are_those_of_detect(crossing: FolderDrive, lookahead: int, is_local: bool) -> None:
    drive = crossing.without_georeference() if is_local else crossing
    config = preset("default", f"keyframes.lookahead={lookahead}")
    expected = detect(drive, config)
    session = LiveSession(config)
    answers = drive_through(session, list(play(drive, config)))
    tables = [each.detections for each in answers if each.detections is not None]
    assert len(tables) == len(expected.keyframes)
    for column in ("lidar_xy", "world_xy", "score", *([] if is_local else ["lonlat"])):
        found = np.concatenate([getattr(table, column) for table in tables])
        np.testing.assert_array_equal(found, getattr(expected.detections, column))
    _, intersections, detections = session.complete()
    np.testing.assert_array_equal(intersections.world_xy, expected.intersections.world_xy)
    np.testing.assert_array_equal(intersections.confidence, expected.intersections.confidence)
    np.testing.assert_array_equal(detections.intersection, expected.detections.intersection)


def test_a_scan_of_the_sensor_is_as_good_as_one_that_is_sorted(crossing: FolderDrive, config: DetectorConfig) -> None:
    sorted_ = list(play(crossing, config))
    points = [np.pad(scan.points, ((0, 0), (0, 1))) for scan in sorted_]
    labelled = [
        replace(scan, points=each, road_count=None, labels=np.full(len(each), 40, np.uint32))
        for scan, each in zip(sorted_, points, strict=True)
    ]
    by_network = [replace(scan, labels=None, label=lambda p: np.full(len(p), 40, np.uint32)) for scan in labelled]
    found = [
        [each.detections.lidar_xy.tolist() for each in drive_through(LiveSession(config), scans) if each.detections]
        for scans in (sorted_, labelled, by_network)
    ]
    assert found[0] == found[1] == found[2]


def test_the_map_grows(crossing: FolderDrive, config: DetectorConfig) -> None:
    session = LiveSession(config)
    kinds = Counter[str]()
    ids = set()
    for answer in drive_through(session, list(play(crossing, config))):
        kinds.update(each.kind for each in answer.events)
        ids |= {each.intersection.id for each in answer.events}
        assert {each.intersection.id for each in answer.events if each.kind != "gone"} <= {
            each.id for each in session.map.intersections
        }
    (intersection,) = session.map.intersections
    assert ids == {intersection.id} == {1}
    assert (kinds["new"], kinds["confirmed"], kinds["gone"]) == (1, 1, 0)
    assert kinds["seen"] > 5
    np.testing.assert_allclose(intersection.world_xy, [60, 0], atol=0.3)
    (row,) = session.complete()[1].position_std_m
    assert intersection.position_std_m == pytest.approx(row, rel=0.05)


def sighting(x_m: float, *world_xy: tuple[float, float]) -> KeyframeDetections:
    places, count = np.array(world_xy, np.float64).reshape(-1, 2), len(world_xy)
    branches = [np.array([0.0, 1.6, 3.1])] * count
    widths = [np.full(3, 8.0)] * count
    keyframe = Keyframe(int(x_m), pose_at(x_m), None)
    return KeyframeDetections(keyframe, places - [x_m, 0.0], places, branches, np.full(count, 0.9), widths)


def test_what_later_keyframes_do_not_see_goes() -> None:
    growing = GrowingMap(preset("default"))
    places = [((20.0, 5.0),), *[()] * 20]
    events = [each for row, seen in enumerate(places) for each in growing.add(sighting(2.0 * row, *seen), None)]
    assert [each.kind for each in events] == ["new", "gone"]
    assert growing.intersections == []


def test_a_second_pass_finds_the_same_intersection() -> None:
    growing = GrowingMap(preset("default"))
    there_and_back = [*range(0, 600, 4), *range(600, 0, -4)]
    events = [
        each for x in there_and_back for each in growing.add(sighting(x, (20.0, 5.0)) if x < 60 else sighting(x), None)
    ]
    assert [(each.kind, each.intersection.id) for each in events if each.kind in {"new", "gone"}] == [("new", 1)]
    assert growing.intersections[0].observations == 29


def wrong_pose(scan: LiveScan) -> LiveScan:
    return replace(scan, T_world_lidar=np.full((4, 4), np.nan))


def wrong_point(scan: LiveScan) -> LiveScan:
    return replace(scan, points=np.where(np.arange(len(scan.points))[:, None] == 3, np.float32(np.nan), scan.points))


def radians(scan: LiveScan) -> LiveScan:
    return replace(scan, fix=Fix(490.0, 8.4, 0.0, np.eye(3)))


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        (wrong_pose, DriveError, "not finite"),
        (wrong_point, DriveError, "point 3 is not finite"),
        (radians, GeoreferenceError, "no place on WGS84"),
        (lambda scan: replace(scan, fix=None), GeoreferenceError, "has no fix, the scans before it have one"),
        (lambda scan: replace(scan, frame=1), DriveError, "must rise"),
        (lambda scan: replace(scan, road_count=None), DriveError, "no labels"),
        (lambda scan: replace(scan, road_count=None, labels=np.zeros(5, np.uint32)), DriveError, "5 labels"),
    ],
)
def test_a_scan_that_is_not_valid_is_refused_and_the_next_is_not(
    crossing: FolderDrive, config: DetectorConfig, change: object, error: type[InterLocError], text: str
) -> None:
    scans = [live_scan(crossing, row) for row in range(4)]
    session = LiveSession(config)
    for scan in scans[:2]:
        session.push(scan)
    with pytest.raises(error, match=text):
        session.push(change(scans[2]))  # type: ignore[operator]
    assert session.push(scans[3]).is_keyframe
