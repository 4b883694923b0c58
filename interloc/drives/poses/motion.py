"""How a body moves in its own frame, and where it is between the poses that are known."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drives.findings import DriveFileError
from interloc.geometry import rigid_transforms, rows_apart

LONGEST_GAP_S = 2.0  # between two poses; in a longer one nobody knows where the vehicle was
MIN_MOTION_M = 1.0
TURNED_RAD = 0.15
"""Turning over a drive that is worth mentioning."""

_JUMP_M, _ACCELERATION_MPS2, _LONGEST_S = 5.0, 10.0, 2.0
_AROUND, _RARELY = 11, 0.05
_STANDS_M = 0.2

_STEP_M = 3.0
_JUDGED = 100_000  # poses at the beginning of a file; hours of driving tell enough
_AXES = "xyz"

_NEARLY_PARALLEL = 1e-9
"""Square of the sine of the half angle under which the great arc is the straight line."""


@dataclass(frozen=True)
class BodyMotion:
    """How a body moves in its own frame."""

    distance_m: float
    """Sum of the steps looked at, each some metres long."""
    along: FloatArray
    """(3,) float64: share of the motion along x, y, z; sums to 1."""
    forward: float
    """Mean of the steps along the main axis, -1 (backwards) to 1."""
    about: FloatArray
    """(3,) float64: share of the turning about x, y, z; sums to 1 (zeros without turning)."""
    turned_rad: float
    """Root of the sum of squared turns."""
    steadiness: float
    """Share of the motion along its main direction, whichever that is; near 1 for a vehicle."""

    @property
    def axis(self) -> str:
        """Main axis of the motion: "x", "y" or "z"."""
        return _AXES[int(np.argmax(self.along))]

    @property
    def turning_axis(self) -> str:
        """Main axis of the turns."""
        return _AXES[int(np.argmax(self.about))]

    def describe(self) -> str:
        """Return in words along which axis it moves and about which it turns."""
        text = f"it moves along its {self.axis} axis ({self.along.max():.0%} of the motion)"
        if self.turned_rad > TURNED_RAD:
            text += f" and turns about its {self.turning_axis} axis"
        return text


def body_motion(poses: FloatArray) -> BodyMotion | None:
    """Measure how a body moves in its own frame, by (P, 4, 4) T_world_body; None where it moves less than a metre."""
    poses = poses[:_JUDGED]
    position = poses[:, :3, 3]
    extent = float(np.linalg.norm(position - position[0], axis=1).max())
    if extent < MIN_MOTION_M:
        return None
    rows = rows_apart(position, min(_STEP_M, extent / 2))
    step = body_steps(poses[rows])
    length = np.linalg.norm(step, axis=1)
    unit = step / length[:, None]
    along = (unit**2).mean(axis=0)
    turn = body_turns(poses[rows])
    squares = (turn**2).sum(axis=0)
    return BodyMotion(
        distance_m=float(length.sum()),
        along=along,
        forward=float(unit[:, int(np.argmax(along))].mean()),
        about=squares / max(float(squares.sum()), 1e-12),
        turned_rad=float(np.sqrt(squares.sum())),
        steadiness=float(np.linalg.eigvalsh(unit.T @ unit / len(unit))[-1]),
    )


def body_steps(poses: FloatArray) -> FloatArray:
    """Return the (P - 1, 3) motions from pose to pose of (P, 4, 4) T_world_body, each in the frame of its body."""
    steps: FloatArray = np.einsum("nji,nj->ni", poses[:-1, :3, :3], np.diff(poses[:, :3, 3], axis=0))
    return steps


def body_turns(poses: FloatArray) -> FloatArray:
    """Return the (P - 1, 3) turns from pose to pose, axis times angle in radians, each in the frame of its body."""
    rotation = poses[:, :3, :3]
    return _rotation_vectors(np.einsum("nji,njk->nik", rotation[:-1], rotation[1:]))


def _rotation_vectors(rotation: FloatArray) -> FloatArray:
    """Return axis times angle of (N, 3, 3) rotations as (N, 3), radians (importing scipy's would take longer)."""
    skew = np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(skew, axis=1) / 2
    angle = np.arctan2(sine, (np.trace(rotation, axis1=1, axis2=2) - 1) / 2)
    vectors: FloatArray = skew * (angle / np.maximum(2 * sine, 1e-12))[:, None]
    return vectors


def longest_piece(positions: FloatArray, times_s: FloatArray | None, frames: IntArray) -> tuple[slice, str]:
    """Cut a drive where its poses jump: what lies beyond a jump would come to another place of the map.

    Returns the rows of the longest piece between two jumps (all, where they jump so often that it is noise), and where
    and by how much they jump, in words; "" where they do not. A jump is a step longer than any vehicle drives
    meanwhile, or, where no times are known, longer than twice the usual steps around it and 5 m.
    """
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if len(steps) < 2:
        return slice(0, len(positions)), ""
    passed = np.diff(frames) / np.median(np.diff(frames)) if times_s is None else np.diff(times_s)
    speeds = steps / np.maximum(passed, 1e-3)
    usual = np.median(sliding_window_view(np.pad(speeds, _AROUND // 2, mode="symmetric"), _AROUND), axis=1)
    if times_s is None:
        moving = speeds[speeds > _STANDS_M]
        typical = np.quantile(moving, 0.75, method="higher") if len(moving) else 0.0
        after = np.flatnonzero(steps > 2 * np.maximum(usual, typical) * np.maximum(passed, 1.0) + _JUMP_M)
    else:
        allowed_m = usual * passed + _JUMP_M + _ACCELERATION_MPS2 * passed**2
        after = np.flatnonzero((steps > allowed_m) & (passed < _LONGEST_S))
    if not 0 < len(after) <= max(2, _RARELY * len(steps)):
        return slice(0, len(positions)), ""
    ends = [0, *(after + 1).tolist(), len(positions)]
    first, last = max(pairwise(ends), key=lambda piece: piece[1] - piece[0])
    driven_m = np.concatenate([[0.0], np.cumsum(steps)])
    named = [
        f"by {steps[row]:,.0f} m after scan {frames[row]} ({driven_m[row]:,.0f} m on)" for row in after[:3].tolist()
    ]
    return slice(first, last), (
        f"jump: {', '.join([*named, '...'] if len(after) > len(named) else named)}. The drive is cut there, and its "
        f"longest piece is used: scans {frames[first]} to {frames[last - 1]}, {last - first:,} of {len(positions):,}. "
        "Usual cause: an odometry that was reset or lost track, or an outage of GNSS."
    )


@dataclass(frozen=True)
class TimedPoses:
    """Poses of a body at times."""

    times_s: FloatArray
    """(P,) float64: seconds, strictly ascending, at least one."""
    poses: FloatArray
    """(P, 4, 4) float64: rigid T_world_body at each."""
    source: str = "poses"
    """Where they come from, for messages."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds."""
        return float(self.times_s[0]), float(self.times_s[-1])

    def covers(self, times_s: ArrayLike, *, longest_gap_s: float | None = None) -> BoolArray:
        """Tell which of (N,) times lie between two poses, or on one.

        Not between two that lie further apart than `longest_gap_s`; None: however far.
        """
        times = np.asarray(times_s, dtype=np.float64)
        first, last = self.span_s
        inside: BoolArray = (times >= first - 1e-6) & (times <= last + 1e-6)  # as they may be printed
        if longest_gap_s is not None:
            after = np.clip(np.searchsorted(self.times_s, times), 0, len(self.times_s) - 1)
            before = np.clip(np.searchsorted(self.times_s, times, side="right") - 1, 0, len(self.times_s) - 1)
            inside &= self.times_s[after] - self.times_s[before] <= longest_gap_s
        return inside

    def at(self, times_s: ArrayLike) -> FloatArray:
        """Return the poses at (N,) times: positions on the straight line, rotations on the great arc between."""
        times = np.asarray(times_s, dtype=np.float64)
        outside = ~self.covers(times)
        if outside.any():
            first, last = self.span_s
            raise DriveFileError(
                self.source,
                f"{np.count_nonzero(outside):,} of {len(times):,} times have no pose, such as "
                f"{times[np.argmax(outside)]:.3f} s: the poses cover {first:.3f} s to {last:.3f} s. Expected poses "
                "before and after each. Usual cause: another clock, or poses of another drive.",
            )
        if len(self.times_s) == 1:
            return np.repeat(self.poses, len(times), axis=0)
        after = np.clip(np.searchsorted(self.times_s, times), 1, len(self.times_s) - 1)
        before = after - 1
        share = (times - self.times_s[before]) / (self.times_s[after] - self.times_s[before])
        start, end = self.poses[before], self.poses[after]
        first_q, second_q = quaternions_from_rotations(start[:, :3, :3]), quaternions_from_rotations(end[:, :3, :3])
        rotations = rotations_from_quaternions(_slerp(first_q, second_q, share))
        return rigid_transforms(rotations, start[:, :3, 3] + share[:, None] * (end[:, :3, 3] - start[:, :3, 3]))


def rotations_from_quaternions(quaternions: FloatArray) -> FloatArray:
    """Return the (N, 3, 3) rotations of (N, 4) quaternions x y z w, which are normalised first."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternions_from_rotations(rotations: FloatArray) -> FloatArray:
    """Return the (N, 4) unit quaternions x y z w, w at least 0, of (N, 3, 3) rotations.

    Every column of the outer product q q^T is q times one of its components, and the matrix gives that product: the
    column of the largest component divides by no small number.
    """
    r = rotations
    xx, yy, zz = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    xw, yw, zw = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    outer = np.stack(
        [
            np.stack([1 + xx - yy - zz, xy, xz, xw], axis=-1),
            np.stack([xy, 1 - xx + yy - zz, yz, yw], axis=-1),
            np.stack([xz, yz, 1 - xx - yy + zz, zw], axis=-1),
            np.stack([xw, yw, zw, 1 + xx + yy + zz], axis=-1),
        ],
        axis=-2,
    )
    largest = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    column = outer[np.arange(len(r)), largest]
    unit = column / np.linalg.norm(column, axis=1, keepdims=True)
    upward: FloatArray = np.where(unit[:, 3:] < 0, -unit, unit)
    return upward


def _slerp(first: FloatArray, second: FloatArray, share: FloatArray) -> FloatArray:
    """Return the (N, 4) quaternions at a (N,) share of the shorter great arc between two."""
    cosine = np.einsum("ni,ni->n", first, second)
    second = np.where(cosine[:, None] < 0, -second, second)
    cosine = np.minimum(np.abs(cosine), 1.0)
    angle, square = np.arccos(cosine), 1.0 - cosine**2
    straight = square < _NEARLY_PARALLEL
    sine = np.sqrt(np.where(straight, 1.0, square))
    near = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    far = np.where(straight, share, np.sin(share * angle) / sine)
    return near[:, None] * first + far[:, None] * second
