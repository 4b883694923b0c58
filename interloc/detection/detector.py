"""The detector: intersections around the vehicle, keyframe by keyframe (paper, section III)."""

import math
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import DEFAULT, DetectorConfig
from interloc.detection.accumulation import BevImage, RoadAccumulator
from interloc.detection.branches import Segmentation, segment_all
from interloc.detection.candidates import Candidates, find_candidates
from interloc.detection.centerline import Centerline, extract_centerline
from interloc.detection.compound import join_halves, split_compound
from interloc.detection.image import BinaryImage, Roi
from interloc.detection.islands import place_on_rings
from interloc.detection.keyframes import Keyframe, KeyframeSelector
from interloc.detection.occupancy import branch_widths, infer_occupancy
from interloc.detection.refinement import Junction, refine
from interloc.detection.scan import ScanLike, checked_points, checked_pose
from interloc.errors import expect
from interloc.geometry import rotate_2d, yaw_of
from interloc.processes import Stopwatch


@dataclass(frozen=True)
class KeyframeDetections:
    """What was found around one keyframe; n detections."""

    keyframe: Keyframe
    lidar_xy: FloatArray
    """(n, 2) float64: positions in L, levelled (heading only), metres (paper, eq. 11)."""
    world_xy: FloatArray
    """(n, 2) float64: positions in W, metres."""
    branch_angles_rad: list[FloatArray]
    """List of (B,) float64: direction of each branch in W, counter-clockwise from +x."""
    score: FloatArray
    """(n,) float64: 0..1, how sure the detector is."""
    branch_widths_m: list[FloatArray]
    """List of (B,) float64: width of the road across each branch, metres; NaN where it is not known."""
    std_m: FloatArray
    """(n,) float64: standard deviation along each axis, metres, by how well its lines are known and meet."""

    def __repr__(self) -> str:
        places = ", ".join(f"({x:.1f}, {y:.1f})" for x, y in self.lidar_xy.tolist())
        return (
            f"<KeyframeDetections frame {self.keyframe.frame}: {len(self.score)}{f' at {places} m' if places else ''}>"
        )


@dataclass(frozen=True)
class Steps:
    """The images and points between the steps for one keyframe, for pictures."""

    roi: Roi
    """Where the images lie in W."""
    min_points: int
    """Points from which a cell is road: m, lowered where keyframes are sparse."""
    bev: BinaryImage
    occupancy: BinaryImage
    centerline: Centerline
    candidates: Candidates
    """Of sections III-B.3 to 6 of the paper."""
    segmentation: Segmentation
    """The pieces of centerline around each candidate, and the branches of those that were kept (III-C.1)."""
    junctions: list[Junction]
    """The candidates that were kept, corrected (III-C.2); one may have been split into several."""


@dataclass(frozen=True)
class Window:
    """The road around one keyframe, whose neighbours have all been accumulated."""

    keyframe: Keyframe
    bev: BevImage
    config: DetectorConfig
    stopwatch: Stopwatch
    """Of the detector."""

    def steps(self) -> Steps:
        """Run the steps of the paper."""
        bev, config, lap = self.bev, self.config, self.stopwatch.lap
        self.stopwatch.start()
        occupancy = infer_occupancy(bev.image, config.occupancy, bev.against)  # III-B.4
        lap("occupancy")
        centerline = extract_centerline(occupancy, config.centerline)  # III-B.5
        lap("centerline")
        candidates = find_candidates(centerline, config.candidates)  # III-B.6
        lap("candidates")
        segmentation = segment_all(candidates, centerline, config.branches, bev.share, bev.against)  # III-C.1
        branches = segmentation.branches
        if config.compound is not None:
            limits = config.compound.separation_m, config.branches.straight_deg
            parts = [split_compound(each, *limits) for each in branches]
            # Junctions far apart may be intersections of their own though no lines tell: then three roads meet at each.
            apart = candidates.parted([found[0].index for found in parts if len(found) == 1 and found[0].count > 3])
            if apart is not candidates:
                candidates = apart
                segmentation = segment_all(candidates, centerline, config.branches, bev.share, bev.against)
                parts = [split_compound(each, *limits) for each in segmentation.branches]
            branches = [part for found in parts for part in found]
        road = occupancy if config.branches.line == "least_squares" else None
        prior = 0.0 if config.branches.candidate_std_m is None else config.branches.candidate_std_m**-2
        junctions = [refine(b, prior, road, bev.against) for b in branches]  # III-C.2
        if config.compound is not None:
            junctions = join_halves(junctions, *limits)
        if road is not None and junctions:
            places = place_on_rings(np.array([j.position for j in junctions]), road)
            junctions = [replace(j, position=place) for j, place in zip(junctions, places, strict=True)]
        lap("refinement")
        return Steps(bev.roi, bev.min_points, bev.image, occupancy, centerline, candidates, segmentation, junctions)

    def detect(self) -> KeyframeDetections:
        """Return the detections of the keyframe."""
        return locate(self.steps(), self.keyframe, self.config)


