"""Poses of a drive from its points alone, computed once: they are kept in the user's cache."""

import hashlib
import os
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from filelock import FileLock
from platformdirs import user_cache_path

from interloc.arrays import FloatArray, IntArray
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.options import ODOMETRY, DriveOptions
from interloc.drives.plan_matching import MIN_CELLS, PlanMatch, upright_plan
from interloc.drives.scans.raw import trajectory_of
from interloc.drives.scans.recording import PointSource, Recording
from interloc.drives.trajectory import Trajectory
from interloc.errors import DriveError
from interloc.files import atomic_write
from interloc.odometry import MAX_STEP_M, MIN_INLIER_SHARE, Odometry, Velocity, is_bent, register, require_small_gicp
from interloc.processes import Progress
from interloc.storage import temporary_folder
from interloc.wording import counted

_METHOD = "odometry 10"
"""Tracks that another version of the method made are computed anew."""

_BRIDGED = "it was taken to keep its speed"
_ALIKE = 0.45  # of a plan that lies on another: real streets have more up to 23 m apart


@dataclass(frozen=True)
class Track:
    """The poses that the points of a drive tell."""

    path: Path
    """Lines of poses of the LiDAR, each with its frame number; the first is `how` they were made, as a comment."""
    how: str

    def trajectory(self, recording: Recording, options: DriveOptions, findings: Findings) -> Trajectory:
        """Return the trajectory of a recording that is read by these poses: nothing is told of the file they are in."""
        heard = Findings(stop_at_first=False)
        found = trajectory_of(recording, options, heard)
        for finding in heard.found:
            if finding.path != str(self.path):
                findings.tell(finding)
            elif finding.severity == "error":
                findings.refuse(
                    "poses",
                    "were computed from the points, and are not those of a vehicle that drives where the sensor looks. "
                    "Usual cause: points with the axes of a camera, in the frame of the world, or of scans that do not "
                    f"follow each other ({finding.message.split('. ')[0]}).",
                )
        if found.poses is None:
            return found
        return replace(found, poses=replace(found.poses, reason=self.how, is_computed=True))


def track_of(
    recording: Recording, options: DriveOptions, findings: Findings, progress: Progress | None = None
) -> Track:
    """Return the poses that the points of a drive tell, which are computed where that was not done before."""
    source, frames = recording.points, recording.frames
    require_small_gicp()
    clock, has_times = _clock(recording, options)
    path = _kept_as(source, frames, clock, options)
    with FileLock(path.parent / "odometry.lock"):
        if not path.is_file():
            for kept in path.parent.glob("*.txt"):
                with suppress(OSError):
                    if time.time() - kept.stat().st_mtime > 60 * 86400:  # nobody will come back to it
                        kept.unlink()
            findings.note(ODOMETRY, f"the poses of {len(frames):,} scans are computed from their points, once.")
            is_timed = len(frames) > 1 and recording.has_times and has_times and options.deskew != "off"
            deskew = is_timed and (options.deskew == "on" or _are_bent(source, frames, clock))
            _refuse_far_apart(source, frames)
            poses, bridged = _follow(source, frames, clock, deskew, progress)
            how = f"odometry over the points of {len(frames):,} scans{', deskewed' if deskew else ''}"
            if bridged:
                places = ", ".join(f"{start:,.0f} to {stop:,.0f} m" for start, stop in bridged)
                how += f"; from {places} nothing told how fast the vehicle moved, and {_BRIDGED}"
            with atomic_write(path) as file:
                file.write(f"# {how}\n".encode())
                lines = np.column_stack([frames, np.array(poses)[:, :3].reshape(-1, 12)])
                np.savetxt(file, lines, fmt=["%d", *["%.9g"] * 12])
    with path.open() as kept_track:
        track = Track(path, next(kept_track).removeprefix("# ").strip())
    if _BRIDGED in track.how:
        findings.warning(ODOMETRY, f"{track.how}.")
    return track


