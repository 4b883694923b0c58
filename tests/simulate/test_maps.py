"""From a map and a track to a drive, in one call."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from interloc.drives.open import open_drive
from interloc.simulate.config import LidarConfig, TrackConfig
from interloc.simulate.lines import open_track
from interloc.simulate.local_frame import LocalFrame
from interloc.simulate.maps import simulate_map


def test_a_csv_track_over_a_map(frame: LocalFrame, write_map: Callable[..., Path], tmp_path: Path) -> None:
    roads = write_map(
        ([(-90.0, 0.0), (0.0, 0.0), (90.0, 0.0)], {"highway": "residential"}),
        ([(0.0, 0.0), (20.0, 80.0)], {"highway": "residential"}),
    )
    lonlat = frame.lonlat([[-30, 0], [0, 0], [10, 40]])
    track = tmp_path / "track.csv"
    track.write_text("lat,lon\n" + "".join(f"{lat:.9f},{lon:.9f}\n" for lon, lat in lonlat))
    count = simulate_map(
        open_track(track, TrackConfig(speed_mps=10, rate_hz=4)),
        roads,
        tmp_path / "drive",
        sensor=LidarConfig(columns=120),
    )
    drive = open_drive(tmp_path / "drive")
    assert count == len(drive.frames)
    assert 26 <= count <= 29  # 71 m at 2.5 m a scan, less what rounding the corner saves
    assert np.linalg.norm(drive.T_world_lidar[-1, :3, 3] - drive.T_world_lidar[0, :3, 3]) > 50
    labels = np.fromfile(tmp_path / "drive/labels/000010.label", np.uint32)
    assert 50 in labels  # houses are made up where the map has none
