"""Scans in PCD files: ascii, binary or binary_compressed, with any fields; also nuScenes' .pcd.bin.

The reader of pypcd4 trusts the header (a file that is cut short is read as fewer points), and refuses files of before
version 0.7, without COUNT, or with tabs.
"""

import io
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import lzf
import numpy as np
from numpy.typing import NDArray

from interloc.arrays import FloatArray, IntArray, UInt8Array
from interloc.drives.files import EMPTY, MAX_NUMBER, SINCE_1970_MS, SourceFile, in_seconds, is_number
from interloc.drives.findings import Findings
from interloc.drives.georeference.read import read_georeference
from interloc.drives.layouts import PCD_ENDINGS, DriveParts, pcd_ending
from interloc.drives.options import DriveOptions
from interloc.drives.poses.motion import rotations_from_quaternions
from interloc.drives.scans.bin_files import RING_POINT_BYTES, read_points
from interloc.drives.scans.deskewed import TIME_FIELDS, point_times
from interloc.drives.scans.recording import (
    CARLA_FIELD,
    CARLA_WORDS,
    LABEL_FIELDS,
    REMISSION_FIELDS,
    Recording,
    ScanPoints,
)
from interloc.drives.scans.reduced_format import MAX_POINTS
from interloc.drives.trajectory import LidarPoses, Trajectory
from interloc.errors import InterLocError
from interloc.geometry import from_first, invert_transform, rigid_transforms

_NO_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_MOVED_M, _FAR_M = 1.0, 20.0
_MAX_HEADER_BYTES = 65_536
_MAX_POINT_BYTES = 4096
_MAX_ASCII_BYTES_PER_POINT = 1024
_MAX_RATIO = 100  # of LZF, which makes at most 264 bytes of 3
_MAX_FILES = 1_000_000
_TYPES = {("F", 4), ("F", 8), *((kind, size) for kind in "IU" for size in (1, 2, 4, 8))}
_DIGITS = re.compile(r"\d+")
_SPLIT_TIME = re.compile(r"(?<!\d)(\d{9,10})[^\d.](\d{3,9})$")
_TOO_LARGE = 10**18  # for a scan number, as in `list_numbered`


@dataclass(frozen=True)
class PcdScans:
    """The .pcd files of a drive; a `PointSource`."""

    folder: SourceFile
    names: tuple[str, ...]
    """Of the files, in the order of the scans."""
    frames: IntArray
    """(N,) int64: their scan numbers, ascending."""
    times_s: FloatArray | None = None
    """(N,): the times in their names, from which times of points may count."""
    T_world_lidar: FloatArray | None = None
    """(N, 4, 4): by which points that lie in the world are brought back to the sensor."""

    def file(self, frame: int) -> SourceFile:
        """Return the file of a scan."""
        return replace(self.folder, path=self.folder.path / self.names[int(np.searchsorted(self.frames, frame))])

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return self.file(frame).name

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the file of a scan."""
        return (self.file(frame).path,)

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan; those without a return stay in their place, with label 0."""
        file = self.file(frame)
        if file.path.name.endswith(PCD_ENDINGS[1]):
            return ScanPoints(read_points(file, RING_POINT_BYTES))
        row = int(np.searchsorted(self.frames, frame))
        stamp_s = None if self.times_s is None else float(self.times_s[row])
        T_lidar_world = None if self.T_world_lidar is None else invert_transform(self.T_world_lidar[row])
        return read_pcd(file, stamp_s, T_lidar_world)


@dataclass(frozen=True)
class PcdHeader:
    """What a PCD file says of itself."""

    dtype: np.dtype[Any]
    """Of one point."""
    points: int
    encoding: str
    """{"ascii", "binary", "binary_compressed"}."""
    data_at: int
    """Where the points begin, in bytes."""
    viewpoint: tuple[float, ...] = _NO_VIEWPOINT
    """x y z, quaternion w x y z: where the points were measured."""

    def field_among(self, names: Sequence[str]) -> str | None:
        """Return the first field with one of these names, in capitals or not."""
        fields = {field.lower(): field for field in self.dtype.names or ()}
        return next((fields[name] for name in names if name in fields), None)


