"""The sheet of all steps, and the files of `interloc explain`."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from interloc.arrays import FloatArray, JsonObject
from interloc.config import DetectorConfig
from interloc.drawing import INK, MUTED, PAPER, entitle, image, new_figure
from interloc.drive import Drive, Georeference
from interloc.evaluation.coverage import check_coverage
from interloc.explain import steps
from interloc.explain.canvas import PX_PER_M, Canvas, Square
from interloc.explain.evidence import ExplainedKeyframe, GroundTruth, gather, ground_truth, record
from interloc.files import atomic_folder, write_file
from interloc.geometry import lonlat_from_enu, rotate_2d, yaw_of
from interloc.osm.graph import RoadGraph
from interloc.osm.policies import Policy
from interloc.output.geojson import positions, write_record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


logger = logging.getLogger(__name__)

RECORD = "explain.json"
OVERVIEW = "overview.png"

_DPI = 100
_FINER = 2  # the canvas has so many pixels per pixel of a sheet and direction
_TICK_M = 20.0


class Step(NamedTuple):
    """One step: its name in the paper, what lies below the vehicle, and what lies above it."""

    title: str
    ground: tuple[steps.Draw, ...]
    marks: tuple[steps.Draw, ...] = ()


_FAINT = (steps.road, steps.faint_centerline)
STEPS = (
    Step("Road point segmentation", (steps.road_points,)),
    Step("Keyframe concatenation", (steps.panoramic_scan,)),
    Step("BEV projection", (steps.bev,)),
    Step("Road occupancy inference", (steps.occupancy,)),
    Step("Road centerline extraction", (steps.road, steps.centerline)),
    Step(
        "Intersection candidate detection",
        (*_FAINT, steps.short_branches, steps.corners, steps.margin),
        (steps.candidates,),
    ),
    Step(
        "Branch-based refinement",
        (*_FAINT, steps.outer_circles, steps.branches),
        (steps.refined_points, steps.numbers_of_intersections),
    ),
)


def explain(
    drive: Drive,
    frame: int,
    config: DetectorConfig,
    out: str | os.PathLike[str],
    *,
    graph: RoadGraph | None = None,
    policy: Policy = "drive",
) -> list[Path]:
    """Draw the steps of the method for the keyframe nearest to a scan number; return the files.

    They are the six steps of the paper's Fig. 2 and the refinement of its Fig. 5 on one sheet, and the numbers, in a
    folder that is written whole or not at all; one of an earlier call is replaced. Roads of OpenStreetMap are drawn on
    top where the drive is georeferenced; the policy says which of them are roads and ground truth. A map of another
    place is a `MapError`.
    """
    explained = gather(drive, frame, config)
    logger.info(
        "frame %d: keyframe %d of %d is scan %d, %d keyframes in its window",
        frame,
        explained.number + 1,
        explained.keyframe_count,
        explained.keyframe.frame,
        len(explained.window),
    )
    truth = None
    if graph is not None and drive.georeference is None:
        logger.warning("%s: without georeference the roads of OpenStreetMap cannot be drawn", drive.name)
    elif graph is not None and drive.georeference is not None:
        check_coverage(drive.georeference.lonlat, graph, roi_m=config.bev.size_m)
        truth = ground_truth(explained, drive.georeference, graph, policy)
    with atomic_folder(Path(out), marker=RECORD) as folder:
        write_file(folder / OVERVIEW, image(overview(explained, truth), "png", dpi=_DPI))
        write_record(folder / RECORD, record(explained, drive.name, truth))
    return [Path(out) / OVERVIEW, Path(out) / RECORD]


_TILE, _SPACE, _HEAD = 400, 16, 58  # pixels: side of a panel, between two, for the title of the sheet
_TILE_TITLE = 26
_FACTS, _FACT = 3, 19  # lines that fit below the key; pixels that each further one needs


def overview(explained: ExplainedKeyframe, truth: GroundTruth | None) -> Figure:
    """Draw all steps side by side, and in the eighth place a scale, the key of all panels, the detections."""
    facts = []
    for number, i in [(each.number, i) for each in explained.kept for i in each.detections]:
        ahead, aside = explained.detections.lidar_xy[i]
        count = explained.steps.junctions[i].branches.count
        facts.append(f"{number:>2}   x {ahead:.1f} m, y {aside:.1f} m, {count} branches")
    facts = ["intersections (x ahead, y to the left):", *facts] if facts else ["no intersections"]
    more = max(0, len(facts) - _FACTS) * _FACT
    width, height = 4 * _TILE + 5 * _SPACE, _HEAD + 2 * (_TILE + _TILE_TITLE + _SPACE) + more
    figure = new_figure(width / _DPI, height / _DPI)
    figure.set_layout_engine("none")
    frame, count = explained.keyframe.frame, len(explained.window)
    about = [
        f"scan {frame}" + ("" if explained.asked == frame else f" (nearest keyframe to {explained.asked})"),
        f"keyframe {explained.number + 1} of {explained.keyframe_count}",
        f"{count} {'keyframe' if count == 1 else 'keyframes'} in the window",
        f"preset {explained.config.preset}",
    ]
    _write(figure, _SPACE, height - 10, "From road points to intersections", fontsize=14, va="top", weight="bold")
    _write(figure, _SPACE, height - 34, "   ·   ".join(about), fontsize=9, color=MUTED, va="top")
    places = [
        (_SPACE + (i % 4) * (_TILE + _SPACE), height - _HEAD - (i // 4 + 1) * (_TILE + _TILE_TITLE + _SPACE) + _SPACE)
        for i in range(8)
    ]
    drawn = []
    for number, (step, (left, bottom)) in enumerate(zip(STEPS, places, strict=False), 1):
        canvas = _drawn(step, explained, truth)
        entitle(_show(figure, canvas, left, bottom), f"{number}  {step.title}", 11.0)
        drawn.append(canvas)
    left, bottom = places[-1]
    _legend(figure, drawn, left + 6, bottom + _TILE)
    bottom -= more
    _write(figure, left + 10, bottom + 44, "\n".join(facts), fontsize=9, linespacing=1.5)
    _draw_scale(figure, left + 10, bottom + 7, _TILE / (2.0 * drawn[0].square.half_m))
    return figure


def _draw_scale(figure: Figure, left: float, bottom: float, px_per_m: float) -> None:
    axes = _add_axes(figure, left, bottom, 20.0 * px_per_m, 4.0)
    axes.set(xticks=[], yticks=[], facecolor=INK)
    axes.spines[:].set_visible(False)
    _write(figure, left + 10.0 * px_per_m, bottom + 8, "20 m", fontsize=9, ha="center", va="bottom")


def _drawn(step: Step, explained: ExplainedKeyframe, truth: GroundTruth | None) -> Canvas:
    """Draw a step, and what every picture has: the map, where there is one, and the vehicle."""
    canvas = Canvas(explained, _FINER * _TILE, px_per_m=_FINER * PX_PER_M, background=PAPER)
    for draw in step.ground:
        draw(canvas, explained)
    if truth is not None:
        steps.osm(canvas, truth)
    steps.vehicle(canvas, explained)
    for draw in step.marks:
        draw(canvas, explained)
    return canvas


def _show(figure: Figure, canvas: Canvas, left: float, bottom: float) -> Axes:
    """Add a drawn canvas at a place in pixels, in metres along the axes of W, with its notes."""
    from matplotlib.patheffects import withStroke  # noqa: PLC0415 - slow to import

    axes = _add_axes(figure, left, bottom, _TILE, _TILE)
    axes.imshow(canvas.smooth(_TILE), extent=canvas.square.extent, interpolation="nearest")
    x, y, half_m = canvas.square
    for axis, middle in ((axes.xaxis, x), (axes.yaxis, y)):
        first, last = math.ceil((middle - half_m) / _TICK_M), math.floor((middle + half_m) / _TICK_M)
        axis.set_ticks([_TICK_M * i for i in range(first, last + 1)])
    axes.tick_params(color=MUTED, length=3, labelbottom=False, labelleft=False)
    axes.spines[:].set_color(MUTED)
    for xy, text in canvas.notes:  # towards the middle of the picture
        flip = xy[0] > x + half_m - 8.0
        axes.annotate(
            text,
            (xy[0], xy[1]),
            xytext=(-9 if flip else 9, -14 if xy[1] > y + half_m - 8.0 else 6),
            textcoords="offset points",
            ha="right" if flip else "left",
            fontsize=11,
            weight="bold",
            color=INK,
            path_effects=[withStroke(linewidth=3, foreground=PAPER)],
        )
    return axes


def _add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place given in pixels from the lower left corner."""
    w, h = figure.get_size_inches() * _DPI
    return figure.add_axes((left / w, bottom / h, width / w, height / h))


