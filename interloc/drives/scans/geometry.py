"""Labels that are made from the scans themselves and from the driven track, without a network."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray, UInt32Array
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.scans.recorded import PointSource, Recording, ScanPoints
from interloc.drives.trajectory import Trajectory
from interloc.labelling.doubts import doubts_in_words, joined
from interloc.labelling.geometry import METHOD, GeometryLabeller

GEOMETRY = "geometry"
"""The choice of labels by which they are made."""

_MIN_VIEW_DEG = 200.0


@dataclass(frozen=True)
class GeometryLabels:
    """What geometry and brightness say of the scans, in ids of SemanticKITTI."""

    points: PointSource
    frames: IntArray
    """(N,) int64: scan numbers, ascending."""
    labeller: GeometryLabeller
    name = GEOMETRY
    scheme = "semantickitti"
    is_slow = True

    @classmethod
    def of_drive(
        cls, points: PointSource, frames: IntArray, T_world_lidar: FloatArray, usable: IntArray
    ) -> GeometryLabels:
        """Label the scans of a drive with (N, 4, 4) poses, of which some, (M,) positions, can be read."""
        return cls(points, frames, GeometryLabeller(T_world_lidar, usable, _PointsOf(points, frames)))

    @property
    def identity(self) -> tuple[str, ...]:
        """Which method, along which track: labels of the same scans by the same identity are equal."""
        return (METHOD, hashlib.sha256(self.labeller.track.T_world_lidar.tobytes()).hexdigest())

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the files of the scans around, of which the labels of a scan are made."""
        track = self.labeller.track
        rows = track.context(track.window_of(self._row(frame)))
        return tuple(path for row in rows for path in self.points.files(int(self.frames[row])))

    def of(self, frame: int, points: ScanPoints, scan: str) -> UInt32Array:  # noqa: ARG002 - as of `LabelFiles`
        """Label the points of a scan."""
        return self.labeller.label(self._row(frame), points.values)

    def is_doubtful(self, frame: int) -> bool:
        """Return whether the labels of a scan may be wrong."""
        return self.labeller.quality_of(self._row(frame)).is_doubtful

    def windows_of(self, frames: Sequence[int]) -> IntArray:
        """Return the windows of the track that scans belong to, (N,)."""
        return np.array([self.labeller.track.window_of(self._row(frame)) for frame in frames], np.int64)

    def tell_doubts(self, where: str, findings: Findings) -> None:
        """Warn of the stretches looked at whose labels are doubtful."""
        known = self.labeller.known_quality()
        if stretches := joined((window.start_m, window.stop_m) for window in known if window.is_doubtful):
            findings.warning(where, doubts_in_words(stretches))

    def _row(self, frame: int) -> int:
        return int(np.searchsorted(self.frames, frame))


@dataclass(frozen=True)
class _PointsOf:
    """Reads the points of the scan in a row."""

    points: PointSource
    frames: IntArray

    def __call__(self, row: int) -> Float32Array:
        return self.points.read(int(self.frames[row])).values


def open_geometry(recording: Recording, trajectory: Trajectory, findings: Findings) -> GeometryLabels:
    """Prepare labels by geometry for the scans of a recording."""
    where = recording.parts.file(recording.parts.scans).name
    if trajectory.poses is None or recording.points is None or recording.frames is None:
        raise DriveFileError(
            where,
            "labels by geometry need poses and points of all scans. Expected a drive whose poses can be read. "
            "Usual cause: the fault in its poses or scans that is told beside this one.",
        )
    usable = recording.usable
    if usable is None:
        usable = np.arange(len(recording.frames), dtype=np.int64)
    remission = recording.sampled_remission()
    remission = remission[np.isfinite(remission)]
    if remission.size == 0 or np.ptp(remission) == 0:
        findings.warning(
            where,
            "the points have no remission: labels by geometry then rest on kerbs and roughness alone, and sidewalks "
            "beside low kerbs are taken for road.",
        )
    if len(usable):
        seen_deg = _field_of_view_deg(recording.points.read(int(recording.frames[usable[len(usable) // 2]])).values)
        if seen_deg < _MIN_VIEW_DEG:
            findings.warning(
                where,
                f"the sensor sees {seen_deg:.0f} degrees around it. Labels by geometry expect one that turns: side "
                "streets are then seen late or not at all, and what is behind the vehicle is not labelled.",
            )
    return GeometryLabels.of_drive(recording.points, recording.frames, trajectory.poses.T_world_lidar, usable)


def _field_of_view_deg(points: Float32Array) -> float:
    """Return how much of the horizon the points of a scan cover, in sectors of 10 degrees."""
    x, y = points[np.isfinite(points[:, :2]).all(axis=1), :2].T
    return 10.0 * len(np.unique(np.floor(np.degrees(np.arctan2(y, x)) / 10.0) % 36))
