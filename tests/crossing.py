"""A street with one crossing, as road points, as a drive with its OXTS, and as a map."""

import gzip
from pathlib import Path

import numpy as np

SPACING_M = 2.5


def road_at(x_m: float) -> np.ndarray:
    """Road points of a crossing 60 m from the start, seen within 35 m from a vehicle on one of its streets."""
    x, y = np.meshgrid(np.arange(-48, 176, 0.8), np.arange(-48, 48, 0.8))
    seen = (np.hypot(x - x_m, y) < 35) & ((np.abs(y) < 5) | (np.abs(x - 60) < 5))
    return np.stack([x[seen] - x_m, y[seen], np.full(int(seen.sum()), -1.73)], axis=1).astype(np.float32)


def pose_at(x_m: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x_m
    return pose


def write_drive(root: Path, raw: Path) -> None:
    """Write a drive through the crossing, with the OXTS of a raw drive beside, and its map."""
    (root / "velodyne").mkdir(parents=True)
    (root / "labels").mkdir()
    (raw / "oxts" / "data").mkdir(parents=True)
    (raw / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
    lines = []
    for frame in range(48):
        x_m = SPACING_M * frame
        points = np.pad(road_at(x_m), ((0, 0), (0, 1)))
        points.tofile(root / f"velodyne/{frame:06d}.bin")
        np.full(len(points), 40, np.uint32).tofile(root / f"labels/{frame:06d}.label")
        lines.append(" ".join(f"{value:g}" for value in pose_at(x_m)[:3].ravel()))
        lon_deg = 8.4 + np.degrees(x_m / (6_390_400 * np.cos(np.radians(49.0))))
        values = [49.0, lon_deg, 110.0, 0.0, 0.0, 0.0, *([0.0] * 24)]
        (raw / f"oxts/data/{frame:010d}.txt").write_text(" ".join(f"{value:.12g}" for value in values) + "\n")
    (root / "poses.txt").write_text("\n".join(lines) + "\n")
    east, north = np.degrees(60 / (6_390_400 * np.cos(np.radians(49.0)))), np.degrees(100 / 6_382_000)
    nodes = [(0, 0), (east, 0), (4 * east, 0), (east, -north), (east, north)]
    osm = (
        '<osm version="0.6">'
        + "".join(
            f'<node id="{i}" lat="{49 + lat:.9f}" lon="{8.4 + lon:.9f}"/>' for i, (lon, lat) in enumerate(nodes, 1)
        )
        + "".join(
            f'<way id="{i}">{"".join(f"<nd ref={chr(34)}{ref}{chr(34)}/>" for ref in refs)}'
            '<tag k="highway" v="residential"/></way>'
            for i, refs in enumerate([(1, 2, 3), (4, 2, 5)], 1)
        )
        + "</osm>"
    )
    with gzip.open("map.osm.gz", "wt") as file:
        file.write(osm)