def _refuse_far_apart(source: PointSource, frames: IntArray) -> None:
    """Raise DriveError where what stands upright shows at some places that the scans lie too far apart."""
    apart_m = []
    for row in np.linspace(0, max(len(frames) - 2, 0), 3).astype(int):
        here, there = (
            upright_plan(source.read(int(frame)).values[:, :3])
            for frame in frames[[row, min(row + 1, len(frames) - 1)]]
        )
        if min(len(here), len(there)) < MIN_CELLS:
            return
        match = PlanMatch.of(here, there)
        apart_m.append(float(np.hypot(*match.motion[:2])))
        if match.share < _ALIKE or apart_m[-1] <= MAX_STEP_M:
            return
    raise DriveFileError(
        source.name(int(frames[0])),
        f"the scans lie about {np.median(apart_m):.0f} m apart: odometry follows scans up to {MAX_STEP_M:.0f} m apart, "
        "and is sure up to some metres. Give all scans of the recording, or poses.",
    )


def _follow(
    source: PointSource, frames: IntArray, clock: FloatArray, deskew: bool, progress: Progress | None
) -> tuple[list[FloatArray], list[tuple[float, float]]]:
    """Return the poses of all scans, W being the LiDAR at the first, and from where to where, metres, none was told."""
    odometry, poses, driven_m = Odometry(deskew=deskew), list[FloatArray](), 0.0
    bridged: list[tuple[float, float]] = []
    for row, frame in enumerate(frames.tolist()):
        points = source.read(frame)
        try:
            times_s = None if points.times_s is None else np.nan_to_num(points.times_s)
            pose = odometry.add(points.values[:, :3], float(clock[row]), times_s)
        except DriveError as error:
            before = f"--frames {frames[0]}:{frame} is what lies before, --frames {frame}: what comes after"
            raise DriveFileError(
                source.name(frame),
                f"the odometry lost track here, after {counted(row, 'scan')} and {driven_m:,.0f} m: "
                f"{str(error).rstrip('.')}. Work on a part of the drive ({before}), or give poses.",
            ) from error
        before_m = driven_m
        if poses:
            driven_m += float(np.linalg.norm(pose[:3, 3] - poses[-1][:3, 3]))
        poses.append(pose)
        if odometry.is_bridged:
            is_next = bool(bridged) and before_m - bridged[-1][1] < 5.0  # they are told as one
            bridged.append((bridged.pop()[0] if is_next else before_m, driven_m))
        if progress is not None:
            progress(row + 1, len(frames))
    return poses, bridged


def _clock(recording: Recording, options: DriveOptions) -> tuple[FloatArray, bool]:
    """Return the (N,) times of the scans, and True; their numbers, and False, where these are not known."""
    frames, unheard = recording.frames, Findings(stop_at_first=False)  # what is wrong is told when the drive is read
    times_s = trajectory_of(recording, options, unheard).times_s
    if times_s is None or (np.diff(times_s) <= 0).any():
        return frames.astype(np.float64), False
    return times_s - times_s[0], True


def _are_bent(source: PointSource, frames: IntArray, clock: FloatArray) -> bool:
    """Tell whether the motion within scans is still in their points, where these carry times."""
    votes: list[bool | None] = []
    for row in np.unique(np.linspace(0, len(frames) - 2, 12).astype(int)):
        here, there = (source.read(int(frames[each])) for each in (row, row + 1))
        if here.times_s is None:
            return False
        found = register(there.values[:, :3], here.values[:, :3])
        if found.inlier_share >= MIN_INLIER_SHARE:
            velocity = Velocity.between(found.T_target_source, float(clock[row + 1] - clock[row]))
            votes.append(is_bent(here.values[:, :3], np.nan_to_num(here.times_s), velocity))
    return votes.count(True) > votes.count(False)


def _kept_as(source: PointSource, frames: IntArray, clock: FloatArray, options: DriveOptions) -> Path:
    """Return where the track of just these scans is kept, whether it is there or not."""
    key = hashlib.sha256(f"{_METHOD} {options.deskew} {options.points}".encode() + frames.tobytes() + clock.tobytes())
    for path in sorted({path for frame in frames.tolist() for path in source.files(frame)}):
        stat = path.stat()
        key.update(os.fsencode(path.absolute()) + f" {stat.st_size} {stat.st_mtime_ns}\n".encode())
    folder = user_cache_path("interloc") / "odometry"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # no home, as in some containers: computed anew by each process
        folder = temporary_folder()
    return folder / f"{key.hexdigest()[:32]}.txt"
