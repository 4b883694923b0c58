"""Opening of a drive: its folder is read step by step, on the one path behind `open_drive` and `inspect_drive`."""

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Unpack, cast

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.drives.checks import check_flat_road, check_motion, sample_indices
from interloc.drives.files import each_read_once, rows_of_part, scan_once
from interloc.drives.findings import Findings
from interloc.drives.folder import DROPPED, FolderDrive, Scans, dropped_in_words
from interloc.drives.formats import FORMATS, ScanFormat, find_format, installed_formats
from interloc.drives.georeference.geodetic import check_against_poses
from interloc.drives.labels import SEMANTICKITTI, LabelJudgement
from interloc.drives.layouts import IN_CAPITALS, SCAN_FOLDERS, misnamed, not_a_drive, recognise_layout
from interloc.drives.levelling import LevelScans, check_points, grounds_of, level_of, levelled
from interloc.drives.options import LABEL_FILES, ODOMETRY, DriveArguments, DriveOptions, LabelFolder, ReadingOptions
from interloc.drives.scans.deskewed import deskewed, is_to_deskew
from interloc.drives.scans.raw import RawScans, trajectory_of
from interloc.drives.scans.recording import Recording, rows_within
from interloc.drives.scans.reduced_format import (
    MANIFEST,
    ReducedManifest,
    ReducedScans,
    is_reduced,
    read_manifest,
    reduced_trajectory,
)
from interloc.drives.trajectory import Trajectory
from interloc.errors import DriveError
from interloc.processes import Progress

if TYPE_CHECKING:
    from interloc.drives.odometry import Track

NO_POSES = "there are none: they are computed from the points."

SAMPLED_SCANS = 5
"""How many scans are looked into, unless all are."""


def open_drive(
    path: str | os.PathLike[str], options: ReadingOptions | None = None, **arguments: Unpack[DriveArguments]
) -> FolderDrive:
    """Open a drive folder: poses, times and georeference are read, points when they are asked for.

    Parameters
    ----------
    path
        The drive: a SemanticKITTI / KITTI odometry sequence, a KITTI raw drive, a drive of KITTI-360, a folder of PCD
        files, a ROS bag (.bag, .db3, .mcap), LAS or LAZ files with their trajectory; or a reduced drive
        (`interloc.drives.scans.reduced_format`).
    options : ReadingOptions or None
        Those of `ReadingOptions` at once; what is named beside it counts.
    labels : {"auto", "labels", "predictions", "geometry"}
        The files of labels/ or predictions/, or labels made of the points; "auto" takes the first that there is.
    label_scheme
        "auto", "semantickitti", "learning" (0..19, road = 9), "kitti360", or the ids of road, as a collection or as
        text ("40,60").
    pose_frame : {"auto", "camera", "lidar"}
        Sensor whose poses the pose file holds; "auto" finds it out from the motion.
    layout
        "auto", or the name of one of the `interloc.drives.formats`.
    poses, points, fix, crs : str or None
        Where poses, scans and fixes are, and the coordinate system of LAS files: see `ReadingOptions`. The poses
        "odometry" are computed from the points.
    frames : str or None
        Part of the drive to use, "FROM:TO" by the numbers of its scans; either may be left out.
    deskew : {"auto", "on", "off"}
        Whether the motion within scans is taken out of points that carry times.
    model
        Folder of a network (`interloc.labelling`) that labels the scans as they are read; label files do not count.
    provider
        What the network runs on.
    oxts
        Georeference from elsewhere: the KITTI raw drive of an odometry sequence, a file with one OXTS row per frame
        (or its .gz), or a geo.csv.
    name : str or None
        Name of the drive, where it is not that of the folder.
    check : bool
        Check the sizes of all files, and look into a few scans to see whether labels, poses and georeference fit
        together.

    Returns
    -------
    FolderDrive
        A `Drive`, cheap to send to another process.

    Raises
    ------
    DriveError
        The folder is not a drive, or something in it is damaged or does not fit together.
    GeoreferenceError
        The georeference is damaged or that of another drive.
    ModelError
        The network cannot be used.
    ConfigError
        An unknown option or choice.
    """
    drive, check = open_to_check(Path(path), DriveOptions.of(options, **arguments))
    check()
    return drive


