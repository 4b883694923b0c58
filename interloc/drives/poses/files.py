"""Pose files: KITTI's lines of 12 or 16 numbers, with or without the frame number in front, and TUM's with a time."""

from array import array
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.files import MAX_NUMBER, SourceFile, in_seconds, is_number
from interloc.drives.findings import Findings
from interloc.drives.layouts import INDEXED_LENGTHS
from interloc.drives.poses.motion import TimedPoses, body_motion, rotations_from_quaternions
from interloc.geometry import rigid_transforms
from interloc.wording import counted

SEPARATED_BY_COMMAS = "numbers are separated by commas; spaces were expected. Usual cause: a CSV export."
CUT_OFF = "a file cut off while it was written or copied, or a line edited by hand"
"""The usual cause of a line that holds another count of numbers than the others."""

_LENGTHS = (12, 13, 16, 17)
_ORTHONORMAL = 1e-3
_MAX_FRAME = 10**15

TUM_FIELDS = 8
"""Numbers of a line: time x y z qx qy qz qw."""

_MORE_FIELDS = 9
"""One more: sec nsec ... (Newer College), num t ... (MCD), or an id at the end (RTAB-Map)."""

_OFF_UNIT = 1e-2
_EPOCH_S = 1e8
_SHUFFLED = 0.2
"""More of the lines run backwards in time in a file that is not sorted; few where recordings follow each other."""

_SLIDES, _STEADY, _UPRIGHT = 10.0, 1e-3, 0.9
_HEAD_BYTES = 65536


@dataclass(frozen=True)
class PoseLines:
    """The poses of a file."""

    poses: FloatArray
    """(P, 4, 4) float64: rigid transforms from the frame of the file (camera, LiDAR or IMU) into its world, metres."""
    frames: IntArray | None
    """(P,) int64 or None: frame number of each, ascending, where the lines carry it; else line i belongs to frame i."""


def read_poses(file: SourceFile) -> PoseLines:
    """Read and check pose lines."""
    if not file.path.exists():
        raise file.fault(
            "is missing. Expected one line of 12 numbers per scan: the pose of the camera (KITTI) or of the LiDAR "
            "(kiss-icp and others). For KITTI odometry it comes with the labels of SemanticKITTI."
        )
    values, lines = read_rows(file, _LENGTHS, _length_complaint)
    frames = None
    if values.shape[1] in INDEXED_LENGTHS:
        frames, values = _split_frames(values, lines, file), values[:, 1:]
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :] = values[:, :12].reshape(-1, 3, 4)
    if values.shape[1] == 16 and (wrong := np.abs(values[:, 12:] - (0, 0, 0, 1)).max(axis=1) > _ORTHONORMAL).any():
        raise file.fault(
            "the last four of 16 numbers are not 0 0 0 1. Expected a 4x4 matrix, row by row. "
            "Usual cause: a matrix written column by column; transpose each.",
            lines[int(np.argmax(wrong))],
        )
    refuse_far(poses[:, :3, 3], lines, file)
    proper, bad_row = orthonormalised(poses)
    if bad_row is not None:
        raise file.fault(rotation_complaint(poses[bad_row, :3, :3]), lines[bad_row])
    if frames is not None:
        order = np.argsort(frames, kind="stable")
        return PoseLines(proper[order], frames[order])
    return PoseLines(proper, None)


def refuse_far(positions: FloatArray, lines: IntArray, file: SourceFile) -> None:
    """Raise DriveError where one of (P, 3) positions is absurdly far from the origin."""
    large = np.abs(positions).max(axis=1) > MAX_NUMBER
    if large.any():
        raise file.fault(
            f"a position is more than {MAX_NUMBER / 1000:,.0f} km from the origin. Expected metres. "
            "Usual cause: millimetres, or an odometry that diverged.",
            lines[int(np.argmax(large))],
        )


def orthonormalised(poses: FloatArray) -> tuple[FloatArray, int | None]:
    """Bring nearly proper rotations of (P, 4, 4) poses to SO(3).

    Returns also the first row whose rotation is further than 1e-3 from orthonormal, or mirrors; or None.
    """
    rotation = poses[:, :3, :3]
    gram = np.einsum("nji,njk->nik", rotation, rotation)
    wrong = (np.abs(gram - np.eye(3)).max(axis=(1, 2)) > _ORTHONORMAL) | (np.linalg.det(rotation) < 0)
    if wrong.any():
        return poses, int(np.argmax(wrong))
    u, _, vt = np.linalg.svd(rotation)
    proper = poses.copy()
    proper[:, :3, :3] = u @ vt
    return proper, None


def rotation_complaint(rotation: FloatArray) -> str:
    """Return what is wrong with the 3x3 part of a pose."""
    off = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if off <= _ORTHONORMAL:
        return (
            "its 3x3 part mirrors (determinant -1); a rotation was expected. "
            "Usual cause: an axis flipped by hand between two conventions."
        )
    return (
        f"its 3x3 part is not a rotation (off by {off:.2g}, allowed 0.001). "
        "Expected r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz. "
        "Usual cause: another order of the numbers, or quaternions (TUM format) instead of matrices."
    )


