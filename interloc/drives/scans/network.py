"""Labels that a network gives to the scans as they are read."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from interloc.arrays import UInt32Array
from interloc.drives.findings import Findings
from interloc.drives.scans.recorded import Recording, ScanPoints
from interloc.labelling import networks
from interloc.labelling.networks import ScanLabeller, remission_scale

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
        """Leave the labels of recent scans behind."""
        return {**self.__dict__, "_recent": OrderedDict()}

    @property
    def name(self) -> str:
        """Name of the network."""
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
