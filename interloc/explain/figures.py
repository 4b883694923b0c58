"""The sheets: one per step, the refinement of every intersection, all of them on one; and their files."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from interloc.config import DetectorConfig
from interloc.drawing import INK, MUTED, PAPER, entitle, image, new_figure
from interloc.drive import Drive
from interloc.explain import steps
from interloc.explain.canvas import PX_PER_M, Canvas, Square
from interloc.explain.evidence import ExplainedKeyframe, GroundTruth, gather, ground_truth, record
from interloc.files import atomic_folder, write_file
from interloc.osm.graph import RoadGraph
from interloc.osm.policies import Policy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


logger = logging.getLogger(__name__)

RECORD = "explain.json"
OVERVIEW = "overview.png"

_DPI = 100
_FINER = 2  # the canvas has so many pixels per pixel of a sheet and direction
_WIDTH, _HEIGHT = 1120, 860  # pixels: a picture fits a laptop screen at 100 %
_MAP_LEFT, _MAP_BOTTOM, _MAP_SIDE = 66, 54, 750  # one cell of the usual image is one pixel
_KEY_LEFT = _MAP_LEFT + _MAP_SIDE + 18
_TICK_M = 20.0


@dataclass(frozen=True)
class Step:
    """One step: its file, its name in the paper, what lies below the vehicle, and what lies above it."""

    number: int
    file: str
    title: str
    ground: tuple[steps.Draw, ...]
    marks: tuple[steps.Draw, ...] = ()


_FAINT = (steps.road, steps.faint_centerline)
STEPS = (
    Step(1, "1_road_points.png", "Road point segmentation", (steps.road_points,)),
    Step(2, "2_panoramic_scan.png", "Keyframe concatenation", (steps.panoramic_scan,)),
    Step(3, "3_bev.png", "BEV projection", (steps.bev,)),
    Step(4, "4_occupancy.png", "Road occupancy inference", (steps.occupancy,)),
    Step(5, "5_centerline.png", "Road centerline extraction", (steps.road, steps.centerline)),
    Step(
        6,
        "6_candidates.png",
        "Intersection candidate detection",
        (*_FAINT, steps.short_branches, steps.corners, steps.margin),
        (steps.candidates,),
    ),
    Step(
        7,
        "7_refinement.png",
        "Branch-based refinement",
        (*_FAINT, steps.outer_circles, steps.branches),
        (steps.refined_points, steps.numbers_of_intersections),
    ),
)


def explain(
    drive: Drive,
    frame: int,
    config: DetectorConfig,
    out: Path,
    *,
    graph: RoadGraph | None = None,
    policy: Policy = "drive",
) -> list[Path]:
    """Draw the steps of the method for the keyframe nearest to a scan number; return the files.

    They are the six steps of the paper's Fig. 2, the refinement of its Fig. 5, all of them on one sheet, and the
    numbers, in a folder that is written whole or not at all; one of an earlier call is replaced. Roads of OpenStreetMap
    are drawn on top where the drive is georeferenced; the policy says which of them are roads and ground truth.
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
        truth = ground_truth(explained, drive.georeference, graph, policy)
    with atomic_folder(out, marker=RECORD) as folder:
        for step in STEPS:
            sheet = refinement_sheet if step is STEPS[-1] and explained.kept else step_sheet
            write_file(folder / step.file, image(sheet(step, explained, truth), "png", dpi=_DPI))
        write_file(folder / OVERVIEW, image(overview(explained, truth), "png", dpi=_DPI))
        text = json.dumps(record(explained, drive.name, truth), indent=2, allow_nan=False)
        write_file(folder / RECORD, f"{text}\n")
    return [out / name for name in (*(step.file for step in STEPS), OVERVIEW, RECORD)]


def step_sheet(step: Step, explained: ExplainedKeyframe, truth: GroundTruth | None) -> Figure:
    """Draw one step over the whole region of interest, its key and numbers beside it."""
    figure = _sheet(_WIDTH, _HEIGHT)
    _entitle_sheet(figure, _MAP_LEFT, f"{step.number}  {step.title}", explained)
    canvas = _drawn(step, explained, truth, _MAP_SIDE)
    axes = _show(figure, canvas, (_MAP_LEFT, _MAP_BOTTOM, _MAP_SIDE), tick_m=_TICK_M)
    axes.set_xlabel("x of W, from the vehicle [m]", fontsize=9, color=INK)
    axes.set_ylabel("y of W, from the vehicle [m]", fontsize=9, color=INK, labelpad=0)
    _legend(figure, [canvas], _KEY_LEFT, _MAP_BOTTOM + _MAP_SIDE)
    facts = {"fontsize": 9, "va": "bottom", "linespacing": 1.5}
    _write(figure, _KEY_LEFT, _MAP_BOTTOM, "\n".join(canvas.facts), **facts)
    return figure


