"""What points tell before anything labels them: their unit, the axes that they are in, and how the ground lies."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.drives.findings import Findings
from interloc.drives.poses.motion import body_steps
from interloc.drives.scans.recording import ChangedScans, ScanPoints
from interloc.drives.trajectory import Trajectory
from interloc.geometry import rows_apart

_NEAR_M = 15.0
_CELL_M = 0.5
_POINTS, _CELLS, _TRIED = 12_000, 800, 150
_OFF_M = 0.12
_BELOW = 2.0
"""So many times as much must lie on a plane that is not below the sensor, as the ceiling of a garage."""

_MAX_RANGE_M, _MIN_RANGE_M = 200.0, 0.2
_APART_M = 60.0
_UPRIGHT, _AGREE = 0.7, 0.8
_SHARE = 0.15

_LEVEL_RAD, _SPREAD_RAD = np.radians(5.0), np.radians(2.5)
"""Real drives have up to 4 degrees, the median of five scans on a hill; and so alike are those of one mounting."""


@dataclass(frozen=True)
class Ground:
    """The largest plane around the sensor, as seen from it."""

    up: FloatArray
    """(3,) float64: its normal, towards the sensor."""
    height_m: float
    """Of the sensor above it."""
    share: float
    """Of the places around the sensor that lie on it."""

    @classmethod
    def of(cls, xyz: Float32Array) -> "Ground | None":
        """Find it in the (N, 3) points of a scan; None where there are too few around the sensor."""
        xyz = xyz[:: len(xyz) // _POINTS | 1]
        with np.errstate(invalid="ignore", over="ignore"):
            squared = np.einsum("ij,ij->i", xyz, xyz)
            near = xyz[(squared > 1.0) & (squared < _NEAR_M**2)]
        _, rows = np.unique(np.floor(near / _CELL_M).astype(np.int64) @ (1, 1 << 10, 1 << 20), return_index=True)
        random = np.random.default_rng(0)
        places = near[random.permutation(rows)[:_CELLS]].astype(np.float64)
        if len(places) < 50:
            return None
        corners = places[random.integers(0, len(places), (_TRIED, 3))]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1)
        normals, corners = normals[lengths > 1.0] / lengths[lengths > 1.0, None], corners[lengths > 1.0]
        if not len(normals):
            return None
        along = np.einsum("ij,ij->i", normals, corners[:, 0])
        are_on = np.abs(places @ normals.T - along) < _OFF_M
        is_below = -np.sign(along) * normals[:, 2] > _UPRIGHT
        on = are_on[:, int(np.argmax(np.count_nonzero(are_on, axis=0) * np.where(is_below, _BELOW, 1.0)))]
        for _ in range(2):
            middle = places[on].mean(axis=0)
            up = np.linalg.eigh(np.cov(places[on].T))[1][:, 0]
            on = np.abs((places - middle) @ up) < _OFF_M
        up = up if middle @ up < 0 else -up
        return cls(up, float(-middle @ up), float(on.mean()))


def grounds_of(scans: Sequence[Float32Array]) -> list[Ground]:
    """Return the ground of those of some scans, (N, 3) points each, that show it."""
    return [ground for xyz in scans if (ground := Ground.of(xyz)) is not None and ground.share > _SHARE]


def check_points(
    scans: Sequence[Float32Array], grounds: Sequence[Ground], folder: str, findings: Findings, *, has_poses: bool
) -> bool:
    """Check, and return, whether points, (N, 3) of some scans, are metres in the frame of an upright sensor."""
    errors = findings.errors
    flat = [xyz[:: len(xyz) // _POINTS | 1, :2].T.copy() for xyz in scans if len(xyz)]  # columns, side by side
    centres = np.array([np.median(xy, axis=1) for xy in flat]).reshape(-1, 2)
    ranges = [np.median(np.hypot(*(xy - centre[:, None]))) for xy, centre in zip(flat, centres, strict=True)]
    range_m = float(np.median(ranges or [1.0]))
    if not _MIN_RANGE_M < range_m < _MAX_RANGE_M:
        findings.refuse(
            folder,
            f"half of the points are {'over' if range_m > 1 else 'under'} {range_m:,.3g} m from their middle "
            "(usual: 8 to 25 m). Expected x y z in metres. Usual cause: points in millimetres or centimetres, or "
            "divided by their range.",
        )
    elif len(centres) and float(np.linalg.norm(centres - centres[0], axis=1).max()) > _APART_M:
        findings.refuse(
            folder,
            "the points move along with the vehicle: they are in the frame of the world already. Expected points as "
            "the sensor saw them, x y z from the sensor. Usual cause: registered clouds of an odometry or SLAM "
            "(cloud_registered, poses applied); write them in the frame of the sensor, or apply the inverse of "
            "each pose.",
        )
    elif grounds and np.mean([ground.up[2] < -_UPRIGHT for ground in grounds]) > _AGREE:
        poses = ", and each pose is multiplied by diag(1, -1, -1, 1) from the right" if has_poses else ""
        findings.refuse(
            folder,
            f"the road lies {np.median([ground.height_m for ground in grounds]):.1f} m above the sensor: its z axis "
            "points down, and the map would be mirrored. Expected x forward, y left, z up. Usual cause: a sensor that "
            "is mounted upside down, or axes of NED or FRD. Turn them by half a turn about x: y and z of the points "
            f"change their signs{poses}.",
        )
    elif grounds and np.mean([abs(ground.up[2]) < _UPRIGHT for ground in grounds]) > _AGREE:
        up = np.median([ground.up for ground in grounds], axis=0)
        axis = int(np.argmax(np.abs(up)))
        findings.refuse(
            folder,
            f"the ground lies in the direction of {'-' if up[axis] > 0 else '+'}{'xyz'[axis]}, not below the sensor. "
            "Expected x forward, y left, z up. Usual cause: points with the axes of a camera (x right, y down, z "
            "forward), or a sensor that is mounted on its side; turn the points"
            f"{', and the poses with them' if has_poses else ''}.",
        )
    return findings.errors == errors


def level_of(grounds: Sequence[Ground], scans: int) -> FloatArray | None:
    """Return the (3, 3) rotation that brings points upright, where the ground is tilted alike in all of some scans."""
    if len(grounds) < scans or len(grounds) < 3:
        return None
    normals = np.array([ground.up for ground in grounds])
    up = np.median(normals, axis=0)
    up /= np.linalg.norm(up)
    tilts, tilt = np.arccos(np.clip(normals @ up, -1, 1)), float(np.arccos(min(1.0, up[2])))
    if not _LEVEL_RAD < tilt < np.pi / 4 or tilts.max() > _SPREAD_RAD:
        return None
    axis = np.array([up[1], -up[0], 0.0]) / np.hypot(up[0], up[1])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    level: FloatArray = np.eye(3) + np.sin(tilt) * cross + (1 - np.cos(tilt)) * cross @ cross
    return level


@dataclass(frozen=True)
class LevelScans(ChangedScans):
    """Scans of a sensor that is mounted at an angle, turned upright; a `PointSource`."""

    level: FloatArray
    """(3, 3) float64: from the frame of the sensor into that of one that stands upright in its place."""

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan, and turn them."""
        points = self.source.read(frame)
        values = points.values.copy()
        values[:, :3] = points.values[:, :3] @ self.level.T.astype(np.float32)
        return replace(points, values=values)


def levelled(trajectory: Trajectory, level: FloatArray) -> Trajectory | None:
    """Return where the sensor was that stands upright; None where the poses are not those of the one at an angle.

    The vehicle drives along the ground: where its steps, in the frame of the sensor, do not, another body's they are.
    """
    poses, fixes = trajectory.poses, trajectory.georeference
    if poses is None:
        return None
    T = poses.T_world_lidar
    steps = body_steps(T[rows_apart(T[:, :3, 3], 3.0)])
    if float(np.square(steps @ level[2]).sum()) > float(np.square(steps[:, 2]).sum()) + 1e-9:
        return None
    turned = np.eye(4)
    turned[:3, :3] = level
    T_world_lidar = turned @ T @ turned.T
    if fixes is not None and float(np.median(fixes.R_enu_lidar[:, 2] @ level[2])) > float(
        np.median(fixes.R_enu_lidar[:, 2, 2])
    ):
        fixes = replace(fixes, R_enu_lidar=fixes.R_enu_lidar @ level.T)
    poses = replace(poses, T_world_lidar=T_world_lidar, T_file_world=None)
    return replace(trajectory, poses=poses, georeference=fixes)
