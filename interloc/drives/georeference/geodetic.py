"""Geodetic fixes: their checks, and rigid poses on the ellipsoid."""

from dataclasses import replace

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings, GeoreferenceFileError
from interloc.drives.georeference.fixes import MIN_FIXES, are_moving, fit_shift, standing_fixes, tell_standing
from interloc.drives.poses.motion import body_steps, body_turns
from interloc.geometry import (
    ecef_from_geodetic,
    enu_from_lonlat,
    from_first,
    invert_transform,
    lonlat_from_enu,
    rigid_transforms,
    rows_apart,
    travelled,
)

MAX_GEOREFERENCE_ERROR = 0.1
"""Of the distance between two scans; all KITTI drives stay under 0.02, and those of other drives are over 0.1."""

MIN_TURNED_RAD = np.radians(30.0)
"""Root of the sum of squared turns over which the turns of poses and georeference are compared."""

_MIN_TURN_SHARE = 0.5
_JUMP_M = 5.0
_MIN_SHIFT_SCANS = 0.7
_E7, _LEAST_E7 = 1e7, 2e7
"""Some receivers write multiples of 1e-7 degrees; beyond two degrees these are larger than any coordinate in metres."""


def in_degrees(lat: FloatArray, lon: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Bring latitudes and longitudes to degrees, longitudes to -180 up to 180.

    They are degrees, longitudes of any turn, or most of them multiples of 1e-7 degrees: then the third value is True.
    """
    with np.errstate(invalid="ignore"):
        larger = np.maximum(np.abs(lat), np.abs(lon))
        larger = larger[np.isfinite(larger) & (larger > 0)]
        is_e7 = bool(len(larger) and np.median(larger) > _LEAST_E7 and larger.max() <= 360 * _E7)
        if is_e7:
            lat, lon = lat / _E7, lon / _E7
        turned = np.where(np.abs(lon) > 180, np.where(np.abs(lon) <= 360, (lon + 180) % 360 - 180, lon), lon)
    return lat, turned, is_e7


def checked_fixes(file: SourceFile, rows: FloatArray, frames: IntArray) -> FloatArray:
    """Refuse positions that are not on Earth, and angles in degrees; bring longitudes to -180 up to 180.

    Rows are latitude, longitude in degrees, altitude in metres, roll, pitch, yaw in radians, and whatever follows; the
    (N,) scan numbers are for messages.
    """
    rows = rows.copy()
    rows[:, 0], rows[:, 1], _ = in_degrees(rows[:, 0], rows[:, 1])
    lat, lon, alt, angles = np.abs(rows[:, 0]), np.abs(rows[:, 1]), np.abs(rows[:, 2]), np.abs(rows[:, 3:6])
    off = (lat > 89) | (lon > 360) | (alt > 20_000)
    if off.any():
        row = int(np.argmax(off))
        raise file.fault(
            f"frame {frames[row]}: latitude {rows[row, 0]:g}, longitude {rows[row, 1]:g}, altitude {rows[row, 2]:g} "
            "is no place to drive. Expected degrees and metres. Usual cause: projected coordinates, latitude and "
            "longitude swapped, or degrees and minutes in one number, as NMEA has them."
        )
    if ((lat == 0) & (lon == 0)).any():
        row = int(np.argmax((lat == 0) & (lon == 0)))
        raise file.fault(f"frame {frames[row]}: latitude and longitude are 0: the receiver had no fix.")
    if (angles > 2 * np.pi).any():
        row = int(np.argmax((angles > 2 * np.pi).any(axis=1)))
        raise file.fault(
            f"frame {frames[row]}: an angle of {angles[row].max():g}. Expected radians. Usual cause: degrees."
        )
    return rows


def poses_of(georeference: Georeference) -> FloatArray:
    """Return (N, 4, 4) T_world_lidar of a georeference, exact on the ellipsoid; W is the LiDAR at the first fix."""
    return from_first(ecef_poses(georeference))


def ecef_poses(georeference: Georeference) -> FloatArray:
    """Return (N, 4, 4) poses of the LiDAR in the earth-centred, earth-fixed frame of WGS84, metres."""
    lat, lon = np.radians(georeference.lat_deg), np.radians(georeference.lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(lat)
    east = np.stack([-sin_lon, cos_lon, zero], axis=1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=1)
    positions = ecef_from_geodetic(georeference.lat_deg, georeference.lon_deg, georeference.alt_m)
    return rigid_transforms(np.stack([east, north, up], axis=2) @ georeference.R_enu_lidar, positions)


def without_standing(
    poses: FloatArray, georeference: Georeference, frames: IntArray, findings: Findings
) -> Georeference:
    """Let (N, 4, 4) T_world_lidar tell where the vehicle was while fixes stood still, from those before and after.

    Fixes that stand for half of the drive stay as they are: they are not its fixes.
    """
    lonlat = georeference.lonlat
    runs = standing_fixes(poses[:, :2, 3], enu_from_lonlat(lonlat[0, 1], lonlat[0, 0], lonlat))
    driven_m = travelled(poses[:, :3, 3])
    is_most = max((run.driven_m for run in runs), default=0.0) > driven_m[-1] / 2
    if not runs or is_most or np.count_nonzero(are_moving(runs, len(poses))) < MIN_FIXES:
        return georeference
    tell_standing(runs, frames.astype(np.float64), "scans {:.0f} to {:.0f}", georeference.source, findings)
    R, std_m = georeference.R_enu_lidar.copy(), georeference.position_std_m
    alt, std_m = georeference.alt_m.copy(), None if std_m is None else std_m.copy()
    for run in runs:
        rows, last = run.repeated, min(run.stop, len(poses) - 1)
        moved = invert_transform(poses[run.first]) @ poses[run.first + 1 : last + 1]
        enu = moved[:, :3, 3] @ R[run.first].T
        if run.stop < len(poses):  # what the poses drift until the next fix is spread over the way there
            at_m = enu_from_lonlat(lonlat[run.first, 1], lonlat[run.first, 0], lonlat[last])
            share = (driven_m[run.first + 1 : last + 1] - driven_m[run.first]) / (driven_m[last] - driven_m[run.first])
            enu += share[:, None] * (np.array([*at_m, alt[last] - alt[run.first]]) - enu[-1])
        enu, moved = enu[: run.stop - run.first - 1], moved[: run.stop - run.first - 1]
        lonlat[rows] = lonlat_from_enu(lonlat[run.first, 1], lonlat[run.first, 0], enu[:, :2])
        alt[rows], R[rows] = alt[run.first] + enu[:, 2], R[run.first] @ moved[:, :3, :3]
        if std_m is not None:
            std_m[rows] = std_m[[run.first, last]].max()
    return replace(
        georeference, lat_deg=lonlat[:, 1], lon_deg=lonlat[:, 0], alt_m=alt, R_enu_lidar=R, position_std_m=std_m
    )


def check_against_poses(poses: FloatArray, georeference: Georeference, findings: Findings) -> float | None:
    """Check that the georeference moves as the poses do, and neither late nor early; as `check_georeference`."""
    errors = findings.errors
    error = check_georeference(poses, georeference, findings)
    if findings.errors == errors:
        check_shift(poses, georeference, findings)
    return error


def check_georeference(poses: FloatArray, georeference: Georeference, findings: Findings) -> float | None:
    """Check that the georeference moves as (N, 4, 4) T_world_lidar do, piece by piece (drift does not matter).

    Returns the median error of the motion over pieces of some metres, as a share of their length; None where it hardly
    moves.
    """
    rows = rows_apart(poses[:, :3, 3], 10.0)
    if len(rows) < 2:
        return None
    ours = body_steps(poses[rows])[:, :2]  # satellite heights settle by metres, and say nothing of the map

    def error_of(fixes: Georeference) -> float:
        theirs = body_steps(ecef_poses(fixes)[rows])[:, :2]
        return float(np.median(np.linalg.norm(theirs - ours, axis=1) / np.linalg.norm(ours, axis=1)))

    error = error_of(georeference)
    if error <= MAX_GEOREFERENCE_ERROR:
        theirs = ecef_poses(georeference)
        _check_turns(poses[rows], theirs[rows], georeference.source, findings)
        apart_m = np.linalg.norm((body_steps(theirs) - body_steps(poses))[:, :2], axis=1)
        if (apart_m > _JUMP_M).any():
            first = int(np.argmax(apart_m > _JUMP_M))
            driven_m = float(np.linalg.norm(body_steps(poses[: first + 1]), axis=1).sum())
            findings.warning(
                georeference.source,
                f"jumps against the poses, {np.count_nonzero(apart_m > _JUMP_M):,} times, first by "
                f"{apart_m[first]:.0f} m after {driven_m:.0f} m: intersections are so far off there. Usual cause: a "
                "receiver that lost its corrections (RTK), or an outage.",
            )
    else:
        cause = (
            "Usual cause: the georeference of another drive, rows that start at another frame, or angles in another "
            "convention (expected: yaw 0 = east, counter-clockwise, radians)."
        )
        lat, lon = georeference.lat_deg, georeference.lon_deg
        others = {
            "Latitude and longitude are swapped: the other way round": (lon, lat),
            "Latitude and longitude are in radians: in degrees": (np.degrees(lat), np.degrees(lon)),
        }
        for kind, (lat_deg, lon_deg) in others.items():
            other = replace(georeference, lat_deg=lat_deg, lon_deg=lon_deg)
            if np.abs(lat_deg).max() < 90.0 and error_of(other) < MAX_GEOREFERENCE_ERROR:
                cause = f"{kind} the motion is that of the poses."
        findings.refuse(
            georeference.source,
            f"describes another motion than the poses: off by {error:.0%} of the distance, piece by piece "
            f"(usual: under 2 %). {cause}",
            GeoreferenceFileError,
        )
    return error


def _check_turns(ours: FloatArray, theirs: FloatArray, source: str, findings: Findings) -> None:
    """Check that two tracks of (P, 4, 4) poses turn alike: their steps are the same where left and right are not."""
    turns, expected = body_turns(ours), body_turns(theirs)
    squares = float((expected**2).sum())
    share = float((turns * expected).sum()) / max(squares, 1e-12)
    if np.sqrt(squares) < MIN_TURNED_RAD or share > _MIN_TURN_SHARE:
        return
    how = "to the other side" if share < -_MIN_TURN_SHARE else "otherwise"
    findings.refuse(
        source,
        f"turns {how} than the poses ({share:.0%} of its turns are in them). Usual cause: one of the two has its z "
        "axis down (NED, FRD), so that left and right are mirrored, or an attitude that is not filled in. "
        "Expected x forward, y left, z up in both.",
        GeoreferenceFileError,
    )


def check_shift(poses: FloatArray, georeference: Georeference, findings: Findings) -> None:
    """Check that the georeference is not late or early: its shape is that of the poses, some scans on."""
    lonlat = georeference.lonlat
    enu = enu_from_lonlat(lonlat[0, 1], lonlat[0, 0], lonlat)
    scans = np.arange(len(poses), dtype=np.float64)
    shift = fit_shift(scans, poses[:, :2, 3], scans, enu)
    if shift is None or not shift.is_there or abs(shift.late) < _MIN_SHIFT_SCANS:
        if shift is not None and shift.undecided:
            findings.undecided(georeference.source, shift.undecided)
        return
    findings.refuse(
        georeference.source,
        f"is {abs(shift.late):.1f} scans {'late' if shift.late > 0 else 'early'} against the poses: so shifted it "
        f"lies {shift.after_m:.1f} m off them, else {shift.before_m:.1f} m, and intersections would be about "
        f"{shift.metres:.0f} m off along the road. Usual cause: rows that start at another frame, or two clocks.",
        GeoreferenceFileError,
    )
