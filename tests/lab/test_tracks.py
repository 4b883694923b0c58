"""Tracks from lines and OXTS."""

import numpy as np
import pytest

from interloc.errors import DriveError
from interloc.geometry import yaw_of
from interloc.lab.config import TrackConfig
from interloc.lab.tracks import LocalFrame, track_from_line, track_from_oxts


def test_a_line_is_driven_at_constant_speed(frame: LocalFrame) -> None:
    track = track_from_line(frame.lonlat([[0, 0], [0, 50], [50, 50]]), None, TrackConfig(speed_mps=5, rate_hz=10))
    xy = frame.xy(np.column_stack([track.lon_deg, track.lat_deg]))
    steps = np.hypot(*np.diff(xy, axis=0).T)
    assert np.allclose(steps, 0.5, atol=0.02)
    yaw = yaw_of(track.R_enu_lidar)
    assert yaw[0] == pytest.approx(np.pi / 2, abs=0.01)
    assert yaw[-1] == pytest.approx(0.0, abs=0.01)
    assert np.abs(np.diff(yaw)).max() < 0.25  # no jump at the corner


def test_an_offset_is_to_the_right(frame: LocalFrame) -> None:
    track = track_from_line(frame.lonlat([[0, 0], [0, 50]]), None, TrackConfig(offset_m=1.6))
    assert np.allclose(frame.xy(np.column_stack([track.lon_deg, track.lat_deg]))[:, 0], 1.6, atol=0.01)


def test_oxts_rows_and_lidar_fixes_undo_each_other(frame: LocalFrame) -> None:
    track = track_from_line(frame.lonlat([[0, 0], [30, 20], [60, 20]]), np.array([100.0, 101, 103]))
    again = track_from_oxts(track.oxts)
    metres = [111_000, 73_000, 1]
    for a, b, scale in zip(
        (track.lat_deg, track.lon_deg, track.alt_m), (again.lat_deg, again.lon_deg, again.alt_m), metres, strict=True
    ):
        assert np.abs(a - b).max() * scale < 1e-4
    assert np.allclose(track.R_enu_lidar, again.R_enu_lidar, atol=1e-6)  # the calibration has 7 digits


def test_lines_that_cannot_be_driven(frame: LocalFrame) -> None:
    with pytest.raises(DriveError, match="1 point"):
        track_from_line(frame.lonlat([[0, 0]]))