def open_to_check(root: Path, options: DriveOptions) -> tuple[FolderDrive, Callable[[], object]]:
    """Open a drive as `open_drive` does, and return with it what checks whether its parts fit together."""
    findings = Findings(stop_at_first=True)
    (reading,) = read_drive(root, options, findings, checks_later=True).values()
    assert reading.drive is not None  # else a fault was raised
    return reading.drive, partial(each_read_once()(_checked), reading, findings) if options.check else lambda: None


@dataclass(frozen=True)
class DriveReading:
    """What was found out about a drive by one label folder; a step that failed leaves its part None or empty."""

    scans: Scans | None = None
    trajectory: Trajectory = field(default_factory=Trajectory)
    """Where the LiDAR was at each of them."""
    sample: list[int] = field(default_factory=list)
    """Positions of the scans that were looked into."""
    labels: LabelJudgement = field(default_factory=LabelJudgement)
    """What their labels mean."""
    drive: FolderDrive | None = None
    """The drive, where all of these are there."""
    flatness_m: float | None = None
    """Median difference in height of the same piece of road seen from two scans."""
    georeference_error: float | None = None
    """Median error of the motion against the georeference, as a share of the distance."""


def read_drive(
    root: Path,
    options: DriveOptions,
    findings: Findings,
    *,
    label_folders: Sequence[LabelFolder] = (),
    thorough: bool = False,
    needs_labels: bool = True,
    checks_later: bool = False,
    progress: Progress | None = None,
) -> dict[LabelFolder, DriveReading]:
    """Read all of a drive but its points, and check it; look into some scans, or into all of them (`thorough`).

    The drive is opened once, and its small files are read once, for all label folders (those of `options.labels` by
    default). Where poses are computed from points, `progress` is called with the scans done and the scans in all.
    """
    readings: dict[LabelFolder, DriveReading] = {}
    with each_read_once():
        opened, trajectory, part = _open(root, options, findings, progress)
        for folder in dict.fromkeys(label_folders or (_label_folder(opened, options, findings, needs_labels),)):
            scans: Scans | None = None
            with findings.stage():
                if isinstance(opened, ReducedManifest):
                    scans = ReducedScans.of(opened, root, folder, options, findings)
                    scans = scans if part is None else _within(scans, part)
                elif opened is not None:
                    scans = RawScans.of(opened, folder, options, findings, trajectory, needs_labels=needs_labels)
            if scans is None:
                readings[folder] = DriveReading()
                continue
            where = trajectory()
            if isinstance(scans, RawScans) and scans.labelled is not None:
                where = where.part(scans.labelled)
            rows, where = where.within_jumps(scans.frames, _pose_file(scans, where), findings)
            scans = scans if rows is None else _within(scans, rows)
            sample = sample_indices(scans.usable, len(scans.usable) if thorough else SAMPLED_SCANS)
            labels = scans.judge_labels(sample, options, findings)
            reading = DriveReading(scans, where, sample, labels, _drive_of(scans, where, labels))
            readings[folder] = _checked(reading, findings) if options.check and not checks_later else reading
    return readings


