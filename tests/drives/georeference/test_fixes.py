"""A shift in time between poses and fixes is found by the shape of the path, and none where there is none."""

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.drive import Georeference
from interloc.drives.findings import Findings
from interloc.drives.georeference.fixes import fit_moving, fit_shift
from interloc.drives.georeference.geodetic import poses_of, without_standing
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d, rotation_from_rpy

TIMES = np.arange(0.0, 120.0, 0.1)


def path(bend: float = 0.8) -> FloatArray:
    """Return (1200, 2) positions along an S at 8 to 12 m/s."""
    speed = 10.0 + 2.0 * np.sin(TIMES / 7.0)
    heading = bend * np.sin(TIMES / 9.0)
    steps = 0.1 * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.cumsum(steps, axis=0)


@pytest.mark.parametrize("noise_m", [0.0, 1.0])
@pytest.mark.parametrize("late_s", [0.0, 1.0, 2.0, -5.0, 18.0])
def test_a_shift_is_found_whatever_the_noise(late_s: float, noise_m: float) -> None:
    noise = np.random.default_rng(4).normal(0.0, noise_m, (120, 2)) if noise_m else 0.0
    found = fit_shift(TIMES, path(), TIMES[::10] + late_s, rotate_2d(path()[::10], 1.0) + noise)
    assert not found.untold
    assert found.is_there == (late_s != 0.0)
    if late_s == 0.0:
        return
    assert found.is_sure
    assert found.late == pytest.approx(late_s, abs=0.2)
    assert found.after_m < found.before_m


def test_too_few_fixes_tell_nothing() -> None:
    assert fit_shift(TIMES, path(), TIMES[:30:10] + 3.0, path()[:30:10]) is None
    standing = np.zeros((len(TIMES), 2))
    assert fit_shift(TIMES, standing, TIMES[::10], standing[::10]) is None


def test_what_cannot_be_told_is_said() -> None:
    """On a straight road and on a bend, at one speed, 3 s late looks as in time; with a stop it does not."""
    heading = TIMES / 40.0
    bend = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    straight = np.stack([10.0 * TIMES, np.zeros_like(TIMES)], axis=1)
    for track in (straight, bend):
        found = fit_shift(TIMES, track, TIMES[::10] + 3.0, track[::10])
        assert not found.is_there
        assert found.untold_m > 50
        assert "cannot be told" in found.untold
    stops = straight.copy()
    stops[600:900, 0] = stops[600, 0]
    stops[900:, 0] = stops[600, 0] + straight[:300, 0]
    found = fit_shift(TIMES, stops, TIMES[::10] + 3.0, stops[::10])
    assert found.is_there
    assert found.late == pytest.approx(3.0, abs=0.1)
    assert not found.untold


def test_speeds_that_repeat_do_not_make_a_shift_of_a_period() -> None:
    """Every 38 s it slows down alike: 2 s late looks as 36 s early; the smaller is taken, and neither is sure."""
    straight = np.cumsum(np.stack([1.0 + 0.2 * np.sin(TIMES / 6.0), np.zeros_like(TIMES)], axis=1), axis=0)
    found = fit_shift(TIMES, straight, TIMES[::10] + 2.0, straight[::10])
    assert found.late == pytest.approx(2.0, abs=0.2)
    assert not found.is_sure


def test_fixes_that_stand_while_the_vehicle_drives_tell_nothing() -> None:
    """Frozen for 12 s and 3 s under fresh stamps, and late by 2 s or not: the others tell the shift."""
    for late_s in (0.0, 2.0):
        fixes = path()[::5].copy()
        fixes[40:64], fixes[100:106] = fixes[40], fixes[100]
        found, runs = fit_moving(TIMES, path(), TIMES[::5] + late_s, fixes)
        assert [(run.first, run.stop) for run in runs] == [(40, 64), (100, 106)]
        assert [run.driven_m for run in runs] == pytest.approx([110.0, 25.0], rel=0.2)
        assert found.is_there == (late_s != 0.0)
        assert found.late == pytest.approx(late_s, abs=0.1)


@pytest.mark.parametrize("late_s", [0.0, 3.0])
def test_a_parked_vehicle_stands_with_its_fixes(late_s: float) -> None:
    parked = np.repeat(path(), np.where(np.arange(len(TIMES)) == 500, 300, 1), axis=0)
    times = 0.1 * np.arange(len(parked))
    noise = np.random.default_rng(4).normal(0.0, 1.0, parked.shape)
    for fixes in (parked, parked + noise):
        assert not fit_moving(times, parked, times + late_s, fixes)[1]


def test_of_fixes_that_repeat_the_first_counts() -> None:
    """New ones come once a second, ten are written."""
    found, runs = fit_moving(TIMES, path(), TIMES, np.repeat(path()[::10], 10, axis=0))
    assert not found.is_there
    assert len(runs) == 120


@pytest.mark.parametrize("stands", [slice(0, 150), slice(400, 640), slice(1100, 1200)])
def test_poses_tell_where_it_was_while_the_georeference_stood(stands: slice) -> None:
    xy, yaw = path(), 0.8 * np.sin(TIMES / 9.0)
    zero = np.zeros(len(xy))
    lonlat = lonlat_from_enu(49.0, 8.4, xy)
    R_enu_lidar = rotation_from_rpy(zero, zero, yaw)
    true = Georeference(lonlat[:, 1], lonlat[:, 0], zero + 110.0, R_enu_lidar, "geo.csv", zero + 0.1)
    rows = np.arange(len(xy))
    rows[stands] = stands.start
    findings = Findings(stop_at_first=False)
    poses = poses_of(true)
    found = without_standing(poses, true.part(rows), np.arange(len(xy)), findings)
    off_m = enu_from_lonlat(found.lat_deg, found.lon_deg, lonlat)
    assert np.abs(off_m).max() < 0.05
    assert np.abs(found.R_enu_lidar - R_enu_lidar).max() < 1e-3
    (warning,) = findings.found
    assert f"scans {stands.start} to {stands.stop - 1}, " in warning.message
    assert without_standing(poses, true, np.arange(len(xy)), Findings(stop_at_first=True)) is true
