"""A session answers with the detections of `detect`, its map becomes that of `detect`; scans on their way to it."""

import json
import struct
import threading
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.config import DetectorConfig, preset
from interloc.detection.detector import KeyframeDetections
from interloc.detection.keyframes import Keyframe
from interloc.drives.folder import FolderDrive
from interloc.errors import DriveError, GeoreferenceError, InterLocError
from interloc.live.scan import Fix, LiveScan, live_scan, play
from interloc.live.session import Answer, GrowingMap, LiveSession
from interloc.live.wire import decode_scan, encode_scan
from interloc.live.worker import LiveWorker
from interloc.pipeline import detect
from tests.small_drives import level_poses


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
    keyframe = Keyframe(int(x_m), level_poses(x_m), None)
    score, std_m = np.full(count, 0.9), np.ones(count)
    return KeyframeDetections(keyframe, places - [x_m, 0.0], places, branches, score, widths, std_m)


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
        (lambda scan: replace(scan, fix=Fix(49.0, 8.4, 0.0, np.eye(3)[[1, 0, 2]])), GeoreferenceError, "a rotation"),
        (lambda scan: replace(scan, fix=None), GeoreferenceError, "has no fix, the scans before it have one"),
        (lambda scan: replace(scan, frame=1), DriveError, "must rise"),
        (lambda scan: replace(scan, road_count=None), DriveError, "no labels"),
        (lambda scan: replace(scan, road_count=None, labels=np.zeros(5, np.uint32)), DriveError, "labels of shape"),
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


def scan_of(crossing: FolderDrive) -> LiveScan:
    scan = live_scan(crossing, 7)
    assert scan.fix is not None
    return scan


def test_to_the_last_digit(crossing: FolderDrive) -> None:
    scan = scan_of(crossing)
    pose = scan.T_world_lidar + np.array([[0, 0, 0, np.pi], [0, 0, 0, 1 / 3], [0, 0, 0, 0], [0, 0, 0, 0]])
    again = decode_scan(encode_scan(replace(scan, T_world_lidar=pose, time_s=1.1)))
    np.testing.assert_array_equal(again.T_world_lidar, pose)
    np.testing.assert_array_equal(again.points, scan.ground.xyz)
    assert (again.frame, again.road_count, again.time_s) == (scan.frame, scan.road_count, 1.1)
    np.testing.assert_array_equal(again.fix.R_enu_lidar, scan.fix.R_enu_lidar)
    assert (again.fix.lat_deg, again.fix.lon_deg) == (scan.fix.lat_deg, scan.fix.lon_deg)
    assert Fix(49.0, 181.5, 0.0, np.eye(3)).checked(0).lon_deg == -178.5


def test_what_has_labels_is_sorted_by_the_sender() -> None:
    points, labels = np.eye(4, dtype=np.float32), np.array([40, 48, 70, 40], np.uint32)
    again = decode_scan(encode_scan(LiveScan(0, np.eye(4), points, labels)))
    np.testing.assert_array_equal(again.road_points, points[[0, 3], :3])
    np.testing.assert_array_equal(again.other_points, points[[1], :3])


def message(**changes: Any) -> bytes:
    head = {"frame": 1, "pose": np.eye(4).ravel().tolist(), "points": 2, "road_count": 1, **changes}
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    return b"ILS1" + struct.pack("<I", len(text)) + text + bytes(24)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "does not begin with ILS1"),
        (b"GET / HTTP/1.1\r\n\r\n", "does not begin with ILS1"),
        (b"ILS1" + struct.pack("<I", 0xFFFFFFFC), "4,294,967,292 bytes, in a message of 8"),
        (b"ILS1" + struct.pack("<I", 3) + b"{} ", "a multiple of 4"),
        (b"ILS1" + struct.pack("<I", 4) + b"\xff\xfe{}", "head"),
        (message(points=3), "announces 3 points of 12 bytes"),
        (message(labels=True), "labels"),
        (message(points=2**40), "points: Input should be less"),
        (message(points=-1), "points"),
        (message(frame="1"), "frame"),
        (message(pose=[float("nan")] * 16), "pose.0"),
        (message(pose=[0.0]), "pose"),
        (message(road_count=3), "road_count is 3 of 2"),
        (message(more=1), "more"),
        (message(fix={"lat_deg": 91, "lon_deg": 0, "R_enu_lidar": [0.0] * 9}), "fix.lat_deg"),
    ],
)
def test_what_is_no_scan_is_refused(data: bytes, text: str) -> None:
    with pytest.raises(DriveError, match=text):
        decode_scan(data)
    assert decode_scan(message()).frame == 1