def _open(
    root: Path, options: DriveOptions, findings: Findings, progress: Progress | None
) -> tuple[Recording | ReducedManifest | None, Callable[[], Trajectory], slice | None]:
    """Open the scans of a drive, and return with them the part asked for, and what reads, once, where they were."""
    opened: Recording | ReducedManifest | None = None
    part: slice | None = None  # of all scans; a recording is cut to it, the trajectory is read of all
    track: Track | None = None  # where the poses are not given

    @cache
    def trajectory() -> Trajectory:
        if options.poses == ODOMETRY:
            return Trajectory(georeference_reason="the poses could not be computed")
        if isinstance(whole, ReducedManifest):
            found = reduced_trajectory(whole, root, options, findings)
        elif track is not None:
            return track.trajectory(whole, options, findings)
        else:
            found = trajectory_of(whole, options, findings)
        return found if part is None else found.part(part)

    with findings.stage():
        whole = read_manifest(root) if is_reduced(root) else open_recording(root, options, findings)
        part = _part_of(whole, options)
        opened = _cut(whole, part) if isinstance(whole, Recording) else whole
    if isinstance(opened, Recording):
        has_poses = options.poses != ODOMETRY and (options.poses is not None or opened.has_poses)
        where = opened.parts.file(opened.parts.scans).name
        seen = _seen(opened)
        grounds = grounds_of(seen)
        is_plausible = not options.check or check_points(seen, grounds, where, findings, has_poses=has_poses)
        with findings.stage():
            if options.poses is None and not opened.has_poses:
                other = min((path.name for path in root.glob("*pose*.txt")), default="")
                findings.warning("poses", NO_POSES + (f" Not read: {other}; call it poses.txt." if other else ""))
                options = options.model_copy(update={"poses": ODOMETRY})
                opened = _cut(open_recording(root, options, findings), part)
            if not is_plausible and not has_poses:
                return opened, trajectory, part
            if options.poses == ODOMETRY:
                from interloc.drives.odometry import track_of  # noqa: PLC0415 - slow to import

                track = track_of(opened, options, findings, progress)
                options = options.model_copy(update={"poses": str(track.path), "pose_frame": "lidar"})
                whole = opened = _cut(open_recording(root, options, findings), part)
                part = None
            if is_to_deskew(opened, options, findings):
                opened = deskewed(opened, trajectory(), options, findings)
            return *_upright(opened, trajectory, level_of(grounds, len(seen)), findings), part
    return opened, trajectory, part


def _upright(
    recording: Recording, trajectory: Callable[[], Trajectory], level: FloatArray | None, findings: Findings
) -> tuple[Recording, Callable[[], Trajectory]]:
    """Turn points and poses upright where the ground, seen in some scans, shows that the sensor is tilted."""
    upright = None if level is None else levelled(trajectory(), level)
    if level is None or upright is None:
        return recording, trajectory
    findings.warning(
        recording.parts.file(recording.parts.scans).name,
        f"the ground is tilted by {np.degrees(np.arccos(level[2, 2])):.0f} degrees against the sensor in all scans "
        "looked at: points and poses are turned upright. Usual cause: a sensor that is mounted at an angle.",
    )
    return replace(recording, points=LevelScans(recording.points, level)), lambda: upright


def _seen(recording: Recording) -> list[Float32Array]:
    """Return the points of some scans, those that can be read."""
    source, seen = recording.points, []
    for frame in recording.frames[sample_indices(recording.readable, SAMPLED_SCANS)].tolist():
        with suppress(DriveError):  # which is said where it is read
            points = scan_once((id(source), frame), partial(source.read, frame), lambda points: points.nbytes)
            xyz, is_finite = points.values[:, :3], np.isfinite(points.values[:, :3])
            seen.append(xyz if is_finite.all() else xyz[is_finite.all(axis=1)])
    return [xyz for xyz in seen if len(xyz)]


def _part_of(whole: Recording | ReducedManifest, options: DriveOptions) -> slice | None:
    if options.frames is None:
        return None
    name = whole.parts.file(whole.parts.scans).name if isinstance(whole, Recording) else MANIFEST
    return rows_of_part(options.frames, whole.frames, name)


def _cut(recording: Recording, part: slice | None) -> Recording:
    return recording if part is None else recording.within(part)


def open_recording(root: Path, options: DriveOptions, findings: Findings) -> Recording:
    """Open the scans of a drive in whichever of the `interloc.drives.formats` they are."""

    def first_of(formats: Iterable[ScanFormat]) -> Recording | None:
        asked = (each for each in formats if options.layout in {"auto", each.name})
        recordings = (each.open(root, options, findings) for each in asked)
        return next((recording for recording in recordings if recording is not None), None)

    for name, expected in sorted(misnamed(root))[:3] if root.is_dir() else ():
        findings.warning(name, IN_CAPITALS.format(expected))
    has_scans = options.layout == "auto" and any((root / folder).is_dir() for folder in SCAN_FOLDERS)
    whole = [each for each in FORMATS if not each.is_folders and not has_scans]  # beside scans, a cloud is a map
    if (recording := first_of(whole)) is not None:
        return recording
    if (parts := recognise_layout(root, options)) is not None:
        layout = find_format(parts.layout)
        assert layout is not None
        return cast("Recording", layout.open(parts, options, findings))
    if (recording := first_of(installed_formats())) is not None:
        return recording
    raise not_a_drive(root, options)


