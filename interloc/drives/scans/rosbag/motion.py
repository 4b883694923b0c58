"""Where the LiDAR was, and when: odometry, poses or /tf, with what is between their frame and that of the points."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drives.files import MAX_NUMBER
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.poses.motion import LONGEST_GAP_S, TimedPoses, rotations_from_quaternions
from interloc.drives.scans.rosbag.bag import Bag, BagTopic, clock_lead_s
from interloc.drives.scans.rosbag.messages import TRANSFORMS, StampedPose, read_pose, read_transforms
from interloc.geometry import invert_transform, rigid_transforms

ROW = 8
"""Numbers of a transform: time, x y z, quaternion x y z w."""

_EARTH = {"earth", "ecef", "utm"}
_MOVED = 1e-4
"""Metres, or radians: two publishers of one mounting differ by their rounding."""


@dataclass(frozen=True)
class Edge:
    """How one frame lies in another, over time."""

    parent: str
    child: str
    moves: TimedPoses
    """T_parent_child."""
    holds: bool = False
    """Each holds until the next, as a localiser means it that publishes its corrections when they change."""

    @cached_property
    def fixed(self) -> bool:
        """True where it never changes."""
        return bool(np.ptp(self.moves.poses, axis=0).max() < _MOVED)

    @cached_property
    def is_rare(self) -> bool:
        """True where it is mostly told less than once a second."""
        return len(self.moves.times_s) < 2 or float(np.median(np.diff(self.moves.times_s))) > 1.0

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return (N, 4, 4) T_parent_child at some times."""
        if self.fixed:
            return np.repeat(self.moves.poses[:1], len(times_s), axis=0)
        if self.holds:
            return self.moves.poses[np.maximum(np.searchsorted(self.moves.times_s, times_s, side="right") - 1, 0)]
        return self.moves.at(times_s)

    def covers(self, times_s: FloatArray) -> BoolArray:
        """Tell at which of (N,) times it is known."""
        if self.fixed or self.holds:
            return np.ones(len(times_s), dtype=np.bool_)
        return self.moves.covers(times_s, longest_gap_s=LONGEST_GAP_S)


@dataclass(frozen=True)
class FrameTree:
    """All transforms of a bag, by the frames that they lead from."""

    lead_s: float = float("nan")
    """By how much the stamps of /tf are ahead of the times at which they were recorded, the median."""
    parents: dict[str, str] = field(default_factory=dict)
    rows: dict[str, array[float]] = field(default_factory=dict)
    """Time in seconds, x y z in metres and quaternion x y z w of all transforms of each frame, one after the other."""
    _edges: dict[str, Edge | None] = field(default_factory=dict)

    def edge(self, child: str) -> Edge | None:
        """Return how a frame lies in its parent; None where no transform tells."""
        if child not in self._edges:
            moves = None
            if child in self.parents:
                rows = np.frombuffer(self.rows[child]).reshape(-1, ROW)
                moves = timed_poses(rows[:, 0], rows[:, 1:], f"{self.parents[child]} -> {child}")
            self._edges[child] = None if moves is None else Edge(self.parents[child], child, moves)
        return self._edges[child]

    def cure(self, otherwise: str) -> str:
        """Say what mends a transform that is missing: those that are there without a rotation, if any are."""
        bad = [f"{self.parents[child]} -> {child}" for child in self.parents if self.edge(child) is None]
        if not bad:
            return otherwise
        return (
            f"{', '.join(bad[:5])} of the transforms has no rotation (a quaternion 0 0 0 0, or one whose length is not "
            "1) and is not used: give it one, 0 0 0 1 where nothing is turned"
        )

    @property
    def moving(self) -> list[Edge]:
        """All edges that change over time."""
        edges = (self.edge(child) for child in self.parents)
        return [edge for edge in edges if edge is not None and not edge.fixed]

    def upwards(self, frame: str) -> list[Edge]:
        """Return the edges from a frame to the root of its tree; frames that span the Earth do not count."""
        edges: list[Edge] = []
        seen = {frame}
        while (edge := self.edge(frame)) is not None and edge.parent not in seen | _EARTH:
            edges.append(edge)
            frame = edge.parent
            seen.add(frame)
        return edges

    def between(self, target: str, source: str) -> FloatArray | None:
        """Return (4, 4) T_target_source, where both are fixed to each other; else None."""
        if target == source:
            return np.eye(4)
        to_source = self._fixed_above(source)
        to_target = self._fixed_above(target)
        common = next((frame for frame in to_source if frame in to_target), None)
        if common is None:
            return None
        return invert_transform(to_target[common]) @ to_source[common]

    def _fixed_above(self, frame: str) -> dict[str, FloatArray]:
        """Return the frames above that a frame is fixed to, with T_above_frame; itself first."""
        above = {frame: np.eye(4)}
        pose = np.eye(4)
        for edge in self.upwards(frame):
            if not edge.fixed:
                break
            pose = edge.moves.poses[0] @ pose
            above[edge.parent] = pose
        return above


