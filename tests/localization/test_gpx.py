"""A drive is placed by the track of a phone that was along."""

from dataclasses import replace

import numpy as np
import pytest

from interloc.errors import LocationError
from interloc.localization.gpx import GpxTrack, georeference_by_gpx
from tests.localization.town import MadeDrive, drive_along, route_xy

START_S = 1.7e9
DRIVE = drive_along(route_xy(), drift_deg_per_km=2.0)


def phone(drive: MadeDrive, *, noise_m: float = 3.0, every: int = 10) -> GpxTrack:
    """What a phone records along the way: a fix every ten metres, off by what changes slowly."""
    rng = np.random.default_rng(3)
    count = len(drive.true_lonlat)
    white = rng.normal(0.0, noise_m, (count, 2))
    slow = np.column_stack([np.convolve(white[:, axis], np.ones(50) / 50**0.5, "same") for axis in (0, 1)])
    degrees = slow / 111_320.0 / [np.cos(np.radians(49.0)), 1.0]
    return GpxTrack((drive.true_lonlat + degrees)[::every], START_S + np.arange(count)[::every] / 10.0, "phone.gpx")


@pytest.mark.parametrize("by", ["time", "shape"])
def test_a_drive_is_laid_on_the_track(by: str) -> None:
    times_s = START_S + np.arange(len(DRIVE.frames)) / 10.0 if by == "time" else None
    placed = georeference_by_gpx(replace(DRIVE, times_s=times_s), phone(DRIVE))
    error_m = DRIVE.error_m(placed.georeference)
    assert placed.matched_by == by
    assert np.median(error_m) < 4.0
    assert error_m.max() < 12.0
    assert 4.0 <= np.median(placed.georeference.position_std_m) < 6.0
    assert "phone.gpx" in placed.georeference.source


def test_a_track_that_is_longer_than_the_drive() -> None:
    track = phone(DRIVE)
    part = slice(300, 1000)
    poses = np.linalg.inv(DRIVE.T_world_lidar[part][0]) @ DRIVE.T_world_lidar[part]
    drive = MadeDrive(poses, DRIVE.true_lonlat[part], DRIVE.true_yaw_rad[part])
    assert np.median(drive.error_m(georeference_by_gpx(drive, track).georeference)) < 5.0


def test_a_track_of_somewhere_else_is_refused() -> None:
    other = drive_along(route_xy() * [-1.0, 1.0])
    with pytest.raises(LocationError, match="track of another day"):
        georeference_by_gpx(DRIVE, phone(other))
    short = phone(DRIVE)
    with pytest.raises(LocationError, match="Expected a track that covers the drive"):
        georeference_by_gpx(DRIVE, GpxTrack(short.lonlat[:30], None, "short.gpx"))


def test_a_straight_drive_fits_everywhere_along_a_straight_track() -> None:
    line = drive_along(np.array([[0.0, 0.0], [1000.0, 0.0]]))
    piece = MadeDrive(line.T_world_lidar[:300], line.true_lonlat[:300], line.true_yaw_rad[:300])
    with pytest.raises(LocationError, match="ambiguous"):
        georeference_by_gpx(piece, phone(line, noise_m=0.5))
    with pytest.raises(LocationError, match="m long; a track places one"):
        georeference_by_gpx(replace(piece, T_world_lidar=piece.T_world_lidar[:51]), phone(line))


@pytest.mark.parametrize("late_s", [2.0, -8.0])
def test_a_clock_that_is_late_is_put_right(late_s: float) -> None:
    drive = replace(DRIVE, times_s=START_S + np.arange(len(DRIVE.frames)) / 10.0)
    track = phone(DRIVE)
    placed = georeference_by_gpx(drive, replace(track, time_s=track.time_s + late_s))
    assert placed.late_s == pytest.approx(late_s, abs=0.3)
    assert f"put right by {-placed.late_s:+.1f} s" in placed.georeference.source
    assert np.median(DRIVE.error_m(placed.georeference)) < 4.0
    assert georeference_by_gpx(drive, track).late_s == 0.0


def test_where_the_clock_does_not_fit_the_shape_places_the_drive() -> None:
    drive = replace(DRIVE, times_s=START_S + np.arange(len(DRIVE.frames)) / 10.0)
    track = phone(DRIVE)
    placed = georeference_by_gpx(drive, replace(track, time_s=track.time_s + 3600.0))
    assert placed.matched_by == "shape"
    assert np.median(DRIVE.error_m(placed.georeference)) < 4.0
