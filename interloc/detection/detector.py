"""The detector: intersections around the vehicle, keyframe by keyframe (paper, section III)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.config import DEFAULT, DetectorConfig, ScoreConfig
from interloc.detection.accumulation import RoadAccumulator
from interloc.detection.branches import segment_all
from interloc.detection.candidates import Candidates, find_candidates
from interloc.detection.centerline import Centerline, extract_centerline
from interloc.detection.compound import split_compound
from interloc.detection.image import BinaryImage, Roi
from interloc.detection.keyframes import Keyframe, KeyframeSelector
from interloc.detection.occupancy import infer_occupancy
from interloc.detection.refinement import Junction, refine
from interloc.detection.scan import ScanLike
from interloc.geometry import rotate_2d, yaw_of
from interloc.stopwatch import Stopwatch


@dataclass(frozen=True)
class KeyframeDetections:
    """What was found around one keyframe; n detections.

    Attributes
    ----------
    keyframe
    lidar_xy : (n, 2) float64
        Positions in L, levelled (heading only), metres (paper, eq. 12).
    world_xy : (n, 2) float64
        Positions in W, metres.
    branch_angles_rad : list of (B,) float64
        Direction of each branch in W, counter-clockwise from +x.
    score : (n,) float64
        0..1, how sure the detector is.
    """

    keyframe: Keyframe
    lidar_xy: FloatArray
    world_xy: FloatArray
    branch_angles_rad: list[FloatArray]
    score: FloatArray


@dataclass(frozen=True)
class Steps:
    """The images and points between the steps for one keyframe, for pictures."""

    roi: Roi
    bev: BinaryImage
    occupancy: BinaryImage
    centerline: Centerline
    candidates: Candidates
    enders: IntArray  # the candidates at which branches end
    junctions: list[Junction]


class Detector:
    """Finds intersections online: push scans, get the detections of the keyframe that each one completes.

    Parameters
    ----------
    config : DetectorConfig
        ``config.keyframes.lookahead`` keyframes pass before the detections of one come back; 0 is causal.
    """

    def __init__(self, config: DetectorConfig = DEFAULT) -> None:
        self.config = config
        self._selector = KeyframeSelector(config.keyframes)
        self.stopwatch = Stopwatch()
        self._road = RoadAccumulator(config.keyframes, config.bev)

    def push(self, scan: ScanLike) -> KeyframeDetections | None:
        """Take the next scan; return the detections of the keyframe that it completes, if any."""
        keyframe = self.advance(scan)
        return None if keyframe is None else self.detect(keyframe)

    def finish(self) -> Iterator[KeyframeDetections]:
        """Return the detections of the last keyframes, whose windows the end of the drive cuts short."""
        while (keyframe := self.complete()) is not None:
            yield self.detect(keyframe)

    def advance(self, scan: ScanLike) -> Keyframe | None:
        """Take the next scan without detecting anything; return the keyframe that it completes, if any."""
        if not self._selector.is_keyframe(scan.T_world_lidar):
            return None
        self.stopwatch.start()
        road_points = scan.road_points  # III-B.1
        other_points = scan.other_points if self.config.bev.vote else None
        self.stopwatch.lap("read")
        keyframe = Keyframe(scan.frame, scan.T_world_lidar, scan.time_s)
        completed = self._road.add(keyframe, road_points, other_points)  # III-B.2
        self.stopwatch.lap("accumulate")
        return completed

    def complete(self) -> Keyframe | None:
        """Complete the next keyframe although not all its successors came; None when there is none left."""
        return self._road.finish()

    def detect(self, keyframe: Keyframe) -> KeyframeDetections:
        """Return the detections of the keyframe that was completed last."""
        steps = self.steps(keyframe)
        return locate(steps.junctions, steps.roi, keyframe, self.config.score)

    def steps(self, keyframe: Keyframe) -> Steps:
        """Run the steps of the paper on what is accumulated around the keyframe that was completed last."""
        config, resolution_m, lap = self.config, self.config.bev.resolution_m, self.stopwatch.lap
        self.stopwatch.start()
        bev, roi = self._road.bev(keyframe)  # III-B.3
        lap("bev")
        occupancy = infer_occupancy(bev, resolution_m, config.occupancy)  # III-B.4
        lap("occupancy")
        centerline = extract_centerline(occupancy, config.centerline)  # III-B.5
        lap("centerline")
        candidates = find_candidates(centerline, resolution_m, config.candidates)  # III-B.6
        lap("candidates")
        branches, enders = segment_all(candidates, centerline, resolution_m, config.branches)  # III-C.1
        if config.compound is not None:
            branches = [part for b in branches for part in split_compound(b, resolution_m, config.compound)]
        prior = config.branches.candidate_std_m
        junctions = [refine(b, 0.0 if prior is None else prior**-2) for b in branches]  # III-C.2
        lap("refinement")
        return Steps(roi, bev, occupancy, centerline, candidates, enders, junctions)


def locate(junctions: list[Junction], roi: Roi, keyframe: Keyframe, config: ScoreConfig) -> KeyframeDetections:
    """Turn junctions of the image into positions in W and in L (paper, eq. 12)."""
    positions = np.array([j.position for j in junctions], np.float64).reshape(-1, 2)
    world_xy = roi.world(positions[:, 0], positions[:, 1])
    T = keyframe.T_world_lidar
    lidar_xy = rotate_2d(world_xy - T[:2, 3], -yaw_of(T[:3, :3]))
    angles = [np.arctan2(-j.directions[:, 0], j.directions[:, 1]) for j in junctions]  # rows go against +y
    score = np.array([_score(j, roi.resolution_m, config) for j in junctions], np.float64)
    return KeyframeDetections(keyframe, lidar_xy, world_xy, angles, score)


def _score(junction: Junction, resolution_m: float, config: ScoreConfig) -> float:
    """Rate a junction 0..1: its lines meet in a point, and its third branch is long enough to be a road."""
    agreement = math.exp(-((junction.residual * resolution_m / config.spread_m) ** 2))
    lengths, rank = np.sort(junction.branches.lengths), config.rated_branch
    rated = lengths[-rank] if len(lengths) >= rank else 0.0
    is_road = min(1.0, rated * resolution_m / config.full_length_m)
    return float(config.agreement_share * agreement + (1.0 - config.agreement_share) * is_road)
