"""Where the LiDAR was at every scan of a bag: its poses and GNSS fixes, or a file of poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.georeference.fixes import (
    MIN_EXTENT_M,
    MIN_FIXES,
    Fixes,
    extent_m,
    georeference_from_fixes,
)
from interloc.drives.georeference.geodetic import check_georeference
from interloc.drives.georeference.read import read_georeference
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.recorded import Topic
from interloc.drives.scans.rosbag.bag import Bag, BagTopic
from interloc.drives.scans.rosbag.frames import FrameTree, latest_of_each, read_tree
from interloc.drives.scans.rosbag.messages import NO_FIX, TRANSFORMS, read_fix
from interloc.drives.scans.rosbag.motion import Motion, read_motion
from interloc.drives.scans.rosbag.stamps import ScanTimes
from interloc.drives.scans.rosbag.topics import (
    PointsTopic,
    choose_fix,
    is_static,
    pose_topics,
    topic_list,
)
from interloc.drives.scans.rosbag.wire import WireError
from interloc.drives.trajectory import LidarPoses, Trajectory, read_trajectory
from interloc.errors import InterLocError
from interloc.geometry import invert_transform


class BagTrajectory:
    """Reads the motion of a bag once, when it is opened; what is wrong with it is raised when it is asked for.

    Attributes
    ----------
    bag : Bag
    points : PointsTopic
    parts : DriveParts
    times : ScanTimes
        Of all scans.
    frames : (N,) int64
        Numbers of the scans that are used.
    times_s : (N,) float64
        Their times, seconds.
    """

    def __init__(
        self, bag: Bag, points: PointsTopic, parts: DriveParts, times: ScanTimes, options: DriveOptions
    ) -> None:
        self.bag, self.points, self.parts, self.times = bag, points, parts, times
        self.frames: IntArray = np.empty(0, dtype=np.int64)
        self.times_s: FloatArray = np.empty(0)
        self._options = options
        self._motion: Motion | None = None
        self._tree = FrameTree()
        self._poses: BagTopic | None = None
        self._fix: BagTopic | None = None
        self._fault: InterLocError | None = None
        self._by_log = False

    def choose_scans(self, findings: Findings) -> IntArray:
        """Read the poses, and return the numbers of the scans whose pose is known: all, where there are no poses."""
        every = np.arange(len(self.times.order), dtype=np.int64)
        self.frames, self.times_s = every, self.times.stamp_s
        if self._pose_file() is not None:
            return every
        try:
            covered = self._find_motion(findings)
        except InterLocError as fault:
            self._fault = fault
            return every
        times_s = self.times.log_s if self._by_log else self.times.stamp_s
        left_out = int(np.count_nonzero(~covered))
        if left_out:
            first, last = self._moved.span_s
            findings.note(
                self.bag.name,
                f"{left_out:,} of {len(covered):,} scans are left out: no pose is known at their time. The poses last "
                f"from {first:.3f} s to {last:.3f} s, the scans from {times_s.min():.3f} s to {times_s.max():.3f} s.",
            )
        self.frames, self.times_s = every[covered], times_s[covered]
        return self.frames

    def _pose_file(self) -> Path | None:
        """Return the file of poses that was given instead of a topic."""
        given = self._options.poses
        if given is None or any(topic.name.lstrip("/") == given.lstrip("/") for topic in self.bag.topics):
            return None
        return Path(given) if Path(given).is_file() else None

    @property
    def _moved(self) -> Motion:
        assert self._motion is not None
        return self._motion

    def _find_motion(self, findings: Findings) -> BoolArray:
        """Read the poses; return at which scans they are known."""
        bag = self.bag
        self._fix = choose_fix(bag, self._options.fix, findings)
        candidates = pose_topics(bag, self._options.poses)
        if not candidates:
            only = "It has GNSS fixes, but these tell no attitude, and are too far apart in time. " if self._fix else ""
            raise DriveFileError(
                bag.name,
                f"holds no poses. {only}Expected nav_msgs/Odometry, PoseStamped or /tf of an odometry or SLAM, or a "
                f"file of poses (--poses). It holds: {topic_list(bag)}.",
            )
        try:
            self._tree = read_tree(bag, [topic for topic in bag.topics if topic.type in TRANSFORMS])
        except WireError as error:
            raise DriveFileError(bag.name, f"a message of /tf or /tf_static: {error}.") from error
        faults: list[DriveFileError] = []
        for topic in candidates:
            try:
                covered = self._cover(topic, findings)
            except DriveFileError as error:
                faults.append(error)
                continue
            for fault in faults:
                findings.warning(fault.path, fault.message)
            if others := [other.name for other in candidates if other is not topic]:
                findings.note(
                    bag.name,
                    f"the poses are taken from {topic.name} ({topic.type}); others may be in {', '.join(others[:5])}. "
                    "Choose with --poses.",
                )
            self._poses = topic
            return covered
        raise faults[0]

    def _cover(self, topic: BagTopic, findings: Findings) -> BoolArray:
        """Take the poses of a topic; return at which scans they are known.

        Raises
        ------
        DriveError
            At none.
        """
        bag, frame, stamp_s, log_s = self.bag, self.points.frame_id, self.times.stamp_s, self.times.log_s
        said = Findings(stop_at_first=False)
        motion = read_motion(bag, topic, self._tree, frame, said)
        covered, by_log = motion.covers(stamp_s), False
        first, last = motion.span_s
        if not covered.any() and topic.type not in TRANSFORMS and (stamp_s.max() < first or stamp_s.min() > last):
            motion = read_motion(bag, topic, self._tree, frame, Findings(stop_at_first=False), by_log=True)
            covered, by_log = motion.covers(log_s), True
        if not covered.any():
            raise DriveFileError(
                bag.name,
                f"no scan has a pose of {topic.name}: the scans last from {stamp_s.min():.3f} s to {stamp_s.max():.3f} "
                f"s, the poses from {first:.3f} s to {last:.3f} s. Expected poses at most 2 s apart while scans were "
                "taken. Usual cause: different clocks, or an odometry that did not run.",
            )
        for finding in said.found:
            (findings.warning if finding.severity == "warning" else findings.note)(finding.path, finding.message)
        if by_log:
            findings.warning(
                bag.name,
                f"the stamps of {self.points.topic.name} and {topic.name} are of different clocks; the times at which "
                "the messages were recorded are used instead, which is less exact. Usual cause: a LiDAR without time "
                "synchronisation.",
            )
        self._motion, self._by_log = motion, by_log
        return covered

    def topics(self) -> tuple[Topic, ...]:
        """Return all topics of the bag, with what they are read as."""
        return tuple(
            Topic(name=topic.name, type=topic.type, messages=len(topic), role=self._role(topic))
            for topic in self.bag.topics
        )

    def _role(self, topic: BagTopic) -> str | None:
        if topic is self.points.topic:
            return "points"
        if topic is self._poses:
            return "poses"
        if topic is self._fix:
            return "fix"
        if topic.type in TRANSFORMS and len(topic) and self._motion is not None:
            from_tree = self._poses is not None and self._poses.type in TRANSFORMS
            return "extrinsics" if is_static(topic) or not from_tree else "poses"
        return None

    def read(self, options: DriveOptions, findings: Findings) -> Trajectory:
        """Return poses and times of the scans, and their georeference.

        Raises
        ------
        DriveError, GeoreferenceError
            The first fault, where `findings` stops at it.
        """
        if (file := self._pose_file()) is not None:
            parts = replace(self.parts, poses=file)
            return read_trajectory(parts, self.frames, options, findings, times_s=self.times_s)
        if self._fault is not None:
            with findings.stage():
                raise self._fault
            return Trajectory(times_s=self.times_s, georeference_reason="the poses could not be read")
        world = self._moved.at(self.times_s)
        relative: FloatArray = invert_transform(world[0]) @ world
        relative[0] = np.eye(4)
        poses = LidarPoses(relative, "lidar", self._moved.reason)
        georeference, reason = None, ""
        with findings.stage():
            try:
                georeference = read_georeference(self.parts, self.frames, options.oxts)
            except InterLocError as error:
                reason = str(error)
                raise
        if georeference is not None or reason:
            return Trajectory(poses, self._moved.count, self.times_s, georeference, reason)
        if self._fix is None:
            reason = "the bag holds no GNSS fixes (sensor_msgs/NavSatFix)"
            return Trajectory(poses, self._moved.count, self.times_s, None, reason)
        with findings.stage():
            fixes, reason = self._fixes(self._fix, world, findings)
            if fixes is not None:
                source = f"{self._fix.name} (GNSS), heading from the motion"
                georeference = georeference_from_fixes(fixes[0], world, fixes[1], source)
                doubts = Findings(stop_at_first=False)
                check_georeference(relative, georeference, doubts)
                if doubts.found:
                    georeference, reason = None, f"{self._fix.name} {doubts.found[0].message}"
                    findings.warning(self.bag.name, reason)
        if georeference is None:
            findings.note(self.bag.name, f"no georeference: {reason}")
        return Trajectory(poses, self._moved.count, self.times_s, georeference, "" if georeference else reason)

    def _fixes(
        self, topic: BagTopic, world: FloatArray, findings: Findings
    ) -> tuple[tuple[Fixes, FloatArray] | None, str]:
        """Read the fixes within the poses, and the distance driven until every scan; or why there are none."""
        assert topic.encoding is not None
        messages = []
        for number, message in enumerate(self.bag.messages(topic)):
            try:
                messages.append(read_fix(message, topic.encoding))
            except WireError as error:
                raise DriveFileError(self.bag.name, f"{topic.name}, message {number}: {error}.") from error
        stamps = np.array([fix.header.stamp_ns for fix in messages], dtype=np.int64)
        unset = bool((stamps <= 0).any())
        times_s = (topic.log_ns if self._by_log or unset else stamps) / 1e9
        positions = np.array([fix.position for fix in messages], dtype=np.float64).reshape(-1, 3)
        sound = _sound_fixes(positions, [fix.status for fix in messages])
        if not sound.any():
            return None, f"{topic.name}: none of {len(messages):,} fixes has a position"
        positions[~np.isfinite(positions[:, 2]), 2] = 0.0
        covered = sound & self._moved.covers(times_s)
        if not covered.any() and (by_log := sound & self._moved.covers(topic.log_ns / 1e9)).any():
            findings.warning(
                self.bag.name,
                f"the stamps of {topic.name} are of another clock; the times of recording are used.",
            )
            times_s, covered = topic.log_ns / 1e9, by_log
        rows = np.flatnonzero(covered)[latest_of_each(times_s[covered])]
        if len(rows) < MIN_FIXES:
            return None, (
                f"{topic.name}: {len(rows)} of {len(messages):,} fixes have a position while the pose is known; "
                f"expected at least {MIN_FIXES}"
            )
        at_fixes = self._moved.at(times_s[rows])
        frames = [fix.header.frame_id for fix in messages]
        antenna = self._antenna(frames[int(rows[0])])
        places = at_fixes[:, :3, :3] @ antenna + at_fixes[:, :3, 3]
        distance_m = _distances(
            np.concatenate([times_s[rows], self.times_s]), np.concatenate([at_fixes[:, :3, 3], world[:, :3, 3]])
        )
        fixes = Fixes(positions[rows, 0], positions[rows, 1], positions[rows, 2], places, distance_m[: len(rows)])
        if extent_m(fixes) < MIN_EXTENT_M or float(np.ptp(places, axis=0).max()) < MIN_EXTENT_M / 2:
            return None, (
                f"{topic.name}: the fixes reach over {extent_m(fixes):.1f} m; expected at least {MIN_EXTENT_M:.0f} m, "
                "or the heading is not known"
            )
        return (fixes, distance_m[len(rows) :]), ""

    def _antenna(self, frame_id: str) -> FloatArray:
        """Return the (3,) position of the antenna in the frame of the LiDAR; zero where it is not known."""
        between = self._tree.between(self.points.frame_id, frame_id) if frame_id else None
        return np.zeros(3) if between is None else between[:3, 3]


def _sound_fixes(positions: FloatArray, status: Sequence[int]) -> BoolArray:
    """Tell which of (K, 3) fixes are positions on Earth."""
    lat, lon = positions[:, 0], positions[:, 1]
    with np.errstate(invalid="ignore"):
        on_earth = (np.abs(lat) < 89) & (np.abs(lon) <= 360) & ((lat != 0) | (lon != 0))
        height = ~(np.abs(positions[:, 2]) > 20_000)
    sound: BoolArray = (np.array(status) > NO_FIX) & on_earth & height
    return sound


def _distances(times_s: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the distance driven until each of (M,) times at (M, 3) positions, in the order in which they are given."""
    order = np.argsort(times_s, kind="stable")
    steps = np.linalg.norm(np.diff(positions[order], axis=0), axis=1)
    distances = np.empty(len(times_s))
    distances[order] = np.concatenate([[0.0], np.cumsum(steps)])
    return distances
