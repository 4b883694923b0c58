"""A straight street with crossings every 60 m, driven with a keyframe every 2.1 m: as long a job as a test needs."""

from pathlib import Path

import numpy as np

from interloc.geometry import lonlat_from_enu
from tests.osm_files import osm_text
from tests.small_drives import write_scan

LAT_DEG, LON_DEG = 49.0, 8.4
SPACING_M = 2.1
BLOCK_M = 60.0
_REACH_M = 35.0


def write_street(root: Path, scans: int) -> Path:
    """Write the drive (SemanticKITTI layout, LiDAR poses, geo.csv) with its map.osm; returns its folder."""
    fixes = lonlat_from_enu(LAT_DEG, LON_DEG, np.stack([np.arange(scans) * SPACING_M, np.zeros(scans)], axis=1))
    poses, times = [], []
    rows = ["frame,lat_deg,lon_deg,alt_m,roll_rad,pitch_rad,yaw_rad"]
    for frame, (lon, lat) in enumerate(fixes):
        write_scan(root, frame, *_scan(frame * SPACING_M))
        poses.append(f"1 0 0 {frame * SPACING_M:.6f} 0 1 0 0 0 0 1 0")
        times.append(f"{0.25 * frame:.6e}")
        rows.append(f"{frame},{lat:.10f},{lon:.10f},110,0,0,0")
    for name, lines in (("poses.txt", poses), ("times.txt", times), ("geo.csv", rows)):
        (root / name).write_text("\n".join(lines) + "\n")
    (root / "map.osm").write_text(_map(scans * SPACING_M))
    return root


def in_a_town(osm: str) -> str:
    """Add streets to the map, block by block, 160 m to both sides: it does not look cut off at its crossings."""
    enu = np.array([(x, y) for y in (-160.0, 160.0) for x in np.arange(-5 * BLOCK_M, 10 * BLOCK_M, BLOCK_M)])
    fixes = enumerate(lonlat_from_enu(LAT_DEG, LON_DEG, enu), 500)
    nodes = [f'<node id="{number}" lat="{lat:.9f}" lon="{lon:.9f}"/>' for number, (lon, lat) in fixes]
    ways = [
        f'<way id="{number}"><nd ref="{number}"/><nd ref="{number + 1}"/><tag k="highway" v="residential"/></way>'
        for number in range(500, 499 + len(enu))
        if number != 499 + len(enu) // 2
    ]
    return osm.replace("</osm>", "\n".join([*nodes, *ways, "</osm>"]))


def _scan(x_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of the plane around the vehicle in L, and their labels: road, sidewalk beside it, terrain."""
    x, y = np.meshgrid(np.arange(x_m - _REACH_M, x_m + _REACH_M, 0.8), np.arange(-_REACH_M, _REACH_M, 0.8))
    x, y = x[np.hypot(x - x_m, y) < _REACH_M], y[np.hypot(x - x_m, y) < _REACH_M]
    across = np.abs((x + BLOCK_M / 2) % BLOCK_M - BLOCK_M / 2)  # streets at 0, 60, 120, ... m
    aside = np.minimum(np.abs(y), across)
    points = np.stack([x - x_m, y, np.full_like(x, -1.73), np.full_like(x, 0.3)], axis=1)
    return points.astype(np.float32), np.where(aside < 5, 40, np.where(aside < 7, 48, 72)).astype(np.uint32)


def _map(length_m: float) -> str:
    xs = np.arange(-BLOCK_M, length_m + 2 * BLOCK_M, BLOCK_M)
    enu = np.array([(x, y) for x in xs for y in (-80.0, 0.0, 80.0)])
    along = [3 * i + 2 for i in range(len(xs))]
    across = ([3 * i + 1, 3 * i + 2, 3 * i + 3] for i in range(len(xs)))
    return osm_text(lonlat_from_enu(LAT_DEG, LON_DEG, enu), [along, *across])
