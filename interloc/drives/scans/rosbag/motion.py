"""Where the LiDAR was, and when: odometry, poses or /tf, with what is between their frame and that of the points."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import BoolArray, FloatArray
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.scans.rosbag.bag import Bag, BagTopic
from interloc.drives.scans.rosbag.frames import ROW, Edge, FrameTree, timed_poses
from interloc.drives.scans.rosbag.messages import TRANSFORMS, StampedPose, read_pose
from interloc.drives.scans.rosbag.stamps import clock_lead_s

TOLERANCE_S = 0.005
"""So far outside of the poses a scan may lie; it takes the nearest."""

_BODIES = ("base_link", "base_footprint", "base", "body", "vehicle", "ego_vehicle", "imu_link", "imu")


@dataclass(frozen=True)
class LidarMotion:
    """Poses of the LiDAR over time."""

    edges: tuple[Edge, ...]
    """From the frame that carries the LiDAR up to the fixed one."""
    T_body_lidar: FloatArray
    """(4, 4) float64."""
    count: int
    """Poses that were read."""
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


def read_motion(
    bag: Bag, topic: BagTopic, tree: FrameTree, points_frame: str, findings: Findings, *, by_log: bool = False
) -> LidarMotion:
    """Read the poses of a topic, and bring them to the LiDAR.

    Parameters
    ----------
    tree : FrameTree
    points_frame : str
        Frame of the points.
    by_log : bool
        Take the times at which the poses were recorded, not those in their headers.

    Raises
    ------
    DriveError
        There are no poses, they are damaged, or the points were moved into the fixed frame already.
    """
    if topic.type in TRANSFORMS:
        return _from_tree(bag, topic, tree, points_frame, findings)
    edge, count, lead_s = _read_edge(bag, topic, findings, by_log=by_log)
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
            f"{why}: taken as poses of the LiDAR itself. Record /tf_static, or choose other poses with --poses.",
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


def _read_edge(bag: Bag, topic: BagTopic, findings: Findings, *, by_log: bool) -> tuple[Edge, int, float]:
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
    if not by_log and (stamp_ns <= 0).any():
        findings.note(bag.name, f"{topic.name}: stamps of 0; the times at which the poses were recorded are used.")
        by_log = True
    times_s = (topic.log_ns[rows] if by_log else stamp_ns) / 1e9
    moves = timed_poses(times_s, np.frombuffer(values).reshape(-1, ROW - 1)[rows], topic.name)
    if moves is None:
        raise bag.fault(
            f"{topic.name}: none of {len(stamps):,} poses is one. Expected finite positions, and unit quaternions. "
            "Usual cause: an odometry that never started.",
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
                "bag without odometry, or --poses is needed.",
            )
        if points_frame != body:
            findings.warning(
                bag.name,
                f"no transform leads from {points_frame or 'the frame of the points'} to {body}: the poses of {body} "
                "are taken as those of the LiDAR itself. Record /tf_static.",
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
    """Return the error to raise about points that are not in the frame of the sensor."""
    return bag.fault(
        f"the points are in {frame}, the fixed frame of {topic}: they were moved there already. Expected points as the "
        "sensor saw them. Choose their topic with --points.",
    )
