"""The intersections that a drive saw, one per passage, as landmarks to compare with a map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.geometry import rotate_2d
from interloc.localization.track import Track
from interloc.mapping.fusion import fuse
from interloc.results import DriveResult

_SAME_PASSAGE_M = 60.0
_MIN_DETECTIONS = 3
_RANGE_SCALE_M = 15.0
MAX_BRANCHES = 8


@dataclass(frozen=True)
class Sightings:
    """J passages of intersections."""

    at_m: FloatArray
    """(J,) float64: distance driven where it was seen best."""
    xy: FloatArray
    """(J, 2) float64: position in V (see `Track`) as of that moment."""
    angles_rad: FloatArray
    """(J, MAX_BRANCHES) float64: directions of its branches in V, leaving it; NaN where there are no more."""

    def __len__(self) -> int:
        return len(self.at_m)

    def mirrored(self) -> Sightings:
        """Return what the mirrored drive would have seen."""
        return Sightings(self.at_m, self.xy * [1.0, -1.0], -self.angles_rad)


def no_sightings() -> Sightings:
    """Return the sightings of a drive of which only the trajectory is known."""
    return Sightings(np.zeros(0), np.zeros((0, 2)), np.zeros((0, MAX_BRANCHES)))


def sightings_of(result: DriveResult, frames: IntArray, track: Track) -> Sightings:
    """Return the passages of intersections that the detections of a run amount to.

    Parameters
    ----------
    result
        Of `detect` on this drive. A georeference in it is not used.
    frames : (N,) int64
        Scan numbers of the drive.
    track
        Of the drive.

    Notes
    -----
    The detections are fused in W, passage by passage: where the odometry drifted between two passages, they are two
    landmarks. Fewer than three detections of a passage are not taken for an intersection.
    """
    keyframes, table = result.keyframes, result.detections
    turn_deg = np.zeros(len(keyframes))
    if keyframes.enu_yaw_rad is not None:  # bearings are from north then; W is what counts here
        turn_deg = np.degrees(keyframes.enu_yaw_rad - keyframes.world_yaw_rad)
    bearings = [each + turn_deg[row] for each, row in zip(table.bearings_deg, table.keyframe.tolist(), strict=True)]
    _, label = fuse(
        replace(keyframes, lonlat=None, enu_yaw_rad=None), replace(table, lonlat=None, bearings_deg=bearings)
    )
    scan = np.searchsorted(frames, keyframes.frame)[table.keyframe]
    yaw = track.yaw_rad[scan]
    xy = track.xy[scan] + rotate_2d(table.lidar_xy, yaw)
    weight = (0.1 + 0.9 * table.score) / (1.0 + (np.hypot(*table.lidar_xy.T) / _RANGE_SCALE_M) ** 2)
    turn_v = yaw - keyframes.world_yaw_rad[table.keyframe]  # from W to V
    at_m, places, angles = [], [], []
    for members in _passages(label, track.at_m[scan]):
        at_m.append(float(np.average(track.at_m[scan[members]], weights=weight[members])))
        places.append(np.average(xy[members], axis=0, weights=weight[members]))
        best = int(members[np.argmax(weight[members])])
        row = np.full(MAX_BRANCHES, np.nan)
        seen = np.radians(90.0 - np.asarray(bearings[best])[:MAX_BRANCHES]) + turn_v[best]
        row[: len(seen)] = seen
        angles.append(row)
    if not at_m:
        return no_sightings()
    return Sightings(np.array(at_m), np.array(places), np.array(angles))


def _passages(label: IntArray, at_m: FloatArray) -> list[IntArray]:
    """Split the detections of each intersection where the drive came back later."""
    passages = []
    for one in np.unique(label[label >= 0]):
        members = np.flatnonzero(label == one)
        members = members[np.argsort(at_m[members], kind="stable")]
        cuts = np.flatnonzero(np.diff(at_m[members]) > _SAME_PASSAGE_M) + 1
        passages += [each for each in np.split(members, cuts) if len(each) >= _MIN_DETECTIONS]
    return passages
