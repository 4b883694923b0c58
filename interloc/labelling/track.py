"""The driven track: where each scan lies along it, its windows, and how sure labels by geometry are along it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.geometry import rows_apart, travelled

WINDOW_M = 25.0
"""Length of track whose scans are labelled by one surface."""

CONTEXT_M = 45.0
"""Track before and after a window whose scans are used for it."""

CONTEXT_STEP_M = 2.0
"""Distance between the scans that are used."""

_MIN_CONTEXT = 10  # scans
_JITTER_M = 0.5
_JUMP_M = 40.0
_STEP_M = 0.5
_BEYOND_M = 4.0


@dataclass(frozen=True)
class Track:
    """The track of a drive, known from its poses alone: everybody who knows them cuts it in the same way."""

    T_world_lidar: FloatArray
    """(N, 4, 4) float64: pose of the LiDAR at every scan."""
    usable: IntArray
    """(M,) int64: rows of the scans that can be read, ascending."""
    distance_m: FloatArray
    """(N,) float64: distance driven until each scan; a vehicle that stands or trembles does not move on."""
    line: FloatArray
    """(P, 4) float64: points of the track, at most 0.5 m apart: x, y, z in W and the distance driven. Between scans it
    is a Hermite curve whose ends point where the vehicle heads; where poses jump there are none."""

    @classmethod
    def of(cls, T_world_lidar: FloatArray, usable: IntArray) -> "Track":
        """Make the track of a drive from (N, 4, 4) poses, and the rows of the scans that can be read."""
        position = T_world_lidar[:, :3, 3]
        anchors = np.array(rows_apart(position, _JITTER_M))
        at_anchors = travelled(position[anchors])
        before = np.searchsorted(anchors, np.arange(len(position)), side="right") - 1
        distance = at_anchors[before] + np.linalg.norm(position - position[anchors[before]], axis=1)
        return cls(T_world_lidar, usable, distance, _line(T_world_lidar[anchors], at_anchors))

    def window_of(self, row: int) -> int:
        """Return the number of the window that a scan belongs to."""
        return int(self.distance_m[row] // WINDOW_M)

    def rows_in(self, window: int) -> IntArray:
        """Return the rows of the scans of a window."""
        return np.flatnonzero(self.distance_m // WINDOW_M == window)

    def context(self, window: int) -> IntArray:
        """Return the rows of the scans that the surface of a window is made of: about one every two metres."""
        start_m = window * WINDOW_M - CONTEXT_M
        distance = self.distance_m[self.usable]
        near = self.usable[(distance >= start_m) & (distance < start_m + WINDOW_M + 2 * CONTEXT_M)]
        near = near[np.unique(self.distance_m[near] // _JITTER_M, return_index=True)[1]]  # a stop is one place
        _, first = np.unique(self.distance_m[near] // CONTEXT_STEP_M, return_index=True)
        if len(first) < _MIN_CONTEXT:
            first = np.unique(np.linspace(0, len(near) - 1, min(_MIN_CONTEXT, len(near))).round().astype(np.int64))
        return near[first]

    def line_around(self, window: int) -> FloatArray:
        """Return the points of `line` in a window and its context."""
        start_m = window * WINDOW_M - CONTEXT_M
        inside = (self.line[:, 3] >= start_m) & (self.line[:, 3] < start_m + WINDOW_M + 2 * CONTEXT_M)
        return self.line[inside]


def _line(poses: FloatArray, distance_m: FloatArray) -> FloatArray:
    position = poses[:, :3, 3]
    heads = poses[:, :3, :3] @ _forward(poses)
    pieces = [_beyond(position[0], distance_m[0], -heads[0] * _side(heads[0], position[1:2] - position[0]))]
    for row, chord in enumerate(np.diff(position, axis=0)):
        length = float(np.linalg.norm(chord))
        if length > _JUMP_M:
            pieces.append(np.append(position[row + 1], distance_m[row + 1])[None])
            continue
        ends = [head * np.copysign(length, head @ chord) for head in heads[row : row + 2]]
        ends = [end if end @ chord > 0.7 * length**2 else chord for end in ends]  # it slides, or the poses do
        t = np.linspace(0.0, 1.0, int(np.ceil(length / _STEP_M)) + 1)[1:, None]
        curve = (
            position[row] + (3 * t**2 - 2 * t**3) * chord + (t**3 - 2 * t**2 + t) * ends[0] + (t**3 - t**2) * ends[1]
        )
        along = distance_m[row] + t * (distance_m[row + 1] - distance_m[row])
        pieces.append(np.hstack([curve, along]))
    pieces.append(_beyond(position[-1], distance_m[-1], heads[-1] * _side(heads[-1], position[-1] - position[-2:-1])))
    return np.concatenate(pieces)


def _side(head: FloatArray, step: FloatArray) -> float:
    """Return 1 where a step goes ahead, -1 where it goes back."""
    return float(np.copysign(1.0, (step @ head).sum()))


def _beyond(position: FloatArray, distance_m: float, direction: FloatArray) -> FloatArray:
    """Return points beyond an end of the track: where the vehicle stands, which no scan from there sees."""
    t = np.arange(0.0, _BEYOND_M + _STEP_M, _STEP_M)[:, None]
    return np.hstack([position + t * direction, np.full_like(t, distance_m)])


def _forward(poses: FloatArray) -> FloatArray:
    """Return the (3,) direction in L in which a vehicle moves, however the sensor is turned on it."""
    steps = np.diff(poses[:, :3, 3], axis=0)
    if not len(steps):
        return np.array([1.0, 0.0, 0.0])
    rotations = poses[:-1, :3, :3] + poses[1:, :3, :3]
    own = np.einsum("nji,nj->ni", rotations, steps)
    return np.linalg.eigh(own.T @ own)[1][:, -1]


# How sure the labels are


Stretch = tuple[float, float]
"""From where to where along the track, metres."""

_MIN_CONTRAST, _MAX_WIDTH_M, _MIN_EVENNESS = 5.0, 9.0, 1.0


@dataclass(frozen=True)
class WindowQuality:
    """How sure the labels of a window of the track are.

    On 222 windows of simulated streets, half of them with flush sidewalks as bright as the road, the width ranks those
    whose road agrees by less than 0.65 (intersection over union) with the truth by 0.86 (area under the curve), the
    contrast by 0.66, the whole area of the road by 0.64. The bound finds half of them, and doubts 7 of 100 good ones.
    """

    start_m: float
    stop_m: float
    """Where it begins and ends along the track."""
    contrast: float
    """How much better the driven strip scores than the ground just outside of the road; 0 where nothing was seen."""
    width_m: float
    """Width of the road: its area within 8 m of the driven strip per metre of track."""
    evenness: float
    """What four fifths of the driven strip score at least: little where it does not look like itself."""

    @property
    def is_doubtful(self) -> bool:
        """Whether what lies beside the road looks like road, or was taken for it, or the strip is a bad example."""
        return self.contrast < _MIN_CONTRAST or self.width_m > _MAX_WIDTH_M or self.evenness < _MIN_EVENNESS


def joined(stretches: Iterable[Stretch]) -> list[Stretch]:
    """Make one stretch of those that follow each other."""
    result: list[Stretch] = []
    for start_m, stop_m in stretches:
        follows = bool(result) and result[-1][1] == start_m
        result.append((result.pop()[0] if follows else start_m, stop_m))
    return result


def doubts_in_words(stretches: Iterable[Stretch]) -> str:
    """Return the warning that labels by geometry are doubtful along some stretches."""
    places = ", ".join(f"{start:,.0f} to {stop:,.0f} m" for start, stop in stretches)
    return (
        f"Labels by geometry are doubtful from {places} of the track: what lies beside the road looks like the road, "
        "or little of the driven strip was seen. Usual causes: sidewalks without a kerb, a square, yard or car park, "
        "snow. Expect missing or wrong intersections there; a network (--model) does better."
    )
