"""The method of the paper done plainly, with OpenCV and scikit-image: slow, short, and nothing else.

This is what the detector is held against: the tests compare the two over whole drives, and `make bench` measures how
much faster the other one is. Every step stands in one function under
its section of the paper; all settings are those of the preset `paper`. Nothing of `interloc.kernels` is used.

Results differ a little from those of the preset `paper`: scikit-image thins by a variant of Zhang and Suen's algorithm,
OpenCV's disc lacks four pixels, and Harris corners of equal score are chosen in another order.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from skimage.morphology import skeletonize

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray, UInt8Array
from interloc.config import PAPER, DetectorConfig, HarrisCandidates, OccupancyConfig
from interloc.detection.accumulation import roi_around
from interloc.detection.detector import KeyframeDetections
from interloc.detection.edges import SLACK_M
from interloc.detection.image import Roi
from interloc.detection.keyframes import Keyframe, select_keyframes
from interloc.detection.refinement import PARALLEL, UNKNOWN_M
from interloc.drive import Drive, scans_of
from interloc.geometry import rotate_2d, yaw_of
from interloc.pipeline import RangeResult, assemble
from interloc.processes import Progress, Stopwatch, peak_memory_bytes
from interloc.results import DriveResult

REFERENCE = PAPER

BESIDE = np.ones((3, 3), np.uint8)  # a pixel and its eight neighbours


class Junction(NamedTuple):
    """An intersection in the image: row and column, unit direction and pixels of each branch, distance of its lines."""

    position: FloatArray
    directions: FloatArray
    lengths: FloatArray
    residual: float


def detect_by_reference(drive: Drive) -> DriveResult:
    """Find the intersections along a drive as `interloc.detect` does, but by the steps of this module."""
    keyframes = select_keyframes(drive.T_world_lidar, REFERENCE.keyframes)
    found = find_range(drive, keyframes, 0, len(keyframes))
    return assemble(drive, keyframes, [found], REFERENCE, workers=1, seconds=0.0)


def find_range(
    drive: Drive,
    keyframes: IntArray,
    start: int,
    stop: int,
    config: DetectorConfig = REFERENCE,
    progress: Progress | None = None,
) -> RangeResult:
    """Find the intersections around the keyframes of a range; see `interloc.pipeline.detect_range`."""
    stopwatch, found = Stopwatch(), []
    scans = list(scans_of(drive, keyframes))
    road_points: dict[int, Float32Array] = {}  # of the keyframes in the window
    for k in range(start, stop):
        window = range(max(0, k - config.keyframes.window), min(len(scans), k + config.keyframes.after + 1))
        stopwatch.start()
        road_points = {i: road_points[i] if i in road_points else scans[i].road_points for i in window}
        stopwatch.lap("read")
        keyframe = Keyframe(scans[k].frame, scans[k].T_world_lidar, scans[k].time_s)
        points = [(scans[i].T_world_lidar, road_points[i]) for i in window]
        found.append(detect_around(keyframe, points, config, stopwatch))
        if progress is not None:
            progress(len(found), stop - start)
    return RangeResult(start, found, stopwatch.seconds, peak_memory_bytes())


def detect_around(
    keyframe: Keyframe, points: list[tuple[FloatArray, Float32Array]], config: DetectorConfig, stopwatch: Stopwatch
) -> KeyframeDetections:
    """Find the intersections around a keyframe: all of section III.

    `points` are pose, (4, 4), and road points in L, (N, 3), of each keyframe of the window (III-B.1).
    """
    resolution_m, lap = config.bev.resolution_m, stopwatch.lap
    roi = roi_around(keyframe, config.bev)
    stopwatch.start()
    world = concatenate(points)  # III-B.2
    lap("accumulate")
    bev = project(world, roi, config.bev.min_points)  # III-B.3
    lap("bev")
    occupancy = infer_occupancy(bev, config.occupancy, resolution_m)  # III-B.4
    lap("occupancy")
    centerline = skeletonize(occupancy > 0)  # type: ignore[no-untyped-call]  # III-B.5
    lap("centerline")
    assert isinstance(config.candidates, HarrisCandidates)
    corners = find_corners(centerline, config.candidates)  # III-B.6
    candidates = merge(corners, config.candidates.merge_m / resolution_m)
    lap("candidates")
    junctions = []
    for i, candidate in enumerate(candidates):
        others = np.delete(candidates, i, axis=0)
        branches = segment_branches(centerline, candidate, others, resolution_m, config)  # III-C.1
        if len(branches) >= config.branches.min_branches:
            junctions.append(refine(candidate, branches, config.branches.inner_radius_m / resolution_m))  # III-C.2
    lap("refinement")
    return locate(junctions, keyframe, roi, config)


def concatenate(points: list[tuple[FloatArray, Float32Array]]) -> FloatArray:
    """Put the road points of all keyframes of the window together, x and y in W (paper, eq. 2)."""
    return np.concatenate([xyz @ T[:2, :3].T + T[:2, 3] for T, xyz in points])


def project(world_xy: FloatArray, roi: Roi, min_points: int) -> UInt8Array:
    """Set the cells with enough road points (paper, eq. 3)."""
    cells = np.floor(world_xy / roi.resolution_m).astype(np.int64)
    rows, cols = roi.top - cells[:, 1], cells[:, 0] - roi.left
    inside = (rows >= 0) & (rows < roi.size) & (cols >= 0) & (cols < roi.size)
    counts = np.bincount(rows[inside] * roi.size + cols[inside], minlength=roi.size**2)
    return (counts.reshape(roi.size, roi.size) >= min_points).astype(np.uint8)


def infer_occupancy(bev: UInt8Array, config: OccupancyConfig, resolution_m: float) -> UInt8Array:
    """Close the gaps, then remove what is too small to be road (paper, eq. 4)."""
    closing, opening = (_disc(diameter_m / resolution_m) for diameter_m in (config.closing_m, config.opening_m))
    closed = cv2.morphologyEx(bev, cv2.MORPH_CLOSE, closing)
    return cv2.morphologyEx(closed, cv2.MORPH_OPEN, opening).astype(np.uint8)


def _disc(diameter: float) -> UInt8Array:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (round(diameter), round(diameter))).astype(np.uint8)


def find_corners(centerline: BoolArray, config: HarrisCandidates) -> FloatArray:
    """Return row and column of the Harris corners on the centerline, the best first (paper, eq. 6)."""
    score = cv2.cornerHarris(centerline.astype(np.float32), config.block_px, 3, config.k)
    score[~centerline] = 0.0
    peaks = (score > 0) & (score == cv2.dilate(score, np.ones((config.peak_px, config.peak_px), np.uint8)))
    corners = np.argwhere(peaks & (score >= config.min_score * score.max()))
    return corners[np.argsort(-score[tuple(corners.T)], kind="stable")].astype(np.float64)


def merge(points: FloatArray, radius: float) -> FloatArray:
    """Replace points by the average of all that were merged with them, until none are near each other (III-C.1)."""
    groups = [point[None] for point in points]
    i = 0
    while i < len(groups):
        near = [j for j, group in enumerate(groups) if j != i and math.dist(group.mean(0), groups[i].mean(0)) < radius]
        groups[i] = np.concatenate([groups[i], *(groups[j] for j in near)])
        groups = [group for j, group in enumerate(groups) if j not in near]
        i = 0 if near else i + 1
    return np.array([group.mean(axis=0) for group in groups]).reshape(-1, 2)


def segment_branches(
    centerline: BoolArray, candidate: FloatArray, others: FloatArray, resolution_m: float, config: DetectorConfig
) -> list[FloatArray]:
    """Return the pixels, (P, 2), of each connected piece of centerline that leaves the inner circle (eq. 7 and 8)."""
    inner, outer = config.branches.inner_radius_m / resolution_m, config.branches.outer_radius_m / resolution_m
    pixels = np.argwhere(centerline)
    distance = np.hypot(*(pixels - candidate).T)
    ring = (distance > inner) & (distance < outer)
    at_other = np.zeros(len(pixels), np.bool_)
    for other in others:
        at_other |= np.hypot(*(pixels - other).T) < config.branches.stop_m / resolution_m

    def image_of(mask: BoolArray) -> UInt8Array:
        image = np.zeros(centerline.shape, np.uint8)
        image[tuple(pixels[mask].T)] = 1
        return image

    rows, cols = pixels.T
    begins = cv2.dilate(image_of(distance <= inner), BESIDE)[rows, cols] > 0
    free = ring & (begins | ~at_other)  # an intersection right behind the circle is the end of a branch, too
    ends = cv2.dilate(image_of(ring & ~free), BESIDE)[rows, cols] > 0
    count, pieces = cv2.connectedComponents(image_of(free), connectivity=8)
    branches = []
    for number in range(1, count):
        piece = pieces[rows, cols] == number
        is_long = distance[piece].max() * resolution_m >= config.branches.min_reach_m
        if (piece & begins).any() and (is_long or (piece & ends).any()):
            nearest_first = np.argsort(distance[piece], kind="stable")
            branches.append(pixels[piece][nearest_first].astype(np.float64))
    return branches


def refine(candidate: FloatArray, branches: list[FloatArray], inner: float) -> Junction:
    """Move a candidate to the point nearest to the lines of its branches, within the inner circle (eq. 9 and 10)."""
    starts, means = (np.array(rows) for rows in ([b[0] for b in branches], [b.mean(axis=0) for b in branches]))
    directions = (means - starts) / np.maximum(np.linalg.norm(means - starts, axis=1), 1e-9)[:, None]
    lengths = np.array([len(branch) for branch in branches], np.float64)
    normals = np.column_stack([directions[:, 1], -directions[:, 0]])
    offsets = np.sum(normals * (starts - candidate), axis=1)
    shift, _, _, singular = np.linalg.lstsq(normals, offsets)
    if singular[-1] ** 2 < PARALLEL * len(normals):  # lines that run alike meet nowhere
        return Junction(candidate, directions, lengths, math.inf)
    shift *= min(1.0, inner / max(float(np.linalg.norm(shift)), 1e-9))
    residual = float(np.sqrt(np.mean((normals @ shift - offsets) ** 2)))
    return Junction(candidate + shift, directions, lengths, residual)


def locate(junctions: list[Junction], keyframe: Keyframe, roi: Roi, config: DetectorConfig) -> KeyframeDetections:
    """Turn positions in the image into positions in W and in L (paper, eq. 11), with the score of this project."""
    rows, cols = np.array([junction.position for junction in junctions]).reshape(-1, 2).T
    world_xy = roi.world(rows, cols)
    T = keyframe.T_world_lidar
    scores, variances = [], []
    for junction in junctions:
        normals = junction.directions @ np.array([[0.0, -1.0], [1.0, 0.0]])
        of_lines = np.trace(np.linalg.inv(normals.T @ normals + np.eye(2) / UNKNOWN_M**2)) / 2.0
        variances.append(min(of_lines + SLACK_M**2 + (junction.residual * roi.resolution_m) ** 2, UNKNOWN_M**2))
        agreement = math.exp(-((junction.residual * roi.resolution_m / config.score.spread_m) ** 2))
        third_m = np.sort(junction.lengths)[-config.branches.min_branches] * roi.resolution_m
        scores.append(0.5 * agreement + 0.5 * min(1.0, third_m / (0.5 * config.branches.fit_length_m)))
    angles = [np.arctan2(-junction.directions[:, 0], junction.directions[:, 1]) for junction in junctions]
    return KeyframeDetections(
        keyframe,
        rotate_2d(world_xy - T[:2, 3], -yaw_of(T[:3, :3])),
        world_xy,
        angles,
        np.array(scores, np.float64),
        [np.full(len(each), np.nan) for each in angles],
        np.sqrt(variances),
    )
