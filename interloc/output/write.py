"""Write the tables of a run as GeoJSON files: the result folder (`interloc.output.layout` lists what is in it)."""

import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from pydantic_core import to_jsonable_python

from interloc.arrays import FloatArray
from interloc.errors import Beside, OutputError, expect
from interloc.files import reason_of
from interloc.geometry import bearing_deg, thin
from interloc.output import layout
from interloc.output.geojson import Feature, bearings, line_of, positions, write_collection, write_record
from interloc.output.layers import LAYERS, Column
from interloc.output.properties import origin_of
from interloc.output.road import mosaic_of, write_road
from interloc.output.roads import road_features, roads
from interloc.results import DetectionTable, DriveResult, IntersectionTable, PositionParts, Verdicts
from interloc.roadmap.network import RoadNetwork

# Names of places that stay the same from run to run.
#
# An intersection is numbered by the order of sight, so its `id` means nothing in another run. Its `uid` names the
# place:
#
# - `n123`: the place of OpenStreetMap node 123. After an evaluation, for every intersection that is assigned to a node
#   of the policy within 10 m, else to a junction of roads, service roads included. It stays however far the position
#   moves as long as it stays nearest to the same node, and for as long as the map keeps the node.
# - `49.01110,8.42040`: the centre (latitude, longitude) of the cell of a grid of `CELL_DEG`, about 22 m. Without a map,
#   and where the map has nothing. `49.01110,8.42040-2` is the second intersection of one cell, from west to east.
# - `x40y-20`: the centre of a cell of `CELL_M` in metres of W, for a drive without georeference; it holds for runs over
#   this drive only.
#
# A grid has edges: a position that moves by a metre leaves its cell of 22 m in about 6 of 100 cases. Two runs are best
# joined after an evaluation, by nodes. Policy `consolidated` names a merged junction by its smallest node.

CELL_DEG = 0.0002
"""Height of a cell, degrees of latitude: 22 m. Its width is the same in metres."""

CELL_M = 20.0
"""Side of a cell in W, metres."""


def place_uids(intersections: IntersectionTable) -> list[str]:
    """Return the names of the places of intersections by their position alone, all different.

    The position counts as it is printed, so that a result that is read back has the same names.
    """
    if intersections.lonlat is None:
        xy = np.array(positions(intersections.world_xy, local=True)).reshape(-1, 2)
        cells = (np.floor(xy / CELL_M) * CELL_M + CELL_M / 2.0).astype(np.int64)
        return number_repeated([f"x{x}y{y}" for x, y in cells.tolist()], xy)
    lonlat = np.array(positions(intersections.lonlat, local=False)).reshape(-1, 2)
    return number_repeated([_cell_name(lon, lat) for lon, lat in lonlat.tolist()], lonlat)


def _cell_name(lon_deg: float, lat_deg: float) -> str:
    lat = (np.floor(lat_deg / CELL_DEG) + 0.5) * CELL_DEG
    # As many cells around the Earth as make them square at this latitude: no cell lies across the date line.
    columns = max(1, round(360.0 * np.cos(np.radians(lat)) / CELL_DEG))
    width = 360.0 / columns
    column = np.floor((lon_deg + 180.0) % 360.0 / width) % columns
    return f"{lat:.5f},{(column + 0.5) * width - 180.0:.5f}"


def number_repeated(names: list[str], xy: FloatArray) -> list[str]:
    """Add -2, -3, ... to names that come again, in the order of (N, 2) positions from west to east."""
    numbered = list(names)
    count: dict[str, int] = {}
    for row in np.lexsort((xy[:, 1], xy[:, 0])).tolist():
        name = names[row]
        count[name] = count.get(name, 0) + 1
        if count[name] > 1:
            numbered[row] = f"{name}-{count[name]}"
    return numbered


TRAJECTORY_STEP_M = 0.5


