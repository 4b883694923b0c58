"""The tree of coordinate frames of a bag: /tf and /tf_static."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drives.files import MAX_NUMBER
from interloc.drives.poses.timed import TimedPoses, rotations_from_quaternions
from interloc.drives.scans.rosbag.bag import Bag
from interloc.drives.scans.rosbag.messages import TRANSFORMS, read_transforms
from interloc.geometry import invert_transform, rigid_transforms

LONGEST_GAP_S = 2.0
"""Between two poses; in a longer one nobody knows where the vehicle was."""

ROW = 8
"""Numbers of a transform: time, x y z, quaternion x y z w."""

_EARTH = {"earth", "ecef", "utm"}
_MOVED = 1e-4
"""Metres, or radians: two publishers of one mounting differ by their rounding."""

_RARE_S = 1.0
_MAX_FRAMES = 10_000
_OFF_UNIT = 0.05


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
        return len(self.moves.times_s) < 2 or float(np.median(np.diff(self.moves.times_s))) > _RARE_S

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
    """All transforms of a bag."""

    lead_s: float = float("nan")
    """By how much the stamps of /tf are ahead of the times at which they were recorded, the median."""
    parents: dict[str, str] = field(default_factory=dict)
    """The parent of each frame."""
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

    def leads_to_motion(self, frame: str) -> bool:
        """Return whether a frame is carried by one that moves."""
        return any(not edge.fixed for edge in self.upwards(frame))

    def between(self, target: str, source: str) -> FloatArray | None:
        """Return (4, 4) T_target_source, where both are fixed to each other; else None."""
        if target == source:
            return np.eye(4)
        to_source = self._fixed_above(source)
        to_target = self._fixed_above(target)
        common = next((frame for frame in to_source if frame in to_target), None)
        if common is None:
            return None
        relative: FloatArray = invert_transform(to_target[common]) @ to_source[common]
        return relative

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
    """Read all transforms of a bag, of all of its files, before anything is made of them.

    Raises
    ------
    DriveError
        A file or a message is damaged.
    """
    found: dict[tuple[str, str], array[float]] = {}
    leads = array("d")
    for topic in (each for each in bag.topics if each.type in TRANSFORMS and each.encoding is not None):
        for transforms, log_ns in zip(bag.decoded(topic, read_transforms), topic.log_ns, strict=True):
            for transform in transforms:
                key = (transform.header.frame_id, transform.child_frame)
                if key not in found and len(found) >= _MAX_FRAMES:
                    continue
                rows = found.setdefault(key, array("d"))
                if transform.header.stamp_ns and not topic.name.endswith("_static"):
                    leads.append((transform.header.stamp_ns - int(log_ns)) / 1e9)
                rows.append((transform.header.stamp_ns or int(log_ns)) / 1e9)
                rows.extend(transform.values)
    tree = FrameTree(float(np.median(np.frombuffer(leads))) if leads else float("nan"))
    for (parent, child), rows in sorted(found.items(), key=lambda item: len(item[1])):  # the most messages count
        tree.parents[child], tree.rows[child] = parent, rows
    return tree


def timed_poses(times: FloatArray, numbers: FloatArray, source: str) -> TimedPoses | None:
    """Make poses of (P,) times and (P, 7) values x y z, quaternion x y z w, without those that are none.

    They are sorted by time; of several at one time the last counts. None where none is left.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        unit = np.abs(np.linalg.norm(numbers[:, 3:], axis=1) - 1.0) < _OFF_UNIT
        near = np.abs(numbers[:, :3]).max(axis=1) < MAX_NUMBER
    sound = unit & near & np.isfinite(times)
    numbers, times = numbers[sound], times[sound]
    if not len(times):
        return None
    rows = latest_of_each(times)
    poses = rigid_transforms(rotations_from_quaternions(numbers[rows, 3:]), numbers[rows, :3])
    return TimedPoses(times[rows], poses, source)


def latest_of_each(times: FloatArray) -> IntArray:
    """Return the rows of (P,) times in ascending order, of equal ones the last."""
    order = np.argsort(times, kind="stable")
    last = np.diff(times[order], append=np.inf) > 0
    rows: IntArray = order[last]
    return rows