def open_pcd_files(parts: DriveParts, options: DriveOptions, findings: Findings) -> Recording:
    """List the .pcd files of a drive."""
    folder = parts.file(parts.scans)
    names, sizes = _listed(folder)
    order, frames, times_s, how = number_scans(names)
    scans = PcdScans(folder, tuple(names[row] for row in order), frames, times_s)
    if how:
        findings.note(folder.name, how)
    header = None
    first = replace(folder, path=folder.path / scans.names[0])
    has_header = not first.path.name.endswith(PCD_ENDINGS[1])
    with findings.stage():
        if has_header:
            header, _ = read_pcd_header(first)
    is_damaged = has_header and header is None
    label = None if header is None else header.field_among(LABEL_FIELDS)
    if header is not None and label is not None:
        findings.note(folder.name, f"the field {label!r} of the points is their label.")
    if header is not None and header.field_among((CARLA_FIELD,)) is not None and label is None:
        findings.warning(folder.name, CARLA_WORDS)
    T_world_lidar = None if header is None else _viewpoints(scans, findings)
    if T_world_lidar is not None and _lie_in_world(scans, T_world_lidar):
        scans = replace(scans, T_world_lidar=T_world_lidar)
        findings.note(folder.name, "the points lie in the world, and are brought back to the sensor by VIEWPOINT.")
    has_own = parts.has_poses or options.poses is not None
    if T_world_lidar is not None:
        use = "they are not used: there is a file of poses" if has_own else "they are read as those of the LiDAR"
        findings.note(folder.name, f"VIEWPOINT changes from file to file, and so holds poses; {use}.")

    def read_poses(chosen: IntArray, options: DriveOptions, findings: Findings) -> Trajectory:
        assert T_world_lidar is not None
        rows = np.searchsorted(frames, chosen)
        poses = LidarPoses(from_first(T_world_lidar[rows]), "lidar", "VIEWPOINT of the PCD files")
        georeference, reason = None, "the drive has neither oxts/ nor geo.csv"
        with findings.stage():
            georeference = read_georeference(parts, chosen, options.oxts, findings)
        times = None if times_s is None else times_s[rows]
        return Trajectory(poses, len(frames), times, georeference, "" if georeference else reason)

    return Recording(
        parts,
        scans,
        frames,
        scan_bytes=int(sizes.sum()),
        usable=np.flatnonzero(sizes[order] > 0) if options.check else None,
        carries_labels=label is not None or is_damaged,  # which is reported; that labels lack would be a guess
        has_remission=header is None or header.field_among(REMISSION_FIELDS) is not None,
        has_times=header is not None and header.field_among(TIME_FIELDS) is not None,
        carries_poses=T_world_lidar is not None,
        times_s=times_s,
        read_trajectory=None if T_world_lidar is None or has_own else read_poses,
    )


