"""How often drives are placed on a map without GNSS, and how well: KITTI sequences and pieces of them against OXTS."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from interloc.arrays import FloatArray
from interloc.benchmark.cases import TwinCase
from interloc.drive import Drive
from interloc.errors import GeoreferenceError
from interloc.files import atomic_write
from interloc.geometry import enu_from_lonlat, wrap_angle, yaw_of
from interloc.localization.locate import Found, SearchedMap, decide_by, find_places, georeference_by
from interloc.localization.roads import road_map
from interloc.localization.sightings import Sightings, no_sightings, sightings_of
from interloc.localization.track import Track, track_of
from interloc.osm.graph import RoadGraph
from interloc.pipeline import detect
from interloc.simulate.twins import twin_track

RIGHT_M = 10.0
"""Median distance from the truth up to which a drive counts as placed right."""

WRONG_MAP_MARGIN_DEG = 0.003
"""A map that does not hold the drive: the map without the box around the drive and this margin."""

MapKind = Literal["map", "mirrored", "without"]


@dataclass(frozen=True)
class Piece:
    """A piece of a drive, with its truth.

    Attributes
    ----------
    sequence : str
    start_m, length_m : float
        Where it begins along the drive.
    whole : bool
        True for all of the drive.
    track : Track
    sightings : Sightings
    lonlat : (N, 2) float64
        True position of the LiDAR, degrees.
    yaw_rad : (N,) float64
        Its true heading from east.
    sequence_lonlat : (M, 2) float64
        True positions of the whole sequence.
    """

    sequence: str
    start_m: float
    length_m: float
    whole: bool
    track: Track
    sightings: Sightings
    lonlat: FloatArray
    yaw_rad: FloatArray
    sequence_lonlat: FloatArray


@dataclass(frozen=True)
class LocateRow:
    """What became of one piece on one map.

    Attributes
    ----------
    sequence : str
    start_m, length_m : float
    whole : bool
    on : {"map", "mirrored", "without"}
        The map; in a mirror; without the roads around the drive. Only on the first may anything be found.
    outcome : {"found", "ambiguous", "not_found"}
    right : bool
        The best place is the true one, found or not.
    median_m, p95_m, heading_deg : float or None
        Errors of the scans at the best place; heading: median. None on maps that do not hold the drive.
    score, runner_up, chance : float
    """

    sequence: str
    start_m: float
    length_m: float
    whole: bool
    on: MapKind
    outcome: str
    right: bool
    median_m: float | None
    p95_m: float | None
    heading_deg: float | None
    score: float
    runner_up: float
    chance: float


def pieces_of(
    kitti: Path, sequence: str, lengths_m: tuple[float, ...], *, twins: Path | None = None, scratch: Path | None = None
) -> Iterator[Piece]:
    """Yield a whole sequence and its pieces of given lengths, one behind the other.

    Parameters
    ----------
    kitti
        Folder as `interloc benchmark twins` takes it.
    sequence
    lengths_m
        Lengths of the pieces; inf: the whole.
    twins
        Folder where twins are kept: their intersections are detected and used. None: the trajectory alone.
    scratch
        For temporary files.
    """
    if twins is None:
        truth = twin_track(kitti, sequence)
        poses = _lidar_poses(np.asarray(truth.poses_camera), str(truth.calib_text))
        track, sightings = track_of(poses), no_sightings()
        lonlat = np.column_stack([truth.lon_deg, truth.lat_deg])
        yaw = yaw_of(truth.R_enu_lidar)
    else:
        with TwinCase(kitti, sequence, keep=twins).opened(scratch or twins) as drive:
            track, sightings, lonlat, yaw = _from_twin(drive)
    at = track.at_m
    for length_m in lengths_m:
        whole = not np.isfinite(length_m)
        for start_m in [0.0] if whole else np.arange(0.0, at[-1] - length_m + 1.0, length_m).tolist():
            first = int(np.searchsorted(at, start_m))
            rows = slice(first, len(at) if whole else int(np.searchsorted(at, start_m + length_m)) + 1)
            piece = Track(track.xy[rows], track.z_m[rows], track.R_level_lidar[rows], at[rows] - at[first])
            seen = sightings.between(at[first], at[rows][-1])
            seen = replace(seen, at_m=seen.at_m - at[first])
            yield Piece(sequence, start_m, piece.length_m, whole, piece, seen, lonlat[rows], yaw[rows], lonlat)


def measure_pieces(
    pieces: Iterator[Piece], graph: RoadGraph, report: Callable[[Piece, list[LocateRow]], None] | None = None
) -> list[LocateRow]:
    """Place pieces on the map, on its mirror image, and on the map without the roads around them."""
    full = SearchedMap.of(road_map(graph))
    holes: dict[str, SearchedMap] = {}
    rows: list[LocateRow] = []
    for piece in pieces:
        if piece.sequence not in holes:
            holes = {piece.sequence: SearchedMap.of(road_map(_without(graph, piece.sequence_lonlat)))}
        new = _measure(piece, full, holes[piece.sequence])
        rows += new
        if report is not None:
            report(piece, new)
    return rows


def _measure(piece: Piece, full: SearchedMap, hole: SearchedMap) -> list[LocateRow]:
    found, mirrored = _both(piece, full)
    elsewhere, elsewhere_mirrored = _both(piece, hole)
    return [
        _row(piece, "map", found, mirrored, full),
        _row(piece, "mirrored", mirrored, found),
        _row(piece, "without", elsewhere, elsewhere_mirrored),
        _row(piece, "without", elsewhere_mirrored, elsewhere),
    ]


def _both(piece: Piece, searched: SearchedMap) -> tuple[list[Found], list[Found]]:
    with ThreadPoolExecutor(2) as pool:
        mirrored = pool.submit(find_places, piece.track.mirrored(), piece.sightings.mirrored(), searched)
        return find_places(piece.track, piece.sightings, searched), mirrored.result()


def _row(
    piece: Piece, on: MapKind, found: list[Found], chance: list[Found], searched: SearchedMap | None = None
) -> LocateRow:
    decision = decide_by(found, chance)
    errors: tuple[float | None, float | None, float | None] = (None, None, None)
    if found and searched is not None:
        placed = georeference_by(found[0].chain, found[0].fit, piece.track, searched.roads, "")
        here = np.column_stack([placed.lon_deg, placed.lat_deg])
        error_m = np.hypot(*enu_from_lonlat(piece.lonlat[:, 1], piece.lonlat[:, 0], here).T)
        turned = np.degrees(np.abs(wrap_angle(yaw_of(placed.R_enu_lidar) - piece.yaw_rad)))
        errors = (float(np.median(error_m)), float(np.percentile(error_m, 95)), float(np.median(turned)))
    return LocateRow(
        piece.sequence,
        piece.start_m,
        piece.length_m,
        piece.whole,
        on,
        decision.outcome,
        errors[0] is not None and errors[0] <= RIGHT_M,
        *errors,
        *(group[rank].score if len(group) > rank else 0.0 for group, rank in ((found, 0), (found, 1), (chance, 0))),
    )


def table_of(rows: list[LocateRow]) -> str:
    """Return the figures as a table in Markdown, one line per length."""
    lines = [
        "| pieces | count | placed right | refused | wrong | median / 95 % [m] | heading [deg] | found on wrong maps |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, group in _by_length(rows):
        on_map = [row for row in group if row.on == "map"]
        wrong_maps = [row for row in group if row.on != "map"]
        found = [row for row in on_map if row.outcome == "found"]
        right = [row for row in found if row.right]
        accepted = sum(row.outcome == "found" for row in wrong_maps)
        lines.append(
            f"| {name} | {len(on_map)} | {len(right)} ({100 * len(right) / len(on_map):.0f} %) "
            f"| {len(on_map) - len(found)} | {len(found) - len(right)} "
            f"| {_median([row.median_m for row in right])} / {_median([row.p95_m for row in right])} "
            f"| {_median([row.heading_deg for row in right])} | {accepted} of {len(wrong_maps)} |"
        )
    return "\n".join(lines)


def write_locating(rows: list[LocateRow], out: Path) -> None:
    """Write OUT/locate.json and OUT/locate.md."""
    out.mkdir(parents=True, exist_ok=True)
    with atomic_write(out / "locate.json") as file:
        file.write(json.dumps([asdict(row) for row in rows], indent=1).encode())
    with atomic_write(out / "locate.md") as file:
        file.write(table_of(rows).encode() + b"\n")


def _by_length(rows: list[LocateRow]) -> Iterator[tuple[str, list[LocateRow]]]:
    wholes = [row for row in rows if row.whole]
    if wholes:
        yield "whole sequences", wholes
    for length_m in sorted({round(row.length_m, -2) for row in rows if not row.whole}, reverse=True):
        yield f"{length_m:.0f} m", [row for row in rows if not row.whole and round(row.length_m, -2) == length_m]


def _median(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.median(known):.2f}" if known else "-"


def _lidar_poses(camera: FloatArray, calib_text: str) -> FloatArray:
    """Return (N, 4, 4) poses of the LiDAR from (N, 3, 4) poses of the camera."""
    line = next(line for line in calib_text.splitlines() if line.startswith("Tr"))
    T_cam_lidar = np.eye(4)
    T_cam_lidar[:3] = np.array(line.split()[1:13], dtype=np.float64).reshape(3, 4)
    full = np.tile(np.eye(4), (len(camera), 1, 1))
    full[:, :3] = camera
    poses = np.linalg.inv(T_cam_lidar) @ full @ T_cam_lidar
    first: FloatArray = np.linalg.inv(poses[0]) @ poses
    return first


def _from_twin(drive: Drive) -> tuple[Track, Sightings, FloatArray, FloatArray]:
    truth = drive.georeference
    if truth is None:
        raise GeoreferenceError(f"{drive.name}: the twin has no georeference to compare with")
    track = track_of(drive.T_world_lidar)
    sightings = sightings_of(detect(drive), drive.frames, track)
    return track, sightings, np.column_stack([truth.lon_deg, truth.lat_deg]), yaw_of(truth.R_enu_lidar)


def _without(graph: RoadGraph, lonlat: FloatArray) -> RoadGraph:
    """Return a map without the roads around a drive."""
    margin = np.array([1.5, 1.0]) * WRONG_MAP_MARGIN_DEG
    low, high = lonlat.min(axis=0) - margin, lonlat.max(axis=0) + margin
    inside: Any = ((graph.lonlat > low) & (graph.lonlat < high)).all(axis=1)
    kept = ~inside[graph.edges].any(axis=1)
    return replace(graph, edges=graph.edges[kept], edge_way=graph.edge_way[kept])
