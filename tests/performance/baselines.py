"""What InterLoc is compared with: merely reading the scans, and the method of the paper done plainly."""

import time
from pathlib import Path

import numpy as np

from interloc.config import PAPER
from interloc.detection.keyframes import select_keyframes
from interloc.drives.open import open_drive
from tests.reference import find_range

ROAD_IDS = (40, 60)


def masking(root: Path) -> dict[str, float]:
    """Merely read the scans and their labels and mask the road, in plain numpy."""
    began, worked = time.perf_counter(), time.process_time()
    scans = sorted((root / "velodyne").glob("*.bin"))
    for scan in scans:
        points = np.fromfile(scan, np.float32).reshape(-1, 4)
        labels = np.fromfile(root / "labels" / f"{scan.stem}.label", np.uint32) & 0xFFFF
        assert len(points[(labels == ROAD_IDS[0]) | (labels == ROAD_IDS[1])])
    seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - worked
    return {"ms": 1e3 * seconds / len(scans), "cpu_ms": 1e3 * cpu_seconds / len(scans)}


def literal(root: Path, keyframes: int) -> dict[str, float]:
    """Time `tests.reference` around the middle of a drive, once its first window is read: one scan per keyframe."""
    drive = open_drive(root)
    every = select_keyframes(drive.T_world_lidar, PAPER.keyframes)
    first = max(0, len(every) // 2 - keyframes // 2)
    marks: list[tuple[float, float]] = []
    part = find_range(
        drive,
        every,
        first,
        first + keyframes + 1,
        progress=lambda *_: marks.append((time.perf_counter(), time.process_time())),
    )
    seconds, cpu_seconds = (end - began for began, end in zip(marks[0], marks[-1], strict=True))
    found = sum(len(detections.world_xy) for detections in part.detections[1:])
    return {"ms": 1e3 * seconds / keyframes, "cpu_ms": 1e3 * cpu_seconds / keyframes, "detections": found}
