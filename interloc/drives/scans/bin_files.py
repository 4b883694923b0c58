"""Scans in .bin files: float32 x y z remission (KITTI), or with the ring as the fifth value (nuScenes)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array
from interloc.drives.files import EMPTY, MAX_NAMED, NumberedFiles, SourceFile, in_part, list_numbered, others_like_it
from interloc.drives.findings import Findings
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.recorded import Recording, ScanPoints
from interloc.drives.trajectory import posed_frames

POINT_BYTES = 16
"""float32 x y z remission."""

RING_POINT_BYTES = 20
"""float32 x y z intensity ring."""

_MAX_RINGS = 512
_BARE_POINT_BYTES = 12
"""float32 x y z: a scan without remission, which is refused."""


@dataclass(frozen=True)
class BinScans:
    """The .bin files of a drive; a `PointSource`."""

    scan_files: NumberedFiles
    point_bytes: int = POINT_BYTES
    """Bytes per point: 16, or 20 where the ring is the fifth value."""

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return self.scan_files.file(frame).name

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the file of a scan."""
        return (self.scan_files.path(frame),)

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan."""
        return ScanPoints(read_points(self.scan_files.file(frame), self.point_bytes))


def open_bin_files(parts: DriveParts, options: DriveOptions, findings: Findings) -> Recording:
    """List the .bin files of a drive, and check their sizes."""
    scans = None
    with findings.stage():
        scans = list_numbered(parts.file(parts.scans), ".bin")
    if scans is None:
        return Recording(parts, None, None)
    point_bytes = _bytes_per_point(scans)
    posed = np.isin(scans.numbers, posed_frames(parts, scans.numbers, findings))
    scans = replace(scans, numbers=scans.numbers[posed], sizes=scans.sizes[posed])
    usable = np.arange(len(scans.numbers), dtype=np.int64)
    if options.check:
        wrong = ((scans.sizes % point_bytes != 0) | (scans.sizes == 0)) & in_part(options.frames, scans.numbers)
        if wrong.any() and len(wrong) > 1 and (scans.sizes % _BARE_POINT_BYTES == 0).all() and scans.sizes.all():
            findings.error(
                scans.folder.fault(
                    f"all {len(wrong):,} scans have 12 bytes per point: x y z without remission. Expected four float32 "
                    "per point (x y z remission); write 0 as the remission where there is none."
                )
            )
        else:
            for kind in (wrong & (scans.sizes == 0), wrong & (scans.sizes > 0)):
                rows = np.flatnonzero(kind)
                for row in rows[: 1 if len(rows) > MAX_NAMED else None]:
                    complaint = _size_complaint(int(scans.sizes[row]), point_bytes)
                    complaint += others_like_it(scans.numbers[kind], len(scans.numbers))
                    findings.error(scans.file(int(scans.numbers[row])).fault(complaint))
        usable = usable[~wrong]
    if point_bytes == RING_POINT_BYTES:
        findings.note(scans.folder.name, "20 bytes per point: read as x y z intensity ring (nuScenes).")
    return Recording(
        parts,
        BinScans(scans, point_bytes),
        scans.numbers,
        scan_bytes=int(scans.sizes.sum()),
        usable=usable,
        point_counts=scans.sizes // point_bytes,
        carries_poses=parts.in_kitti360_world,
    )


def read_points(file: SourceFile, point_bytes: int = POINT_BYTES) -> Float32Array:
    """Read the (N, 4) float32 points of a file: x y z in L, metres, and remission."""
    try:
        size = file.path.stat().st_size
        values = np.fromfile(file.path, dtype="<f4")
    except OSError as error:
        raise file.unreadable(error) from error
    if size % point_bytes or not size:
        raise file.fault(_size_complaint(size, point_bytes))
    points: Float32Array = values.reshape(-1, point_bytes // 4)
    return points if points.shape[1] == 4 else np.ascontiguousarray(points[:, :4])


def _bytes_per_point(scans: NumberedFiles) -> int:
    """Return 20 where all sizes are multiples of that, and not all of 16 as well, or the fifth value is a ring."""
    fits_ring = scans.sizes.all() and not (scans.sizes % RING_POINT_BYTES).any()
    if not fits_ring:
        return POINT_BYTES
    if (scans.sizes % POINT_BYTES).any() or _has_rings(scans.path(int(scans.numbers[0]))):
        return RING_POINT_BYTES
    return POINT_BYTES


def _has_rings(path: Path) -> bool:
    """Return whether every fifth value of a scan is the number of a laser: a whole number, and not always the same."""
    try:
        ring = np.fromfile(path, dtype="<f4")[4::5]
    except OSError:  # its reader says why
        return False
    with np.errstate(invalid="ignore"):
        whole = (ring == np.rint(ring)) & (ring >= 0) & (ring < _MAX_RINGS)
    return bool(len(ring) and whole.all() and ring.min() < ring.max())


def _size_complaint(size: int, point_bytes: int) -> str:
    if size == 0:
        return EMPTY
    expected = "four float32 per point (x y z remission)"
    if point_bytes == RING_POINT_BYTES:
        expected = "five float32 per point (x y z intensity ring), as in the other scans"
    return (
        f"{size:,} bytes, which is no multiple of {point_bytes}. Expected {expected}. "
        "Usual cause: a file cut short while it was copied, or points with another number of values."
    )
