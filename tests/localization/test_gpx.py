"""A drive is placed by the track of a phone that was along."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.errors import DriveError, LocationError
from interloc.geometry import wrap_longitude
from interloc.localization.gpx import GpxTrack, georeference_by_gpx, read_gpx
from tests.localization.town import MadeDrive, drive_along, route_xy

START_S = 1.7e9
DRIVE = drive_along(route_xy(), drift_deg_per_km=2.0)


def phone(drive: MadeDrive) -> GpxTrack:
    """What a phone records along the way: a fix every ten metres, off by what changes slowly."""
    rng = np.random.default_rng(3)
    count = len(drive.true_lonlat)
    white = rng.normal(0.0, 3.0, (count, 2))
    slow = np.column_stack([np.convolve(white[:, axis], np.ones(50) / 50**0.5, "same") for axis in (0, 1)])
    degrees = slow / 111_320.0 / [np.cos(np.radians(49.0)), 1.0]
    return GpxTrack((drive.true_lonlat + degrees)[::10], START_S + np.arange(count)[::10] / 10.0, "phone.gpx")


def timed(drive: MadeDrive) -> MadeDrive:
    return replace(drive, times_s=START_S + np.arange(len(drive.frames)) / 10.0)


def test_a_drive_is_laid_on_the_track() -> None:
    placed = georeference_by_gpx(timed(DRIVE), phone(DRIVE))
    error_m = DRIVE.error_m(placed.georeference)
    assert np.median(error_m) < 4.0
    assert error_m.max() < 12.0
    assert 4.0 <= np.median(placed.georeference.position_std_m) < 6.0
    assert "phone.gpx" in placed.georeference.source


def test_a_track_across_the_180th_meridian_is_as_good() -> None:
    def east(lonlat: FloatArray) -> FloatArray:
        return np.column_stack([wrap_longitude(lonlat[:, 0] + 180.0 - DRIVE.true_lonlat[50, 0]), lonlat[:, 1]])

    track = phone(DRIVE)
    placed = georeference_by_gpx(timed(DRIVE), replace(track, lonlat=east(track.lonlat)))
    assert np.median(replace(DRIVE, true_lonlat=east(DRIVE.true_lonlat)).error_m(placed.georeference)) < 4.0


def test_a_track_of_another_place_or_time_or_without_times_is_refused() -> None:
    with pytest.raises(LocationError, match="track of another day"):
        georeference_by_gpx(timed(DRIVE), phone(drive_along(route_xy() * [-1.0, 1.0])))
    track = phone(DRIVE)
    with pytest.raises(LocationError, match="Expected a track that covers the"):
        georeference_by_gpx(timed(DRIVE), replace(track, time_s=track.time_s + 3600.0))
    for drive, given in ((DRIVE, track), (timed(DRIVE), replace(track, time_s=None))):
        with pytest.raises(LocationError, match="has no times since 1970"):
            georeference_by_gpx(drive, given)
    with pytest.raises(LocationError, match="m long; a track places one"):
        georeference_by_gpx(replace(DRIVE, T_world_lidar=DRIVE.T_world_lidar[:51]), track)


@pytest.mark.parametrize("late_s", [2.0, -8.0])
def test_a_clock_that_is_late_is_put_right(late_s: float) -> None:
    drive, track = timed(DRIVE), phone(DRIVE)
    placed = georeference_by_gpx(drive, replace(track, time_s=track.time_s + late_s))
    assert placed.late_s == pytest.approx(late_s, abs=0.3)
    assert f"put right by {-placed.late_s:+.1f} s" in placed.georeference.source
    assert np.median(DRIVE.error_m(placed.georeference)) < 4.0
    assert georeference_by_gpx(drive, track).late_s == 0.0


def gpx_text(points: str) -> str:
    return f'<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def test_a_file_is_read_with_and_without_times_and_heights(tmp_path: Path) -> None:
    path = tmp_path / "a.gpx"
    points = "".join(
        f'<trkpt lat="49.0" lon="8.4{i}"><ele>11{i}</ele><time>2026-01-01T00:00:0{i}Z</time></trkpt>' for i in range(3)
    )
    path.write_text(gpx_text(points))
    track = read_gpx(path)
    assert track.lonlat.tolist() == [[8.40, 49.0], [8.41, 49.0], [8.42, 49.0]]
    assert datetime.fromtimestamp(track.time_s[2], UTC) == datetime(2026, 1, 1, 0, 0, 2, tzinfo=UTC)
    path.write_text(gpx_text('<trkpt lat="49.0" lon="8.4"><ele>110</ele></trkpt><trkpt lat="49.0" lon="8.5"/>'))
    bare = read_gpx(path)
    assert bare.time_s is None


def test_a_route_is_read_where_there_is_no_track(tmp_path: Path) -> None:
    path = tmp_path / "a.gpx"
    path.write_text('<gpx version="1.0"><rte><rtept lat="49" lon="8"/><rtept lat="49" lon="8.1"/></rte></gpx>')
    assert read_gpx(path).lonlat.tolist() == [[8.0, 49.0], [8.1, 49.0]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "it is no GPX file"),
        ("no xml", "it is no GPX file"),
        (gpx_text('<trkpt lat="49" lon="8"/>')[:-6], "it is no GPX file"),
        ("<kml/>", r"holds 0 points of a track or route \(it starts with <kml>\)"),
        (gpx_text(""), "holds 0 points"),
        ('<gpx version="1.1"><wpt lat="1" lon="2"/></gpx>', "waypoints are not enough"),
        (gpx_text('<trkpt lat="x" lon="8"/>'), "it is no GPX file"),
        (gpx_text('<trkpt lat="49" lon="8"/><trkpt lat="95" lon="8"/>'), "point 2 is at latitude 95"),
        (gpx_text('<trkpt lat="49" lon="nan"/><trkpt lat="49" lon="8"/>'), "beyond 180 degrees"),
        ('<!DOCTYPE gpx [<!ENTITY a "b">]>' + gpx_text(""), "declares entities or a DOCTYPE"),
    ],
)
def test_what_is_no_track_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.gpx"
    path.write_text(text)
    with pytest.raises(DriveError, match=says):
        read_gpx(path)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DriveError, match="could not be read"):
        read_gpx(tmp_path / "none.gpx")
    with (tmp_path / "large.gpx").open("wb") as file:
        file.truncate(200_000_000)
    with pytest.raises(DriveError, match="at most 100,000,000"):
        read_gpx(tmp_path / "large.gpx")