def _viewpoints(scans: PcdScans, findings: Findings) -> FloatArray | None:
    """Return the (N, 4, 4) poses that the headers hold; None where these are all alike, and a note if that is odd."""
    frames = scans.frames.tolist()
    looked = [frames[row] for row in sorted({0, len(frames) // 2, len(frames) - 1})]
    for each in (looked, frames):
        found = []
        with suppress(InterLocError):  # which is said where they are read
            found = [read_pcd_header(scans.file(frame))[0].viewpoint for frame in each]
        if len(found) < len(each) or set(found) == {_NO_VIEWPOINT}:
            return None
        numbers = np.array(found)
        if np.ptp(numbers[:, :3], axis=0).max() < _MOVED_M:
            listed = " ".join(f"{number:g}" for number in found[0])
            findings.note(
                scans.folder.name,
                f"VIEWPOINT is {listed} in all files (x y z, quaternion w x y z), and is not applied: points and poses "
                "are taken as those of the LiDAR. Where it is the mounting, and the poses are those of the vehicle, "
                "apply it to the points first, or give poses of the LiDAR.",
            )
            return None
    quaternions = numbers[:, [4, 5, 6, 3]] / np.linalg.norm(numbers[:, 3:], axis=1, keepdims=True)
    return rigid_transforms(rotations_from_quaternions(quaternions), numbers[:, :3])


def _lie_in_world(scans: PcdScans, T_world_lidar: FloatArray) -> bool:
    """Return whether the points lie around the pose of their scan, not around the origin."""
    places = T_world_lidar[:, :3, 3]
    far = np.argsort(-np.linalg.norm(places, axis=1), kind="stable")[:3]
    far = far[np.linalg.norm(places[far], axis=1) > _FAR_M]
    closer = []
    with suppress(InterLocError):
        for row in far:
            xyz = scans.read(int(scans.frames[row])).values[:, :3]
            here, there = np.linalg.norm(xyz, axis=1), np.linalg.norm(xyz - places[row], axis=1)
            closer.append(float(np.nanmedian(there)) < 0.5 * float(np.nanmedian(here)))
    return bool(closer) and all(closer)


def number_scans(names: Sequence[str]) -> tuple[IntArray, IntArray, FloatArray | None, str]:
    """Give numbers to the files of scans by their names.

    000010.pcd and street_0000000010.pcd are scan 10, 1305031102.175304.pcd and cloud_1583836591_182590976.pcd are
    times. Returns the (N,) positions of the names in the order of the scans, the (N,) scan numbers in this order, the
    (N,) times in seconds where the names are times, and what was assumed, where that is worth saying.
    """
    stems = [name[: -len(pcd_ending(name))] for name in names]
    anew = np.arange(len(names))
    if (split := _split_times(stems)) is not None:
        order = np.argsort(split, kind="stable")
        return order, anew, split[order], "the names are times in seconds and their fractions."
    ends = [re.search(r"(\d+)(\.\d+)?$", stem) for stem in stems]
    if not all(ends):
        order = np.argsort(np.array(names), kind="stable")
        return order, anew, None, "the names hold no numbers: the scans are taken in alphabetical order."
    keys = [
        ([int(group) for group in _DIGITS.findall(stem[: end.start()])], int(end[1]), float(end[2] or 0), name)
        for name, stem, end in zip(names, stems, ends, strict=True)
        if end
    ]
    order = np.array(sorted(range(len(names)), key=keys.__getitem__))
    before, numbers, fractions, _ = zip(*(keys[row] for row in order), strict=True)
    are_seconds = any(end[2] for end in ends if end)
    if any(groups != before[0] for groups in before):
        how = "the names hold several numbers that change: the scans are taken in the order of all of them."
    # Not a date in digits (20210315123420).
    elif are_seconds or (numbers[0] >= SINCE_1970_MS and 3e8 < in_seconds(np.array(numbers[:1], float))[0] < 4e9):
        times = in_seconds(np.array(numbers, np.float64) + np.array(fractions))
        return order, anew, times, "the names are times; the scans are numbered from 0 in their order."
    elif len(set(numbers)) < len(names):
        how = "the numbers in the names come twice: scans in the order of their names."
    elif numbers[-1] >= _TOO_LARGE:
        how = "the numbers in the names are too large: the scans are numbered from 0."
    else:
        return order, np.array(numbers, dtype=np.int64), None, ""
    return order, anew, None, how


def _split_times(stems: Sequence[str]) -> FloatArray | None:
    """Return the times of names that end in seconds since 1970 and their fraction (1583836591_182590976); else None."""
    ends = [_SPLIT_TIME.search(stem) for stem in stems]
    if not ends or not all(ends):
        return None
    digits = {len(end[2]) for end in ends if end}
    unit = 10.0 ** -digits.pop() if len(digits) == 1 else 1e-9
    return np.array([int(end[1]) + int(end[2]) * unit for end in ends if end])


def read_pcd(file: SourceFile, stamp_s: float | None = None, T_lidar_world: FloatArray | None = None) -> ScanPoints:
    """Read the points of a PCD file, and bring them back from the world; nothing in it is trusted."""
    header, data = read_pcd_header(file, with_data=True)
    points = _points_of(header, data, file)
    values = np.zeros((header.points, 4), np.float32 if T_lidar_world is None else np.float64)
    columns = [header.field_among((axis,)) for axis in "xyz"]
    for column, field in enumerate([*columns, header.field_among(REMISSION_FIELDS)]):
        if field is not None:
            values[:, column] = _column(points, field)
    if T_lidar_world is not None:
        values[:, :3] = values[:, :3] @ T_lidar_world[:3, :3].T + T_lidar_world[:3, 3]
    labels = None
    if (field := header.field_among(LABEL_FIELDS)) is not None:
        label_values = _column(points, field)
        with np.errstate(invalid="ignore"):
            labels = (
                np.where(np.isfinite(values[:, :3]).all(axis=1), label_values, 0).astype(np.int64).astype(np.uint32)
            )
    times_s = None
    if (field := header.field_among(TIME_FIELDS)) is not None:
        times_s = point_times(_column(points, field), stamp_s)
    return ScanPoints(values.astype(np.float32, copy=False), labels, times_s)


def read_pcd_header(file: SourceFile, *, with_data: bool = False) -> tuple[PcdHeader, UInt8Array]:
    """Read the header of a PCD file, and the bytes behind it where they are wanted."""
    try:
        with file.path.open("rb") as handle:
            head = handle.read(_MAX_HEADER_BYTES)
            size = os.fstat(handle.fileno()).st_size
            header = _parse_header(head, file)
            _check_size(header, size, file)
            handle.seek(header.data_at)
            data = np.frombuffer(handle.read() if with_data else b"", np.uint8)
    except OSError as error:
        raise file.unreadable(error) from error
    return header, data


def _listed(folder: SourceFile) -> tuple[list[str], IntArray]:
    names, sizes = [], []
    try:
        with os.scandir(folder.path) as entries:
            for entry in entries:
                if pcd_ending(entry.name) and not entry.name.startswith(".") and entry.is_file():
                    names.append(entry.name)
                    sizes.append(entry.stat().st_size)
    except OSError as error:
        raise folder.unreadable(error) from error
    if not 0 < len(names) <= _MAX_FILES:
        raise folder.fault(f"holds {len(names):,} .pcd files; expected one per scan.")
    return names, np.array(sizes, dtype=np.int64)


def _parse_header(head: bytes, file: SourceFile) -> PcdHeader:
    if not head:
        raise file.fault(EMPTY)
    entries: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in entries:
        end = head.find(b"\n", at)
        if end < 0:
            raise file.fault(
                "is not a PCD file: there is no line DATA in its first 64 kB. Expected the text header of the Point "
                "Cloud Library. Usual cause: another kind of file under this name."
            )
        words = head[at:end].decode("ascii", "replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
    try:
        return _header_of(entries, at, file)
    except (KeyError, IndexError, ValueError) as error:
        raise file.fault(
            f"has a damaged PCD header ({error}). Expected FIELDS, SIZE, TYPE, COUNT, WIDTH, HEIGHT and DATA."
        ) from None


def _header_of(entries: dict[str, list[str]], data_at: int, file: SourceFile) -> PcdHeader:
    """Make the header of its entries; ValueError or KeyError where they make no sense."""
    fields = entries.get("FIELDS") or entries["COLUMNS"]
    sizes, kinds = [int(text) for text in entries["SIZE"]], [text.upper() for text in entries["TYPE"]]
    counts = [int(text) for text in entries.get("COUNT", ["1"] * len(fields))]
    if not len(fields) == len(sizes) == len(kinds) == len(counts):
        raise ValueError(f"{len(fields)} fields, {len(sizes)} sizes, {len(kinds)} types, {len(counts)} counts")
    layout: list[tuple[str, Any, int]] = []
    for index, (field, size, kind, count) in enumerate(zip(fields, sizes, kinds, counts, strict=True)):
        if (kind, size) not in _TYPES or not 0 < count <= _MAX_POINT_BYTES:
            raise ValueError(f"field {field[:40]}: type {kind[:8]}, {size} bytes, {count} values")
        is_again = field == "_" or field in {name for name, *_ in layout}
        layout.append((f"{field} {index}" if is_again else field, f"<{kind.lower()}{size}", count))
    dtype = np.dtype([(name, kind, (count,)) if count > 1 else (name, kind) for name, kind, count in layout])
    if dtype.itemsize > _MAX_POINT_BYTES:
        raise ValueError(f"{dtype.itemsize:,} bytes per point")
    if "POINTS" in entries:
        points = int(entries["POINTS"][0])
    else:
        points = int(entries["WIDTH"][0]) * int(entries.get("HEIGHT", ["1"])[0])
    encoding = entries["DATA"][0].lower() if entries["DATA"] else ""
    if encoding not in {"ascii", "binary", "binary_compressed"}:
        raise ValueError(f"DATA {encoding[:40]!r}")
    seen = tuple(float(text) for text in entries.get("VIEWPOINT", [])[:7] if is_number(text))
    is_pose = len(seen) == len(_NO_VIEWPOINT) and np.abs(seen).max() < MAX_NUMBER and any(seen[3:])
    header = PcdHeader(dtype, points, encoding, data_at, seen if is_pose else _NO_VIEWPOINT)
    missing = [axis for axis in "xyz" if header.field_among((axis,)) is None]
    if missing:
        raise file.fault(
            f"has no field {', '.join(missing)}: its fields are {', '.join(fields)[:200]}. Expected x, y and z in "
            "metres. Usual cause: a cloud of features, or fields under other names."
        )
    if not 0 < points <= MAX_POINTS:
        raise file.fault(
            f"promises {points:,} points; expected 1 to {MAX_POINTS:,}. Usual cause: the map of a whole drive instead "
            "of one file per scan, or a scan without a return, which is to be left out."
        )
    return header


def _check_size(header: PcdHeader, size: int, file: SourceFile) -> None:
    """Refuse a file that cannot hold what its header promises, before anything is read."""
    there, promised = size - header.data_at, header.points * header.dtype.itemsize
    if header.encoding == "binary" and there < promised:
        raise file.fault(
            f"is cut short: {header.points:,} points of {header.dtype.itemsize} bytes are {promised:,} bytes, and "
            f"{there:,} are there. Usual cause: a copy or download that did not finish."
        )
    if header.encoding == "ascii" and there > header.points * _MAX_ASCII_BYTES_PER_POINT:
        raise file.fault(f"holds {there:,} bytes of text for {header.points:,} points, which no such file does.")


def _points_of(header: PcdHeader, data: UInt8Array, file: SourceFile) -> NDArray[Any]:
    if header.encoding == "binary":
        return data[: header.points * header.dtype.itemsize].view(header.dtype)
    if header.encoding == "ascii":
        return _from_text(header, data.tobytes(), file)
    return _from_compressed(header, data, file)


def _from_text(header: PcdHeader, text: bytes, file: SourceFile) -> NDArray[Any]:
    """Read points written as text, one per line."""
    columns = sum(int(np.prod(header.dtype[name].shape)) or 1 for name in _names(header))
    try:
        table = np.loadtxt(io.StringIO(text.decode("ascii")), ndmin=2, comments="#")
    except ValueError as error:
        raise file.fault(f"its points cannot be read: {error}. Expected {columns} numbers per line.") from None
    if table.shape != (header.points, columns):
        raise file.fault(
            f"{table.shape[0]:,} lines of {table.shape[1]} numbers; the header promises {header.points:,} points of "
            f"{columns}. Usual cause: a copy or download that did not finish."
        )
    points = np.zeros(header.points, header.dtype)
    at = 0
    for name in _names(header):
        count = int(np.prod(header.dtype[name].shape)) or 1
        piece = table[:, at : at + count]
        with np.errstate(invalid="ignore"):
            points[name] = piece if header.dtype[name].shape else piece[:, 0]
        at += count
    return points


def _from_compressed(header: PcdHeader, data: UInt8Array, file: SourceFile) -> NDArray[Any]:
    """Unpack points: all values of the first field, then those of the next."""
    promised = header.points * header.dtype.itemsize
    if len(data) < 8:
        raise file.fault("is cut short: its packed points are missing. Usual cause: a copy that did not finish.")
    packed, size = (int(number) for number in data[:8].view("<u4"))
    if size != promised or packed > len(data) - 8 or size > _MAX_RATIO * packed:
        raise file.fault(
            f"is damaged: its points would unpack from {packed:,} to {size:,} bytes; {len(data) - 8:,} bytes "
            f"are there, and {header.points:,} points take {promised:,}. Usual cause: a copy that did not finish."
        )
    try:
        unpacked = lzf.decompress(data[8 : 8 + packed].tobytes(), size)  # None where there would be more than promised
    except ValueError:
        unpacked = None
    if unpacked is None or len(unpacked) != size:
        raise file.fault("is damaged: its packed points cannot be unpacked to what the header promises.")
    raw = np.frombuffer(unpacked, np.uint8)
    points = np.empty(header.points, header.dtype)
    at = 0
    for name in _names(header):
        kind = header.dtype[name]
        length = header.points * kind.itemsize
        points[name] = raw[at : at + length].view(kind.base).reshape(header.points, *kind.shape)
        at += length
    return points


def _names(header: PcdHeader) -> tuple[str, ...]:
    return header.dtype.names or ()


def _column(points: NDArray[Any], field: str) -> NDArray[Any]:
    """Return one value per point of a field; the first where it has several."""
    values = points[field]
    return values if values.ndim == 1 else values[:, 0]
