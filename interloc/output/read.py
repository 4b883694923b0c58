"""Read a result folder back into the tables of its run."""

import os
from pathlib import Path
from typing import cast

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.errors import OutputError
from interloc.geometry import wrap_angle
from interloc.output.geojson import damaged, read_as, read_json
from interloc.output.layers import LAYERS, Rows
from interloc.output.layout import FORMAT, FORMAT_VERSION, ROAD_FILE, RUN_FILE, RUN_KEYS, TABLES, file_names
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable, PositionParts, RunRecord


def read_results(folder: str | os.PathLike[str]) -> DriveResult:
    """Read what `write_results` wrote, to the printed precision: 1 cm on the earth, 0.1 mm in W.

    The trajectory is the thinned one.

    Parameters
    ----------
    folder
        The result folder.

    Raises
    ------
    OutputError
        The folder is not a result, is damaged, or was written by a newer version.
    """
    folder = Path(folder)
    run = read_run(folder)
    georeferenced = run["georeferenced"]
    names = file_names(georeferenced=georeferenced)
    rows = {table: LAYERS[table].read(folder / names[table]) for table in TABLES}
    road_file = folder.resolve() / ROAD_FILE
    keyframes = _read_keyframes(rows["keyframes"], georeferenced=georeferenced)
    intersections = _read_intersections(rows["intersections"], georeferenced=georeferenced)
    detections = _read_detections(rows["detections"], keyframes, intersections, georeferenced=georeferenced)
    world_xy, lonlat = _read_trajectory(rows["trajectory"], georeferenced=georeferenced)
    return DriveResult(
        drive=run["drive_name"],
        keyframes=keyframes,
        detections=detections,
        intersections=intersections,
        trajectory_world_xy=world_xy,
        trajectory_lonlat=lonlat,
        run=cast("RunRecord", {name: value for name, value in run.items() if name not in RUN_KEYS}),
        road_file=road_file if road_file.is_file() or ROAD_FILE in run.get("files", ()) else None,
    )


def read_run(folder: Path) -> RunRecord:
    """Read the `run.json` of a result folder; an OutputError says why the folder is none, or that it is too new."""
    if not folder.is_dir():
        raise OutputError(f"{folder} is not a folder. Give the folder that `interloc run -o` wrote.")
    if not (folder / RUN_FILE).exists():
        raise OutputError(
            f"{folder} is not an InterLoc result: it has no {RUN_FILE}. Give the folder of `interloc run`."
        )
    head = read_json(folder / RUN_FILE)
    version = head.get("format_version")
    if head.get("format") != FORMAT or not isinstance(version, int):
        raise OutputError(f"{folder / RUN_FILE} is not from InterLoc. Give the folder that `interloc run -o` wrote.")
    if version > FORMAT_VERSION:
        raise OutputError(
            f"{folder} was written by a newer InterLoc (format {version}; this one reads up to {FORMAT_VERSION}). "
            "Update InterLoc, or run `interloc run` again with this version."
        )
    run = read_as(RunRecord, folder / RUN_FILE)
    if "georeferenced" not in run or "drive_name" not in run:
        raise damaged(folder / RUN_FILE, "georeferenced or drive_name is missing")
    return run


def _read_keyframes(rows: Rows, *, georeferenced: bool) -> KeyframeTable:
    frame = rows.integers("frame")
    if np.any(np.diff(frame) <= 0):
        raise damaged(rows.path, "its frames do not ascend")
    enu_yaw = wrap_angle(np.radians(90.0 - rows.numbers("heading_deg")))
    return KeyframeTable(
        frame=frame,
        time_s=rows.numbers("time_s"),
        world_xy=rows.numbers("world_x_m", "world_y_m"),
        world_yaw_rad=rows.numbers("world_yaw_rad"),
        lonlat=rows.points() if georeferenced else None,
        enu_yaw_rad=enu_yaw if georeferenced else None,
    )


def _read_intersections(rows: Rows, *, georeferenced: bool) -> IntersectionTable:
    shape = _read_covariances(rows, "shape_cov_m2")
    fix_std_m, scatter_std_m = rows.numbers("fix_std_m"), rows.numbers("scatter_std_m")
    return IntersectionTable(
        id=rows.integers("id"),
        world_xy=rows.numbers("world_x_m", "world_y_m"),
        lonlat=rows.points() if georeferenced else None,
        position_std_m=rows.numbers("position_std_m"),
        observations=rows.integers("observations"),
        confidence=rows.numbers("confidence"),
        bearings_deg=rows.arrays("branch_bearings_deg"),
        widths_m=_read_widths(rows),
        first_frame=rows.integers("first_frame"),
        last_frame=rows.integers("last_frame"),
        position_cov_m2=_read_covariances(rows, "position_cov_m2"),
        parts=None if shape is None else PositionParts(fix_std_m, shape, scatter_std_m),
    )


def _read_covariances(rows: Rows, name: str) -> FloatArray | None:
    """Return covariances, (M, 3); None where the result is of a version before them."""
    written = rows.column(name)
    if any(each is None for each in written):
        return None
    if any(len(each) != 3 for each in written):
        raise damaged(rows.path, f"a {name} does not have three numbers")
    return np.array(written, dtype=np.float64).reshape(-1, 3)


def _read_detections(
    rows: Rows, keyframes: KeyframeTable, intersections: IntersectionTable, *, georeferenced: bool
) -> DetectionTable:
    return DetectionTable(
        keyframe=_rows_of(rows, "frame", keyframes.frame),
        lidar_xy=rows.numbers("x_m", "y_m"),
        world_xy=rows.numbers("world_x_m", "world_y_m"),
        lonlat=rows.points() if georeferenced else None,
        bearings_deg=rows.arrays("branch_bearings_deg"),
        widths_m=_read_widths(rows),
        score=rows.numbers("score"),
        # 1 m where an older version did not write them; none is too small to divide by.
        position_std_m=np.fmax(np.nan_to_num(rows.numbers("position_std_m"), nan=1.0), 0.01),
        intersection=_rows_of(rows, "intersection", intersections.id),
    )


def _read_widths(rows: Rows) -> list[FloatArray]:
    """Return the widths of the branches; NaN where an older version did not write them."""
    counts = [len(bearings) for bearings in rows.column("branch_bearings_deg")]
    widths = rows.arrays("branch_widths_m")
    return [each if len(each) == count else np.full(count, np.nan) for each, count in zip(widths, counts, strict=True)]


def _rows_of(rows: Rows, name: str, keys: IntArray) -> IntArray:
    """Return the rows that a property refers to by their unique keys, -1 for null."""
    row_of = {int(key): row for row, key in enumerate(keys)} | {None: -1}
    values = rows.column(name)
    unknown = [value for value in values if value not in row_of]
    if unknown:
        raise damaged(rows.path, f"{name} {unknown[0]} is not in the other files of the result")
    return np.array([row_of[value] for value in values], dtype=np.int64)


def _read_trajectory(rows: Rows, *, georeferenced: bool) -> tuple[FloatArray, FloatArray | None]:
    if len(rows.features) != 1:
        raise damaged(rows.path, f"it has {len(rows.features)} features instead of one line")
    (feature,) = rows.features
    world_xy = np.array(feature.world_xy_m, dtype=np.float64).reshape(-1, 2)
    places = [] if feature.geometry is None else feature.geometry.coordinates
    line = np.array(places, dtype=np.float64).reshape(-1, 2)[: len(world_xy)]
    if len(line) != len(world_xy):
        raise damaged(rows.path, "its line and its world_xy_m have different lengths")
    return world_xy, line if georeferenced else None