def _write(figure: Figure, left: float, bottom: float, text: str, **style: Any) -> None:  # noqa: ANN401 - matplotlib's
    """Write a text at a place given in pixels from the lower left corner."""
    w, h = figure.get_size_inches() * _DPI
    figure.text(left / w, bottom / h, text, parse_math=False, **{"color": INK} | style)


def _legend(figure: Figure, drawn: Sequence[Canvas], left: float, top: float) -> None:
    """Put the keys of some canvases, each name once, with their upper left corner at a place given in pixels."""
    from matplotlib.lines import Line2D  # noqa: PLC0415 - slow to import

    w, h = figure.get_size_inches() * _DPI
    key = {name: style for canvas in reversed(drawn) for name, style in canvas.key.items()}
    names = list(dict.fromkeys(name for canvas in drawn for name in canvas.key))
    figure.legend(
        [Line2D([], [], **key[name]) for name in names],
        names,
        loc="upper left",
        bbox_to_anchor=(left / w, top / h),
        frameon=False,
        fontsize=7.5,
        labelcolor=INK,
        borderpad=0,
        borderaxespad=0,
        labelspacing=0.7,
        ncols=2,
        columnspacing=0.8,
        handletextpad=0.5,
    )


# The steps of one keyframe as pictures to be laid on a map.