def write_results(
    result: DriveResult, folder: str | os.PathLike[str], *, beside: Beside | None = None
) -> RoadNetwork | None:
    """Write the files of a run into a folder.

    Parameters
    ----------
    result
        The run.
    folder
        Is created where it is missing. Files of an older run in it are replaced one by one, and those of its
        evaluation are removed: they are of another result. All else stays. Write into an
        `interloc.files.atomic_folder` for all or nothing.
    beside
        Collects what of the roads could not be made, instead of an IncompleteError at the end.

    Returns
    -------
    RoadNetwork or None
        The map of the roads, which was made for its files; None where that failed.

    Raises
    ------
    OutputError
        A file could not be written.
    IncompleteError
        All was written but roads or road surface, which failed.

    Notes
    -----
    `run.json` is removed first and written last: a folder that has it is complete. `road.tif` is written where the run
    kept the road around its keyframes (`DriveResult.road`). The trajectory is thinned to one point every 0.5 m; first
    and last scan stay.
    """
    expect(result, DriveResult)
    folder = Path(folder)
    names = layout.file_names(georeferenced=result.is_georeferenced)
    local = not result.is_georeferenced
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / layout.RUN_FILE).is_file():
            _remove_evaluation(folder, is_placed="location" in result.run)
        rasters = [] if result.road_file == folder.resolve() / layout.ROAD_FILE else [layout.ROAD_FILE]
        for stale in (layout.RUN_FILE, *rasters, *layout.file_names(georeferenced=local).values()):
            (folder / stale).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder} could not be written: {reason_of(error)}.") from error
    origin = origin_of(result.run, result.drive)
    for table, features_of in TABLE_FEATURES.items():
        write_collection(folder / names[table], features_of(result), local=local, origin=origin)
    parts, network, rasters = beside or Beside(), None, []
    with parts.part("the map of the roads"):
        mosaic = mosaic_of(result)
        network = roads(result, mosaic, beside=parts)
        if mosaic.raster.tiles:
            write_road(mosaic, folder / layout.ROAD_FILE)
            rasters = [layout.ROAD_FILE]
    made = {key: list[Feature]() for key in layout.ROAD_LAYERS} if network is None else road_features(network)
    for layer, features in made.items():
        write_collection(folder / names[layer], features, local=local, origin=origin)
    times = [each for each in result.keyframes.moments if each is not None]
    first, last = (times[0], times[-1]) if times else (None, None)
    files = [*names.values(), *rasters, layout.RUN_FILE]
    own = (layout.FORMAT, layout.FORMAT_VERSION, result.drive, result.is_georeferenced, files, first, last)
    facts = to_jsonable_python(
        result.run,
        inf_nan_mode="null",
        fallback=lambda value: value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value),
    )
    run = dict(zip(layout.RUN_KEYS, own, strict=True)) | {k: v for k, v in facts.items() if k not in layout.RUN_KEYS}
    write_record(folder / layout.RUN_FILE, run | ({"missing": parts.missing} if parts.missing else {}))
    if beside is None:
        parts.check(folder)
    return network


def _remove_evaluation(folder: Path, *, is_placed: bool) -> None:
    """Remove what an evaluation, and the placing of another run, left in a result folder."""
    stale = layout.RESULT_NAMES.difference(layout.RUN_NAMES, [layout.FIGURES])
    if not is_placed:  # else its places have been written just now
        stale |= {f"{layout.PLACES}.geojson"}
    for name in stale:
        (folder / name).unlink(missing_ok=True)
    if (folder / layout.FIGURES).is_dir():
        shutil.rmtree(folder / layout.FIGURES)


def _coordinates(world_xy: FloatArray, lonlat: FloatArray | None) -> list[list[float]]:
    return positions(world_xy, local=True) if lonlat is None else positions(lonlat, local=False)


def _shared(table: DetectionTable | IntersectionTable, verdicts: Verdicts | None) -> dict[str, Column]:
    """Return the columns that detections and intersections have in common."""
    return {
        "world_x_m": table.world_xy[:, 0],
        "world_y_m": table.world_xy[:, 1],
        "branch_count": [len(each) for each in table.bearings_deg],
        "branch_bearings_deg": [bearings(each) for each in table.bearings_deg],
        "branch_widths_m": [each.tolist() for each in table.widths_m],
        **vars(verdicts or Verdicts.unscored(len(table))),
    }


