"""Read a result folder back into the tables of its run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.errors import OutputError
from interloc.geometry import wrap_angle
from interloc.output.geojson import RUN_AGAIN, Collection, read_collection, read_json
from interloc.output.layout import FORMAT, FORMAT_VERSION, RUN_FILE, RUN_KEYS, file_names
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable


def read_results(folder: Path) -> DriveResult:
    """Read what `write_results` wrote, to the printed precision (0.1 mm; the trajectory is the thinned one).

    Raises
    ------
    OutputError
        The folder is no result, is damaged, or was written by a newer version; the message says what to do.
    """
    run = _read_run(folder)
    georeferenced = run["georeferenced"]
    names = file_names(georeferenced=georeferenced)
    keyframes = _read_keyframes(read_collection(folder / names["keyframes"]), georeferenced=georeferenced)
    intersections = _read_intersections(read_collection(folder / names["intersections"]), georeferenced=georeferenced)
    detections = _read_detections(
        read_collection(folder / names["detections"]), keyframes, intersections, georeferenced=georeferenced
    )
    world_xy, lonlat = _read_trajectory(read_collection(folder / names["trajectory"]), georeferenced=georeferenced)
    return DriveResult(
        drive=str(run["drive_name"]),
        keyframes=keyframes,
        detections=detections,
        intersections=intersections,
        trajectory_world_xy=world_xy,
        trajectory_lonlat=lonlat,
        run={k: v for k, v in run.items() if k not in RUN_KEYS},
    )


def _read_run(folder: Path) -> dict[str, Any]:
    """Read `run.json`, and refuse what is not ours or not for us."""
    if not folder.is_dir():
        raise OutputError(f"{folder} is no folder. Give the folder that `interloc detect -o` wrote.")
    if not (folder / RUN_FILE).exists():
        raise OutputError(
            f"{folder} is no InterLoc result: it has no {RUN_FILE}. Give the folder of `interloc detect`."
        )
    run = read_json(folder / RUN_FILE)
    version = run.get("format_version")
    if run.get("format") != FORMAT or not isinstance(version, int):
        raise OutputError(f"{folder / RUN_FILE} is not from InterLoc. Give the folder that `interloc detect -o` wrote.")
    if version > FORMAT_VERSION:
        raise OutputError(
            f"{folder} was written by a newer InterLoc (format {version}; this one reads up to {FORMAT_VERSION}). "
            "Update InterLoc, or run `interloc detect` again with this version."
        )
    if not isinstance(run.get("georeferenced"), bool) or "drive_name" not in run:
        raise OutputError(f"{folder / RUN_FILE} is damaged: georeferenced or drive_name is missing. {RUN_AGAIN}")
    return run


def _world(collection: Collection) -> FloatArray:
    return np.stack([collection.numbers("world_x_m"), collection.numbers("world_y_m")], axis=-1)


def _read_keyframes(collection: Collection, *, georeferenced: bool) -> KeyframeTable:
    frame = collection.integers("frame")
    if np.any(np.diff(frame) <= 0):
        raise collection.damaged("its frames do not ascend")
    enu_yaw = wrap_angle(np.radians(90.0 - collection.numbers("heading_deg")))
    return KeyframeTable(
        frame=frame,
        time_s=collection.numbers("time_s"),
        world_xy=_world(collection),
        world_yaw_rad=collection.numbers("world_yaw_rad"),
        lonlat=_lonlat(collection, georeferenced=georeferenced),
        enu_yaw_rad=enu_yaw if georeferenced else None,
    )


def _read_intersections(collection: Collection, *, georeferenced: bool) -> IntersectionTable:
    return IntersectionTable(
        id=collection.integers("id"),
        world_xy=_world(collection),
        lonlat=_lonlat(collection, georeferenced=georeferenced),
        position_std_m=collection.numbers("position_std_m"),
        observations=collection.integers("observations"),
        confidence=collection.numbers("confidence"),
        bearings_deg=collection.lists("branch_bearings_deg"),
        first_frame=collection.integers("first_frame"),
        last_frame=collection.integers("last_frame"),
    )


def _read_detections(
    collection: Collection, keyframes: KeyframeTable, intersections: IntersectionTable, *, georeferenced: bool
) -> DetectionTable:
    return DetectionTable(
        keyframe=_rows_of(collection, "frame", keyframes.frame),
        lidar_xy=np.stack([collection.numbers("x_m"), collection.numbers("y_m")], axis=-1),
        world_xy=_world(collection),
        lonlat=_lonlat(collection, georeferenced=georeferenced),
        bearings_deg=collection.lists("branch_bearings_deg"),
        score=collection.numbers("score"),
        intersection=_rows_of(collection, "intersection", intersections.id, none=True),
    )


def _rows_of(collection: Collection, name: str, keys: IntArray, *, none: bool = False) -> IntArray:
    """Return the rows that a property refers to by their unique keys, -1 for null where that is allowed."""
    row_of = {int(key): row for row, key in enumerate(keys)} | ({-1: -1} if none else {})
    values = collection.integers(name).tolist()
    unknown = [v for v in values if v not in row_of]
    if unknown:
        raise collection.damaged(f"{name} {unknown[0]} is not in the other files of the result")
    return np.array([row_of[v] for v in values], dtype=np.int64)


def _lonlat(collection: Collection, *, georeferenced: bool) -> FloatArray | None:
    xy = collection.points()
    if len(xy) != len(collection):
        raise collection.damaged("a feature has no position")
    return xy if georeferenced else None


def _read_trajectory(collection: Collection, *, georeferenced: bool) -> tuple[FloatArray, FloatArray | None]:
    if len(collection) != 1:
        raise collection.damaged(f"it has {len(collection)} features instead of one line")
    world_xy = collection.pairs(collection.features[0].get("world_xy_m"), "world_xy_m")
    line = collection.pairs(collection.geometry(0, "LineString") or [], "the coordinates")[: len(world_xy)]
    if len(line) != len(world_xy):
        raise collection.damaged("its line and its world_xy_m have different lengths")
    return world_xy, line if georeferenced else None