def read_rows(
    file: SourceFile,
    lengths: Collection[int],
    complain: Callable[[list[str], int], str],
    *,
    plain: Callable[[list[str]], list[str]] = list,
) -> tuple[FloatArray, IntArray]:
    """Read the lines of numbers of a file of poses; blank lines and comments (#) are passed over.

    All lines hold as many numbers as the first, one of `lengths`; `complain` says what is wrong with the fields of a
    line, given them and the length of the lines before (0: there are none); `plain` brings lines to numbers separated
    by spaces. Returns (P, L) float64 and the (P,) numbers of the lines, from 1.
    """
    texts = plain(file.lines())
    if (table := _plain_table(texts, lengths)) is not None:
        return table, np.arange(1, len(table) + 1)
    values, lines = array("d"), array("q")  # a tenth of the memory of lists
    length = 0
    for line, text in enumerate(texts, start=1):
        fields = text.split()
        if not fields or fields[0].startswith("#"):
            continue
        if len(fields) not in lengths or (length and len(fields) != length):
            raise file.fault(complain(fields, length), line)
        length = len(fields)
        values.extend(file.numbers(fields, line))
        lines.append(line)
    if not lines:
        raise file.fault("holds comments only. Expected one line of numbers per pose.")
    return np.frombuffer(values).reshape(-1, length), np.frombuffer(lines, dtype=np.int64)


def _plain_table(texts: list[str], lengths: Collection[int]) -> FloatArray | None:
    """Read lines of nothing but poses, five times as fast; None where a line is something else or wrong."""
    try:
        table = np.loadtxt(texts, comments=None, ndmin=2)
    except ValueError:
        return None
    is_plain = len(table) == len(texts) and table.shape[1] in lengths and np.isfinite(table).all()
    return table if is_plain else None


def _length_complaint(fields: list[str], length: int) -> str:
    if any("," in field for field in fields):
        return SEPARATED_BY_COMMAS
    if fields[0].startswith(("VERTEX", "EDGE", "FIX")):
        return (
            "a pose graph of g2o. Expected poses only: write each VERTEX_SE3:QUAT as time x y z qx qy qz qw (TUM), "
            "without the edges."
        )
    expected = (
        f"{length} as in the lines above" if length else "12 (3x4 matrix), 16 (4x4), 13 or 17 (frame number first)"
    )
    usual = CUT_OFF
    if len(fields) == 8:
        usual = "TUM format (time, position, quaternion); export the poses in KITTI format"
    elif len(fields) == 7 and not length:
        usual = (
            "positions and quaternions without times, such as x y z qw qx qy qz of HBA's pose.json; write time x y z "
            "qx qy qz qw (TUM), or matrices"
        )
    elif len(fields) == 4 and not length:
        usual = "4x4 matrices written over four lines; write one matrix per line"
    elif len(fields) == 3 and not length:
        usual = (
            "a .log of Open3D, three numbers and a 4x4 matrix over four lines; write one matrix per line, or positions "
            "without orientation"
        )
    return f"{counted(len(fields), 'number')}; expected {expected}. Usual cause: {usual}."


def _split_frames(values: FloatArray, lines: IntArray, file: SourceFile) -> IntArray:
    first = values[:, 0]
    wrong = (first != np.floor(first)) | (first < 0) | (first > _MAX_FRAME)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise file.fault(
            f"{values.shape[1]} numbers start with a frame number, but {first[row]:g} is not a whole number. "
            "Usual cause: times instead of frame numbers.",
            lines[row],
        )
    frames = first.astype(np.int64)
    unique, counts = np.unique(frames, return_counts=True)
    if (counts > 1).any():
        raise file.fault(f"frame {unique[np.argmax(counts > 1)]} has two poses. Expected one per frame.")
    return frames


def looks_like_tum(path: Path) -> bool:
    """Return whether a file, by its first line that is neither blank nor a comment, holds poses of TUM."""
    try:
        with path.open("rb") as file:
            return is_tum(file.read(_HEAD_BYTES))
    except OSError:
        return False


def is_tum(head: bytes) -> bool:
    """Return the same of the first bytes of a file."""
    for line in _plain(head.decode("utf-8-sig", errors="replace").splitlines()):
        fields = line.split()
        if fields and not fields[0].startswith("#"):
            if len(fields) not in {TUM_FIELDS, _MORE_FIELDS} or not all(map(is_number, fields)):
                return False
            values = np.array([fields], dtype=np.float64)
            return len(fields) == TUM_FIELDS or bool(_are_units(values[:, 5:]) or _are_units(values[:, 4:8]))
    return False