class Detector:
    """Finds intersections online: push scans, get the detections of the keyframe that each one completes.

    Parameters
    ----------
    config : DetectorConfig
        Settings of the method; see `interloc.preset`. ``config.keyframes.lookahead`` keyframes (20, about 40 m, unless
        set) pass before the detections of one come back: `push` answers late. 0 is causal: `push` answers at once, and
        fewer intersections ahead of the vehicle are found.
    room : callable or None
        Told ahead of each keyframe how many bytes of memory the window takes with it. What it raises comes from `push`,
        and the scan does not count.
    first : int
        Number of the first keyframe in its drive, where what comes before is left out: by the number its image is
        turned.

    Attributes
    ----------
    keyframes : int
        Number of scans so far that were keyframes.

    Notes
    -----
    The last keyframes come by `finish` alone: their windows are cut short by the end of the drive. `interloc.stream`
    does both in one loop.

    Examples
    --------
    ::

        detector = interloc.Detector()
        for scan in scans:
            if (found := detector.push(scan)) is not None:
                print(found.keyframe.frame, found.world_xy)
        for found in detector.finish():
            print(found.keyframe.frame, found.world_xy)
    """

    def __init__(
        self, config: DetectorConfig = DEFAULT, room: Callable[[int], None] | None = None, first: int = 0
    ) -> None:
        expect(config, DetectorConfig)
        self.config = config
        self.stopwatch = Stopwatch()
        self.keyframes = 0
        self._selector = KeyframeSelector(config.keyframes)
        self._road = RoadAccumulator(config.keyframes, config.bev, room, first)

    def push(self, scan: ScanLike) -> KeyframeDetections | None:
        """Take the next scan; return the detections of the keyframe that it completes, if any.

        Parameters
        ----------
        scan : Scan
            With its pose. A scan that is no keyframe is not looked at.

        Returns
        -------
        KeyframeDetections or None
            Of an earlier keyframe, unless the look-ahead is 0. None where no keyframe is complete yet.

        Raises
        ------
        DriveError
            The pose is no rigid transform of finite numbers, or the points are no (N, 3) array. The scan does not
            count: go on with the next.
        """
        window = self.take(scan)
        return None if window is None else window.detect()

    def finish(self) -> Iterator[KeyframeDetections]:
        """Return the detections of the last keyframes, whose windows the end of the drive cuts short."""
        for window in self.completed([]):
            yield window.detect()

    def completed(self, scans: Iterable[ScanLike]) -> Iterator[Window]:
        """Take the last scans of a drive; return the window of each keyframe, in order, without detecting anything."""
        for scan in scans:
            window = self.take(scan)
            if window is not None:
                yield window
        while (keyframe := self._road.finish()) is not None:
            yield self._window(keyframe)

    def take(self, scan: ScanLike) -> Window | None:
        """Take the next scan as `push` does; return the window of the keyframe that it completes, nothing detected."""
        pose = checked_pose(scan)
        selector = copy(self._selector)  # a scan that is refused does not count
        if not selector.is_keyframe(pose):
            return None
        self.stopwatch.start()
        road_points = checked_points(scan.road_points, scan)  # III-B.1
        other_points = scan.other_points if self.config.bev.vote else None
        if other_points is not None:
            other_points = checked_points(other_points, scan)
        self.stopwatch.lap("read")
        keyframe = Keyframe(scan.frame, pose, scan.time_s, bool(getattr(scan, "is_doubtful", False)))
        completed = self._road.add(keyframe, road_points, other_points)  # III-B.2
        self._selector, self.keyframes = selector, self.keyframes + 1
        self.stopwatch.lap("accumulate")
        return None if completed is None else self._window(completed)

    def _window(self, completed: Keyframe) -> Window:
        self.stopwatch.start()
        bev = self._road.bev()  # III-B.3
        self.stopwatch.lap("bev")
        return Window(completed, bev, self.config, self.stopwatch)


def locate(steps: Steps, keyframe: Keyframe, config: DetectorConfig) -> KeyframeDetections:
    """Turn junctions of the image into positions in W and in L (paper, eq. 11)."""
    junctions, roi = steps.junctions, steps.roi
    positions = np.array([j.position for j in junctions], np.float64).reshape(-1, 2)
    world_xy = roi.world(positions[:, 0], positions[:, 1])
    T = keyframe.T_world_lidar
    lidar_xy = rotate_2d(world_xy - T[:2, 3], -yaw_of(T[:3, :3]))
    lines = [j.branches.lines for j in junctions]
    directions = [each["direction"] for each in lines]
    angles = [np.arctan2(-each[:, 0], each[:, 1]) + roi.turn_rad for each in directions]  # rows go against +y
    widths = [branch_widths(j.position, j.branches.lines, steps.occupancy) for j in junctions]
    score = np.array([_score(j, config) for j in junctions], np.float64)
    std_m = np.array([j.std_m for j in junctions], np.float64)
    return KeyframeDetections(keyframe, lidar_xy, world_xy, angles, score, widths, std_m)


def _score(junction: Junction, config: DetectorConfig) -> float:
    """Rate a junction 0..1: its lines meet in a point, and its third branch is long enough to be a road."""
    resolution_m, needed = junction.branches.resolution_m, config.branches.min_branches
    agreement = math.exp(-((junction.residual * resolution_m / config.score.spread_m) ** 2))
    lengths = np.sort(junction.branches.lengths)
    length = lengths[-needed] if len(lengths) >= needed else 0.0
    is_road = min(1.0, length * resolution_m / (0.5 * config.branches.fit_length_m))
    return float(0.5 * agreement + 0.5 * is_road)
