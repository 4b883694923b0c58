"""Mobile mapping: LAS files in a projected system with times, and the trajectory that they were recorded along."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.drive import Georeference
from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.georeference.geodetic import poses_of
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.las.clocks import Sample, match_clocks
from interloc.drives.scans.las.clouds import ROAD_SURFACE, CloudFile, all_of
from interloc.drives.scans.las.grid import Grid, grid_of, named_grid, outside
from interloc.drives.scans.las.slices import (
    MAX_SCAN_POINTS,
    SlicedClouds,
    SliceIndex,
    Slices,
    cut,
    index_clouds,
    without_empty,
)
from interloc.drives.scans.las.tracks import SurveyTrack, find_tracks, read_track
from interloc.drives.scans.recorded import Recording
from interloc.drives.trajectory import LidarPoses, Trajectory
from interloc.geometry import from_first, rigid_transforms, rotation_from_rpy, wrap_angle

SENSOR_HEIGHT_M = 2.0
"""Over the ground, where the heights of the trajectory are not those of the cloud (ellipsoid and geoid)."""

_SAMPLED_FILES, _SAMPLED_EVERY = 20, 25
_NEAR_M, _HEIGHTS_M = 15.0, (-1.0, 8.0)
_MAX_OUTSIDE, _OUTSIDE_WORTH_SAYING = 0.5, 0.01
_JUMP_M, _JUMP_MPS = 50.0, 1000.0
_HEADING_OFF_RAD = np.radians(30)


def open_mapping(
    clouds: tuple[CloudFile, ...], parts: DriveParts, options: DriveOptions, findings: Findings
) -> Recording:
    """Cut the clouds of a mobile mapping vehicle into scans.

    Raises
    ------
    DriveError
        They have no times, no trajectory or no coordinate system, or these do not fit together.
    """
    folder = all_of(clouds)
    track = _find_track(clouds, parts, options)
    sample, has_intensity = _sample(clouds, folder)
    grid = _grid(clouds, options, findings)
    vehicle = _vehicle(track, sample, grid, clouds[0], findings)
    slices = cut(vehicle.times_s, vehicle.position)
    index = index_clouds(clouds, slices, folder, findings)
    _check_outside(index, track, findings)
    slices, index, _ = without_empty(slices, index)
    _note_labels(index, folder, findings)
    _note_large(index, folder, findings)
    origin = _at(slices.times_s, vehicle.times_s, vehicle.position)
    heading = vehicle.headings_at(slices.times_s)
    axes = np.tile(np.eye(2), (len(origin), 1, 1)) if grid is None else grid.axes(origin)
    ahead = np.einsum("nij,nj->ni", axes, np.stack([np.cos(heading), np.sin(heading)], axis=1))
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    to_lidar = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=-2) @ axes
    trajectory = _trajectory(slices, origin, yaw, grid, vehicle)
    return Recording(
        parts,
        SlicedClouds(clouds, slices, index, origin, to_lidar, index.has_road),
        np.arange(len(origin), dtype=np.int64),
        scan_bytes=sum(cloud.size for cloud in clouds),
        point_counts=-(-index.counts // index.steps),
        carries_labels=index.has_road,
        scheme="las" if index.has_road else None,
        has_remission=has_intensity,
        is_cut=True,
        read_trajectory=lambda _frames, _options, _findings: trajectory,
    )


@dataclass(frozen=True)
class Vehicle:
    """Where the vehicle was, in the clock and the coordinates of the cloud."""

    times_s: FloatArray
    """(P,) float64."""
    position: FloatArray
    """(P, 3) float64."""
    heading: FloatArray | None
    """(P,) float64 or None: radians counter-clockwise from the easting axis, without jumps; None: as it moves."""
    reason: str
    """Where they come from, in words."""

    def headings_at(self, times_s: FloatArray) -> FloatArray:
        """Return the (N,) headings at some times."""
        if self.heading is not None:
            return np.interp(times_s, self.times_s, self.heading)
        return _courses(_at(times_s, self.times_s, self.position))


def _at(times_s: FloatArray, known_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(times_s, known_s, axis) for axis in values.T], axis=1)


def _courses(position: FloatArray) -> FloatArray:
    """Return the (N,) directions in which (N, 3) positions a few metres apart follow each other, radians."""
    before, after = np.r_[0, np.arange(len(position) - 1)], np.r_[np.arange(1, len(position)), len(position) - 1]
    along = position[after] - position[before]
    return np.arctan2(along[:, 1], along[:, 0])


def _find_track(clouds: tuple[CloudFile, ...], parts: DriveParts, options: DriveOptions) -> SurveyTrack:
    """Read the trajectory that was named, or the one that lies beside."""
    folder = all_of(clouds)
    timeless = next((cloud for cloud in clouds if not cloud.has_time), None)
    reason = "A map cloud has no scans: points need the time at which they were measured (gps_time), and a trajectory "
    reason += "says where the vehicle was then."
    if timeless is not None:
        raise timeless.file.fault(
            f"its points have no gps_time (point format {timeless.point_format}; 1 and 3 to 10 have it). {reason}"
        )
    if options.poses is not None:
        given = Path(options.poses)
        return read_track(parts.file(given if given.is_absolute() or given.exists() else parts.root / given))
    found = find_tracks([parts.root, parts.scans])
    if not found:
        raise folder.fault(
            f"no trajectory lies beside the cloud. {reason} Expected a table with a header (time,x,y,z or "
            "time,lat,lon,alt; .csv or .txt), an SBET (.sbet, .out) or TUM poses in world coordinates; or name it "
            "(--poses)."
        )
    if len(found) > 1:
        names = ", ".join(parts.file(path).name for path in found[:5])
        raise folder.fault(f"there are several trajectories: {names}. Name the right one (--poses {found[0].name}).")
    return read_track(parts.file(found[0]))


def _sample(clouds: tuple[CloudFile, ...], folder: SourceFile) -> tuple[Sample, bool]:
    """Read some points of some files, from their beginnings and ends, and tell whether they have an intensity."""
    chosen = _some_of(clouds)
    times, xyz, has_intensity = [], [], False
    for at in chosen:
        for block in sorted({0, clouds[at].blocks - 1}):
            for points in clouds[at].read(block, 1, frozenset({"time", "xyz", "intensity"})):
                has_intensity |= bool(points.intensity.any())
                times.append(points.times_s[::_SAMPLED_EVERY])
                xyz.append(points.xyz[::_SAMPLED_EVERY])
    all_times, all_xyz = np.concatenate(times), np.concatenate(xyz)
    finite = np.isfinite(all_times)
    if not finite.any():
        raise folder.fault("no point has a finite gps_time. Usual cause: a damaged file.")
    all_times, all_xyz = all_times[finite], all_xyz[finite]
    if all_times.min() == all_times.max():
        raise folder.fault(
            f"the gps_time of all points looked at is {all_times[0]:g}, so that nobody knows when they were measured. "
            "Usual cause: a program that wrote the format but not the times."
        )
    return Sample(all_times, all_xyz, clouds[0].time_offset_s), has_intensity


def _some_of(clouds: tuple[CloudFile, ...]) -> list[int]:
    """Return the positions of the files that are looked into before all are read: the first, the last, some between."""
    return sorted(set(np.linspace(0, len(clouds) - 1, _SAMPLED_FILES).astype(int).tolist()))


def _grid(clouds: tuple[CloudFile, ...], options: DriveOptions, findings: Findings) -> Grid | None:
    """Return the coordinate system that was named, or that the files state; None where none is stated."""
    file = clouds[0].file
    if options.crs is not None:
        return named_grid(options.crs, file)
    stated = [clouds[at].crs() for at in _some_of(clouds)]
    crs = stated[0]
    if different := next((other for other in stated if other != crs), None):
        raise file.fault(
            f"is in {crs.name if crs else 'no stated system'}, and another of the files in {different.name}. Expected "
            "files of one coordinate system; reproject them, or name the one that is right (--crs EPSG:25832)."
        )
    if crs is None:
        if max(abs(value) for cloud in clouds for value in (*cloud.minimum[:2], *cloud.maximum[:2])) > 100_000:
            raise file.fault(
                "states no coordinate system, and its coordinates are those of one. Name it (--crs EPSG:25832)."
            )
        findings.warning(
            file.name,
            "states no coordinate system: the coordinates are taken as local metres, and the drive has no "
            "georeference. Name the system if there is one (--crs EPSG:25832).",
        )
        return None
    return grid_of(crs, f"stated in {file.name}", file)


def _vehicle(track: SurveyTrack, sample: Sample, grid: Grid | None, first: CloudFile, findings: Findings) -> Vehicle:
    position, cloud = track.position.copy(), first.file
    if track.geographic:
        if grid is None:
            raise cloud.fault(
                f"states no coordinate system, and {track.file.name} is in degrees. Name the system of the cloud "
                "(--crs EPSG:25832)."
            )
        position[:, :2] = grid.from_lonlat(track.position[:, :2])
        if not np.isfinite(position).all():
            raise outside(track.file, grid, "the trajectory")
    if grid is not None and not np.isfinite(grid.axes(position[[0, -1]])).all():
        raise outside(track.file, grid, "the trajectory")
    _check_speed(track, position)
    header = "adjusted standard time" if first.standard_time else "seconds of the GPS week"
    match = match_clocks(sample, track.times_s, position[:, :2], track.file, cloud.name)
    times = track.times_s + match.offset_s
    findings.note(
        track.file.name,
        f"{match.reason}: {match.offset_s:+.0f} s are added; by that the points are {match.distance_m:.0f} m away "
        f"from the vehicle when they were measured (median). The header states {header}.",
    )
    position[:, 2] += _height_offset(times, position, sample, track.file, findings)
    heading, reason = _heading(track, position, grid, findings)
    return Vehicle(times, position, heading, f"{track.file.name}; heading from {reason}")


def _check_speed(track: SurveyTrack, position: FloatArray) -> None:
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    jumps = (step > _JUMP_M) & (step > _JUMP_MPS * np.diff(track.times_s))
    if jumps.any():
        row = int(np.argmax(jumps))
        raise track.file.fault(
            f"jumps by {step[row]:,.0f} m between {track.times_s[row]:.3f} s and {track.times_s[row + 1]:.3f} s, as no "
            "vehicle does. Usual cause: a damaged line, or fixes without a solution; leave them out."
        )


def _height_offset(
    times_s: FloatArray, position: FloatArray, sample: Sample, file: SourceFile, findings: Findings
) -> float:
    """Return what brings the heights of the vehicle a little over the ground of the cloud; 0 where they are."""
    inside = (sample.times_s >= times_s[0]) & (sample.times_s <= times_s[-1])
    here = _at(sample.times_s[inside], times_s, position)
    points = sample.xyz[inside]
    near = np.linalg.norm(points[:, :2] - here[:, :2], axis=1) < _NEAR_M
    if np.count_nonzero(near) < 20:
        return 0.0
    ground_below = float(np.percentile((points - here)[near, 2], 10))
    if _HEIGHTS_M[0] <= -ground_below <= _HEIGHTS_M[1]:
        return 0.0
    offset = ground_below + SENSOR_HEIGHT_M
    findings.note(
        file.name,
        f"the ground lies {-ground_below:.1f} m below the trajectory: its heights are moved by {offset:+.1f} m, to "
        f"{SENSOR_HEIGHT_M:g} m over the ground. Usual cause: heights over the ellipsoid and over the geoid.",
    )
    return offset


def _heading(
    track: SurveyTrack, position: FloatArray, grid: Grid | None, findings: Findings
) -> tuple[FloatArray | None, str]:
    """Return the heading that the trajectory states, in the way in which it fits the motion; None where none does."""
    if not track.headings:
        return None, "its motion"
    slices = cut(track.times_s, position)
    course = _courses(_at(slices.times_s, track.times_s, position))
    rows = np.searchsorted(track.times_s, slices.times_s)
    off = {
        meaning: float(np.median(np.abs(wrap_angle(angles[rows] - course))))
        for meaning, angles in track.headings.items()
    }
    best = min(off, key=lambda meaning: off[meaning])
    if off[best] > _HEADING_OFF_RAD:
        findings.warning(
            track.file.name,
            f"its headings are {np.degrees(off[best]):.0f} degrees off the motion (median) at best, taken as {best}: "
            "the headings are taken from the motion. Usual cause: the attitude of another frame.",
        )
        return None, "its motion"
    heading = np.unwrap(track.headings[best])
    if track.geographic and grid is not None:  # from true north to grid north
        axes = np.linalg.inv(grid.axes(position[rows]))
        true = track.headings[best][rows]
        on_grid = np.einsum("nij,nj->ni", axes, np.stack([np.cos(true), np.sin(true)], axis=1))
        turned = wrap_angle(np.arctan2(on_grid[:, 1], on_grid[:, 0]) - true)
        heading = heading + np.interp(track.times_s, slices.times_s, turned)
    return heading, best


def _check_outside(index: SliceIndex, track: SurveyTrack, findings: Findings) -> None:
    """Refuse a trajectory that misses most points; say so where it misses some."""
    inside = int(index.counts.sum())
    share = index.outside / max(inside + index.outside, 1)
    message = f"{index.outside:,} points ({share:.1%}) were measured when the trajectory has no pose"
    if not inside or share > _MAX_OUTSIDE:
        raise track.file.fault(
            f"{message}. Expected the trajectory of the whole cloud. Usual cause: a part of it, or another drive's."
        )
    if share > _OUTSIDE_WORTH_SAYING:
        findings.warning(track.file.name, f"{message}; they are left out.")


def _note_labels(index: SliceIndex, folder: SourceFile, findings: Findings) -> None:
    classes = ", ".join(str(number) for number in np.flatnonzero(index.classes)[:20])
    if index.has_road:
        findings.note(folder.name, f"the classification of the points is their label ({ROAD_SURFACE}: road surface).")
    else:
        findings.note(
            folder.name,
            f"no point is classified as road surface ({ROAD_SURFACE}); the classes are {classes}. "
            "The labels must come from elsewhere: label files, or a network.",
        )


def _note_large(index: SliceIndex, folder: SourceFile, findings: Findings) -> None:
    if large := int(np.count_nonzero(index.steps > 1)):
        findings.note(
            folder.name,
            f"{large:,} scans hold more than {MAX_SCAN_POINTS:,} points, up to {index.counts.max():,}: of these every "
            "second, third, ... is read. Usual cause: the vehicle waited there.",
        )


def _trajectory(slices: Slices, origin: FloatArray, yaw: FloatArray, grid: Grid | None, vehicle: Vehicle) -> Trajectory:
    """Return poses, times and georeference of the scans; L is level, with x ahead.

    Parameters
    ----------
    origin : (S, 3) float64
        Easting, northing, height.
    yaw : (S,) float64
        Direction of L's x axis from the east.
    """
    rotation = rotation_from_rpy(0.0, 0.0, yaw)
    georeference, reason = None, "the cloud states no coordinate system"
    if grid is None:
        poses = from_first(rigid_transforms(rotation, origin))
    else:
        lonlat = grid.to_lonlat(origin[:, :2])
        georeference = Georeference(
            lat_deg=lonlat[:, 1].copy(),
            lon_deg=lonlat[:, 0].copy(),
            alt_m=origin[:, 2].copy(),
            R_enu_lidar=rotation,
            source=f"{vehicle.reason}; {grid.name}",
        )
        poses, reason = poses_of(georeference), ""
    lidar = LidarPoses(poses, "lidar", f"cut out of the trajectory {vehicle.reason}")
    return Trajectory(lidar, len(vehicle.times_s), slices.times_s, georeference, reason)
