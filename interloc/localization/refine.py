"""Bending a track onto the roads: robust least squares over a chain of poses.

The chain is a pose graph in the plane (as in 2D SLAM): one pose every `NODE_STEP_M` of the way. Three kinds of
measurement hold it: the odometry from pose to pose, the distance of each pose from the middle of the way it runs on,
less the lane offset of the drive, and the intersections that were seen, each at its node of the map. The scale of the
odometry is estimated along.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import rotate_2d, wrap_angle
from interloc.localization.roads import Nodes, RoadMap
from interloc.localization.track import Sightings, Track, resample

NODE_STEP_M = 10.0

# Standard deviations. SuMa's poses on KITTI drift less; 1 % of scale and 5 degrees in a kilometre must still pass.
_ODOMETRY = np.array([0.08, 0.03, 0.0015])  # ahead, across [m] and turn [rad], from pose to pose
_WAY_M = 1.5  # of a pose from the middle of its lane; the error of a way stays the same for about three poses
_WAY_CORRELATION = 3.0
_NODE_M = 1.5  # of an intersection from its node
_OFFSET_PRIOR = 5.0  # poses: how many of them hold the lane offset at zero
_ALIGNED = 0.8  # cosine between a way and the heading of who drives on it
_START_SIGMA_M = 5.0
_START_GATE_M, _GATE_M = 20.0, 8.0
_SCALE_STD, _SCALE_LIMIT = 0.01, 0.04
_WINDOW, _GROW = 40, 30  # poses to either side of an anchor at first, and more of them in each round


@dataclass(frozen=True)
class Chain:
    """A track as a chain of poses, with what was seen from them."""

    at_m: FloatArray
    """(n,) float64: distance driven."""
    pose: FloatArray
    """(n, 3) float64: x, y, direction of motion in V."""
    seen_from: IntArray
    """(J,) int64: pose from which each intersection was seen."""
    seen_xy: FloatArray
    """(J, 2) float64: where, in the frame of that pose."""
    seen_angles_rad: FloatArray
    """(J, B) float64: its branches in that frame; NaN: no more."""

    def __len__(self) -> int:
        return len(self.at_m)

    @classmethod
    def of(cls, track: Track, sightings: Sightings) -> "Chain":
        """Cut a track into poses."""
        at_m, pose = resample(track, NODE_STEP_M)
        seen_from = np.clip(np.round(sightings.at_m / NODE_STEP_M).astype(np.int64), 0, len(pose) - 1)
        heading = pose[seen_from, 2]
        seen_xy = rotate_2d(sightings.xy - pose[seen_from, :2], -heading)
        return cls(at_m, pose, seen_from, seen_xy, sightings.angles_rad - heading[:, None])

    def placed(self, row: int, pose: FloatArray) -> FloatArray:
        """Return the chain, (n, 3), moved rigidly so that one of its poses comes to a given one."""
        turn = pose[2] - self.pose[row, 2]
        xy = rotate_2d(self.pose[:, :2] - self.pose[row, :2], turn) + pose[:2]
        return np.column_stack([xy, self.pose[:, 2] + turn])

    def seen_at(self, pose: FloatArray) -> FloatArray:
        """Return where the intersections are, (J, 2), if the poses are these."""
        return pose[self.seen_from, :2] + rotate_2d(self.seen_xy, pose[self.seen_from, 2])


@dataclass(frozen=True)
class Fit:
    """A chain bent onto the roads."""

    pose: FloatArray
    """(n, 3) float64: x, y, direction of motion in M."""
    offset_m: float
    """Lane offset: how far left of the middle of the ways the drive ran."""
    scale: float
    """By how much the map is larger than the odometry says."""
    lateral_m: FloatArray
    """(n,) float64: distance from the middle of the way less the lane offset; NaN where no way runs along."""
    strain: float
    """How far the odometry had to be bent: mean of its squared normalised errors."""


class _Normal:
    """Normal equations of the chain: symmetric, block tridiagonal with blocks of 3 x 3, bordered by the scale."""

    def __init__(self, count: int) -> None:
        self.diagonal = np.zeros((count, 3, 3))
        self.coupling = np.zeros((count - 1, 3, 3))
        self.right = np.zeros((count, 3))
        self.border = np.zeros((count, 3))
        self.corner, self.scale_right = 0.0, 0.0
        self.diagonal[:] += np.diag([1e-6, 1e-6, 1e-3])

    def banded(self) -> FloatArray:
        """Return the lower band, (6, 3 n), as LAPACK wants it."""
        count = len(self.diagonal)
        band = np.zeros((6, 3 * count))
        for below in range(3):
            for column in range(3 - below):
                band[below, column::3] = self.diagonal[:, column + below, column]
        for row in range(3):
            for column in range(3):
                band[3 + column - row, row : 3 * (count - 1) : 3] = self.coupling[:, row, column]
        return band

    def solve(self) -> tuple[FloatArray, float]:
        """Return the steps of the poses, (n, 3), and of the scale, by the Schur complement of the border."""
        both = np.stack([self.right.ravel(), self.border.ravel()], axis=1)
        solved = solveh_banded(self.banded(), both, lower=True, check_finite=False)
        free, along = solved[:, 0], solved[:, 1]
        border = self.border.ravel()
        scale = float((self.scale_right - border @ free) / (self.corner - border @ along))
        step: FloatArray = (free - scale * along).reshape(-1, 3)
        return step, scale

    def covariance(self) -> FloatArray:
        """Return the covariance of each pose, (n, 3, 3): the diagonal blocks of the inverse.

        Two sweeps along the chain, as in a Kalman smoother: what all poses before one say of it, and all behind.
        """
        count = len(self.diagonal)
        before, behind = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
        for i in range(1, count):
            c = self.coupling[i - 1]
            before[i] = c.T @ np.linalg.solve(self.diagonal[i - 1] - before[i - 1], c)
        for i in range(count - 2, -1, -1):
            c = self.coupling[i]
            behind[i] = c @ np.linalg.solve(self.diagonal[i + 1] - behind[i + 1], c.T)
        return np.asarray(np.linalg.inv(self.diagonal - before - behind), dtype=np.float64)


def fit(
    chain: Chain,
    start: FloatArray,
    roads: RoadMap,
    *,
    nodes: Nodes | None = None,
    anchor: int | None = None,
    rounds: int = 10,
) -> Fit:
    """Bend a chain onto the roads.

    Around `anchor` the `start`, (n, 3) in M, is good; the fit takes hold there and grows outwards, so that drift does
    not carry the far ends to the wrong roads. None: it is good everywhere. So many rounds follow once the whole chain
    takes part. Where `nodes` are given, only these intersections of the map are used.
    """
    low, high = (0, len(chain)) if anchor is None else (anchor - _WINDOW, anchor + _WINDOW + 1)
    pose, offset_m, scale, done = start, 0.0, 1.0, 0
    while True:
        whole = low <= 0 and high >= len(chain)
        active = np.zeros(len(chain), dtype=np.bool_)
        active[max(low, 0) : high] = True
        step = _Round(chain, pose, offset_m, scale, active, cooling=0.7**done)
        fitted, normal = step.linearise(roads, roads.nodes if nodes is None else nodes)
        if done >= rounds:
            return fitted
        moved, stretched = normal.solve()
        pose, scale = pose + moved, float(np.clip(scale + stretched, 1.0 - _SCALE_LIMIT, 1.0 + _SCALE_LIMIT))
        if whole:
            offset_m, done = step.offset(), done + 1
        low, high = low - _GROW, high + _GROW


def uncertainty(chain: Chain, fitted: Fit, roads: RoadMap) -> FloatArray:
    """Return the covariance of the poses of a fit, (n, 3, 3)."""
    everywhere = np.ones(len(chain), dtype=np.bool_)
    step = _Round(chain, fitted.pose, fitted.offset_m, fitted.scale, everywhere, cooling=0.0)
    return step.linearise(roads, roads.nodes)[1].covariance()


class _Round:
    """One round of iteratively reweighted least squares."""

    def __init__(
        self, chain: Chain, pose: FloatArray, offset_m: float, scale: float, active: BoolArray, *, cooling: float
    ) -> None:
        self.chain, self.pose, self.offset_m, self.scale, self.active = chain, pose, offset_m, scale, active
        self.sigma_m = max(_WAY_M, _START_SIGMA_M * cooling)
        self.gate_m = max(_GATE_M, _START_GATE_M * cooling)
        self.lateral_m = self.weight = np.zeros(0)

    def linearise(self, roads: RoadMap, nodes: Nodes) -> tuple[Fit, _Normal]:
        """Return the state as it is, and the equations of the next step."""
        normal = _Normal(len(self.chain))
        on_way = self._hold_by_ways(normal, roads)
        self._hold_by_nodes(normal, nodes)
        strain = self._hold_by_odometry(normal)
        lateral_m = np.where(on_way, self.lateral_m - self.offset_m, np.nan)
        return Fit(self.pose, self.offset_m, self.scale, lateral_m, strain), normal

    def _hold_by_ways(self, normal: _Normal, roads: RoadMap) -> BoolArray:
        segment, foot = roads.nearest_ways(self.pose)
        left = np.column_stack([-foot[:, 3], foot[:, 2]])
        self.lateral_m = np.einsum("ij,ij->i", self.pose[:, :2] - foot[:, :2], left)
        aligned = np.cos(self.pose[:, 2]) * foot[:, 2] + np.sin(self.pose[:, 2]) * foot[:, 3]
        on_way: BoolArray = (segment >= 0) & (aligned > _ALIGNED)
        error = self.lateral_m - self.offset_m
        self.weight = np.where(on_way & self.active, 1.0 / (1.0 + (error / self.sigma_m) ** 2) ** 2, 0.0)
        weight = self.weight / (_WAY_M**2 * _WAY_CORRELATION)
        normal.diagonal[:, :2, :2] += weight[:, None, None] * left[:, :, None] * left[:, None, :]
        normal.right[:, :2] -= (weight * error)[:, None] * left
        return on_way

    def _hold_by_nodes(self, normal: _Normal, nodes: Nodes) -> None:
        seen_from = self.chain.seen_from
        arm = rotate_2d(self.chain.seen_xy, self.pose[seen_from, 2])
        at = self.pose[seen_from, :2] + arm
        distance, nearest = nodes.nearest(at, self.gate_m)
        held = np.flatnonzero(np.isfinite(distance) & self.active[seen_from])
        error = at[held] - nodes.xy[nearest[held]]
        softness = max(2.0 * _NODE_M, self.gate_m / 4.0)
        weight = 1.0 / (1.0 + (distance[held] / softness) ** 2) ** 2 / _NODE_M**2
        jacobian = np.zeros((len(held), 2, 3))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
        jacobian[:, 0, 2], jacobian[:, 1, 2] = -arm[held, 1], arm[held, 0]
        weighted = weight[:, None, None] * np.swapaxes(jacobian, 1, 2)
        np.add.at(normal.diagonal, seen_from[held], weighted @ jacobian)
        np.add.at(normal.right, seen_from[held], -np.einsum("nij,nj->ni", weighted, error))

    def _hold_by_odometry(self, normal: _Normal) -> float:
        measured, local = _steps(self.chain.pose), _steps(self.pose)
        error = local - measured * [self.scale, self.scale, 1.0]
        error[:, 2] = wrap_angle(error[:, 2])
        c, s = np.cos(self.pose[:-1, 2]), np.sin(self.pose[:-1, 2])
        count = len(error)
        of_first, of_second = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
        of_second[:, 0, 0], of_second[:, 0, 1], of_second[:, 1, 0], of_second[:, 1, 1] = c, s, -s, c
        of_second[:, 2, 2] = 1.0
        of_first[:] = -of_second
        of_first[:, 0, 2], of_first[:, 1, 2] = local[:, 1], -local[:, 0]
        weight = 1.0 / _ODOMETRY**2
        first, second = weight[None, :, None] * of_first, weight[None, :, None] * of_second
        normal.diagonal[:-1] += np.swapaxes(of_first, 1, 2) @ first
        normal.diagonal[1:] += np.swapaxes(of_second, 1, 2) @ second
        normal.coupling += np.swapaxes(of_first, 1, 2) @ second
        normal.right[:-1] -= np.einsum("nij,ni->nj", first, error)
        normal.right[1:] -= np.einsum("nij,ni->nj", second, error)
        by_scale = -measured * [1.0, 1.0, 0.0]  # derivative of the error
        normal.border[:-1] += np.einsum("nij,ni->nj", first, by_scale)
        normal.border[1:] += np.einsum("nij,ni->nj", second, by_scale)
        normal.corner = float((weight * by_scale**2).sum()) + 1.0 / _SCALE_STD**2
        normal.scale_right = -float((weight * by_scale * error).sum()) - (self.scale - 1.0) / _SCALE_STD**2
        return float((weight * error**2).sum() / max(1, count))

    def offset(self) -> float:
        """Return the lane offset: the weighted mean of the distances from the ways, drawn to zero where few count."""
        weight = self.weight * (np.abs(self.lateral_m - self.offset_m) < 2.0 * self.sigma_m)
        return float((weight * self.lateral_m).sum() / (weight.sum() + _OFFSET_PRIOR))


def _steps(pose: FloatArray) -> FloatArray:
    """Return the motion from pose to pose, (n - 1, 3), each in the frame of the first of the two."""
    ahead = rotate_2d(np.diff(pose[:, :2], axis=0), -pose[:-1, 2])
    return np.column_stack([ahead, np.diff(pose[:, 2])])