def _label_folder(
    opened: Recording | ReducedManifest | None, options: DriveOptions, findings: Findings, needs_labels: bool
) -> LabelFolder:
    """Return the labels that were asked for; where that was left open, the first that there are."""
    if options.labels != "auto":
        return options.labels
    if isinstance(opened, ReducedManifest):
        return min(opened.labels, key=lambda each: each.folder == "geometry").folder  # which is the last resort
    if opened is None or options.model is not None:
        return "labels"
    there = [folder for folder in LABEL_FILES if opened.parts.label_folder(folder).is_dir()]
    if there == ["predictions"]:
        other = ", and those of the points are not used (--labels labels)" if opened.carries_labels else ""
        findings.note("predictions", f"are the labels: there is no labels/{other}.")
    if there or opened.carries_labels or not needs_labels:
        return there[0] if there else "labels"
    findings.warning(
        "labels",
        "there are none: the road is found by geometry (--labels geometry), from the points and the path driven. "
        "Labels of a network place intersections better: docs/labels.md says where to get one.",
    )
    return "geometry"


def _within(scans: Scans, rows: slice) -> Scans:
    """Return a piece of the scans."""
    usable = rows_within(scans.usable, rows)
    if isinstance(scans, RawScans):
        return replace(scans, recording=scans.recording.within(rows), usable=usable)
    return replace(scans, frames=scans.frames[rows], usable=usable)


def _pose_file(scans: Scans, trajectory: Trajectory) -> str:
    if trajectory.poses is not None and trajectory.poses.is_computed:
        return "poses computed from the points"
    if scans.parts.poses is not None and scans.parts.poses.exists():
        return scans.parts.file(scans.parts.poses).name
    is_oxts = trajectory.poses is not None and trajectory.poses.frame == "oxts"
    return "oxts" if is_oxts else "poses"  # those of a bag and of PCD files are in no file


def _drive_of(scans: Scans, trajectory: Trajectory, labels: LabelJudgement) -> FolderDrive | None:
    poses = trajectory.poses
    if poses is None or (isinstance(scans, RawScans) and scans.labels is None):
        return None
    return FolderDrive(
        root=scans.parts.root,
        name=scans.parts.drive_name,
        layout=scans.parts.layout,
        frames=scans.frames,
        T_world_lidar=poses.T_world_lidar,
        times_s=trajectory.times_s,
        georeference=trajectory.georeference,
        scans=scans.by_scheme(labels.scheme or SEMANTICKITTI),
        pose_frame=poses.frame,
        pose_file=_pose_file(scans, trajectory),
        pose_frame_reason=poses.reason,
    )


def _checked(reading: DriveReading, findings: Findings) -> DriveReading:
    """Read the sampled scans, and see whether labels, poses and georeference fit together."""
    drive, scans = reading.drive, reading.scans
    if drive is None or scans is None:
        return reading
    pose_file, seen = _pose_file(scans, reading.trajectory), []
    for index in reading.sample:
        with findings.stage():
            seen.append(drive.ground_points(index).road)
    errors = findings.errors
    if isinstance(scans, ReducedScans):
        check_points(seen, grounds_of(seen), scans.parts.file(scans.parts.scans).name, findings, has_poses=True)
    check_motion(drive.T_world_lidar, pose_file, findings)
    reading = replace(reading, flatness_m=check_flat_road(drive, scans.usable, pose_file, findings))
    tells_motion = not isinstance(scans, RawScans) or (scans.check_turns(findings) and not scans.recording.is_cut)
    if findings.errors == errors and tells_motion:  # else what follows is the same fault in other words
        from interloc.drives.scan_motion import check_scan_motion  # noqa: PLC0415 - slow to import

        poses = reading.trajectory.poses
        is_computed = poses is not None and poses.is_computed
        check_scan_motion(drive, scans.usable, pose_file, findings, is_computed=is_computed)
    if isinstance(scans, RawScans):
        scans.tell_doubts(findings)
        with findings.stage():  # a reduced drive has the warning in its manifest
            if (dropped := drive.dropped) is not None:
                findings.warning(DROPPED, dropped_in_words(dropped))
    if drive.georeference is None or drive.pose_frame == "oxts":
        return reading
    error = check_against_poses(drive.T_world_lidar, drive.georeference, findings)
    return replace(reading, georeference_error=error)