OverlayLayer = Literal["bev", "occupancy", "centerline", "candidates", "branches", "all"]
OVERLAYS: tuple[OverlayLayer, ...] = get_args(OverlayLayer)

_SHARP_PX = 1500  # lines and marks are drawn on about so many pixels per side

_PARTS: dict[OverlayLayer, tuple[steps.Draw, ...]] = {
    "bev": (steps.bev,),
    "occupancy": (steps.occupancy,),
    "centerline": (steps.centerline,),
    "candidates": (steps.candidates,),
    "branches": (steps.branches, steps.refined_points),
    "all": (
        *(steps.road_cells, steps.faint_centerline, steps.branches),
        *(steps.refined_points, steps.rejected_candidates, steps.vehicle),
    ),
}


def draw_overlay(explained: ExplainedKeyframe, layer: OverlayLayer) -> bytes:
    """Draw one step as a square PNG of the region of interest, +x of W to the right, +y up.

    bev: the binary image. occupancy: road, and what closing added and opening took away. centerline, candidates,
    branches: lines and marks. All of these are transparent where there is nothing; "all", the steps in one picture, is
    opaque.
    """
    size = explained.roi.size
    cell_px = 1 if layer in {"bev", "occupancy"} else max(1, round(_SHARP_PX / size))
    canvas = Canvas(explained, size * cell_px, background=PAPER if layer == "all" else None)
    for draw in _PARTS[layer]:
        draw(canvas, explained)
    return canvas.png()


def describe_overlays(explained: ExplainedKeyframe, drive_name: str, georeference: Georeference | None) -> JsonObject:
    """Return where the pictures lie and the numbers behind them, as values that JSON can say.

    Longitudes and latitudes come from the keyframe's own fix (paper, eq. 12), as those of its detections do.
    """
    left, right, bottom, top = Square.of_region(explained).extent
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    config = explained.config
    numbers = record(explained, drive_name, None)
    for table in ("candidates", "detections"):
        for row in numbers[table]:
            around = np.array([row["world_x_m"], row["world_y_m"]]) - explained.vehicle
            row["lonlat"] = None if georeference is None else lonlat_of(explained, georeference, around[None])[0]
    return {
        "frame": explained.keyframe.frame,
        "time_s": explained.keyframe.time_s,
        "size_px": explained.roi.size,
        "resolution_m": explained.roi.resolution_m,
        "corners_lonlat": None if georeference is None else lonlat_of(explained, georeference, corners),
        "corners_world_m": positions(corners + explained.vehicle, local=True),
        "layers": list(OVERLAYS),
        "outer_radius_m": config.branches.outer_radius_m,
        "relevant_zone_m": max(0.0, config.bev.size_m - 2 * config.branches.outer_radius_m),
        "min_points": explained.steps.min_points,
        **{key: numbers[key] for key in ("keyframe", "keyframes_in_drive", "pose", "window", "points", "cells")},
        "candidates": numbers["candidates"],
        "detections": numbers["detections"],
    }


def lonlat_of(explained: ExplainedKeyframe, georeference: Georeference, around: FloatArray) -> list[list[float]]:
    """Return longitude, latitude of (N, 2) points given from the vehicle along the axes of W."""
    fix = explained.index
    turn = float(yaw_of(georeference.R_enu_lidar[fix])) - explained.yaw_rad
    enu = rotate_2d(around, turn)
    return positions(lonlat_from_enu(georeference.lat_deg[fix], georeference.lon_deg[fix], enu), local=False)
