"""Drives that have one file per scan: .bin or .pcd, as their layout says."""

from __future__ import annotations

from pathlib import Path

from interloc.drives.findings import Findings
from interloc.drives.layouts import find_layout
from interloc.drives.options import DriveOptions
from interloc.drives.scans.bin_files import open_bin_files
from interloc.drives.scans.pcd import open_pcd_files
from interloc.drives.scans.recorded import Recording


def open_scan_files(root: Path, options: DriveOptions, findings: Findings) -> Recording:
    """Find the layout of a folder, and list its scans.

    Raises
    ------
    DriveError
        The folder is not a drive; or it is damaged, and `findings` stops at that.
    """
    parts = find_layout(root, options)
    if parts.layout == "pcd":
        return open_pcd_files(parts, options, findings)
    return open_bin_files(parts, findings, check=options.check)