def detection_features(result: DriveResult, verdicts: Verdicts | None = None) -> list[Feature]:
    """Return the features of the layer `detections`, with the verdicts of an evaluation where there is one."""
    table = result.detections
    ids = [*result.intersections.id.tolist(), None]  # row -1: not fused
    moments = result.keyframes.moments
    return LAYERS["detections"].features(
        _coordinates(table.world_xy, table.lonlat),
        frame=result.keyframes.frame[table.keyframe],
        x_m=table.lidar_xy[:, 0],
        y_m=table.lidar_xy[:, 1],
        position_std_m=table.position_std_m,
        score=table.score,
        intersection=[ids[row] for row in table.intersection.tolist()],
        id=table.names(result.keyframes),
        time=[moments[row] for row in table.keyframe.tolist()],
        **_shared(table, verdicts),
    )


def _keyframe_features(result: DriveResult) -> list[Feature]:
    table = result.keyframes
    return LAYERS["keyframes"].features(
        _coordinates(table.world_xy, table.lonlat),
        frame=table.frame,
        time_s=table.time_s,
        heading_deg=bearing_deg(table.world_yaw_rad if table.enu_yaw_rad is None else table.enu_yaw_rad),
        detections=np.bincount(result.detections.keyframe, minlength=len(table)),
        world_x_m=table.world_xy[:, 0],
        world_y_m=table.world_xy[:, 1],
        world_yaw_rad=table.world_yaw_rad,
        time=table.moments,
    )


def intersection_features(
    result: DriveResult,
    verdicts: Verdicts | None = None,
    uids: Sequence[str] | None = None,
    names: Sequence[str | None] | None = None,
) -> list[Feature]:
    """Return the features of the layer `intersections`, with the verdicts of an evaluation where there is one.

    `uids` are the names of the places, by default those that need no map (`interloc.output.write.place_uids`); `names`
    those of the streets that meet, by default none.
    """
    table = result.intersections
    parts = table.parts or PositionParts.unknown(len(table))
    moment_of = dict(zip(result.keyframes.frame.tolist(), result.keyframes.moments, strict=True))
    return LAYERS["intersections"].features(
        _coordinates(table.world_xy, table.lonlat),
        id=table.id,
        observations=table.observations,
        position_std_m=table.position_std_m,
        position_cov_m2=table.covariances[:, [0, 0, 1], [0, 1, 1]],
        fix_std_m=parts.fix_std_m,
        shape_cov_m2=[each.tolist() if np.isfinite(each).all() else None for each in parts.shape_cov_m2],
        scatter_std_m=parts.scatter_std_m,
        first_frame=table.first_frame,
        last_frame=table.last_frame,
        confidence=table.confidence,
        uid=place_uids(table) if uids is None else list(uids),
        first_time=[moment_of.get(frame) for frame in table.first_frame.tolist()],
        last_time=[moment_of.get(frame) for frame in table.last_frame.tolist()],
        **_shared(table, verdicts),
        names=[None] * len(table) if names is None else list(names),
    )


def trajectory_feature(track_xy: FloatArray, lonlat: FloatArray | None, scans: int | None = None) -> Feature:
    """Return the LineString of a track over all N scans, thinned; one of a single scan repeats it (RFC 7946, 3.1.4).

    Given are (N, 2) metres of W, and longitudes and latitudes, or None: then the line is in metres. A result that was
    read has the thinned line, and says how many scans it was of.
    """
    rows = thin(track_xy, TRAJECTORY_STEP_M)
    world_xy = track_xy[rows]
    line = line_of(_coordinates(world_xy, None if lonlat is None else lonlat[rows]))
    (feature,) = LAYERS["trajectory"].features([line or None], scans=[scans or len(track_xy)])
    return feature | {"world_xy_m": positions(world_xy, local=True)}


TABLE_FEATURES: dict[str, Callable[[DriveResult], list[Feature]]] = {
    "detections": detection_features,
    "keyframes": _keyframe_features,
    "trajectory": lambda of: [trajectory_feature(of.trajectory_world_xy, of.trajectory_lonlat, of.run.get("scans"))],
    "intersections": intersection_features,
}
"""The features of each layer of a run, before any evaluation, in the order in which they are written."""
