"""Where the LiDAR is, from odometry and /tf as they come in: nothing is extrapolated."""

from collections import deque

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.poses.motion import TimedPoses, rotations_from_quaternions
from interloc.drives.scans.rosbag.messages import StampedPose

_KEPT = 1000  # poses of each frame: ten seconds at 100 Hz
_MAX_DEPTH = 20


class Frames:
    """A tree of frames, each with the poses that it lately had in the frame above it."""

    def __init__(self) -> None:
        self._moves: dict[str, tuple[str, deque[tuple[float, FloatArray]], bool]] = {}

    def put(self, pose: StampedPose, *, is_fixed: bool = False) -> None:
        """Take a pose of its `child_frame` in the frame of its header."""
        x, y, z, *quaternion = pose.values
        T = np.eye(4)
        T[:3, 3] = x, y, z
        T[:3, :3] = rotations_from_quaternions(np.array([quaternion]))[0]
        parent, time_s = pose.header.frame_id, pose.header.stamp_ns / 1e9
        known = self._moves.get(pose.child_frame)
        if known is None or known[0] != parent or is_fixed:
            known = (parent, deque(maxlen=_KEPT), is_fixed)
            self._moves[pose.child_frame] = known
        elif known[1] and time_s <= known[1][-1][0]:
            return  # sent again, or late
        known[1].append((time_s, T))

    def knows(self, frame: str) -> bool:
        """Return whether a frame lies in another one."""
        return frame in self._moves

    def pose(self, frame: str, time_s: float, world: str | None = None) -> tuple[FloatArray, str] | None:
        """Find the pose (4, 4) of a frame in another one above it, by default the topmost, and return that, too.

        None where it is not known, or not yet.
        """
        T = np.eye(4)
        for _ in range(_MAX_DEPTH):
            if frame == world or (world is None and frame not in self._moves and self._moves):
                return T, frame
            if frame not in self._moves:
                return None
            frame, poses, is_fixed = self._moves[frame]
            times = np.array([each for each, _ in poses])
            if is_fixed:
                T = poses[-1][1] @ T
            elif times[0] <= time_s <= times[-1]:
                T = TimedPoses(times, np.array([each for _, each in poses])).at([time_s])[0] @ T
            else:
                return None
        return None
