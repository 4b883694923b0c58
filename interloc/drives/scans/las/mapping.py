"""LAS and LAZ files as drives: a scan each, or clouds of mobile mapping that are cut along the vehicle's trajectory."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.georeference.geodetic import poses_of
from interloc.drives.layouts import ENDINGS, POSE_FILES, SCAN_FOLDERS, DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.poses.files import looks_like_tum
from interloc.drives.scans.deskewed import point_times
from interloc.drives.scans.las.clouds import BLOCK_POINTS, ROAD_SURFACE, Cloud, Points, all_of, in_words, open_cloud
from interloc.drives.scans.las.tracks import ADJUSTED_S, SurveyTrack, check_clock, find_tracks, is_table, read_track
from interloc.drives.scans.pcd import number_scans
from interloc.drives.scans.recording import Recording, ScanPoints
from interloc.drives.trajectory import LidarPoses, Trajectory
from interloc.geometry import (
    WGS84_A_M,
    enu_from_lonlat,
    from_first,
    projection,
    rigid_transforms,
    rotation_from_rpy,
    rows_apart,
)

SLICE_M = 2.1
"""Distance driven from scan to scan. A little more than that of keyframes (2 m), so that each scan is one, and no point
is left out."""

MAX_GAP_M = 100.0
"""Where two poses of the trajectory lie further apart than this, nothing in between is used."""

MAX_SCAN_POINTS = 4_000_000

_LONGEST_S = 1.5
"""Points that were measured longer before or after the pose of their scan, as where the vehicle waits, are left out."""

SENSOR_HEIGHT_M = 2.0
"""Over the ground, where the heights of the trajectory are not those of the cloud (ellipsoid and geoid)."""

_MARGIN_S = 0.5  # points measured a little before the first pose, or after the last, are used; at most half a slice
_SAMPLED_FILES, _SAMPLED_EVERY = 20, 25
_NEAR_M, _HEIGHTS_M = 15.0, (-1.0, 8.0)
_MAX_OUTSIDE, _OUTSIDE_WORTH_SAYING = 0.5, 0.01
_SORT = "Sort them by gps_time, with lassort -gps_time or pdal translate IN OUT sort --filters.sort.dimension=GpsTime"
_NO_SCANS = (
    "A map cloud has no scans: points need the time at which they were measured (gps_time), and a trajectory says "
    "where the vehicle was then."
)

_STEP_M = 10.0


def open_mapping(clouds: tuple[Cloud, ...], parts: DriveParts, options: DriveOptions, findings: Findings) -> Recording:
    """Cut the clouds of a mobile mapping vehicle into scans."""
    folder = all_of(clouds)
    track = _find_track(clouds, parts, options)
    times, points, has_intensity = _sample(clouds, folder)
    grid = _grid(clouds, options, findings)
    track_s, position = _vehicle(track, times, points, grid, clouds[0], findings)
    slices, classes = _index(clouds, cut(track_s, position), track, folder, findings)
    has_road = bool(classes[ROAD_SURFACE])
    if has_road:
        findings.note(folder.name, f"the classification of the points is their label ({ROAD_SURFACE}: road surface).")
    else:
        findings.note(
            folder.name,
            f"no point is classified as road surface ({ROAD_SURFACE}); the classes are "
            f"{', '.join(str(number) for number in np.flatnonzero(classes)[:20])}. "
            "The labels must come from elsewhere: label files, or a network.",
        )
    origin = _at(slices.times_s, track_s, position)
    rows = np.arange(len(origin))
    along = origin[np.minimum(rows + 1, rows[-1])] - origin[np.maximum(rows - 1, 0)]
    axes = np.tile(np.eye(2), (len(origin), 1, 1)) if grid is None else grid.axes(origin)
    heading = np.arctan2(along[:, 1], along[:, 0])
    ahead = np.einsum("nij,nj->ni", axes, np.stack([np.cos(heading), np.sin(heading)], axis=1))
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    to_lidar = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=-2) @ axes
    trajectory = _trajectory(slices.times_s, origin, yaw, grid, track)
    return Recording(
        parts,
        CutClouds(clouds, slices, origin, to_lidar, has_road),
        rows.astype(np.int64),
        scan_bytes=sum(cloud.size for cloud in clouds),
        point_counts=slices.counts,
        carries_labels=has_road,
        scheme="las" if has_road else None,
        has_remission=has_intensity,
        is_cut=True,
        read_trajectory=lambda _frames, _options, _findings: trajectory,
    )


def _find_track(clouds: tuple[Cloud, ...], parts: DriveParts, options: DriveOptions) -> SurveyTrack:
    """Read the trajectory that was named, or the one that lies beside."""
    folder = all_of(clouds)
    timeless = next((cloud for cloud in clouds if not cloud.has_time), None)
    if timeless is not None:
        raise timeless.file.fault(
            f"its points have no gps_time (point format {timeless.point_format}; 1 and 3 to 10 have it). {_NO_SCANS}"
        )
    if options.poses is not None:
        return read_track(parts.file(_pose_file(parts, options)))
    found = find_tracks([parts.root, parts.scans])
    if not found:
        raise folder.fault(
            f"no trajectory lies beside the cloud. {_NO_SCANS} Expected a table with a header (time,x,y,z or "
            "time,lat,lon,alt; .csv or .txt) or TUM poses in world coordinates; or name it "
            "(--poses)."
        )
    if len(found) > 1:
        names = ", ".join(parts.file(path).name for path in found[:5])
        raise folder.fault(f"there are several trajectories: {names}. Name the right one (--poses {found[0].name}).")
    return read_track(parts.file(found[0]))


def _some_of(clouds: tuple[Cloud, ...]) -> list[Cloud]:
    """Return the files that are looked into before all are read: the first, the last, some between."""
    rows = set(np.linspace(0, len(clouds) - 1, _SAMPLED_FILES).astype(int).tolist())
    return [clouds[row] for row in sorted(rows)]


def _sample(clouds: tuple[Cloud, ...], folder: SourceFile) -> tuple[FloatArray, FloatArray, bool]:
    """Return times and places of points from beginnings and ends of files, and whether any has an intensity."""
    read = [
        points
        for cloud in _some_of(clouds)
        for start in sorted({0, (cloud.points - 1) // BLOCK_POINTS * BLOCK_POINTS})
        for points in cloud.read(start, start + BLOCK_POINTS)
    ]
    times = np.concatenate([points.times_s[::_SAMPLED_EVERY] for points in read])
    xyz = np.concatenate([points.xyz[::_SAMPLED_EVERY] for points in read])
    finite = np.isfinite(times)
    if not finite.any():
        raise folder.fault("no point has a finite gps_time. Usual cause: a damaged file.")
    times, xyz = times[finite], xyz[finite]
    if times.min() == times.max():
        raise folder.fault(
            f"the gps_time of all points looked at is {times[0]:g}, so that nobody knows when they were measured. "
            "Usual cause: a program that wrote the format but not the times."
        )
    return times, xyz, any(points.intensity.any() for points in read)


def _grid(clouds: tuple[Cloud, ...], options: DriveOptions, findings: Findings) -> "Grid | None":
    """Return the coordinate system that was named, or that the files state; None where none is stated."""
    file = clouds[0].file
    if options.crs is not None:
        if (stated := clouds[0].crs()) is not None and not stated.equals(options.crs):
            findings.warning(file.name, f"states {stated.name}; {options.crs} is used, as given (--crs).")
        return grid_of(options.crs, "as given", file)
    crs, *others = [cloud.crs() for cloud in _some_of(clouds)]
    if different := next((other for other in others if other != crs), None):
        raise file.fault(
            f"is in {crs.name if crs else 'no stated system'}, and another of the files in {different.name}. Expected "
            "files of one coordinate system; reproject them, or name the one that is right (--crs EPSG:CODE)."
        )
    if crs is not None:
        return grid_of(crs, f"stated in {file.name}", file)
    if max(cloud.reach for cloud in clouds) > 100_000:
        raise file.fault(
            "states no coordinate system, and its coordinates are those of one. Name it (--crs EPSG:CODE)."
        )
    findings.warning(
        file.name,
        "states no coordinate system: the coordinates are taken as local metres, and the drive has no "
        "georeference. Name the system if there is one (--crs EPSG:CODE).",
    )
    return None


def _vehicle(
    track: SurveyTrack, times_s: FloatArray, points: FloatArray, grid: "Grid | None", first: Cloud, findings: Findings
) -> tuple[FloatArray, FloatArray]:
    """Return times and places of the vehicle in the coordinates of the cloud."""
    position, name = track.position.copy(), track.file.name
    if track.geographic:
        if grid is None:
            raise first.file.fault(
                f"states no coordinate system, and {name} is in degrees. Name the system of the cloud "
                "(--crs EPSG:CODE)."
            )
        position[:, :2] = projection(4326, grid.crs)(track.position[:, :2])  # infinite where it ends
    if not np.isfinite(position).all() or (grid is not None and not np.isfinite(grid.axes(position[[0, -1]])).all()):
        assert grid is not None
        raise track.file.fault(
            f"the trajectory lies outside of {grid.name} ({grid.source}). Usual cause: another zone, or another system "
            "than stated; name the right one (--crs EPSG:CODE)."
        )
    track_s = track.times_s
    distance_m = check_clock(times_s, points, first, track_s, position[:, :2], track.file)
    findings.note(name, f"the points are {distance_m:.0f} m away from the vehicle when they were measured (median).")
    inside = (times_s >= track_s[0]) & (times_s <= track_s[-1])
    away = points[inside] - _at(times_s[inside], track_s, position)
    near = np.linalg.norm(away[:, :2], axis=1) < _NEAR_M
    height = -float(np.percentile(away[near, 2], 10)) if np.count_nonzero(near) >= 20 else SENSOR_HEIGHT_M
    if not _HEIGHTS_M[0] <= height <= _HEIGHTS_M[1]:
        position[:, 2] += SENSOR_HEIGHT_M - height
        findings.note(
            name,
            f"the ground lies {height:.1f} m below the trajectory: its heights are moved by "
            f"{SENSOR_HEIGHT_M - height:+.1f} m, to {SENSOR_HEIGHT_M:g} m over the ground. Usual cause: heights over "
            "the ellipsoid and over the geoid, or in feet.",
        )
    return track_s, position


def _at(times_s: FloatArray, known_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(times_s, known_s, axis) for axis in values.T], axis=1)


@dataclass(frozen=True)
class Cuts:
    """The intervals of time that a drive is cut into."""

    times_s: FloatArray
    """(S,) float64: of the poses, in the clock of the cloud, ascending."""
    start_s: FloatArray
    end_s: FloatArray
    """(S,) float64: points from the start on and before the end belong to it; the intervals do not overlap."""

    def of(self, times_s: FloatArray) -> IntArray:
        """Return the interval of (N,) times, -1 where there is none."""
        at = np.searchsorted(self.start_s, times_s, side="right") - 1
        inside = (at >= 0) & (times_s < self.end_s[at])
        return np.where(inside, at, -1)


def cut(times_s: FloatArray, position: FloatArray) -> Cuts:
    """Cut a drive, by (P,) ascending times and (P, 3) positions, into intervals of about `SLICE_M` driven.

    The poses are those of the trajectory; where these lie further apart, more are put evenly between.
    """
    rows = np.array(rows_apart(position, SLICE_M))
    step = np.linalg.norm(np.diff(position[rows], axis=0), axis=1)
    pieces = np.where(step < MAX_GAP_M, np.maximum(step // SLICE_M, 1), 1).astype(np.int64)
    time = times_s[rows]
    inner = [
        np.linspace(start, end, count, endpoint=False)
        for start, end, count in zip(time[:-1], time[1:], pieces, strict=True)
    ]
    centres = np.concatenate([*inner, time[-1:]])
    middle = (centres[:-1] + centres[1:]) / 2
    margin = np.minimum(np.diff(centres) / 2, _MARGIN_S) if len(centres) > 1 else np.full(1, _MARGIN_S)
    start, end = np.r_[times_s[0] - margin[0], middle], np.r_[middle, times_s[-1] + margin[-1]]
    for gap in np.searchsorted(centres, time[:-1][step >= MAX_GAP_M]):  # nothing in there
        end[gap], start[gap + 1] = np.nextafter(centres[gap], np.inf), centres[gap + 1]
    return Cuts(centres, start, end)


@dataclass(frozen=True)
class Slices:
    """The intervals that hold points: the scans."""

    times_s: FloatArray
    """(S,) float64: of their poses."""
    counts: IntArray
    """(S,) int64: points of every scan."""
    rows: IntArray
    """(files, S, 2) int64: from which point on, and up to which, each lies in every file."""


def _index(
    clouds: tuple[Cloud, ...], cuts: Cuts, track: SurveyTrack, folder: SourceFile, findings: Findings
) -> tuple[Slices, IntArray]:
    """Go through all points once; return the scans, and the (256,) counts of the classes of their points."""
    start, end = cuts.times_s - _LONGEST_S, cuts.times_s + _LONGEST_S
    near = Cuts(cuts.times_s, np.maximum(cuts.start_s, start), np.minimum(cuts.end_s, end))
    counts, classes = np.zeros(len(cuts.times_s), np.int64), np.zeros(256, np.int64)
    rows, outside, total = np.zeros((len(clouds), len(counts), 2), np.int64), 0, 0
    for number, cloud in enumerate(clouds):
        before = -np.inf
        for points in cloud.read():
            times = points.times_s
            if not (np.diff(times, prepend=before) >= 0).all():
                raise cloud.file.fault(
                    f"its points are not in the order of their times, or have none that is finite. {_SORT}. Usual "
                    "cause: a cloud that was sorted by place."
                )
            before = times[-1]
            rows[number, :, 0] += np.searchsorted(times, near.start_s)
            rows[number, :, 1] += np.searchsorted(times, near.end_s)
            is_used = ~points.withheld
            total += int(np.count_nonzero(is_used))
            outside += int(np.count_nonzero(cuts.of(times[is_used]) < 0))
            found = near.of(times[is_used])
            counts += np.bincount(found[found >= 0], minlength=len(counts))
            classes += np.bincount(points.labels[is_used][found >= 0], minlength=256)
    share = outside / max(total, 1)
    message = f"{outside:,} points ({share:.1%}) were measured when the trajectory has no pose"
    if not counts.any() or share > _MAX_OUTSIDE:
        raise track.file.fault(
            f"{message}. Expected the trajectory of the whole cloud. Usual cause: a part of it, or another drive's."
        )
    if share > _OUTSIDE_WORTH_SAYING:
        findings.warning(track.file.name, f"{message}; they are left out.")
    if waiting := total - outside - int(counts.sum()):
        findings.note(folder.name, f"{waiting:,} points were measured while the vehicle stood, and are left out.")
    if counts.max() > MAX_SCAN_POINTS:
        raise folder.fault(
            f"{counts.max():,} points were measured along {SLICE_M:g} m; a scan has at most {MAX_SCAN_POINTS:,}. Thin "
            "the cloud, with las2las -keep_every_nth 2."
        )
    kept = np.flatnonzero(counts)
    return Slices(cuts.times_s[kept], counts[kept], rows[:, kept]), classes


def _trajectory(
    times_s: FloatArray, origin: FloatArray, yaw: FloatArray, grid: "Grid | None", track: SurveyTrack
) -> Trajectory:
    """Return poses, times and georeference of the scans; L is level, with x ahead (`yaw` from the east)."""
    rotation = rotation_from_rpy(0.0, 0.0, yaw)
    if 1e8 < times_s[0] < 1e9:  # adjusted standard GPS time
        times_s = times_s + ADJUSTED_S
    georeference, reason = None, "the cloud states no coordinate system"
    if grid is None:
        poses = from_first(rigid_transforms(rotation, origin))
    else:
        lonlat = grid.to_lonlat(origin[:, :2])
        source = f"{track.file.name}; heading from its motion; {grid.name}"
        lat, lon, height = lonlat[:, 1].copy(), lonlat[:, 0].copy(), origin[:, 2].copy()
        georeference = Georeference(lat_deg=lat, lon_deg=lon, alt_m=height, R_enu_lidar=rotation, source=source)
        poses, reason = poses_of(georeference), ""
    lidar = LidarPoses(poses, "lidar", f"cut out of the trajectory {track.file.name}; heading from its motion")
    return Trajectory(lidar, len(track.times_s), times_s, georeference, reason)


@dataclass(frozen=True)
class CutClouds:
    """The scans of a cloud; a `PointSource`. The scans are numbered from 0."""

    clouds: tuple[Cloud, ...]
    slices: Slices
    origin: FloatArray
    """(S, 3) float64: where the vehicle was, in the coordinates of the cloud."""
    to_lidar: FloatArray
    """(S, 2, 2) float64: ``xy in L = to_lidar @ (easting, northing from the origin)``."""
    carries_labels: bool

    def name(self, frame: int) -> str:
        """Return how messages call a scan: its files, and its time."""
        names = [cloud.file.name for cloud, _, _ in self._rows(frame)]
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        return f"{names[0]}{more}, {self.slices.times_s[frame]:.3f} s"

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the files that a scan is read from."""
        return tuple(cloud.file.path for cloud, _, _ in self._rows(frame))

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan."""
        values, labels = [], []
        for cloud, first, last in self._rows(frame):
            with in_words(cloud.file):
                state = cloud.file.path.stat()
            for start in range(first // BLOCK_POINTS * BLOCK_POINTS, last, BLOCK_POINTS):
                read = _read_block(cloud, start, (state.st_mtime_ns, state.st_size))
                used = np.flatnonzero(~read.withheld[max(first - start, 0) : last - start]) + max(first - start, 0)
                away = read.xyz[used] - self.origin[frame]
                points = np.empty((len(used), 4), np.float32)
                points[:, :2] = away[:, :2] @ self.to_lidar[frame].T
                points[:, 2] = away[:, 2]
                points[:, 3] = read.intensity[used]
                values.append(points)
                labels.append(read.labels[used])
        all_labels = np.concatenate(labels).astype(np.uint32) if self.carries_labels else None
        return ScanPoints(np.concatenate(values), all_labels)

    def _rows(self, frame: int) -> list[tuple[Cloud, int, int]]:
        """Return the files that hold points of a scan, each with the first of them, and that after the last."""
        rows = self.slices.rows[:, frame].tolist()
        return [(cloud, first, last) for cloud, (first, last) in zip(self.clouds, rows, strict=True) if last > first]


@lru_cache(maxsize=4)
def _read_block(cloud: Cloud, start: int, _state: tuple[int, int]) -> Points:
    """Read a block of a file in a state; scans are mostly read one after the other, and share them."""
    return next(cloud.read(start, start + BLOCK_POINTS))


@dataclass(frozen=True)
class Grid:
    """A projected coordinate system in metres."""

    crs: Any
    """Its horizontal part."""
    source: str
    """Where it is stated."""

    @property
    def name(self) -> str:
        """Its code or name."""
        code = self.crs.to_epsg(min_confidence=70)
        return f"EPSG:{code}" if code else str(self.crs.name)

    def to_lonlat(self, xy: FloatArray) -> FloatArray:
        """Return (N, 2) longitudes, latitudes on WGS84 of (N, 2) easting, northing; infinite where there are none."""
        return projection(self.crs, 4326)(xy)

    def axes(self, xyz: FloatArray) -> FloatArray:
        """Return how the axes lie on the ground near (N, 3) points: (N, 2, 2), ``enu_xy = axes @ grid_xy``.

        It holds the scale of the projection, the meridian convergence, and the height over the ellipsoid.
        """
        here = self.to_lonlat(xyz[:, :2])
        columns = []
        for step in ((_STEP_M, 0.0), (0.0, _STEP_M)):
            ahead, behind = self.to_lonlat(xyz[:, :2] + step), self.to_lonlat(xyz[:, :2] - step)
            there = enu_from_lonlat(here[:, 1], here[:, 0], ahead) - enu_from_lonlat(here[:, 1], here[:, 0], behind)
            columns.append(there / (2 * _STEP_M))
        return np.stack(columns, axis=-1) * (1 + xyz[:, 2] / WGS84_A_M)[:, None, None]


def grid_of(crs: Any, source: str, file: SourceFile) -> Grid:  # noqa: ANN401 - pyproj.CRS or its name
    """Check a coordinate system, and take its horizontal part."""
    from pyproj import CRS  # noqa: PLC0415 - slow to import
    from pyproj.exceptions import CRSError  # noqa: PLC0415

    try:
        crs = CRS.from_user_input(crs)
    except CRSError as error:
        raise DriveFileError(
            f"crs {crs!r}", "is not known. Expected a coordinate system such as EPSG:25832 (--crs)."
        ) from error
    horizontal = crs
    while horizontal.is_bound or (horizontal.is_compound and horizontal.sub_crs_list):
        horizontal = horizontal.source_crs if horizontal.is_bound else horizontal.sub_crs_list[0]
    advice = (
        "Reproject cloud and trajectory to the UTM zone of the place: EPSG:326ZZ in the north, EPSG:327ZZ in the "
        "south, with ZZ the whole part of (longitude + 180) / 6, plus 1; the cloud with "
        "pdal translate IN OUT reprojection --filters.reprojection.out_srs=EPSG:326ZZ."
    )
    if not horizontal.is_projected:
        raise file.fault(
            f"is in {crs.name} ({source}), which is not projected. Expected easting, northing and height in metres, "
            f"such as UTM. {advice}"
        )
    units = {axis.unit_name for axis in crs.axis_info if axis.unit_conversion_factor != 1.0}
    if units:
        raise file.fault(f"is in {crs.name} ({source}), in units of {', '.join(units)}. Expected metres. {advice}")
    return Grid(horizontal.to_2d(), source)


# Which files there are, and whether they hold a scan each, in the coordinates of the sensor.

SENSOR_RANGE_M = 1000.0
"""No LiDAR of a vehicle sees further; coordinates beyond are those of a map."""

_FOLDERS = (".", "las", "laz")
_MAX_FILES = 100_000
_SAMPLED = 5


def open_las(root: Path, options: DriveOptions, findings: Findings) -> Recording | None:
    """Open LAS or LAZ files: one per scan in sensor coordinates, or a cloud of mobile mapping with its trajectory.

    The root is one file, or a folder that holds such: directly, or in las/ or laz/. None where these are no LAS files.
    """
    other = any((root / folder).is_dir() for folder in SCAN_FOLDERS)  # a map may lie beside the scans
    if options.layout != "las" and (options.layout != "auto" or other):
        return None
    folder, paths = root.absolute().parent, [root.absolute()]
    if not root.is_file():
        places = [place for place in (root / each for each in _FOLDERS) if place.is_dir()]
        found = ((place, [*{p.stem: p for p in sorted(place.iterdir()) if _is_las(p)}.values()]) for place in places)
        folder, paths = next(((place, files) for place, files in found if files), (root, []))
    elif not _is_las(root):
        return None
    if not paths:
        return None
    if len(paths) > _MAX_FILES:
        raise DriveFileError(str(folder), f"holds {len(paths):,} LAS files; at most {_MAX_FILES:,} are read.")
    home = folder if root.is_file() else root
    name = options.name or (root.stem if root.is_file() else "")
    parts = replace(DriveParts.inside("las", home, folder, None), name=name)
    clouds = tuple(open_cloud(SourceFile(path, home)) for path in paths)
    if _is_one_per_scan(clouds, parts, options):
        return _open_scan_clouds(clouds, parts, options, findings)
    return open_mapping(clouds, parts, options, findings)


def _is_las(path: Path) -> bool:
    return path.suffix.lower() in ENDINGS["las"] and not path.name.startswith(".") and path.is_file()


def _is_one_per_scan(clouds: tuple[Cloud, ...], parts: DriveParts, options: DriveOptions) -> bool:
    """Return whether files hold one scan each: around the origin, with poses, not with the trajectory of a map."""
    if options.crs is not None or any(cloud.reach >= SENSOR_RANGE_M for cloud in clouds):
        return False
    path = _pose_file(parts, options)
    if not path.is_file():
        return len(clouds) > 1 and not (clouds[0].has_time and find_tracks([parts.root, parts.scans]))
    if len(clouds) > 1:
        return not is_table(path)
    return len(SourceFile(path, parts.root).head()[:4096].split()) in {8, 12, 13, 16, 17}


def _pose_file(parts: DriveParts, options: DriveOptions) -> Path:
    if options.poses is not None:
        given = Path(options.poses)
        return given if given.is_absolute() or given.exists() else parts.root / given
    beside = [folder / name for folder in (parts.root, parts.scans) for name in POSE_FILES]
    found = [path for path in beside if path.is_file()]
    return next((path for path in found if looks_like_tum(path)), found[0]) if found else beside[0]


def _open_scan_clouds(
    clouds: tuple[Cloud, ...], parts: DriveParts, options: DriveOptions, findings: Findings
) -> Recording:
    """Open the files of the scans, in the order of the numbers in their names."""
    folder = all_of(clouds)
    order, frames, times_s, how = number_scans([f"{cloud.file.path.stem}.pcd" for cloud in clouds])
    if how:
        findings.note(folder.name, how)
    clouds = tuple(clouds[row] for row in order)
    counts = np.array([cloud.points for cloud in clouds])
    usable = np.flatnonzero(counts <= MAX_SCAN_POINTS)
    for row in np.flatnonzero(counts > MAX_SCAN_POINTS):
        findings.error(
            clouds[row].file.fault(
                f"holds {counts[row]:,} points; a scan has at most {MAX_SCAN_POINTS:,}. "
                "Expected one file per scan. Usual cause: a map, or the whole drive in one file."
            )
        )
    has_road, has_intensity = False, False
    for row in np.intersect1d(np.linspace(0, len(clouds) - 1, _SAMPLED).astype(int), usable):
        with findings.stage():
            for points in clouds[row].read():
                has_road |= bool((points.labels == ROAD_SURFACE).any())
                has_intensity |= bool(points.intensity.any())
    if has_road:
        findings.note(folder.name, f"the classification of the points is their label ({ROAD_SURFACE}: road surface).")
    return Recording(
        replace(parts, poses=_pose_file(parts, options)),
        ScanClouds(clouds, frames, has_road, times_s),
        frames,
        scan_bytes=sum(cloud.size for cloud in clouds),
        usable=usable,
        point_counts=counts,
        carries_labels=has_road,
        scheme="las" if has_road else None,
        has_remission=has_intensity,
        has_times=clouds[0].has_time,
        carries_poses=False,
        times_s=times_s,
    )


@dataclass(frozen=True)
class ScanClouds:
    """One LAS file per scan; a `PointSource`."""

    clouds: tuple[Cloud, ...]
    """In the order of the scans."""
    frames: IntArray
    """(N,) int64: their scan numbers, ascending."""
    carries_labels: bool
    times_s: FloatArray | None
    """(N,): the times in their names, from which times of points may count."""

    def _cloud(self, frame: int) -> Cloud:
        return self.clouds[int(np.searchsorted(self.frames, frame))]

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return self._cloud(frame).file.name

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the file of a scan."""
        return (self._cloud(frame).file.path,)

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan; points that are marked as withheld stay in their place, with label 0."""
        cloud = self._cloud(frame)
        points = Points(*map(np.concatenate, zip(*cloud.read(), strict=True)))
        values = np.column_stack([points.xyz, points.intensity]).astype(np.float32)
        labels = np.where(points.withheld, 0, points.labels).astype(np.uint32) if self.carries_labels else None
        stamp_s = None if self.times_s is None else float(self.times_s[np.searchsorted(self.frames, frame)])
        return ScanPoints(values, labels, point_times(points.times_s, stamp_s) if cloud.has_time else None)
