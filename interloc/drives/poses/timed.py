"""Poses at times, such as those of a trajectory, and the poses between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from interloc.arrays import BoolArray, FloatArray
from interloc.drives.findings import DriveFileError
from interloc.geometry import rigid_transforms

_NEARLY_PARALLEL = 1e-9
"""Square of the sine of the half angle under which the great arc is the straight line."""


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
        """Tell which of some times lie between two poses, or on one.

        Parameters
        ----------
        times_s : (N,) float
        longest_gap_s : float or None
            Times between two poses that lie further apart than this are not covered; None: however far.

        Returns
        -------
        (N,) bool
        """
        times = np.asarray(times_s, dtype=np.float64)
        first, last = self.span_s
        inside: BoolArray = (times >= first) & (times <= last)
        if longest_gap_s is not None:
            after = np.clip(np.searchsorted(self.times_s, times), 0, len(self.times_s) - 1)
            before = np.clip(np.searchsorted(self.times_s, times, side="right") - 1, 0, len(self.times_s) - 1)
            inside &= self.times_s[after] - self.times_s[before] <= longest_gap_s
        return inside

    def at(self, times_s: ArrayLike) -> FloatArray:
        """Return the poses at some times: positions on the straight line, rotations on the great arc between two.

        Parameters
        ----------
        times_s : (N,) float
            Seconds, in any order.

        Returns
        -------
        (N, 4, 4) float64

        Raises
        ------
        DriveError
            A time lies outside of the poses, or is not finite; nothing is extrapolated.
        """
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

    Notes
    -----
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
    between: FloatArray = near[:, None] * first + far[:, None] * second
    return between
