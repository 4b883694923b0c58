"""The contents of a drive as it was recorded: scans, and labels beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.drives.faults import Findings
from interloc.drives.files import NumberedFiles, list_numbered, shown
from interloc.drives.found import Survey
from interloc.drives.inventory import check_files, list_labels
from interloc.drives.labels import SEMANTICKITTI, LabelScheme, guess_scheme, named_scheme
from interloc.drives.options import DriveOptions
from interloc.drives.parts import DriveParts
from interloc.drives.plausibility import check_labels
from interloc.drives.scans import POINT_BYTES, RawScans, read_label_ids


@dataclass
class RawContents:
    """Scans and labels of a drive as it was recorded; `Contents`.

    Attributes
    ----------
    parts : DriveParts
    scans, labels : NumberedFiles or None
        None where they could not be listed.
    """

    parts: DriveParts
    scans: NumberedFiles | None = None
    labels: NumberedFiles | None = None

    @property
    def name(self) -> str:
        """Name of the drive."""
        return self.parts.drive_name

    def list_scans(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """List the files, and check their sizes."""
        root = self.parts.root
        with findings.stage():
            self.scans = list_numbered(self.parts.scans, ".bin", root)
            found.frames = self.scans.numbers
        with findings.stage():
            self.labels = list_labels(self.parts)
        if self.scans is not None and self.labels is not None:
            found.usable = check_files(self.scans, self.labels, root, findings, sizes=options.check)

    def look_into_labels(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """Count the ids of the sampled scans."""
        if self.labels is None:
            return
        assert found.frames is not None
        for index in found.sample:
            with findings.stage():
                path = self.labels.path(int(found.frames[index]))
                for label, count in read_label_ids(path, self.parts.root):
                    found.label_counts[label] = found.label_counts.get(label, 0) + count
        found.scheme = judge_labels(
            self.parts.layout, shown(self.labels.folder, self.parts.root), found.label_counts, options, findings
        )

    def ground(self, found: Survey) -> RawScans | None:
        """Return the scans."""
        if self.scans is None or self.labels is None:
            return None
        return RawScans(self.parts.root, self.scans, self.labels, found.scheme or SEMANTICKITTI)

    def report(self, found: Survey) -> dict[str, Any]:  # noqa: ARG002 - of `Contents`
        """Report the files."""
        report: dict[str, Any] = {}
        if self.scans is not None:
            points = self.scans.sizes // POINT_BYTES
            report |= {
                "scans": len(points),
                "first_frame": int(self.scans.numbers[0]),
                "last_frame": int(self.scans.numbers[-1]),
                "scan_bytes": int(self.scans.sizes.sum()),
                "points_per_scan": int(np.median(points)),
                "least_points": int(points.min()),
                "most_points": int(points.max()),
            }
        if self.labels is not None:
            report |= {"label_folder": self.parts.labels.name, "label_bytes": int(self.labels.sizes.sum())}
        return report


def judge_labels(
    layout: str | None, folder: str, counts: dict[int, int], options: DriveOptions, findings: Findings
) -> LabelScheme | None:
    """Tell what the label ids of some scans mean, and whether that makes sense.

    Parameters
    ----------
    layout : str or None
        Of the drive.
    folder : str
        Of the labels, in messages.
    counts : dict of int to int
        How many points carry each id.

    Returns
    -------
    LabelScheme or None
        None where nothing was counted, and no scheme was named.

    Raises
    ------
    DriveError
        No point is road, or the ids are of another scheme; where `findings` stops at it.
    """
    scheme = named_scheme(options.label_scheme)
    if scheme is None and counts:
        ids = np.array(sorted(counts), dtype=np.int64)
        scheme = guess_scheme(ids, kitti360=layout == "kitti360")
        if scheme is not SEMANTICKITTI:
            findings.note(folder, f"the ids look like scheme {scheme.name} and are read as such.")
    if options.check and scheme is not None and counts:
        check_labels(folder, scheme, counts, findings)
    return scheme
