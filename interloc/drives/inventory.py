"""Scans and their labels: whether all files are there, and their sizes fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.faults import DriveFileError, Findings
from interloc.drives.files import NumberedFiles, list_numbered, listed, missing_numbers, shown
from interloc.drives.parts import DriveParts
from interloc.drives.scans import LABEL_BYTES, POINT_BYTES, label_count_complaint, scan_size_complaint


def list_labels(parts: DriveParts) -> NumberedFiles:
    """List the label files."""
    folder = parts.labels
    if not folder.is_dir():
        other = parts.root / ("predictions" if folder.name == "labels" else "labels")
        hint = (
            f"There is {other.name}/: choose it as the label folder."
            if other.is_dir()
            else "Any semantic segmentation that writes SemanticKITTI .label files will do."
        )
        raise DriveFileError(
            shown(folder, parts.root), f"is missing. Expected one .label file a scan: uint32 a point. {hint}"
        )
    return list_numbered(folder, ".label", parts.root)


def check_files(
    scans: NumberedFiles, labels: NumberedFiles, root: Path, findings: Findings, *, sizes: bool
) -> IntArray:
    """Check that every scan has its labels, and that their sizes fit, by names and sizes only.

    Returns
    -------
    (M,) int64
        Positions of the scans that can be read.
    """
    missing = missing_numbers(labels.numbers, scans.numbers)
    if len(missing):
        findings.error(
            DriveFileError(
                shown(labels.path(int(missing[0])), root),
                f"is missing: {len(missing):,} of {len(scans.numbers):,} scans have no labels ({listed(missing)}). "
                "Expected one .label file a scan. Usual cause: an archive that was not unpacked to the end.",
            )
        )
    extra = missing_numbers(scans.numbers, labels.numbers)
    if len(extra):
        findings.note(shown(labels.folder, root), f"labels of {len(extra):,} scans that are not there are not used.")
    common, at_scan, at_label = np.intersect1d(scans.numbers, labels.numbers, assume_unique=True, return_indices=True)
    if not sizes:
        return at_scan
    for row in np.flatnonzero((scans.sizes % POINT_BYTES != 0) | (scans.sizes == 0)):
        name = shown(scans.path(int(scans.numbers[row])), root)
        findings.error(DriveFileError(name, scan_size_complaint(int(scans.sizes[row]))))
    scan_sizes, label_sizes = scans.sizes[at_scan], labels.sizes[at_label]
    sound = (scan_sizes % POINT_BYTES == 0) & (scan_sizes > 0)
    fits = label_sizes * (POINT_BYTES // LABEL_BYTES) == scan_sizes
    for row in np.flatnonzero(sound & ~fits):
        scan, label = (shown(files.path(int(common[row])), root) for files in (scans, labels))
        count, left = divmod(int(label_sizes[row]), LABEL_BYTES)
        if left:
            message = f"{label_sizes[row]:,} bytes, which is no multiple of 4. Expected one uint32 a point."
        else:
            message = label_count_complaint(count, int(scan_sizes[row]) // POINT_BYTES, scan)
        findings.error(DriveFileError(label, message))
    usable: IntArray = at_scan[sound & fits]
    return usable
