"""Poses of a drive from its points alone, computed once: they are kept in the user's cache."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from filelock import FileLock
from platformdirs import user_cache_path

from interloc.arrays import FloatArray, IntArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.options import ODOMETRY, DriveOptions
from interloc.drives.scans.recorded import PointSource, Recording
from interloc.drives.trajectory import read_trajectory
from interloc.errors import DriveError
from interloc.files import atomic_write
from interloc.odometry.deskew import Velocity, is_bent
from interloc.odometry.odometry import Odometry
from interloc.odometry.registration import MIN_INLIER_SHARE, register, require_small_gicp
from interloc.processes import Progress
from interloc.wording import counted

_METHOD = "odometry 8"
"""Tracks that another version of the method made are computed anew."""

_BRIDGED = "it was taken to keep its speed"
_NEXT_M = 5.0  # between stretches that are told as one
_SAMPLED = 12  # pairs of scans, evenly spread
_KEPT_DAYS = 60


def track_file(
    recording: Recording, options: DriveOptions, findings: Findings, progress: Progress | None = None
) -> SourceFile:
    """Return the file of the poses that the points of a drive tell, which are computed where that was not done before.

    Parameters
    ----------
    recording : Recording
        Opened without poses.
    progress
        Called with the scans done and the scans in all.

    Returns
    -------
    SourceFile
        Lines of poses of the LiDAR, each with its frame number; the first is a comment, `how_made`.

    Raises
    ------
    DriveError
        The scans cannot be followed (it names the first that cannot, and how far the drive had come), a file is
        damaged, or small_gicp is not installed.
    """
    source, frames = recording.points, recording.frames
    if source is None or frames is None:
        raise recording.parts.file(recording.parts.scans).fault("holds no scans to compute poses from.")
    require_small_gicp()
    clock, has_times = _clock(recording, options)
    path = _kept_as(source, frames, clock, options)
    with FileLock(path.parent / "odometry.lock"):
        if not path.is_file():
            _sweep(path.parent)
            findings.note(ODOMETRY, f"the poses of {len(frames):,} scans are computed from their points, once.")
            is_timed = recording.has_times and has_times and options.deskew != "off"
            deskew = is_timed and (options.deskew == "on" or _are_bent(source, frames, clock))
            poses, bridged = _follow(source, frames, clock, deskew, progress)
            how = f"odometry over the points of {len(frames):,} scans{', deskewed' if deskew else ''}"
            if bridged:
                places = ", ".join(f"{start:,.0f} to {stop:,.0f} m" for start, stop in bridged)
                how += f"; from {places} nothing told how fast the vehicle moved, and {_BRIDGED}"
            with atomic_write(path) as file:
                file.write(f"# {how}\n".encode())
                np.savetxt(file, np.column_stack([frames, poses[:, :3].reshape(-1, 12)]), fmt=["%d", *["%.9g"] * 12])
    track = SourceFile(path, recording.parts.root)
    if _BRIDGED in (made := how_made(track)):
        findings.warning(ODOMETRY, f"{made}.")
    return track


def how_made(file: SourceFile) -> str:
    """Return how a track was made, in words."""
    return file.head().partition(b"\n")[0].decode().removeprefix("# ")


def _sweep(folder: Path) -> None:
    """Remove tracks that nobody will come back to."""
    for path in folder.glob("*.txt"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _KEPT_DAYS * 86400:
                path.unlink()


def _follow(
    source: PointSource, frames: IntArray, clock: FloatArray, deskew: bool, progress: Progress | None
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """Return the (N, 4, 4) poses of the scans, W is the LiDAR at the first, and from where to where it was bridged."""
    odometry, poses, driven_m = Odometry(deskew=deskew), np.tile(np.eye(4), (len(frames), 1, 1)), 0.0
    bridged: list[tuple[float, float]] = []
    for row, frame in enumerate(frames.tolist()):
        points = source.read(frame)
        try:
            poses[row] = odometry.add(points.values[:, :3], float(clock[row]), points.times_s)
        except DriveError as error:
            raise DriveFileError(
                source.name(frame),
                f"the odometry lost track here, after {counted(row, 'scan')} and {driven_m:,.0f} m: {error}",
            ) from error
        before_m, driven_m = driven_m, driven_m + float(np.linalg.norm(poses[row, :3, 3] - poses[row - 1, :3, 3]))
        if odometry.is_bridged:
            is_next = bool(bridged) and before_m - bridged[-1][1] < _NEXT_M
            bridged.append((bridged.pop()[0] if is_next else before_m, driven_m))
        if progress is not None:
            progress(row + 1, len(frames))
    return poses, bridged


def _clock(recording: Recording, options: DriveOptions) -> tuple[FloatArray, bool]:
    """Return the (N,) times of the scans, and True; their numbers, and False, where these are not known."""
    frames, unheard = recording.frames, Findings(stop_at_first=False)  # what is wrong is told when the drive is read
    assert frames is not None
    if recording.read_trajectory is not None:
        times_s = recording.read_trajectory(options, unheard).times_s
    else:
        times_s = read_trajectory(recording.parts, frames, options, unheard).times_s
    if times_s is None or (np.diff(times_s) <= 0).any():
        return frames.astype(np.float64), False
    return times_s - times_s[0], True


def _are_bent(source: PointSource, frames: IntArray, clock: FloatArray) -> bool:
    """Tell whether the motion within scans is still in their points, where these carry times."""
    votes: list[bool | None] = []
    for row in np.unique(np.linspace(0, len(frames) - 2, _SAMPLED).astype(int)):
        here, there = (source.read(int(frames[each])) for each in (row, row + 1))
        if here.times_s is None:
            return False
        found = register(there.values[:, :3], here.values[:, :3])
        if found.inlier_share >= MIN_INLIER_SHARE:
            velocity = Velocity.between(found.T_target_source, float(clock[row + 1] - clock[row]))
            votes.append(is_bent(here.values[:, :3], here.times_s, velocity))
    return votes.count(True) > votes.count(False)


def _kept_as(source: PointSource, frames: IntArray, clock: FloatArray, options: DriveOptions) -> Path:
    """Return where the track of just these scans is kept, whether it is there or not."""
    key = hashlib.sha256(f"{_METHOD} {options.deskew}".encode() + frames.tobytes() + clock.tobytes())
    for path in sorted({path for frame in frames.tolist() for path in source.files(frame)}):
        stat = path.stat()
        key.update(f"{path.absolute()} {stat.st_size} {stat.st_mtime_ns}\n".encode())
    folder = user_cache_path("interloc") / "odometry"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # no home, as in some containers
        folder = _own_temporary_folder()
    return folder / f"{key.hexdigest()[:32]}.txt"


def _own_temporary_folder() -> Path:
    """Return a folder that nobody else can read or write, which stays from one command to the next."""
    folder = Path(tempfile.gettempdir()) / f"interloc-odometry-{os.getuid() if hasattr(os, 'getuid') else 'tracks'}"
    folder.mkdir(mode=0o700, exist_ok=True)
    stat = folder.lstat()
    if hasattr(os, "getuid") and (folder.is_symlink() or stat.st_uid != os.getuid() or stat.st_mode & 0o077):
        raise DriveError(
            f"{folder} is not a folder of this user's own (0700). Tracks are kept there where there is no home; remove "
            "it, or set XDG_CACHE_HOME."
        )
    return folder
