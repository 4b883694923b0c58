"""Scans in .bin files: float32 x y z remission (KITTI), and what follows: the ring (nuScenes), times, and others.

How their values stand is told by the labels that go with them, by the values themselves, and by sizes.
A column of a scan holds values of one kind, where a wrong number of values per point mixes them in every column. So the
right one is that whose columns are the least mixed (entropy, over bins that all values fill alike); that needs neither
an order of the points nor a kind of sensor.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray
from interloc.drives.files import (
    EMPTY,
    LFS_POINTER,
    MAX_NAMED,
    POINTER,
    NumberedFiles,
    SourceFile,
    in_part,
    list_numbered,
    others_like_it,
)
from interloc.drives.findings import Findings
from interloc.drives.layouts import DriveParts
from interloc.drives.options import LABEL_FILES, DriveOptions
from interloc.drives.scans.recording import Recording, ScanPoints
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

_COUNTS = (4, 3, 5, 6, 7, 8, 9, 10)  # values per point that are tried, the usual one first
_ROWS = (3, 4, 5, 6)
_BINS, _MIN_VALUES, _MAX_VALUES = 64, 2000, 2_000_000
_BLOCK, _BLOCKS = 2520, 40  # values that hold whole points of each number above; so many blocks all over a scan tell
_CLEAR, _TWICE_CLEAR = 0.2, 0.5  # nats; of 8 values, two points of 4 by turns differ a little, too
_FAR, _TINY, _MANY = 1e8, 1e-6, 0.05  # share of values that no coordinate in metres has
_ROW_BY_ROW = (
    "its values stand row by row (all x, then all y, z, ...), as Oxford RobotCar keeps them. Expected four float32 per "
    "point, one point after the other: np.fromfile(FILE, np.float32).reshape(4, -1).T.tofile(FILE) for every scan, "
    "with the number of values per point in place of 4."
)
_NO_FLOATS = (
    "its values are not float32: {share:.0%} of them are no metres. Expected four float32 per point (x y z remission). "
    "Usual cause: {cause}; write every scan anew as float32."
)
_NCLT = "eight bytes per point, as NCLT has them (uint16 x y z in steps of 5 mm from -100 m, uint8 intensity and laser)"


@dataclass(frozen=True)
class BinScans:
    """The .bin files of a drive; a `PointSource`."""

    scan_files: NumberedFiles
    point_bytes: int = POINT_BYTES
    """Bytes per point: four for each value, of which the first four are used."""

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
    scans = list_numbered(parts.file(parts.scans), ".bin")
    point_bytes, fault = _layout_of(scans, parts)
    if fault and options.check:
        raise scans.folder.fault(fault)
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
    octets = file.octets()
    if len(octets) % point_bytes or not len(octets):
        raise file.fault(_size_complaint(len(octets), point_bytes))
    points: Float32Array = octets.view("<f4").reshape(-1, point_bytes // 4)
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
    if values[:8].tobytes().startswith(LFS_POINTER):
        return POINT_BYTES, f"each scan is {POINTER}"
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


def layout_of(values: Float32Array, sizes: IntArray, label_counts: FloatArray) -> tuple[int, str]:
    """Return how many values a point has, and why they cannot be read so, in words that follow the name of a file.

    Told by the (V,) values of one scan, the (N,) bytes of all and the (L,) numbers of their labels, NaN for none.
    """
    if (share := _share_of_no_metres(values)) > _MANY:
        others = {"float64": values[: len(values) // 2 * 2].view("<f8"), "big-endian float32": values.view(">f4")}
        cause = next((kind for kind, each in others.items() if _share_of_no_metres(each) < _MANY / 2), "integers")
        if not (sizes % 8).any():
            middle = np.median(values.view("<u2").reshape(-1, 4)[:, :3], axis=0)
            cause = _NCLT if (np.abs(middle - 20_000) < 10_000).all() else cause
        return 4, _NO_FLOATS.format(share=share, cause=cause)
    values = values[:_MAX_VALUES]
    if (every := len(values) // _BLOCK // _BLOCKS) > 1:
        values = values[: len(values) // _BLOCK * _BLOCK].reshape(-1, _BLOCK)[::every].ravel()
    if len(values) >= _MIN_VALUES and np.isfinite(values).all():
        edges = np.quantile(values[::7], np.linspace(0, 1, _BINS + 1)[1:-1])
        bins = np.searchsorted(np.unique(edges), values)
        whole = {count: bins[: len(bins) // count * count] for count in _COUNTS}
        mixed = {count: _mixture(each.reshape(-1, count).T) for count, each in whole.items()}
        rows = [_mixture(whole[count].reshape(count, -1)) for count in _ROWS]
        fewest = next(count for count in _COUNTS if mixed[count] <= min(mixed.values()) + _CLEAR / 2)
        if min(rows) < mixed[fewest] - _CLEAR:
            return 4, _ROW_BY_ROW
        if mixed[fewest] < mixed[4] - (_TWICE_CLEAR if fewest == 8 else _CLEAR):
            return fewest, ""
        if mixed[4] < max(mixed.values()) - _CLEAR:
            return 4, ""
    known = np.isfinite(label_counts) & (label_counts > 0)
    ratios = np.unique(sizes[known] / (4 * label_counts[known]))
    if len(ratios) == 1 and float(ratios[0]) in {4, 5, 6}:  # 8 may be labels of two bytes each
        return int(ratios[0]), ""
    fits_five = bool(sizes.all()) and not (sizes % 20).any() and bool((sizes % 16).any())
    return (5 if fits_five else 4), ""


def _mixture(columns: IntArray) -> float:
    """Return the mean entropy of the bins in some columns, in nats."""
    total = 0.0
    for column in columns:
        share = np.bincount(column) / len(column)
        share = share[share > 0]
        total -= float((share * np.log(share)).sum())
    return total / len(columns)


def _share_of_no_metres(values: Float32Array | FloatArray) -> float:
    size = np.abs(values[np.isfinite(values)])
    return float(((size > _FAR) | ((size > 0) & (size < _TINY))).mean()) if len(size) else 0.0
