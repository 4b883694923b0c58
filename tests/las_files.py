"""LAS and LAZ files for tests: written by laspy, from arrays or from the scans of another drive."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np
from pyproj import CRS, Transformer

from interloc.arrays import FloatArray
from interloc.drives.folder import FolderDrive
from interloc.geometry import lonlat_from_enu, rotate_2d

UTM32 = "EPSG:25832"


def write_las(
    path: Path,
    xyz: FloatArray,
    *,
    times_s: Any = None,
    labels: Any = 0,
    intensity: Any = 0,
    withheld: Any = False,
    crs: str | None = None,
    point_format: int = 6,
    version: str = "1.4",
    scale: float = 0.001,
) -> Path:
    """Write (N, 3) points; a suffix of .laz compresses them."""
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales, header.offsets = np.full(3, scale), np.floor(xyz.min(axis=0)) if len(xyz) else np.zeros(3)
    if version != "1.1":
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    if crs is not None:
        header.add_crs(CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    if times_s is not None:
        las.gps_time = np.broadcast_to(times_s, len(xyz))
    las.classification = np.broadcast_to(labels, len(xyz)).astype(np.uint8)
    las.intensity = np.broadcast_to(intensity, len(xyz)).astype(np.uint16)
    las.withheld = np.broadcast_to(withheld, len(xyz)).astype(np.uint8)
    las.write(path)
    return path


def write_scan_files(drive: FolderDrive, folder: Path, suffix: str = ".laz") -> Path:
    """Write the ground of every scan of a drive to a file of its own, and its poses beside."""
    folder.mkdir(exist_ok=True)
    for at, frame in enumerate(drive.frames.tolist()):
        points = drive.ground_points(at)
        classes = np.where(points.is_road, 11, 2)  # road surface, ground
        write_las(folder / f"{frame:06d}{suffix}", points.xyz.astype(np.float64), labels=classes)
    np.savetxt(folder / "poses.txt", drive.T_world_lidar[:, :3].reshape(-1, 12), fmt="%.9g")
    return folder


def write_mapping(drive: FolderDrive, folder: Path, *, files: int = 1, crs: str = UTM32, scale: float = 0.001) -> Path:
    """Write the ground of a georeferenced drive as mobile mapping: LAZ in a projected system, and a trajectory (CSV).

    The vehicle drives at 10 m/s. The points of a scan were measured within 20 ms around the time of its pose.
    """
    folder.mkdir(exist_ok=True)
    fixes = drive.georeference
    to_grid = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    steps = np.linalg.norm(np.diff(drive.T_world_lidar[:, :3, 3], axis=0), axis=1)
    stamps = 3.2e8 + np.r_[0, np.cumsum(steps / 10.0)]
    x, y = to_grid.transform(fixes.lon_deg, fixes.lat_deg)
    ahead = lonlat_from_enu(fixes.lat_deg, fixes.lon_deg, fixes.R_enu_lidar[:, :2, 0])
    x_ahead, y_ahead = to_grid.transform(*ahead.T)
    bearing = np.degrees(np.arctan2(x_ahead - x, y_ahead - y))
    track = np.column_stack([stamps, x, y, fixes.alt_m, bearing])
    write_track(folder / "trajectory.csv", track, "gps_time,easting,northing,height,heading_deg")
    for number, chosen in enumerate(np.array_split(np.arange(len(drive.frames)), files)):
        parts = [_scan_on_grid(drive, int(at), to_grid, stamps) for at in chosen]
        xyz, times, labels = (np.concatenate(column) for column in zip(*parts, strict=True))
        write_las(folder / f"strip_{number}.laz", xyz, times_s=times, labels=labels, crs=crs, scale=scale)
    return folder


def _scan_on_grid(drive: FolderDrive, at: int, to_grid: Transformer, stamps: FloatArray) -> tuple[FloatArray, ...]:
    """Return the ground points of a scan on the grid, their times, and their classes."""
    fixes, points = drive.georeference, drive.ground_points(at)
    enu = points.xyz.astype(np.float64) @ fixes.R_enu_lidar[at].T
    lonlat = lonlat_from_enu(fixes.lat_deg[at], fixes.lon_deg[at], enu[:, :2])
    x, y = to_grid.transform(*lonlat.T)
    times = np.clip(stamps[at] + np.linspace(-0.01, 0.01, len(enu)), stamps[0], stamps[-1])
    return np.stack([x, y, fixes.alt_m[at] + enu[:, 2]], axis=1), times, np.where(points.is_road, 11.0, 2.0)


def straight_cloud(length_m: float = 60.0, *, density: int = 200) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points of a strip 20 m wide along a straight drive at 10 m/s, their times, and its trajectory.

    Points are in UTM zone 32, by time; the trajectory holds time, easting, northing, height every 0.05 s.
    """
    random, start_s = np.random.default_rng(0), 3.2e8
    origin, ahead = np.array([458_000.0, 5_428_000.0]), rotate_2d(np.array([1.0, 0.0]), np.radians(60))
    left = np.array([-ahead[1], ahead[0]])
    along = np.sort(random.uniform(0, length_m, int(length_m * density)))
    across = random.uniform(-10, 10, len(along))
    xy = origin + along[:, None] * ahead + across[:, None] * left
    xyz = np.column_stack([xy, random.normal(115, 0.01, len(along))])
    seconds = np.arange(0, length_m / 10 + 0.025, 0.05)
    track = np.column_stack([start_s + seconds, origin + 10 * seconds[:, None] * ahead, np.full(len(seconds), 117.0)])
    return xyz, start_s + along / 10, track


def write_track(path: Path, track: FloatArray, header: str = "time,x,y,z") -> Path:
    """Write rows of time, x, y, z (and more) as a table."""
    np.savetxt(path, track, fmt="%.9f", delimiter=",", header=header, comments="")
    return path
