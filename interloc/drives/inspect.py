"""What is in a drive, and everything that is wrong with it."""

import os
from collections import Counter
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from pydantic import Field

from interloc.drives.findings import Finding, Findings, by_severity
from interloc.drives.open import DriveReading, read_drive
from interloc.drives.options import DriveArguments, DriveOptions, ReadingOptions
from interloc.drives.scans.recording import ScanFacts


class DriveReport(ScanFacts):
    """A drive at a glance, with the `ScanFacts`; what could not be found out is None.

    Attributes
    ----------
    path, name : str
        The folder, and the name of the drive.
    layout : str or None
        "semantickitti", "kitti_raw", "kitti360", "pcd", "rosbag" or "las".
    poses : int
        Poses in the file (may be more than scans).
    length_m : float or None
        Distance driven over the scans.
    spacing_m : float or None
        Median distance between scans.
    duration_s : float or None
    pose_frame, pose_frame_reason : str or None
        Whose poses the file holds ("camera", "lidar", "imu", "oxts"), and why that is thought.
    label_scheme : str or None
    label_ids : dict of int to float
        Share of the points of the scans looked at that carry each id.
    road_share : float or None
        Share of road among the points of the scans looked at.
    unknown_ids : list of int
        Ids that the scheme does not know.
    georeference : str or None
        Where it comes from.
    georeference_reason : str or None
        Why there is none; None where the drive could not be opened to look for one.
    georeference_error : float or None
        Median error of the motion against the georeference, as a share of the distance.
    flatness_m : float or None
        Median difference in height of the same road seen from two scans, at the worst place looked at.
    looked_into : int
        Number of scans whose contents were looked at.
    problems : list of Finding
        Errors first, then warnings and notes.
    """

    path: str
    name: str
    layout: str | None = None
    poses: int = 0
    length_m: float | None = None
    spacing_m: float | None = None
    duration_s: float | None = None
    pose_frame: str | None = None
    pose_frame_reason: str | None = None
    label_scheme: str | None = None
    label_ids: dict[int, float] = Field({})
    road_share: float | None = None
    unknown_ids: list[int] = Field([])
    georeference: str | None = None
    georeference_reason: str | None = None
    georeference_error: float | None = None
    flatness_m: float | None = None
    looked_into: int = 0
    problems: list[Finding] = Field([])

    def __repr__(self) -> str:
        found = Counter(problem.severity for problem in self.problems)
        counts = "".join(f", {count} {severity}{'' if count == 1 else 's'}" for severity, count in found.items())
        return f"<DriveReport {self.name}: {'can' if self.ok else 'cannot'} be used, {self.scans:,} scans{counts}>"

    __str__ = __repr__

    @property
    def ok(self) -> bool:
        """True where nothing makes the drive unusable."""
        return not any(problem.severity == "error" for problem in self.problems)

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON can hold, with `ok`."""
        return {"ok": self.ok, **self.model_dump(mode="json")}


def inspect_drive(
    path: str | os.PathLike[str],
    options: ReadingOptions | None = None,
    *,
    thorough: bool = False,
    **arguments: Unpack[DriveArguments],
) -> DriveReport:
    """Look at a drive as `open_drive` does, but list everything that is wrong instead of stopping at the first.

    Parameters
    ----------
    path, options, **arguments
        As of `open_drive`; `check` is always on.
    thorough : bool
        Read all scans and labels, not only some; the sizes of all files are checked in any case.

    Raises
    ------
    ConfigError
        An unknown option or choice. A bad drive raises nothing.
    """
    root, findings = Path(path), Findings(stop_at_first=False)
    chosen = DriveOptions.of(options, **{**arguments, "check": True})
    (reading,) = read_drive(root, chosen, findings, thorough=thorough).values()
    return report_of(root, chosen, reading, findings)


def report_of(root: Path, options: DriveOptions, reading: DriveReading, findings: Findings) -> DriveReport:
    """Report what was read of a drive, and all that was found meanwhile."""
    scans, trajectory, labels = reading.scans, reading.trajectory, reading.labels
    poses, times_s, georeference = trajectory.poses, trajectory.times_s, trajectory.georeference
    return DriveReport(
        path=str(root),
        name=scans.parts.drive_name if scans else options.name or root.absolute().name,
        layout=scans.parts.layout if scans else None,
        **({} if scans is None else dict(scans.facts)),
        poses=trajectory.pose_count,
        length_m=poses.length_m if poses else None,
        spacing_m=float(np.median(poses.steps_m)) if poses and len(poses.steps_m) else None,
        duration_s=None if times_s is None else float(times_s[-1] - times_s[0]),
        pose_frame=poses.frame if poses else None,
        pose_frame_reason=poses.reason if poses else None,
        label_scheme=labels.scheme.name if labels.scheme else None,
        label_ids=labels.id_shares if labels.scheme else {},
        road_share=labels.road_share,
        unknown_ids=labels.unknown_ids,
        georeference=georeference.source if georeference else None,
        georeference_reason=None if georeference else trajectory.georeference_reason,
        georeference_error=reading.georeference_error,
        flatness_m=reading.flatness_m,
        looked_into=len(reading.sample),
        problems=by_severity(findings.found),
    )