@given(st.binary(max_size=200), st.integers(0, 200), st.integers(0, 2**32 - 1))
def test_whatever_comes_is_a_scan_or_an_error_with_a_reason(noise: bytes, at: int, length: int) -> None:
    whole = message()
    for data in (whole[:at] + noise, b"ILS1" + struct.pack("<I", length) + noise, whole[:at] + whole[at + 1 :]):
        with suppress(InterLocError):
            LiveSession().push(decode_scan(data))


def test_the_oldest_scans_are_dropped(crossing: FolderDrive, config: DetectorConfig) -> None:
    at_work, may_go_on = threading.Event(), threading.Event()
    said: list[dict[str, Any]] = []

    def label(points: np.ndarray) -> np.ndarray:
        at_work.set()
        may_go_on.wait()
        return np.full(len(points), 40, np.uint32)

    worker = LiveWorker(LiveSession(config), lambda document, _: said.append(document), queue_size=2)
    scans = [replace(live_scan(crossing, row), road_count=None, label=label) for row in range(6)]
    worker.put(scans[0])
    at_work.wait()
    for scan in scans[1:]:
        worker.put(scan)
    assert [(each["type"], each["frame"]) for each in said] == [("dropped", 1), ("dropped", 2), ("dropped", 3)]
    may_go_on.set()
    worker.finish()
    worker.join()
    assert [each["frame"] for each in said if each["type"] == "scan" and each["is_keyframe"]] == [0, 4, 5]
    assert (said[-1]["type"], said[-1]["keyframes"], said[-1]["dropped"]) == ("end", 3, 3)


def test_scans_that_wait_are_few_and_small_in_all(crossing: FolderDrive, config: DetectorConfig) -> None:
    may_go_on = threading.Event()

    def label(points: np.ndarray) -> np.ndarray:
        may_go_on.wait()
        return np.full(len(points), 40, np.uint32)

    scans = [replace(live_scan(crossing, row), road_count=None, label=label) for row in range(5)]
    size = max(scan.nbytes for scan in scans)
    dropped: list[int] = []
    worker = LiveWorker(LiveSession(config), lambda said, _: dropped.append(said["frame"]), queue_bytes=2 * size)
    for scan in scans:
        worker.put(scan)
    assert worker.held_bytes <= 3 * size  # and the one that is worked on
    assert len(dropped) >= 2
    worker.abandon()
    may_go_on.set()
    worker.join()
    assert worker.held_bytes == 0


def test_a_scan_that_is_refused_is_answered_by_the_reason(crossing: FolderDrive, config: DetectorConfig) -> None:
    said: list[tuple[dict[str, Any], Answer | None]] = []
    worker = LiveWorker(LiveSession(config), lambda *each: said.append(each), queue_size=10)
    scans = [live_scan(crossing, row) for row in range(3)]
    for scan in (scans[0], replace(scans[1], T_world_lidar=np.zeros((4, 4))), scans[2]):
        worker.put(scan)
    worker.finish()
    worker.join()
    assert [each["type"] for each, _ in said] == ["scan", "refused", "scan", "scan", "scan", "end"]
    assert "not a rotation" in said[1][0]["reason"]


def test_a_listener_that_is_gone_ends_the_session(crossing: FolderDrive, config: DetectorConfig) -> None:
    worker = LiveWorker(LiveSession(config), Mock(side_effect=BrokenPipeError))
    worker.put(live_scan(crossing, 0))
    with pytest.raises(BrokenPipeError):
        worker.join()


def test_a_drive_is_played_at_its_times(crossing: FolderDrive, config: DetectorConfig) -> None:
    waits: list[float] = []
    drive = replace(crossing, times_s=np.arange(48) * 100.0)
    scans = list(play(drive, config, speed=2.0, after=43, wait=waits.append))
    assert [scan.frame for scan in scans] == [44, 45, 46, 47]
    assert [round(seconds, -1) for seconds in waits] == [0, 50, 100, 150]
