"""What InterLoc is compared with: merely reading the scans, and the method of the paper done plainly."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
from skimage.morphology import skeletonize

from interloc.config import PAPER
from interloc.detection.branches import segment_all
from interloc.detection.candidates import Candidates, merge_until_stable
from interloc.detection.centerline import Centerline
from interloc.detection.image import BinaryImage
from interloc.detection.refinement import refine
from interloc.drives.open import open_drive

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
    """Do what the paper says, plainly: all 41 scans of the window put together and binned for every keyframe."""
    drive = open_drive(root)
    n, size_m, cell_m = PAPER.keyframes.window, PAPER.bev.size_m, PAPER.bev.resolution_m
    first = max(n, len(drive.frames) // 2 - keyframes // 2)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (15, 15))
    window = [drive.ground_points(i).road for i in range(first - n, first + n)]
    found, began, worked = 0, time.perf_counter(), time.process_time()
    for k in range(first, first + keyframes):
        window = [*window[-2 * n :], drive.ground_points(k + n).road]
        poses = drive.T_world_lidar[k - n : k + n + 1]
        world = np.concatenate([xyz @ T[:3, :3].T + T[:3, 3] for xyz, T in zip(window, poses, strict=True)])
        side = round(size_m / cell_m)
        cells = np.floor((world[:, :2] - poses[n][:2, 3]) / cell_m).astype(np.int64) + side // 2
        cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
        counts = np.bincount((side - 1 - cells[:, 1]) * side + cells[:, 0], minlength=side * side)
        bev = (counts.reshape(side, side) >= PAPER.bev.min_points).astype(np.uint8)
        occupancy = cv2.morphologyEx(cv2.morphologyEx(bev, cv2.MORPH_CLOSE, disc), cv2.MORPH_OPEN, disc)
        line = skeletonize(occupancy > 0).astype(np.uint8)
        score = cv2.cornerHarris(line.astype(np.float32), 9, 3, 0.04)
        peaks = (line > 0) & (score == cv2.dilate(score, np.ones((21, 21)))) & (score > 0.3 * score.max())
        positions, groups = merge_until_stable(np.argwhere(peaks).astype(np.float64), 10.0 / cell_m)
        centerline = Centerline.of(BinaryImage.from_array(line), BinaryImage.from_array(occupancy))
        candidates = Candidates(positions, np.full(len(groups), 10 / cell_m), [np.empty((0, 2))] * len(groups))
        found += len([refine(b) for b in segment_all(candidates, centerline, cell_m, PAPER.branches)[0]])
    seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - worked
    return {"ms": 1e3 * seconds / keyframes, "cpu_ms": 1e3 * cpu_seconds / keyframes, "detections": found}
