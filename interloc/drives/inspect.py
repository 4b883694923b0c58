"""What is in a drive, and everything that is wrong with it."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from interloc.drives.findings import Finding, Findings
from interloc.drives.found import Survey
from interloc.drives.open import drive_options
from interloc.drives.options import LabelFolder, LayoutChoice, PoseFrame
from interloc.drives.survey import survey


class ReducedReport(BaseModel):
    """What is left of the scans of a reduced drive.

    Attributes
    ----------
    kept_scans : int
    ground_bytes : int or None
        Size of their ground points, where the label folder has any.
    distance_m, angle_deg : float or None
        Keyframe settings by which they were chosen; None: every scan was kept.
    """

    model_config = ConfigDict(frozen=True)

    kept_scans: int
    ground_bytes: int | None
    distance_m: float | None
    angle_deg: float | None


class DriveReport(BaseModel):
    """A drive at a glance; what could not be found out is None.

    Attributes
    ----------
    path, name : str
        The folder, and the name of the drive.
    layout : str or None
        "semantickitti", "kitti_raw" or "kitti360".
    scans : int
        Number of scans (also of those that a reduced drive did not keep).
    first_frame, last_frame : int or None
        Scan numbers.
    scan_bytes, label_bytes : int
        Size of all of them; of a reduced drive that of the files it was made of, 0 where that is not known.
    points_per_scan, least_points, most_points : int or None
        Median, minimum and maximum.
    reduced : ReducedReport or None
        What was kept, where this is a reduced drive.
    poses : int
        Poses in the file (may be more than scans).
    length_m : float or None
        Way driven over the scans.
    spacing_m : float or None
        Median distance between scans.
    duration_s : float or None
    pose_frame, pose_frame_reason : str or None
        Whose poses the file holds ("camera", "lidar", "imu", "oxts"), and why that is thought.
    label_folder, label_scheme : str or None
    label_ids : dict of int to float
        Share of the points of the scans looked at that carry each id.
    road_share : float or None
        Share of road among the points of the scans looked at.
    unknown_ids : list of int
        Ids that the scheme does not know.
    georeference : str or None
        Where it comes from.
    georeference_reason : str or None
        Why there is none.
    georeference_error : float or None
        Median error of the motion against the georeference, as a share of the way.
    flatness_m : float or None
        Median difference in height of the same road seen from two scans, at the worst place looked at.
    looked_into : int
        Number of scans whose contents were looked at.
    problems : list of Finding
        Errors first, then warnings and notes.
    """

    model_config = ConfigDict(frozen=True)

    path: str
    name: str
    layout: str | None = None
    scans: int = 0
    first_frame: int | None = None
    last_frame: int | None = None
    scan_bytes: int = 0
    label_bytes: int = 0
    points_per_scan: int | None = None
    least_points: int | None = None
    most_points: int | None = None
    reduced: ReducedReport | None = None
    poses: int = 0
    length_m: float | None = None
    spacing_m: float | None = None
    duration_s: float | None = None
    pose_frame: str | None = None
    pose_frame_reason: str | None = None
    label_folder: str | None = None
    label_scheme: str | None = None
    label_ids: dict[int, float] = {}
    road_share: float | None = None
    unknown_ids: list[int] = []
    georeference: str | None = None
    georeference_reason: str | None = None
    georeference_error: float | None = None
    flatness_m: float | None = None
    looked_into: int = 0
    problems: list[Finding] = []

    @property
    def ok(self) -> bool:
        """True where nothing makes the drive unusable."""
        return not any(problem.severity == "error" for problem in self.problems)

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON can hold, with `ok`."""
        return {"ok": self.ok, **self.model_dump(mode="json")}


def inspect_drive(
    path: str | os.PathLike[str],
    *,
    labels: LabelFolder = "labels",
    label_scheme: str | Collection[int] = "auto",
    pose_frame: PoseFrame = "auto",
    layout: LayoutChoice = "auto",
    oxts: str | os.PathLike[str] | None = None,
    name: str | None = None,
    thorough: bool = False,
) -> DriveReport:
    """Look at a drive as `open_drive` does, but list every problem instead of stopping at the first.

    Parameters
    ----------
    path, labels, label_scheme, pose_frame, layout, oxts, name
        As of `open_drive`.
    thorough : bool
        Read all scans and labels, not only some; the sizes of all files are checked in any case.

    Raises
    ------
    ConfigError
        An option without meaning. A bad drive raises nothing.
    """
    options = drive_options(
        labels=labels, label_scheme=label_scheme, pose_frame=pose_frame, layout=layout, oxts=oxts, name=name, check=True
    )
    findings = Findings(stop_at_first=False)
    root = Path(path)
    found = survey(root, options, findings, thorough=thorough)
    order = ("error", "warning", "note")
    return DriveReport(
        path=str(root),
        name=found.contents.name if found.contents else name or root.absolute().name,
        layout=found.parts.layout if found.parts else None,
        problems=sorted(findings.found, key=lambda problem: order.index(problem.severity)),
        looked_into=len(found.sample),
        **({} if found.contents is None else found.contents.report(found)),
        **_motion(found),
        **_labels(found),
        **_georeference(found),
    )


def _motion(found: Survey) -> dict[str, Any]:
    """Report poses and times."""
    motion: dict[str, Any] = {"poses": found.pose_count, "flatness_m": found.flatness_m}
    if found.T_world_lidar is not None:
        steps = np.linalg.norm(np.diff(found.T_world_lidar[:, :3, 3], axis=0), axis=1)
        motion |= {
            "length_m": float(steps.sum()),
            "spacing_m": float(np.median(steps)) if len(steps) else None,
            "pose_frame": found.pose_frame,
            "pose_frame_reason": found.pose_frame_reason,
        }
    if found.times_s is not None:
        motion["duration_s"] = float(found.times_s[-1] - found.times_s[0])
    return motion


def _labels(found: Survey) -> dict[str, Any]:
    """Report what the labels mean."""
    labels = found.labels
    return {
        "label_scheme": labels.scheme.name if labels.scheme else None,
        "label_ids": labels.id_shares if labels.scheme else {},
        "road_share": labels.road_share,
        "unknown_ids": labels.unknown_ids,
    }


def _georeference(found: Survey) -> dict[str, Any]:
    """Report the georeference, or why there is none."""
    if found.georeference is None:
        return {"georeference_reason": found.georeference_reason}
    return {"georeference": found.georeference.source, "georeference_error": found.georeference_error}
