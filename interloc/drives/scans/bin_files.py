"""Scans in .bin files: float32 x y z remission (KITTI), or with the ring as the fifth value (nuScenes)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array
from interloc.drives.files import EMPTY, MAX_NAMED, NumberedFiles, SourceFile, in_part, list_numbered, others_like_it
from interloc.drives.findings import Findings
from interloc.drives.layouts import DriveParts
from interloc.drives.options import LABEL_FILES, DriveOptions
from interloc.drives.scans.bin_values import layout_of
from interloc.drives.scans.recorded import Recording, ScanPoints
from interloc.drives.trajectory import posed_frames
from interloc.errors import InterLocError

POINT_BYTES = 16
"""float32 x y z remission."""

RING_POINT_BYTES = 20
"""float32 x y z intensity ring."""

_LABEL_BYTES, _BARE_POINT_BYTES = 4, 12
"""float32 x y z: a scan without remission, which is refused."""

_BARE = (
    "all {count:,} scans have 12 bytes per point: x y z without remission. Expected four float32 per point (x y z "
    "remission); write 0 as the remission where there is none."
)


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
    point_bytes, fault = _layout_of(scans, parts)
    if fault and options.check:
        findings.error(scans.folder.fault(fault))
        return Recording(parts, None, None)
    posed = np.isin(scans.numbers, posed_frames(parts, scans.numbers, findings))
    scans = replace(scans, numbers=scans.numbers[posed], sizes=scans.sizes[posed])
    usable = np.arange(len(scans.numbers), dtype=np.int64)
    if options.check:
        wrong = ((scans.sizes % point_bytes != 0) | (scans.sizes == 0)) & in_part(options.frames, scans.numbers)
        for kind in (wrong & (scans.sizes == 0), wrong & (scans.sizes > 0)):
            rows = np.flatnonzero(kind)
            for row in rows[: 1 if len(rows) > MAX_NAMED else None]:
                complaint = _size_complaint(int(scans.sizes[row]), point_bytes)
                complaint += others_like_it(scans.numbers[kind], len(scans.numbers))
                findings.error(scans.file(int(scans.numbers[row])).fault(complaint))
        usable = usable[~wrong]
    if point_bytes != POINT_BYTES:
        others = f"and {point_bytes // 4 - 4} more values, which are not used"
        more = "ring (nuScenes)" if point_bytes == RING_POINT_BYTES else others
        findings.note(scans.folder.name, f"{point_bytes} bytes per point: read as x y z intensity {more}.")
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


def _layout_of(scans: NumberedFiles, parts: DriveParts) -> tuple[int, str]:
    """Return the bytes per point, and what is wrong with how the values stand."""
    labels = np.full(len(scans.numbers), np.nan)
    for folder in map(parts.label_folder, LABEL_FILES):
        with suppress(InterLocError):  # their reader says why
            if folder.is_dir():
                files = list_numbered(parts.file(folder), ".label")
                _, at_scan, at_label = np.intersect1d(scans.numbers, files.numbers, return_indices=True)
                labels[at_scan] = files.sizes[at_label] / _LABEL_BYTES
                break
    values = np.empty(0, np.float32)
    with suppress(OSError):
        values = np.fromfile(scans.path(int(scans.numbers[len(scans.numbers) // 2])), "<f4")
    count, fault = layout_of(values, scans.sizes, labels)
    sizes = scans.sizes
    has_bare = not (sizes % _BARE_POINT_BYTES).any() and sizes.all() and len(sizes) > 1
    if has_bare and (count == 3 or (count == 4 and (sizes % POINT_BYTES).any())):
        return POINT_BYTES, _BARE.format(count=len(sizes))
    return (POINT_BYTES if count == 3 else 4 * count), fault


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
