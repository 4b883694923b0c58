"""What was found in a range of keyframes, kept in a file: a restart goes on from there, with identical results.

The file is an ``.npz`` of plain arrays (no pickle); the detections of all keyframes stand one after the other.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from interloc.detection.detector import KeyframeDetections
from interloc.detection.keyframes import Keyframe
from interloc.files import atomic_write
from interloc.pipeline import RangeResult, versions
from interloc.results import RoadPatch

Array = NDArray[Any]


def write_checkpoint(path: Path, part: RangeResult) -> None:
    """Write what was found in a range, whole or not at all.

    Raises
    ------
    OutputError
        No space left, and the like.
    """
    found = part.detections
    angles = [a for k in found for a in k.branch_angles_rad]
    arrays: dict[str, Array] = {
        "made_by": np.array(_made_by()),
        "start": np.array(part.start),
        "peak_memory_bytes": np.array(part.peak_memory_bytes),
        "stages": np.array(list(part.seconds), dtype=np.str_),
        "seconds": np.array(list(part.seconds.values()), dtype=np.float64),
        "frame": np.array([k.keyframe.frame for k in found], dtype=np.int64),
        "T_world_lidar": np.array([k.keyframe.T_world_lidar for k in found], dtype=np.float64).reshape(-1, 4, 4),
        "time_s": np.array([np.nan if k.keyframe.time_s is None else k.keyframe.time_s for k in found]),
        "is_doubtful": np.array([k.keyframe.is_doubtful for k in found], dtype=np.bool_),
        "detections": np.array([len(k.score) for k in found], dtype=np.int64),
        "lidar_xy": _joined([k.lidar_xy for k in found], (0, 2)),
        "world_xy": _joined([k.world_xy for k in found], (0, 2)),
        "score": _joined([k.score for k in found], (0,)),
        "branches": np.array([len(a) for a in angles], dtype=np.int64),
        "branch_angles_rad": _joined(angles, (0,)),
        "branch_widths_m": _joined([w for k in found for w in k.branch_widths_m], (0,)),
        "road_keyframe": np.array([p.keyframe for p in part.road], dtype=np.int64),
        "road_corner_xy": np.array([p.corner_xy for p in part.road], dtype=np.float64).reshape(-1, 2),
        "road_resolution_m": np.array([p.resolution_m for p in part.road], dtype=np.float64),
        "road_size": np.array([p.size for p in part.road], dtype=np.int64),
        "road_bytes": np.array([len(p.packed) for p in part.road], dtype=np.int64),
        "road_packed": np.frombuffer(b"".join(p.packed for p in part.road), np.uint8),
        "road_other_bytes": np.array([len(p.packed_other) for p in part.road], dtype=np.int64),
        "road_other": np.frombuffer(b"".join(p.packed_other for p in part.road), np.uint8),
    }
    with atomic_write(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_checkpoint(path: Path) -> RangeResult | None:
    """Read what `write_checkpoint` wrote; None if there is nothing, or nothing that this version can use."""
    try:
        with path.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    if (
        str(arrays.get("made_by")) != _made_by()
        or not {"is_doubtful", "branch_widths_m", "road_other"} <= arrays.keys()
    ):
        return None
    angles = _cut(arrays["branch_angles_rad"], arrays["branches"])
    angles_of = _grouped(angles, arrays["detections"])
    widths_of = _grouped(_cut(arrays["branch_widths_m"], arrays["branches"]), arrays["detections"])
    lidar_xy, world_xy, score = (_cut(arrays[n], arrays["detections"]) for n in ("lidar_xy", "world_xy", "score"))
    times = [None if np.isnan(time) else float(time) for time in arrays["time_s"]]
    detections = [
        KeyframeDetections(
            Keyframe(int(frame), arrays["T_world_lidar"][row], times[row], bool(arrays["is_doubtful"][row])),
            lidar_xy[row],
            world_xy[row],
            angles_of[row],
            score[row],
            widths_of[row],
        )
        for row, frame in enumerate(arrays["frame"])
    ]
    seconds = dict(zip(arrays["stages"].tolist(), arrays["seconds"].tolist(), strict=True))
    packed = _cut(arrays["road_packed"], arrays["road_bytes"])
    other = _cut(arrays["road_other"], arrays["road_other_bytes"])
    columns = (arrays[f"road_{name}"] for name in ("keyframe", "corner_xy", "resolution_m", "size"))
    patches = tuple(
        RoadPatch(int(keyframe), corner_xy, float(resolution_m), int(size), road.tobytes(), ground.tobytes())
        for keyframe, corner_xy, resolution_m, size, road, ground in zip(*columns, packed, other, strict=True)
    )
    return RangeResult(int(arrays["start"]), detections, seconds, int(arrays["peak_memory_bytes"]), patches)


def _made_by() -> str:
    """Return the versions that the numbers depend on, so that an updated service does not mix two versions."""
    return " ".join(f"{name} {version}" for name, version in versions().items())


def _joined(arrays: Sequence[Array], empty: tuple[int, ...]) -> Array:
    return np.concatenate([np.zeros(empty), *arrays])


def _cut(array: Array, counts: Array) -> list[Array]:
    return np.split(array, np.cumsum(counts)[:-1]) if len(counts) else []


def _grouped(items: list[Array], counts: Array) -> list[list[Array]]:
    ends = np.cumsum(counts).tolist()
    return [items[end - count : end] for end, count in zip(ends, counts.tolist(), strict=True)]
