"""What a drive tells of itself: its track in the plane, and the intersections that it saw along it."""

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.errors import ConfigError
from interloc.geometry import rotate_2d, travelled, yaw_of
from interloc.mapping.fusion import fuse
from interloc.results import DriveResult

MAX_BRANCHES = 8
_CHORD_M = 4.0  # of driving, by whose ends the direction of motion is known
_SAME_PASSAGE_M = 60.0
_MIN_DETECTIONS = 3


@dataclass(frozen=True)
class Track:
    """Where a drive went, in its own horizontal plane V: origin at the first scan, x axis ahead of it."""

    xy: FloatArray
    """(N, 2) float64: position of the LiDAR at every scan, metres."""
    z_m: FloatArray
    """(N,) float64: its height over the first scan."""
    R_level_lidar: FloatArray
    """(N, 3, 3) float64: its attitude in V."""
    at_m: FloatArray
    """(N,) float64: distance driven up to every scan."""

    @property
    def length_m(self) -> float:
        """Distance driven."""
        return float(self.at_m[-1])

    def mirrored(self) -> "Track":
        """Return the same track seen in a mirror: every left turn a right turn."""
        flip = np.diag([1.0, -1.0, 1.0])
        return Track(self.xy * [1.0, -1.0], self.z_m, flip @ self.R_level_lidar @ flip, self.at_m)


def track_of(T_world_lidar: FloatArray) -> Track:
    """Return the track of (N, 4, 4) poses; "up" is the mean of the upward axes of the LiDAR."""
    up = T_world_lidar[:, :3, 2].mean(axis=0)
    up /= np.linalg.norm(up)
    ahead = T_world_lidar[0, :3, 0] - up * (up @ T_world_lidar[0, :3, 0])
    ahead /= np.linalg.norm(ahead)
    R_level_world = np.stack([ahead, np.cross(up, ahead), up])
    position = (T_world_lidar[:, :3, 3] - T_world_lidar[0, :3, 3]) @ R_level_world.T
    rotation = R_level_world @ T_world_lidar[:, :3, :3]
    return Track(position[:, :2], position[:, 2], rotation, travelled(position[:, :2]))


def resample(track: Track, step_m: float) -> tuple[FloatArray, FloatArray]:
    """Return points of a track every `step_m`: distance driven, (P,), and x, y, direction of motion in V, (P, 3).

    The direction is that over `_CHORD_M` around each point; it is continuous, not wrapped. A scan that is no farther
    than the one before (the vehicle stands) adds nothing.
    """
    moved = np.concatenate([[True], np.diff(track.at_m) > 1e-6])
    at, xy = track.at_m[moved], track.xy[moved]
    along = np.arange(0.0, at[-1] + 1e-9, step_m)

    def place(distance: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(distance, at, xy[:, 0]), np.interp(distance, at, xy[:, 1])])

    before, after = np.clip(along - _CHORD_M / 2, 0.0, at[-1]), np.clip(along + _CHORD_M / 2, 0.0, at[-1])
    chord = place(after) - place(before)
    return along, np.column_stack([place(along), np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))])


@dataclass(frozen=True)
class Sightings:
    """J passages of intersections, as landmarks to compare with a map."""

    at_m: FloatArray
    """(J,) float64: distance driven where it was seen best."""
    xy: FloatArray
    """(J, 2) float64: position in V (see `Track`) as of that moment."""
    angles_rad: FloatArray
    """(J, MAX_BRANCHES) float64: directions of its branches in V, leaving it; NaN where there are no more."""

    def __len__(self) -> int:
        return len(self.at_m)

    def mirrored(self) -> "Sightings":
        """Return what the mirrored drive would have seen."""
        return Sightings(self.at_m, self.xy * [1.0, -1.0], -self.angles_rad)


NO_SIGHTINGS = Sightings(np.zeros(0), np.zeros((0, 2)), np.zeros((0, MAX_BRANCHES)))
"""Those of a drive of which only the trajectory is known."""


def sightings_of(result: DriveResult, frames: IntArray, track: Track) -> Sightings:
    """Return the passages of intersections that the detections of a run amount to; no georeference is used.

    `frames` are the scan numbers of the drive, (N,). The detections are fused in W, passage by passage: where the
    odometry drifted between two passages, they are two landmarks. Fewer than three detections of a passage are not
    taken for an intersection.
    """
    keyframes, table = result.keyframes, result.detections
    if not np.isin(keyframes.frame, frames).all():
        raise ConfigError("the result has keyframes that the drive has not. Usual cause: other --frames.")
    turn_deg = np.zeros(len(keyframes))
    if keyframes.enu_yaw_rad is not None:  # bearings are from north then; W is what counts here
        turn_deg = np.degrees(keyframes.enu_yaw_rad - keyframes.world_yaw_rad)
    bearings = [each + turn_deg[row] for each, row in zip(table.bearings_deg, table.keyframe.tolist(), strict=True)]
    _, label = fuse(
        replace(keyframes, lonlat=None, enu_yaw_rad=None), replace(table, lonlat=None, bearings_deg=bearings)
    )
    scan = np.searchsorted(frames, keyframes.frame)[table.keyframe]
    yaw, driven_m = yaw_of(track.R_level_lidar)[scan], track.at_m[scan]
    xy = track.xy[scan] + rotate_2d(table.lidar_xy, yaw)
    weight = table.position_std_m**-2
    turn_v = yaw - keyframes.world_yaw_rad[table.keyframe]  # from W to V
    at_m, places, angles = [], [], []
    for one in np.unique(label[label >= 0]):
        seen = np.flatnonzero(label == one)
        seen = seen[np.argsort(driven_m[seen], kind="stable")]
        for members in np.split(seen, np.flatnonzero(np.diff(driven_m[seen]) > _SAME_PASSAGE_M) + 1):
            if len(members) < _MIN_DETECTIONS:
                continue
            at_m.append(float(np.average(driven_m[members], weights=weight[members])))
            places.append(np.average(xy[members], axis=0, weights=weight[members]))
            best = int(members[np.argmax(weight[members])])
            branches = np.radians(90.0 - np.asarray(bearings[best])[:MAX_BRANCHES]) + turn_v[best]
            angles.append(np.pad(branches, (0, MAX_BRANCHES - len(branches)), constant_values=np.nan))
    return Sightings(np.array(at_m), np.array(places), np.array(angles)) if at_m else NO_SIGHTINGS
