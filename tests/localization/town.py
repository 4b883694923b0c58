"""A made-up town of crooked streets, and drives through it whose truth is known."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.drive import Georeference
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d
from interloc.osm.graph import RoadGraph
from tests.osm_files import osm_text, road_graph
from tests.small_drives import level_poses, pose_text, write_scan

LAT_DEG, LON_DEG = 49.0, 8.4
BLOCKS = 9


def graph_of(xy: FloatArray, edges: list[tuple[int, int]]) -> RoadGraph:
    """Return residential streets between points given in metres around the middle of the town."""
    lonlat = lonlat_from_enu(LAT_DEG, LON_DEG, np.asarray(xy, dtype=np.float64))
    return road_graph(lonlat, [("residential", edge, {"name": "Street"}) for edge in edges], 1, "town")


def town_xy() -> FloatArray:
    """Return the corners of the town, (BLOCKS * BLOCKS, 2): a grid of 130 m, each corner moved by up to 35 m."""
    rng = np.random.default_rng(7)
    grid = np.stack(np.meshgrid(np.arange(BLOCKS), np.arange(BLOCKS)), axis=-1).reshape(-1, 2) - (BLOCKS - 1) / 2
    return 130.0 * grid + rng.uniform(-35.0, 35.0, grid.shape)


def town_graph() -> RoadGraph:
    """Nineteen kilometres of streets."""
    along = [(r * BLOCKS + c, r * BLOCKS + c + 1) for r in range(BLOCKS) for c in range(BLOCKS - 1)]
    across = [(r * BLOCKS + c, (r + 1) * BLOCKS + c) for r in range(BLOCKS - 1) for c in range(BLOCKS)]
    return graph_of(town_xy(), along + across)


@dataclass(frozen=True)
class MadeDrive:
    """A drive of which only the poses are known, and where it really was."""

    T_world_lidar: FloatArray
    true_lonlat: FloatArray
    true_yaw_rad: FloatArray
    name: str = "made"
    times_s: None = None
    georeference: None = None

    @property
    def frames(self) -> np.ndarray:
        return np.arange(len(self.T_world_lidar))

    def ground_points(self, index: int) -> None:
        raise NotImplementedError

    def error_m(self, georeference: Georeference) -> FloatArray:
        """Return how far each scan is from the truth."""
        found = np.column_stack([georeference.lon_deg, georeference.lat_deg])
        return np.hypot(*enu_from_lonlat(self.true_lonlat[:, 1], self.true_lonlat[:, 0], found).T)


def drive_along(corners: FloatArray, *, scale: float = 1.0, drift_deg_per_km: float = 0.0) -> MadeDrive:
    """Drive along a line of corners, right of its middle, cutting the corners a little; a scan every metre."""
    steps = np.hypot(*np.diff(corners, axis=0).T)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    along = np.arange(0.0, at[-1], 1.0)
    line = np.column_stack([np.interp(along, at, corners[:, axis]) for axis in (0, 1)])
    kernel = np.ones(9) / 9.0
    line = np.column_stack([np.convolve(np.pad(line[:, axis], 4, "edge"), kernel, "valid") for axis in (0, 1)])
    yaw = np.arctan2(np.gradient(line[:, 1]), np.gradient(line[:, 0]))
    xy = line - 1.5 * np.column_stack([-np.sin(yaw), np.cos(yaw)])
    drifted = np.unwrap(yaw) + np.radians(drift_deg_per_km) * along / 1000.0
    step = np.diff(xy, axis=0)
    turn = drifted[:-1] - np.unwrap(yaw)[:-1]
    odometry = np.concatenate([[[0.0, 0.0]], np.cumsum(scale * rotate_2d(step, turn), axis=0)])
    poses = level_poses(*odometry.T, drifted)
    poses = np.linalg.inv(poses[0]) @ poses
    return MadeDrive(poses, lonlat_from_enu(LAT_DEG, LON_DEG, xy), yaw)


ROUTE = [(4, 0), (4, 1), (4, 2), (3, 2), (3, 3), (2, 3), (2, 4), (3, 4), (4, 4), (4, 5), (5, 5)]
"""Column and row of the corners driven through: 1.3 km with eight turns."""


def route_xy(route: list[tuple[int, int]] = ROUTE) -> FloatArray:
    return town_xy()[[row * BLOCKS + column for column, row in route]]


def write_town_drive(root: Path, *, every_m: int = 2) -> MadeDrive:
    """Write the drive along `ROUTE`, a scan every few metres, of which each shows a patch of road only."""
    drive = drive_along(route_xy())
    x, y = np.meshgrid(np.linspace(-3, 3, 7), np.linspace(-3, 3, 7))
    points = np.stack([x, y, np.full_like(x, -1.73), np.zeros_like(x)], axis=-1).reshape(-1, 4)
    poses = drive.T_world_lidar[::every_m]
    for frame in range(len(poses)):
        write_scan(root, frame, points, 40)
    (root / "poses.txt").write_text(pose_text(poses))
    return MadeDrive(poses, drive.true_lonlat[::every_m], drive.true_yaw_rad[::every_m])


def write_town_map(path: Path) -> None:
    lines = [[r * BLOCKS + c + 1 for c in range(BLOCKS)] for r in range(BLOCKS)]
    lines += [[r * BLOCKS + c + 1 for r in range(BLOCKS)] for c in range(BLOCKS)]
    path.write_text(osm_text(lonlat_from_enu(LAT_DEG, LON_DEG, town_xy()), lines))
