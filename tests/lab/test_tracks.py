"""Tracks from lines, GPX, CSV and OXTS."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from interloc.errors import DriveError
from interloc.geometry import yaw_of
from interloc.lab.config import TrackConfig
from interloc.lab.tracks import LocalFrame, format_oxts, open_track, read_csv, track_from_line, track_from_oxts

GPX = """<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1"><trk><trkseg>
<trkpt lat="49.0" lon="8.4"><ele>110</ele><time>2024-01-01T00:00:00Z</time></trkpt>
<trkpt lat="49.0" lon="8.401"><ele>112</ele></trkpt></trkseg></trk></gpx>"""


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


def test_gpx(tmp_path: Path) -> None:
    path = tmp_path / "a.gpx"
    path.write_text(GPX)
    assert len(open_track(path, TrackConfig(speed_mps=10, rate_hz=1))) == 8  # 73 m at 10 m a scan


@pytest.mark.parametrize(
    "text", ["lat,lon\n49,8.4\n49.001,8.4\n", "Time;Longitude;Latitude;Ele\n0;8.4;49;1\n1;8.4;49.001;\n"]
)
def test_csv(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    lonlat, alt = read_csv(path)
    assert lonlat.tolist() == [[8.4, 49.0], [8.4, 49.001]]
    assert alt is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("49,8.4\n49.001,8.4\n", "Expected a header"),
        ("", "is empty"),
        ("lat,lon\n", "a header only"),
        ("lat,lon\n49,8.4\nnorth,8.4\n", "line 3"),
        ("lat,lon\n49\n", "line 2"),
        ("lat,lon\n49,8.4\nnan,8.4\n", "line 3.*not finite"),
        ("lat,lon\n49,8.4\n8.4,190\n", "line 3: latitude 8.4, longitude 190"),
    ],
)
def test_bad_csv(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(DriveError, match=message):
        read_csv(path)


def test_oxts_files(tmp_path: Path, frame: LocalFrame) -> None:
    rows = track_from_line(frame.lonlat([[0, 0], [20, 0]])).oxts
    packed = tmp_path / "rows.txt.gz"
    packed.write_bytes(gzip.compress("".join(map(format_oxts, rows)).encode()))
    for i, row in enumerate(rows):
        (tmp_path / f"{i:010d}.txt").write_text(format_oxts(row))
    one, other = open_track(packed), open_track(tmp_path)
    assert np.array_equal(one.oxts, other.oxts)
    assert np.allclose(one.oxts[:, 0], rows[:, 0], atol=1e-10)


@pytest.mark.parametrize("text", ["a b c\n", "1 2 3\n4 5\n", "99 8 0 0 0 0" + " 0" * 24])
def test_bad_oxts(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rows.txt"
    path.write_text(text)
    with pytest.raises(DriveError, match="xpected"):
        open_track(path)


def test_lines_that_cannot_be_driven(frame: LocalFrame) -> None:
    with pytest.raises(DriveError, match="1 point"):
        track_from_line(frame.lonlat([[0, 0]]))
    with pytest.raises(DriveError, match="one place"):
        track_from_line(frame.lonlat([[0, 0], [0, 0]]))
    with pytest.raises(DriveError, match=r"3,000 m apart.*Usual cause"):
        track_from_line(frame.lonlat([[0, 0], [3000, 0]]))