def _plain(lines: list[str]) -> list[str]:
    """Write lines with spaces instead of commas, and a first line of column names as a comment."""
    lines = [line.replace(",", " ") for line in lines]
    first = next((row for row, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    if first is not None and not any(map(is_number, lines[first].split())):
        lines[first] = f"# {lines[first]}"
    return lines


def read_tum(file: SourceFile, findings: Findings | None = None) -> TimedPoses:
    """Read and check the lines ``time x y z qx qy qz qw`` of a file; lines that start with # are comments.

    A number or an id beside them is left out; quaternions w x y z are read as such where the motion shows that they
    are, of which findings get a warning.
    """
    if not file.path.exists():
        raise file.fault("is missing. Expected one line per pose: time x y z qx qy qz qw (TUM).")
    values, lines = read_rows(file, (TUM_FIELDS, _MORE_FIELDS), _tum_complaint, plain=_plain)
    if values.shape[1] == _MORE_FIELDS:
        values = _of_eight(values)
    values = np.column_stack([in_seconds(values[:, 0]), values[:, 1:]])
    values, lines = _without_repetitions(values, lines, file)
    refuse_far(values[:, 1:4], lines, file)
    norm = np.linalg.norm(values[:, 4:], axis=1)
    wrong = np.abs(norm - 1) > _OFF_UNIT
    if wrong.any():
        row = int(np.argmax(wrong))
        raise file.fault(
            f"the quaternion is {norm[row]:.4g} long; expected 1. Expected time x y z qx qy qz qw. "
            "Usual cause: another order of the columns, or angles instead of a quaternion.",
            lines[row],
        )
    poses = rigid_transforms(rotations_from_quaternions(values[:, 4:]), values[:, 1:4])
    w_first = rigid_transforms(rotations_from_quaternions(values[:, [5, 6, 7, 4]]), values[:, 1:4])
    if findings is not None and _is_better(w_first, poses):
        findings.warning(
            file.name,
            "the quaternions are in the order w x y z, and are read so: in the order of TUM (x y z w) the vehicle "
            "would not look where it drives.",
        )
        poses = w_first
    return TimedPoses(values[:, 0].copy(), poses, file.name)


def _are_units(quaternions: FloatArray) -> bool:
    return bool((np.abs(np.linalg.norm(quaternions, axis=1) - 1) < _OFF_UNIT).all())


def _of_eight(values: FloatArray) -> FloatArray:
    """Bring (P, 9) values to time x y z and quaternion."""
    if _are_units(values[:, 4:8]) and not _are_units(values[:, 5:]):
        return values[:, :8]  # an id at the end
    first, second = values[:, 0], values[:, 1]
    is_counted = first[0] < _EPOCH_S and bool((np.diff(first) > 0).all() and (np.diff(second) > 0).all())
    time_s = second if is_counted else first + second * 1e-9
    return np.column_stack([time_s, values[:, 2:]])


def _is_better(other: FloatArray, poses: FloatArray) -> bool:
    """Return whether by others of (P, 4, 4) poses the vehicle drives where it looks, and by these it does not."""
    motion, others = body_motion(poses), body_motion(other)
    if motion is None or others is None:
        return False
    if 1 - motion.steadiness > _SLIDES * (1 - others.steadiness) + _STEADY:
        return True
    upright, other_upright = (float(np.median(each[:, 2, 2])) for each in (poses, other))
    is_straight = min(motion.steadiness, others.steadiness) > 1 - _SLIDES * _STEADY
    return is_straight and upright < -_UPRIGHT and other_upright > _UPRIGHT  # 1 0 0 0 is meant for no turn


def _without_repetitions(values: FloatArray, lines: IntArray, file: SourceFile) -> tuple[FloatArray, IntArray]:
    """Leave out lines that repeat the one before; refuse times that do not ascend."""
    repeated = (np.diff(values, axis=0) == 0).all(axis=1)
    kept = np.concatenate([[True], ~repeated])
    values, lines = values[kept], lines[kept]
    steps = np.diff(values[:, 0])
    if np.count_nonzero(steps < 0) > max(1, _SHUFFLED * len(steps)):
        order = np.argsort(values[:, 0], kind="stable")
        values, lines, steps = values[order], lines[order], np.diff(values[order, 0])
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        before, after = values[row - 1, 0], values[row, 0]
        what = "has the time of the line before, but another pose" if before == after else "runs backwards in time"
        raise file.fault(
            f"{what} ({before:.6f} s, then {after:.6f} s). Expected ascending times, in seconds. "
            "Usual cause: two recordings in one file, or times written with too few digits.",
            lines[row],
        )
    return values, lines


def _tum_complaint(fields: list[str], length: int) -> str:
    """Return what is wrong with the count of numbers in a line (all lines before are of the one length)."""
    usual = CUT_OFF
    if len(fields) in {12, 13, 16, 17} and not length:
        usual = "poses as matrices (KITTI), which are read under their own format"
    return f"{len(fields)} numbers; expected {TUM_FIELDS}: time x y z qx qy qz qw (TUM). Usual cause: {usual}."
