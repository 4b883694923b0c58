"""A session that falls behind drops the oldest scans and says so; one that fails at a scan goes on."""

import threading
from dataclasses import replace
from typing import Any

import numpy as np

from interloc.config import DetectorConfig
from interloc.drives.folder import FolderDrive
from interloc.live.scan import live_scan, play
from interloc.live.session import Answer, LiveSession
from interloc.live.worker import LiveWorker


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


def test_a_drive_is_played_at_its_times(crossing: FolderDrive, config: DetectorConfig) -> None:
    waits: list[float] = []
    drive = replace(crossing, times_s=np.arange(48) * 100.0)
    scans = list(play(drive, config, speed=2.0, after=43, wait=waits.append))
    assert [scan.frame for scan in scans] == [44, 45, 46, 47]
    assert [round(seconds, -1) for seconds in waits] == [0, 50, 100, 150]