def read_tree(bag: Bag) -> FrameTree:
    """Read all transforms of a bag, of all of its files, before anything is made of them."""
    found: dict[tuple[str, str], array[float]] = {}
    leads = array("d")
    for topic in (each for each in bag.topics if each.type in TRANSFORMS and each.encoding is not None):
        for transforms, log_ns in zip(bag.decoded(topic, read_transforms), topic.log_ns, strict=True):
            for transform in transforms:
                key = (transform.header.frame_id, transform.child_frame)
                if key not in found and len(found) >= 10_000:
                    continue
                rows = found.setdefault(key, array("d"))
                if topic.name.endswith("_static"):
                    del rows[:]  # the last one holds
                elif transform.header.stamp_ns:
                    leads.append((transform.header.stamp_ns - int(log_ns)) / 1e9)
                rows.append((transform.header.stamp_ns or int(log_ns)) / 1e9)
                rows.extend(transform.values)
    tree = FrameTree(float(np.median(np.frombuffer(leads))) if leads else float("nan"))
    for (parent, child), rows in sorted(found.items(), key=lambda item: len(item[1])):  # the most messages count
        tree.parents[child], tree.rows[child] = parent, rows
    return tree


def timed_poses(times: FloatArray, numbers: FloatArray, source: str) -> TimedPoses | None:
    """Make poses of (P,) times and (P, 7) values x y z, quaternion x y z w, sorted by time; None where none is one.

    Of several at one time the last counts.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        unit = np.abs(np.linalg.norm(numbers[:, 3:], axis=1) - 1.0) < 0.05
        near = np.abs(numbers[:, :3]).max(axis=1) < MAX_NUMBER
    valid = unit & near & np.isfinite(times)
    numbers, times = numbers[valid], times[valid]
    if not len(times):
        return None
    rows = latest_of_each(times)
    poses = rigid_transforms(rotations_from_quaternions(numbers[rows, 3:]), numbers[rows, :3])
    return TimedPoses(times[rows], poses, source)


def latest_of_each(times: FloatArray) -> IntArray:
    """Return the rows of (P,) times in ascending order, of equal ones the last."""
    order = np.argsort(times, kind="stable")
    last = np.diff(times[order], append=np.inf) > 0
    return order[last]


# The motion of the LiDAR


TOLERANCE_S = 0.005
"""So far outside of the poses a scan may lie; it takes the nearest."""

_BODIES = ("base_link", "base_footprint", "base", "body", "vehicle", "ego_vehicle", "imu_link", "imu")


@dataclass(frozen=True)
class LidarMotion:
    """Poses of the LiDAR over time, and how many of them were read."""

    edges: tuple[Edge, ...]
    """From the frame that carries the LiDAR up to the fixed one."""
    T_body_lidar: FloatArray
    count: int
    reason: str
    """Which poses these are, in words."""
    lead_s: float = float("nan")
    """By how much their stamps are ahead of the times at which they were recorded; NaN where that is not known."""
    within_s: tuple[float, float] = (-np.inf, np.inf)
    """Only between these times it is used."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the pose is known, seconds."""
        spans = [edge.moves.span_s for edge in self.edges if not (edge.fixed or edge.holds)] or [
            self.edges[0].moves.span_s
        ]
        spans.append(self.within_s)
        return max(first for first, _ in spans), min(last for _, last in spans)

    def covers(self, times_s: FloatArray) -> BoolArray:
        """Tell at which of (N,) times the pose is known."""
        first, last = self.span_s
        near = (times_s >= first - TOLERANCE_S) & (times_s <= last + TOLERANCE_S)
        inside = np.clip(times_s, first, max(first, last))
        for edge in self.edges:
            near &= edge.covers(inside)
        return near

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return (N, 4, 4) T_world_lidar at times that are covered; W is the fixed frame of the poses."""
        first, last = self.span_s
        inside = np.clip(times_s, first, last)
        poses = np.repeat(self.T_body_lidar[None], len(inside), axis=0)
        for edge in self.edges:
            poses = edge.at(inside) @ poses
        return poses


def read_motion(bag: Bag, topic: BagTopic, tree: FrameTree, points_frame: str, findings: Findings) -> LidarMotion:
    """Read the poses of a topic, and bring them to the frame of the points."""
    if topic.type in TRANSFORMS:
        return _from_tree(bag, topic, tree, points_frame, findings)
    edge, count, lead_s = _read_edge(bag, topic, findings)
    if points_frame and points_frame == edge.parent and points_frame != edge.child:
        raise _moved_already(bag, points_frame, topic.name)
    extrinsic = tree.between(edge.child, points_frame) if edge.child and points_frame else None
    if extrinsic is None:
        extrinsic = np.eye(4)
        owner = f"those of {edge.child}" if edge.child else "without a frame of their own (child_frame_id)"
        why = "no transform between the two is in the bag" if edge.child else "the message does not say whose they are"
        findings.warning(
            bag.name,
            f"the poses of {topic.name} are {owner}, the points are in {points_frame or 'a frame without a name'}, and "
            f"{why}: taken as poses of the LiDAR itself. {tree.cure('Record /tf_static')}, or choose other poses with "
            "--poses.",
        )
        how = "taken as those of the LiDAR itself"
    elif edge.child == points_frame:
        how = "the frame of the points"
    else:
        how = f"moved to {points_frame} by the transforms of the bag"
    return LidarMotion(
        (edge,), extrinsic, count, f"poses of {edge.child or 'an unnamed frame'} from {topic.name}, {how}", lead_s
    )


def first_child_frame(bag: Bag, topic: BagTopic) -> str:
    """Return whose poses the first message of a topic of poses holds; "" where it does not say."""
    try:
        return next(_poses(bag, topic)).child_frame
    except DriveFileError:
        return ""


def _poses(bag: Bag, topic: BagTopic) -> Iterator[StampedPose]:
    return bag.decoded(topic, lambda message, encoding: read_pose(message, topic.type, encoding))


def _read_edge(bag: Bag, topic: BagTopic, findings: Findings) -> tuple[Edge, int, float]:
    """Read the poses of a topic of Odometry or poses; how many there are, and how far their clock is ahead."""
    stamps, values, pairs = array("q"), array("d"), array("q")
    frames: dict[tuple[str, str], int] = {}
    for pose in _poses(bag, topic):
        pairs.append(frames.setdefault((pose.header.frame_id, pose.child_frame), len(frames)))
        stamps.append(pose.header.stamp_ns)
        values.extend(pose.values)
    if not stamps:
        raise bag.fault(f"the topic {topic.name} holds no messages. Expected poses of the LiDAR.")
    usual = int(np.bincount(np.frombuffer(pairs, dtype=np.int64)).argmax())
    parent, child = list(frames)[usual]
    if len(frames) > 1:
        findings.warning(
            bag.name, f"{topic.name} mixes poses of {len(frames)} pairs of frames; only {parent} -> {child} is used."
        )
    rows = np.flatnonzero(np.frombuffer(pairs, dtype=np.int64) == usual)
    stamp_ns = np.frombuffer(stamps, dtype=np.int64)[rows]
    if by_log := bool((stamp_ns <= 0).any()):
        findings.note(bag.name, f"{topic.name}: stamps of 0; the times at which the poses were recorded are used.")
    times_s = (topic.log_ns[rows] if by_log else stamp_ns) / 1e9
    moves = timed_poses(times_s, np.frombuffer(values).reshape(-1, ROW - 1)[rows], topic.name)
    if moves is None:
        raise bag.fault(
            f"{topic.name}: none of {len(stamps):,} poses is one. Expected finite positions, and unit quaternions. "
            "Usual cause: an odometry that never started."
        )
    if len(moves.times_s) < len(rows):
        findings.note(
            bag.name,
            f"{topic.name}: {len(rows) - len(moves.times_s):,} of {len(rows):,} poses repeat a time, or are none, "
            "and are not used.",
        )
    lead_s = float("nan") if by_log else clock_lead_s(stamp_ns, topic.log_ns[rows])
    return Edge(parent, child, moves), len(stamps), lead_s


def _from_tree(bag: Bag, topic: BagTopic, tree: FrameTree, points_frame: str, findings: Findings) -> LidarMotion:
    """Find the way from the points up to the fixed frame in the transforms."""
    chain = tree.upwards(points_frame)
    extrinsic, how = np.eye(4), "up to the fixed frame"
    if all(edge.fixed for edge in chain):
        if any(edge.parent == points_frame for edge in tree.moving):
            raise _moved_already(bag, points_frame, topic.name)
        moving = {edge.child for edge in tree.moving}
        body = next((name for name in _BODIES if name in moving), None)
        body = next(iter(moving)) if body is None and len(moving) == 1 else body
        if body is None:
            frames = ", ".join(f"{parent} -> {child}" for child, parent in list(tree.parents.items())[:10]) or "none"
            raise bag.fault(
                f"{topic.name} does not say how {points_frame or 'the points'} moves. Transforms in the bag: {frames}. "
                "Expected a chain from the frame of the points to map or odom that changes over time. Usual cause: a "
                "bag without odometry, or --poses is needed."
            )
        if points_frame != body:
            findings.warning(
                bag.name,
                f"no transform leads from {points_frame or 'the frame of the points'} to {body}: the poses of {body} "
                f"are taken as those of the LiDAR itself. {tree.cure('Record /tf_static')}.",
            )
        chain, how = tree.upwards(body), "taken as those of the LiDAR itself"
    if any(not edge.fixed and not edge.is_rare for edge in chain):
        if rare := [edge for edge in chain if edge.is_rare and not edge.fixed]:
            findings.note(
                bag.name,
                f"{topic.name}: {', '.join(f'{edge.parent} -> {edge.child}' for edge in rare)} changes rarely; each "
                "transform holds until the next.",
            )
        chain = [replace(edge, holds=True) if edge in rare else edge for edge in chain]
    names = " -> ".join([chain[-1].parent, *(edge.child for edge in reversed(chain))])
    count = max(len(edge.moves.times_s) for edge in chain)
    return LidarMotion(tuple(chain), extrinsic, count, f"poses from {topic.name} ({names}), {how}", tree.lead_s)


def _moved_already(bag: Bag, frame: str, topic: str) -> DriveFileError:
    return bag.fault(
        f"the points are in {frame}, the fixed frame of {topic}: they were moved there already. Expected points as the "
        "sensor saw them. Choose their topic with --points."
    )