_CELL, _GAP, _TEXT = 494, 46, 26  # pixels: side of a view, between two, for the text above
_TOP, _KEY = 56, 76  # for the title and the key


def refinement_sheet(step: Step, explained: ExplainedKeyframe, truth: GroundTruth | None) -> Figure:
    """Draw each intersection in a row: as far as its outer circle, and its inner circle enlarged."""
    height = _TOP + len(explained.kept) * (_CELL + _TEXT + _GAP) + _KEY
    figure = _sheet(_WIDTH, height)
    _entitle_sheet(figure, _MAP_LEFT, f"{step.number}  {step.title}", explained)
    step = replace(step, marks=step.marks[:1])  # no numbers: each has its own row
    drawn = []
    bottom = height - _TOP
    for each in explained.kept:
        alone = replace(explained, candidates=[each])
        bottom -= _TEXT + _CELL
        x, y = explained.around(each.position).tolist()
        inner_m = max(1.3 * each.branches.inner * explained.roi.resolution_m, 5.0)
        outer_m = explained.config.branches.outer_radius_m + 3.0
        for left, half_m, tick_m in (
            (_MAP_LEFT, outer_m, 10.0),
            (_MAP_LEFT + _CELL + _GAP, inner_m, 2.0 if inner_m < 10 else 5.0),
        ):
            canvas = _drawn(step, alone, truth, _CELL, square=Square(x, y, half_m), outlined=True)
            _show(figure, canvas, (left, bottom, _CELL), tick_m=tick_m)
            drawn.append(canvas)
        _write(figure, _MAP_LEFT, bottom + _CELL + 8, canvas.facts[-1], fontsize=10)
        bottom -= _GAP
    longest = max(drawn, key=lambda canvas: len(canvas.key))
    _legend(figure, [longest], _MAP_LEFT, _KEY, ncols=5, columnspacing=1.6)
    return figure


_TILE, _SPACE, _HEAD = 400, 16, 58  # pixels: side of a panel, between two, for the title of the sheet
_TILE_TITLE = 26


