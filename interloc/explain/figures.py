"""The figures: a step each, the refinement of every intersection, and all of them on one sheet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from interloc.drawing import INK, MUTED
from interloc.explain import panels, sheet
from interloc.explain.candidate_panel import candidates
from interloc.explain.evidence import Evidence
from interloc.explain.ground_truth import GroundTruth
from interloc.explain.refinement_panel import describe, draw_intersection, refinement
from interloc.explain.verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OSM = "#6a2c91"
_REFINEMENT = "Branch-based refinement"


@dataclass(frozen=True)
class Step:
    """One step: its file, its name in the paper, and how it is drawn (returning what to say about it)."""

    number: int
    file: str
    title: str
    draw: Callable[[Axes, Evidence], list[str]]


STEPS = (
    Step(1, "1_road_points.png", "Road point segmentation", panels.road_points),
    Step(2, "2_panoramic_scan.png", "Keyframe concatenation", panels.panoramic_scan),
    Step(3, "3_bev.png", "BEV projection", panels.bev),
    Step(4, "4_occupancy.png", "Road occupancy inference", panels.occupancy),
    Step(5, "5_centerline.png", "Road centerline extraction", panels.centerline),
    Step(6, "6_candidates.png", "Intersection candidate detection", candidates),
)


def step_figure(step: Step, evidence: Evidence, truth: GroundTruth | None) -> Figure:
    """Draw one step over the whole region of interest, its key and numbers beside it."""
    figure = sheet.sheet(sheet.WIDTH, sheet.HEIGHT)
    sheet.title(figure, f"{step.number}  {step.title}", _subtitle(evidence))
    axes = sheet.add_axes(figure, sheet.MAP_LEFT, sheet.MAP_BOTTOM, sheet.MAP_SIDE, sheet.MAP_SIDE)
    facts = step.draw(axes, evidence)
    _finish(axes, evidence, truth)
    sheet.frame_map(axes, evidence)
    sheet.write_key(figure, axes, facts)
    return figure


_CELL, _GAP, _TEXT = 494, 46, 26  # pixels: side of a view, between two, for the text above
_TOP, _KEY = 56, 76  # for the title and the key


def refinement_figure(evidence: Evidence, truth: GroundTruth | None) -> Figure:
    """Draw each intersection in a row: as far as its outer circle, and its inner circle enlarged."""
    kept = [v for v in evidence.verdicts if v.is_kept]
    if not kept:
        return step_figure(Step(7, "", _REFINEMENT, refinement), evidence, truth)
    row = _CELL + _TEXT + _GAP
    height = _TOP + len(kept) * row + _KEY
    figure = sheet.sheet(sheet.WIDTH, height)
    sheet.title(figure, f"7  {_REFINEMENT}", _subtitle(evidence))
    most = max(kept, key=lambda v: v.branches.count)
    for i, verdict in enumerate(kept):
        bottom = height - _TOP - i * row - _TEXT - _CELL
        figure.text(
            sheet.MAP_LEFT / sheet.WIDTH,
            (bottom + _CELL + 8) / height,
            describe(evidence, verdict),
            fontsize=10,
            color=INK,
        )
        wide = _view(figure, evidence, truth, verdict, left=sheet.MAP_LEFT, bottom=bottom, zoomed=False)
        _view(figure, evidence, truth, verdict, left=sheet.MAP_LEFT + _CELL + _GAP, bottom=bottom, zoomed=True)
        if verdict is most:
            sheet.legend(figure, [wide], sheet.MAP_LEFT / sheet.WIDTH, _KEY / height, ncols=5, columnspacing=1.6)
    return figure


def _view(
    figure: Figure,
    evidence: Evidence,
    truth: GroundTruth | None,
    verdict: Verdict,
    *,
    left: float,
    bottom: float,
    zoomed: bool,
) -> Axes:
    axes = sheet.add_axes(figure, left, bottom, _CELL, _CELL)
    panels.backdrop(axes, evidence)
    draw_intersection(axes, evidence, verdict)
    _finish(axes, evidence, truth, outlined=True)
    x, y = evidence.around(verdict.position[0], verdict.position[1])
    if zoomed:
        half_m = max(1.3 * verdict.branches.inner * evidence.roi.resolution_m, 5.0)
        sheet.frame_square(axes, x, y, half_m, tick_m=2.0 if half_m < 10 else 5.0)
    else:
        sheet.frame_square(axes, x, y, evidence.config.branches.outer_radius_m + 3.0, tick_m=10.0)
    return axes


_TILE, _SPACE, _HEAD = 400, 16, 58  # pixels: side of a panel, between two, for the title of the sheet
_TILE_TITLE = 26


def overview(evidence: Evidence, truth: GroundTruth | None) -> Figure:
    """Draw all steps side by side."""
    width, height = 4 * _TILE + 5 * _SPACE, _HEAD + 2 * (_TILE + _TILE_TITLE + _SPACE)
    figure = sheet.sheet(width, height)
    figure.text(
        _SPACE / width,
        1 - 10 / height,
        "From road points to intersections",
        fontsize=14,
        va="top",
        color=INK,
        weight="bold",
    )
    figure.text(
        _SPACE / width, 1 - 34 / height, _subtitle(evidence), fontsize=9, color=MUTED, va="top", parse_math=False
    )
    steps = (*STEPS, Step(7, "", _REFINEMENT, refinement))
    drawn = []
    for i, step in enumerate(steps):
        left = _SPACE + (i % 4) * (_TILE + _SPACE)
        bottom = height - _HEAD - (i // 4 + 1) * (_TILE + _TILE_TITLE + _SPACE) + _SPACE
        axes = sheet.add_axes(figure, left, bottom, _TILE, _TILE)
        step.draw(axes, evidence)
        _finish(axes, evidence, truth)
        sheet.frame_map(axes, evidence, labels=False)
        axes.set_title(f"{step.number}  {step.title}", loc="left", fontsize=11, color=INK, pad=6)
        drawn.append(axes)
    _overview_key(figure, evidence, drawn, left + _TILE + _SPACE, bottom)
    return figure


def _overview_key(figure: Figure, evidence: Evidence, panels_drawn: list[Axes], left: float, bottom: float) -> None:
    """Fill the eighth place: a scale, the key of all panels, the detections."""
    width, height = figure.get_size_inches() * sheet.DPI
    axes = sheet.add_axes(figure, left, bottom, _TILE, _TILE)
    sheet.frame_map(axes, evidence, labels=False)
    axes.set_axis_off()
    x, _, y, _ = sheet.extent(evidence)
    sheet.scale_bar(axes, x + 4.0, y + 2.0, 20.0)
    place = ((left + 6) / width, (bottom + _TILE) / height)
    sheet.legend(figure, panels_drawn, *place, fontsize=7.5, ncols=2, columnspacing=0.8, handletextpad=0.5)
    facts = ["intersections (x ahead, y to the left):"]
    for number, i in [(verdict.number, i) for verdict in evidence.verdicts for i in verdict.detections]:
        ahead, aside = evidence.detections.lidar_xy[i]
        count = evidence.steps.junctions[i].branches.count
        facts.append(f"{number:>2}   x {ahead:.1f} m, y {aside:.1f} m, {count} branches")
    if len(facts) == 1:
        facts = ["no intersections"]
    figure.text((left + 10) / width, (bottom + 44) / height, "\n".join(facts), fontsize=9, color=INK, linespacing=1.5)


def _finish(axes: Axes, evidence: Evidence, truth: GroundTruth | None, *, outlined: bool = False) -> None:
    """Add what every picture has: the map, where there is one, and the vehicle."""
    if truth is not None:
        panels.draw_lines(
            axes, truth.roads, color=_OSM, linewidth=1.0, label=f"OSM road (policy {truth.policy})", zorder=6
        )
        axes.plot(
            *truth.nodes.T,
            linestyle="none",
            marker="s",
            markersize=12,
            fillstyle="none",
            color=_OSM,
            markeredgewidth=1.8,
            zorder=7,
            label="OSM intersection",
        )
    sheet.mark_vehicle(axes, evidence, outlined=outlined)


def _subtitle(evidence: Evidence) -> str:
    config, frame = evidence.config, evidence.keyframe.frame
    asked = "" if evidence.asked == frame else f" (nearest keyframe to {evidence.asked})"
    count = len(evidence.window)
    parts = [
        f"scan {frame}{asked}",
        f"keyframe {evidence.number + 1} of {evidence.keyframe_count}",
        f"{count} {'keyframe' if count == 1 else 'keyframes'} in the window",
        f"preset {config.preset}",
    ]
    return "   ·   ".join(parts)
