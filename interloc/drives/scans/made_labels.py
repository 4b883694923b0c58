"""Labels that are made of the scans as they are read: by a network, or by geometry along the driven track."""

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray, UInt32Array
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.scans.recording import SECTOR_DEG, WIDE_VIEW_DEG, PointSource, Recording, ScanPoints, sectors_seen
from interloc.drives.trajectory import Trajectory
from interloc.labelling import networks
from interloc.labelling.geometry import METHOD, GeometryLabeller
from interloc.labelling.networks import ScanLabeller, remission_scale
from interloc.labelling.track import doubts_in_words, joined

_REMEMBERED = 16  # scans: those that the checks look into come up again


@dataclass(frozen=True)
class NetworkLabels:
    """What a network makes of the scans, in ids of SemanticKITTI."""

    labeller: ScanLabeller
    remission_scale: float
    """What the remission of the drive is divided by to lie between 0 and 1."""
    scheme = "semantickitti"
    is_slow = True
    _recent: OrderedDict[int, UInt32Array] = field(default_factory=OrderedDict, compare=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_recent": OrderedDict()}

    @property
    def name(self) -> str:
        """What messages call them."""
        return f"network {self.labeller.name}"

    @property
    def identity(self) -> tuple[str, ...]:
        """Which network, by which remission: labels of the same scan by the same identity are equal."""
        return (self.labeller.identity, repr(self.remission_scale))

    def files(self, frame: int) -> tuple[Path, ...]:  # noqa: ARG002 - as of `LabelFiles`
        """Return none: they are made."""
        return ()

    def of(self, frame: int, points: ScanPoints, scan: str) -> UInt32Array:  # noqa: ARG002 - as of `LabelFiles`
        """Label the points of a scan."""
        known = self._recent.get(frame)
        if known is not None and len(known) == len(points.values):
            return known
        values = points.values
        if self.remission_scale != 1:
            values = values.copy()
            values[:, 3] /= self.remission_scale
        labels: UInt32Array = self.labeller.label(values)
        self._recent[frame] = labels
        while len(self._recent) > _REMEMBERED:
            self._recent.popitem(last=False)
        return labels


def open_network(folder: Path, provider: str, recording: Recording, findings: Findings) -> NetworkLabels:
    """Read a network, and find out what the remission of a recording has to be divided by for it."""
    where = recording.parts.file(recording.parts.scans).name
    labeller = networks.open_network(folder, provider, threads=1)  # several scans are labelled at once
    for note in labeller.notes:
        findings.note(labeller.name, note)
    labeller.load()  # what is wrong with it is told now
    remission = recording.sampled_remission()
    scale = remission_scale(remission)
    if scale != 1:
        findings.note(where, f"the remission is not 0 to 1; it is divided by {scale:,.0f} for the network.")
    if not remission.any():
        findings.warning(
            where, "the points have no remission, which networks need: expect far worse labels than with it."
        )
    return NetworkLabels(labeller, scale)


# By geometry


@dataclass(frozen=True)
class GeometryLabels:
    """What geometry and brightness say of the scans, in ids of SemanticKITTI."""

    points: PointSource
    frames: IntArray
    """(N,) int64: scan numbers, ascending."""
    labeller: GeometryLabeller
    name = "geometry"
    scheme = "semantickitti"
    is_slow = True

    @classmethod
    def of_drive(
        cls, points: PointSource, frames: IntArray, T_world_lidar: FloatArray, usable: IntArray
    ) -> "GeometryLabels":
        """Label the scans of a drive with (N, 4, 4) poses, of which some, (M,) positions, can be read."""
        return cls(points, frames, GeometryLabeller(T_world_lidar, usable, partial(_values_of, points, frames)))

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
        end_m = float(self.labeller.track.distance_m[-1])
        doubtful = (window for window in self.labeller.known_quality() if window.is_doubtful)
        if stretches := joined((window.start_m, min(window.stop_m, end_m)) for window in doubtful):
            findings.warning(where, doubts_in_words(stretches))

    def _row(self, frame: int) -> int:
        return int(np.searchsorted(self.frames, frame))


def _values_of(points: PointSource, frames: IntArray, row: int) -> Float32Array:
    return points.read(int(frames[row])).values


def open_geometry(recording: Recording, trajectory: Trajectory, findings: Findings) -> GeometryLabels:
    """Prepare labels by geometry for the scans of a recording."""
    where = recording.parts.file(recording.parts.scans).name
    if trajectory.poses is None:
        raise DriveFileError(
            where,
            "labels by geometry need poses of all scans. Expected a drive whose poses can be read. Usual cause: "
            "the fault in its poses that is told beside this one.",
        )
    usable = recording.readable
    remission = recording.sampled_remission()
    remission = remission[np.isfinite(remission)]
    if remission.size == 0 or np.ptp(remission) == 0:
        findings.warning(
            where,
            "the points have no remission: labels by geometry then rest on kerbs and roughness alone, and sidewalks "
            "beside low kerbs are taken for road.",
        )
    if len(usable):
        middle = recording.points.read(int(recording.frames[usable[len(usable) // 2]]))
        seen_deg = SECTOR_DEG * len(sectors_seen(middle))
        if seen_deg < WIDE_VIEW_DEG:
            findings.warning(
                where,
                f"the sensor sees {seen_deg} degrees around it. Labels by geometry expect one that turns: side "
                "streets are then seen late or not at all, and what is behind the vehicle is not labelled.",
            )
    return GeometryLabels.of_drive(recording.points, recording.frames, trajectory.poses.T_world_lidar, usable)
