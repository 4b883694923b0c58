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


def timed(drive: MadeDrive) -> MadeDrive:
    """The drive with the times of its scans."""
    return replace(drive, times_s=START_S + np.arange(len(drive.frames)) / 10.0)


def test_a_drive_is_laid_on_the_track() -> None:
    placed = georeference_by_gpx(timed(DRIVE), phone(DRIVE))
    error_m = DRIVE.error_m(placed.georeference)
    assert np.median(error_m) < 4.0
    assert error_m.max() < 12.0
    assert 4.0 <= np.median(placed.georeference.position_std_m) < 6.0
    assert "phone.gpx" in placed.georeference.source


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
