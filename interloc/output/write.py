"""Write the tables of a run as GeoJSON files: the result folder (`interloc.output.layout` lists what is in it)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.errors import OutputError
from interloc.files import atomic_write, reason_of
from interloc.geometry import bearing_deg
from interloc.output.geojson import METRE_DECIMALS, bearings, encode, point, positions, rounded, write_collection
from interloc.output.layout import FORMAT, FORMAT_VERSION, RUN_FILE, RUN_KEYS, file_names
from interloc.output.read import read_results
from interloc.results import DriveResult

__all__ = ["read_results", "thin", "trajectory_feature", "write_results"]

TRAJECTORY_STEP_M = 0.5


def write_results(result: DriveResult, folder: Path) -> None:
    """Write the files of a run into a folder.

    Parameters
    ----------
    result
        The run.
    folder
        Is created where it is missing. Files of an older run in it are replaced one by one; write into an
        `interloc.files.atomic_folder` for all or nothing.

    Raises
    ------
    OutputError
        A file could not be written.

    Notes
    -----
    `run.json` goes first and comes last: a folder that has it is complete. The trajectory is thinned to one point
    every 0.5 m; first and last scan stay.
    """
    names = file_names(georeferenced=result.is_georeferenced)
    local = not result.is_georeferenced
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for stale in (RUN_FILE, *file_names(georeferenced=local).values()):
            (folder / stale).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder} could not be written: {reason_of(error)}.") from error
    write_collection(folder / names["detections"], _detection_features(result), local=local)
    write_collection(folder / names["keyframes"], _keyframe_features(result), local=local)
    track = trajectory_feature(result.trajectory_world_xy, result.trajectory_lonlat)
    write_collection(folder / names["trajectory"], [track], local=local)
    write_collection(folder / names["intersections"], _intersection_features(result), local=local)
    own = (FORMAT, FORMAT_VERSION, result.drive, result.is_georeferenced, [*names.values(), RUN_FILE])
    run = dict(zip(RUN_KEYS, own, strict=True)) | {k: v for k, v in result.run.items() if k not in RUN_KEYS}
    with atomic_write(folder / RUN_FILE) as handle:
        handle.write(encode(_plain(run), indent=2).encode() + b"\n")


def _coordinates(world_xy: FloatArray, lonlat: FloatArray | None) -> list[list[float]]:
    return positions(world_xy, local=True) if lonlat is None else positions(lonlat, local=False)


def _detection_features(result: DriveResult) -> list[dict[str, Any]]:
    table = result.detections
    features = []
    for row, position in enumerate(_coordinates(table.world_xy, table.lonlat)):
        fused = int(table.intersection[row])
        features.append(
            point(
                position,
                {
                    "frame": int(result.keyframes.frame[table.keyframe[row]]),
                    "x_m": rounded(table.lidar_xy[row, 0], METRE_DECIMALS),
                    "y_m": rounded(table.lidar_xy[row, 1], METRE_DECIMALS),
                    "world_x_m": rounded(table.world_xy[row, 0], METRE_DECIMALS),
                    "world_y_m": rounded(table.world_xy[row, 1], METRE_DECIMALS),
                    "branch_count": len(table.bearings_deg[row]),
                    "branch_bearings_deg": bearings(table.bearings_deg[row]),
                    "score": rounded(table.score[row], 6),
                    "intersection": int(result.intersections.id[fused]) if fused >= 0 else None,
                },
            )
        )
    return features


def _keyframe_features(result: DriveResult) -> list[dict[str, Any]]:
    table = result.keyframes
    heading = bearing_deg(table.world_yaw_rad if table.enu_yaw_rad is None else table.enu_yaw_rad)
    detections = np.bincount(result.detections.keyframe, minlength=len(table))
    return [
        point(
            position,
            {
                "frame": int(table.frame[row]),
                "time_s": rounded(table.time_s[row], 6),
                "heading_deg": rounded(heading[row], 6),
                "detections": int(detections[row]),
                "world_x_m": rounded(table.world_xy[row, 0], METRE_DECIMALS),
                "world_y_m": rounded(table.world_xy[row, 1], METRE_DECIMALS),
                "world_yaw_rad": rounded(table.world_yaw_rad[row], 9),
            },
        )
        for row, position in enumerate(_coordinates(table.world_xy, table.lonlat))
    ]


def _intersection_features(result: DriveResult) -> list[dict[str, Any]]:
    table = result.intersections
    return [
        point(
            position,
            {
                "id": int(table.id[row]),
                "observations": int(table.observations[row]),
                "position_std_m": rounded(table.position_std_m[row], METRE_DECIMALS),
                "branch_count": len(table.bearings_deg[row]),
                "branch_bearings_deg": bearings(table.bearings_deg[row]),
                "first_frame": int(table.first_frame[row]),
                "last_frame": int(table.last_frame[row]),
                "confidence": rounded(table.confidence[row], 6),
                "world_x_m": rounded(table.world_xy[row, 0], METRE_DECIMALS),
                "world_y_m": rounded(table.world_xy[row, 1], METRE_DECIMALS),
            },
        )
        for row, position in enumerate(_coordinates(table.world_xy, table.lonlat))
    ]


def thin(xy: FloatArray, step_m: float) -> IntArray:
    """Return the rows of (N, 2) positions that lie at least `step_m` from the one kept before; first and last stay."""
    kept: list[int] = []
    x, y = xy[:, 0].tolist(), xy[:, 1].tolist()
    for row in range(len(xy)):
        if not kept or (x[row] - x[kept[-1]]) ** 2 + (y[row] - y[kept[-1]]) ** 2 >= step_m**2:
            kept.append(row)
    if kept and kept[-1] != len(xy) - 1:
        kept.append(len(xy) - 1)
    return np.array(kept, dtype=np.int64)


def trajectory_feature(trajectory_world_xy: FloatArray, trajectory_lonlat: FloatArray | None) -> dict[str, Any]:
    """Return the LineString of a track over all N scans, thinned; one of a single scan repeats it (RFC 7946, 3.1.4).

    Parameters
    ----------
    trajectory_world_xy : (N, 2) float64
        In W, metres.
    trajectory_lonlat : (N, 2) float64 or None
        Longitude, latitude in degrees; None: the line is in metres of W.
    """
    rows = thin(trajectory_world_xy, TRAJECTORY_STEP_M)
    world_xy = trajectory_world_xy[rows]
    line = _coordinates(world_xy, None if trajectory_lonlat is None else trajectory_lonlat[rows])
    line = line * 2 if len(line) == 1 else line
    return {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": line} if line else None,
        "properties": {"scans": len(trajectory_world_xy), "thinned_to_m": TRAJECTORY_STEP_M},
        "world_xy_m": positions(world_xy, local=True),
    }


def _plain(value: Any) -> Any:  # noqa: ANN401, PLR0911
    """Turn what a caller may put into `run` into what JSON can say."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, set | frozenset):
        return [_plain(v) for v in sorted(value, key=str)]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if hasattr(value, "model_dump"):  # a pydantic model
        return _plain(value.model_dump(mode="json"))
    return str(value)
