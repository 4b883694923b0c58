"""How often drives are placed on a map without GNSS, and how well: KITTI sequences and pieces of them against OXTS."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from interloc.arrays import FloatArray
from interloc.benchmark.cases import TwinCase
from interloc.drawing import BLUE, FAINT, MUTED, VERMILION, image, new_figure
from interloc.drive import Drive
from interloc.errors import GeoreferenceError
from interloc.files import write_file
from interloc.geometry import enu_from_lonlat, wrap_angle, yaw_of
from interloc.localization.locate import Found, SearchedMap, decide_by, find_places, georeference_by
from interloc.localization.roads import road_map
from interloc.localization.sightings import Sightings, no_sightings, sightings_of
from interloc.localization.track import Track, track_of
from interloc.osm.graph import RoadGraph
from interloc.pipeline import detect
from interloc.simulate.tracks import lidar_poses, parse_tr
from interloc.simulate.twins import twin_track

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RIGHT_M = 10.0
"""Median distance from the truth up to which a drive counts as placed right."""

RECALL_M = 5.0
"""Distance from the truth up to which a single intersection counts as recognised, as in InterKey (2025)."""

WRONG_MAP_MARGIN_DEG = 0.003
"""A map that does not hold the drive: the map without the box around the drive and this margin."""

AROUND_M = 75.0
"""How much of the drive before and behind a single intersection is used."""

_PIECES = 8  # of one length from one sequence
_SAMPLE_M = 10.0

MapKind = Literal["map", "mirrored", "without"]
PieceKind = Literal["whole", "piece", "intersection"]


@dataclass(frozen=True)
class Piece:
    """A piece of a drive, with its truth."""

    sequence: str
    start_m: float
    length_m: float
    """Where it begins along the drive."""
    what: PieceKind
    """{"whole", "piece", "intersection"}: all of the drive, a piece of it, or what is around a single intersection."""
    track: Track
    sightings: Sightings
    lonlat: FloatArray
    """(N, 2) float64: true position of the LiDAR, degrees."""
    yaw_rad: FloatArray
    """(N,) float64: its true heading from east."""
    sequence_lonlat: FloatArray
    """(M, 2) float64: true positions of the whole sequence."""


@dataclass(frozen=True)
class LocateRow:
    """What became of one piece on one map."""

    sequence: str
    start_m: float
    length_m: float
    what: PieceKind
    """{"whole", "piece", "intersection"}."""
    on: MapKind
    """{"map", "mirrored", "without"}: the map; in a mirror; without the roads around the drive. Only on the first may
    anything be found."""
    outcome: str
    """{"found", "ambiguous", "not_found"}."""
    score: float
    runner_up: float
    chance: float
    right: bool = False
    """The best place is the true one, found or not."""
    median_m: float | None = None
    p95_m: float | None = None
    heading_deg: float | None = None
    """Errors of the scans at the best place; heading: median. None on maps that do not hold the drive."""
    seconds: float = 0.0
    """For the search of the piece and of its mirror image."""
    errors_m: list[float] = field(default_factory=list)
    headings_deg: list[float] = field(default_factory=list)
    """Errors every ten metres, to be pooled."""


def pieces_of(
    kitti: Path, sequence: str, lengths_m: tuple[float, ...], *, twins: Path | None = None
) -> Iterator[Piece]:
    """Yield a whole sequence, and pieces of given lengths spread evenly over it.

    Parameters
    ----------
    kitti
        Folder as `interloc benchmark twins` takes it.
    sequence
    lengths_m
        Lengths of the pieces; inf: the whole; 0: what is around each single intersection.
    twins
        Folder where twins are kept: their intersections are detected and used. None: the trajectory alone.
    """
    if twins is None:
        truth = twin_track(kitti, sequence)
        poses = lidar_poses(np.asarray(truth.poses_camera), parse_tr(truth.calib_text))
        track, sightings = track_of(poses), no_sightings()
        lonlat = np.column_stack([truth.lon_deg, truth.lat_deg])
        yaw = yaw_of(truth.R_enu_lidar)
    else:
        with TwinCase(kitti, sequence, keep=twins).opened(twins) as drive:
            track, sightings, lonlat, yaw = _from_twin(drive)
    at = track.at_m
    for length_m in lengths_m:
        for start_m, stop_m, what in _spans(length_m, at[-1], sightings):
            first = int(np.searchsorted(at, start_m))
            rows = slice(first, int(np.searchsorted(at, stop_m)) + 1)
            piece = Track(track.xy[rows], track.z_m[rows], track.R_level_lidar[rows], at[rows] - at[first])
            seen = sightings.between(at[first], at[rows][-1])
            seen = replace(seen, at_m=seen.at_m - at[first])
            yield Piece(sequence, start_m, piece.length_m, what, piece, seen, lonlat[rows], yaw[rows], lonlat)


def _spans(length_m: float, end_m: float, sightings: Sightings) -> list[tuple[float, float, PieceKind]]:
    if length_m == 0.0:
        middle = sightings.at_m[(sightings.at_m > AROUND_M) & (sightings.at_m < end_m - AROUND_M)]
        return [(each - AROUND_M, each + AROUND_M, "intersection") for each in middle.tolist()]
    if not np.isfinite(length_m):
        return [(0.0, end_m, "whole")]
    room = end_m - length_m
    if room < 0.0:
        return []
    count = min(_PIECES, 1 + int(2.0 * room / length_m))  # they overlap by half at most
    return [(start, start + length_m, "piece") for start in np.linspace(0.0, room, count).tolist()]


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
    began = time.perf_counter()
    found, mirrored = _both(piece, full)
    row = replace(_row(piece, "map", found, mirrored, full), seconds=round(time.perf_counter() - began, 2))
    if piece.what == "intersection":
        return [row]
    elsewhere, elsewhere_mirrored = _both(piece, hole)
    return [
        row,
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
    row = LocateRow(
        sequence=piece.sequence,
        start_m=piece.start_m,
        length_m=piece.length_m,
        what=piece.what,
        on=on,
        outcome=decision.outcome,
        score=found[0].score if found else 0.0,
        runner_up=found[1].score if len(found) > 1 else 0.0,
        chance=chance[0].score if chance else 0.0,
    )
    if not found or searched is None:
        return row
    placed = georeference_by(found[0].chain, found[0].fit, piece.track, searched.roads, "")
    here = np.column_stack([placed.lon_deg, placed.lat_deg])
    error_m = np.hypot(*enu_from_lonlat(piece.lonlat[:, 1], piece.lonlat[:, 0], here).T)
    turned = np.degrees(np.abs(wrap_angle(yaw_of(placed.R_enu_lidar) - piece.yaw_rad)))
    every = np.searchsorted(piece.track.at_m, np.arange(0.0, piece.track.length_m, _SAMPLE_M))
    return replace(
        row,
        right=bool(np.median(error_m) <= RIGHT_M),
        median_m=float(np.median(error_m)),
        p95_m=float(np.percentile(error_m, 95)),
        heading_deg=float(np.median(turned)),
        errors_m=np.round(error_m[every], 2).tolist(),
        headings_deg=np.round(turned[every], 3).tolist(),
    )


def table_of(rows: list[LocateRow]) -> str:
    """Return the figures as a table in Markdown, one line per length."""
    lines = [
        (
            "| driven | count | placed right | refused | wrong | position, median / 95 % [m] | heading, median [deg] "
            "| found on wrong maps | time, median / longest [s] |"
        ),
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, group in _by_length(rows):
        on_map = [row for row in group if row.on == "map"]
        wrong_maps = [row for row in group if row.on != "map"]
        found = [row for row in on_map if row.outcome == "found"]
        right = [row for row in found if row.right]
        accepted = sum(row.outcome == "found" for row in wrong_maps)
        seconds = [row.seconds for row in on_map]
        errors_m = [error for row in right for error in row.errors_m]
        headings_deg = [error for row in right for error in row.headings_deg]
        lines.append(
            f"| {name} | {len(on_map)} | {len(right)} ({100 * len(right) / len(on_map):.0f} %) "
            f"| {len(on_map) - len(found)} | {len(found) - len(right)} "
            f"| {_percentile(errors_m, 50)} / {_percentile(errors_m, 95)} | {_percentile(headings_deg, 50)} "
            f"| {accepted} of {len(wrong_maps)} | {np.median(seconds):.1f} / {max(seconds):.1f} |"
        )
    single = [row for row in rows if row.what == "intersection"]
    if single:
        near = sum(row.median_m is not None and row.median_m < RECALL_M for row in single)
        share = f"{100 * near / len(single):.0f} % of {len(single)}"
        where = f"the best place within {2 * AROUND_M:.0f} m of driving around it, sure or not"
        lines += ["", f"Recall at {RECALL_M:g} m from a single intersection ({where}): {share}."]
    return "\n".join(lines)


def locating_figure(rows: list[LocateRow]) -> Figure:
    """Draw the share of pieces that are placed right, refused, and placed wrong, over the distance driven."""
    figure = new_figure(7.0, 4.0)
    axes = figure.add_subplot()
    pieces = [row for row in rows if row.what == "piece" and row.on == "map"]
    lengths = sorted({round(row.length_m, -1) for row in pieces})
    groups = [[row for row in pieces if round(row.length_m, -1) == length] for length in lengths]
    right = np.array([np.mean([row.outcome == "found" and row.right for row in group]) for group in groups])
    wrong = np.array([np.mean([row.outcome == "found" and not row.right for row in group]) for group in groups])
    axes.plot(lengths, 100 * right, "o-", color=BLUE, label="placed right")
    axes.plot(lengths, 100 * (1 - right - wrong), "s--", color=MUTED, label="refused (ambiguous or not found)")
    axes.plot(lengths, 100 * wrong, "x-", color=VERMILION, label="placed wrong")
    axes.set(xlabel="distance driven [m]", ylabel="share of pieces [%]", ylim=(-3, 103))
    axes.grid(visible=True, color=FAINT, linewidth=0.5)
    axes.legend(frameon=False)
    return figure


def write_locating(rows: list[LocateRow], out: Path) -> None:
    """Write OUT/locate.json, OUT/locate.md and, where there are pieces, OUT/locate.svg."""
    out.mkdir(parents=True, exist_ok=True)
    write_file(out / "locate.json", json.dumps([asdict(row) for row in rows], indent=1))
    write_file(out / "locate.md", table_of(rows) + "\n")
    if any(row.what == "piece" for row in rows):
        write_file(out / "locate.svg", image(locating_figure(rows), "svg"))


def _by_length(rows: list[LocateRow]) -> Iterator[tuple[str, list[LocateRow]]]:
    wholes = [row for row in rows if row.what == "whole"]
    if wholes:
        yield "whole sequences", wholes
    pieces = [row for row in rows if row.what == "piece"]
    for length_m in sorted({round(row.length_m, -1) for row in pieces}, reverse=True):
        yield f"{length_m:.0f} m", [row for row in pieces if round(row.length_m, -1) == length_m]


def _percentile(values: list[float], percent: float) -> str:
    return f"{np.percentile(values, percent):.2f}" if values else "-"


def _from_twin(drive: Drive) -> tuple[Track, Sightings, FloatArray, FloatArray]:
    truth = drive.georeference
    if truth is None:
        raise GeoreferenceError(f"{drive.name}: the twin has no georeference to compare with")
    track = track_of(drive.T_world_lidar)
    sightings = sightings_of(detect(drive), drive.frames, track)
    return track, sightings, np.column_stack([truth.lon_deg, truth.lat_deg]), yaw_of(truth.R_enu_lidar)


def _without(graph: RoadGraph, lonlat: FloatArray) -> RoadGraph:
    margin = np.array([1.5, 1.0]) * WRONG_MAP_MARGIN_DEG
    low, high = lonlat.min(axis=0) - margin, lonlat.max(axis=0) + margin
    inside: Any = ((graph.lonlat > low) & (graph.lonlat < high)).all(axis=1)
    kept = ~inside[graph.edges].any(axis=1)
    return replace(graph, edges=graph.edges[kept], edge_way=graph.edge_way[kept])