def overview(explained: ExplainedKeyframe, truth: GroundTruth | None) -> Figure:
    """Draw all steps side by side, and in the eighth place a scale, the key of all panels, the detections."""
    width, height = 4 * _TILE + 5 * _SPACE, _HEAD + 2 * (_TILE + _TILE_TITLE + _SPACE)
    figure = _sheet(width, height)
    _entitle_sheet(figure, _SPACE, "From road points to intersections", explained)
    places = [
        (_SPACE + (i % 4) * (_TILE + _SPACE), height - _HEAD - (i // 4 + 1) * (_TILE + _TILE_TITLE + _SPACE) + _SPACE)
        for i in range(8)
    ]
    drawn = []
    for step, (left, bottom) in zip(STEPS, places, strict=False):
        canvas = _drawn(step, explained, truth, _TILE)
        axes = _show(figure, canvas, (left, bottom, _TILE), tick_m=_TICK_M)
        axes.tick_params(labelbottom=False, labelleft=False)
        entitle(axes, f"{step.number}  {step.title}", 11.0)
        drawn.append(canvas)
    left, bottom = places[-1]
    _legend(figure, drawn, left + 6, bottom + _TILE, fontsize=7.5, ncols=2, columnspacing=0.8, handletextpad=0.5)
    facts = []
    for number, i in [(each.number, i) for each in explained.kept for i in each.detections]:
        ahead, aside = explained.detections.lidar_xy[i]
        count = explained.steps.junctions[i].branches.count
        facts.append(f"{number:>2}   x {ahead:.1f} m, y {aside:.1f} m, {count} branches")
    facts = ["intersections (x ahead, y to the left):", *facts] if facts else ["no intersections"]
    _write(figure, left + 10, bottom + 44, "\n".join(facts), fontsize=9, linespacing=1.5)
    _draw_scale(figure, left + 10, bottom + 7, _TILE / (2.0 * drawn[0].square.half_m))
    return figure


def _draw_scale(figure: Figure, left: float, bottom: float, px_per_m: float) -> None:
    axes = _add_axes(figure, left, bottom, 20.0 * px_per_m, 4.0)
    axes.set(xticks=[], yticks=[], facecolor=INK)
    axes.spines[:].set_visible(False)
    _write(figure, left + 10.0 * px_per_m, bottom + 8, "20 m", fontsize=9, ha="center", va="bottom")


def _drawn(
    step: Step,
    explained: ExplainedKeyframe,
    truth: GroundTruth | None,
    side_px: int,
    *,
    square: Square | None = None,
    outlined: bool = False,
) -> Canvas:
    """Draw a step, and what every picture has: the map, where there is one, and the vehicle."""
    canvas = Canvas(explained, _FINER * side_px, square=square, px_per_m=_FINER * PX_PER_M, background=PAPER)
    for draw in step.ground:
        draw(canvas, explained)
    if truth is not None:
        steps.osm(canvas, truth)
    steps.vehicle(canvas, explained, outlined=outlined)
    for draw in step.marks:
        draw(canvas, explained)
    return canvas


def _show(figure: Figure, canvas: Canvas, place: tuple[float, float, int], *, tick_m: float) -> Axes:
    """Add a drawn canvas at left, bottom, side in pixels, in metres along the axes of W, with its notes."""
    from matplotlib.patheffects import withStroke  # noqa: PLC0415 - slow to import

    left, bottom, side = place
    axes = _add_axes(figure, left, bottom, side, side)
    axes.imshow(canvas.smooth(side), extent=canvas.square.extent, interpolation="nearest")
    x, y, half_m = canvas.square
    for axis, middle in ((axes.xaxis, x), (axes.yaxis, y)):
        first, last = math.ceil((middle - half_m) / tick_m), math.floor((middle + half_m) / tick_m)
        axis.set_ticks([tick_m * i for i in range(first, last + 1)])
    axes.tick_params(labelsize=8, color=MUTED, labelcolor=INK, length=3)
    axes.spines[:].set_color(MUTED)
    for xy, text in canvas.notes:  # towards the middle of the picture
        flip = xy[0] > x + half_m - 8.0
        axes.annotate(
            text,
            (xy[0], xy[1]),
            xytext=(-9 if flip else 9, 6),
            textcoords="offset points",
            ha="right" if flip else "left",
            fontsize=11,
            weight="bold",
            color=INK,
            path_effects=[withStroke(linewidth=3, foreground=PAPER)],
        )
    return axes


def _sheet(width: int, height: int) -> Figure:
    figure = new_figure(width / _DPI, height / _DPI)
    figure.set_layout_engine("none")
    return figure


def _add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place given in pixels from the lower left corner."""
    w, h = figure.get_size_inches() * _DPI
    return figure.add_axes((left / w, bottom / h, width / w, height / h))


def _write(figure: Figure, left: float, bottom: float, text: str, **style: Any) -> None:  # noqa: ANN401 - matplotlib's
    """Write a text at a place given in pixels from the lower left corner."""
    w, h = figure.get_size_inches() * _DPI
    figure.text(left / w, bottom / h, text, parse_math=False, **{"color": INK} | style)


def _entitle_sheet(figure: Figure, left: float, title: str, explained: ExplainedKeyframe) -> None:
    """Write the name of the sheet, and below it what it is of, into the upper left corner."""
    frame, count = explained.keyframe.frame, len(explained.window)
    parts = [
        f"scan {frame}" + ("" if explained.asked == frame else f" (nearest keyframe to {explained.asked})"),
        f"keyframe {explained.number + 1} of {explained.keyframe_count}",
        f"{count} {'keyframe' if count == 1 else 'keyframes'} in the window",
        f"preset {explained.config.preset}",
    ]
    top = float(figure.get_size_inches()[1]) * _DPI
    _write(figure, left, top - 10, title, fontsize=14, va="top", weight="bold")
    _write(figure, left, top - 34, "   ·   ".join(parts), fontsize=9, color=MUTED, va="top")


def _legend(figure: Figure, drawn: Sequence[Canvas], left: float, top: float, **options: Any) -> None:  # noqa: ANN401
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
        labelspacing=0.7,
        **{"frameon": False, "fontsize": 9, "labelcolor": INK, "borderpad": 0, "borderaxespad": 0} | options,
    )
