"""The figures: one per step, the refinement of every intersection, all of them on one sheet; and their files."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from interloc.config import DetectorConfig
from interloc.drawing import INK, MUTED, entitle, image, write_image
from interloc.drive import Drive
from interloc.explain import steps as panels
from interloc.explain.evidence import Evidence, GroundTruth, Verdict, gather, ground_truth
from interloc.explain.record import record
from interloc.files import atomic_folder, atomic_write
from interloc.osm.graph import RoadGraph
from interloc.osm.policies import Policy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


logger = logging.getLogger(__name__)

RECORD = "explain.json"
OVERVIEW, REFINEMENT = "overview.png", "7_refinement.png"


def explain(
    drive: Drive,
    frame: int,
    config: DetectorConfig,
    out: Path,
    *,
    graph: RoadGraph | None = None,
    policy: Policy = "drive",
) -> list[Path]:
    """Draw the steps of the method for the keyframe nearest to a scan number.

    Parameters
    ----------
    drive
    frame : int
        Scan number. The keyframe taken is named in the log, in the pictures and in ``explain.json``.
    config
    out
        Folder of the pictures, written whole or not at all; one of an earlier call is replaced.
    graph
        Roads of OpenStreetMap to draw on top, where the drive is georeferenced.
    policy
        Which of them are roads and ground truth.

    Returns
    -------
    list of Path
        The six steps of the paper's Fig. 2, the refinement of its Fig. 5, all of them on one sheet, and the numbers.

    Raises
    ------
    ConfigError
        The drive has no such scan; there is no such policy.
    DriveError
        The drive is empty, or a scan of the window is damaged.
    OutputError
        The folder is something else's, or writing failed; nothing is left behind.
    """
    evidence = gather(drive, frame, config)
    logger.info(
        "frame %d: keyframe %d of %d is scan %d, %d keyframes in its window",
        frame,
        evidence.number + 1,
        evidence.keyframe_count,
        evidence.keyframe.frame,
        len(evidence.window),
    )
    truth = None
    if graph is not None and drive.georeference is None:
        logger.warning("%s: without georeference the roads of OpenStreetMap cannot be drawn", drive.name)
    elif graph is not None and drive.georeference is not None:
        truth = ground_truth(evidence, drive.georeference, graph, policy)
    with atomic_folder(out, marker=RECORD) as folder:
        for step in STEPS:
            write_image(folder / step.file, image(step_figure(step, evidence, truth), "png", dpi=panels.DPI))
        write_image(folder / REFINEMENT, image(refinement_figure(evidence, truth), "png", dpi=panels.DPI))
        write_image(folder / OVERVIEW, image(overview(evidence, truth), "png", dpi=panels.DPI))
        with atomic_write(folder / RECORD) as handle:
            text = json.dumps(record(evidence, drive.name, truth), indent=2, allow_nan=False)
            handle.write(f"{text}\n".encode())
    return [out / name for name in (*(step.file for step in STEPS), REFINEMENT, OVERVIEW, RECORD)]


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
    Step(6, "6_candidates.png", "Intersection candidate detection", panels.candidates),
)


def step_figure(step: Step, evidence: Evidence, truth: GroundTruth | None) -> Figure:
    """Draw one step over the whole region of interest, its key and numbers beside it."""
    figure = panels.sheet(panels.WIDTH, panels.HEIGHT)
    panels.title(figure, f"{step.number}  {step.title}", _subtitle(evidence))
    axes = panels.add_axes(figure, panels.MAP_LEFT, panels.MAP_BOTTOM, panels.MAP_SIDE, panels.MAP_SIDE)
    facts = step.draw(axes, evidence)
    _finish(axes, evidence, truth)
    panels.frame_map(axes, evidence)
    panels.write_key(figure, axes, facts)
    return figure


_CELL, _GAP, _TEXT = 494, 46, 26  # pixels: side of a view, between two, for the text above
_TOP, _KEY = 56, 76  # for the title and the key


def refinement_figure(evidence: Evidence, truth: GroundTruth | None) -> Figure:
    """Draw each intersection in a row: as far as its outer circle, and its inner circle enlarged."""
    kept = [v for v in evidence.verdicts if v.is_kept]
    if not kept:
        return step_figure(Step(7, "", _REFINEMENT, panels.refinement), evidence, truth)
    row = _CELL + _TEXT + _GAP
    height = _TOP + len(kept) * row + _KEY
    figure = panels.sheet(panels.WIDTH, height)
    panels.title(figure, f"7  {_REFINEMENT}", _subtitle(evidence))
    most = max(kept, key=lambda v: v.branches.count)
    for i, verdict in enumerate(kept):
        bottom = height - _TOP - i * row - _TEXT - _CELL
        figure.text(
            panels.MAP_LEFT / panels.WIDTH,
            (bottom + _CELL + 8) / height,
            panels.describe(evidence, verdict),
            fontsize=10,
            color=INK,
        )
        wide = _view(figure, evidence, truth, verdict, left=panels.MAP_LEFT, bottom=bottom, zoomed=False)
        _view(figure, evidence, truth, verdict, left=panels.MAP_LEFT + _CELL + _GAP, bottom=bottom, zoomed=True)
        if verdict is most:
            panels.legend(figure, [wide], panels.MAP_LEFT / panels.WIDTH, _KEY / height, ncols=5, columnspacing=1.6)
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
    axes = panels.add_axes(figure, left, bottom, _CELL, _CELL)
    panels.backdrop(axes, evidence)
    panels.draw_intersection(axes, evidence, verdict)
    _finish(axes, evidence, truth, outlined=True)
    x, y = evidence.around(verdict.position[0], verdict.position[1])
    if zoomed:
        half_m = max(1.3 * verdict.branches.inner * evidence.roi.resolution_m, 5.0)
        panels.frame_square(axes, x, y, half_m, tick_m=2.0 if half_m < 10 else 5.0)
    else:
        panels.frame_square(axes, x, y, evidence.config.branches.outer_radius_m + 3.0, tick_m=10.0)
    return axes


_TILE, _SPACE, _HEAD = 400, 16, 58  # pixels: side of a panel, between two, for the title of the sheet
_TILE_TITLE = 26


def overview(evidence: Evidence, truth: GroundTruth | None) -> Figure:
    """Draw all steps side by side."""
    width, height = 4 * _TILE + 5 * _SPACE, _HEAD + 2 * (_TILE + _TILE_TITLE + _SPACE)
    figure = panels.sheet(width, height)
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
    steps = (*STEPS, Step(7, "", _REFINEMENT, panels.refinement))
    drawn = []
    for i, step in enumerate(steps):
        left = _SPACE + (i % 4) * (_TILE + _SPACE)
        bottom = height - _HEAD - (i // 4 + 1) * (_TILE + _TILE_TITLE + _SPACE) + _SPACE
        axes = panels.add_axes(figure, left, bottom, _TILE, _TILE)
        step.draw(axes, evidence)
        _finish(axes, evidence, truth)
        panels.frame_map(axes, evidence, labels=False)
        entitle(axes, f"{step.number}  {step.title}", 11.0)
        drawn.append(axes)
    _overview_key(figure, evidence, drawn, left + _TILE + _SPACE, bottom)
    return figure


def _overview_key(figure: Figure, evidence: Evidence, panels_drawn: list[Axes], left: float, bottom: float) -> None:
    """Fill the eighth place: a scale, the key of all panels, the detections."""
    width, height = figure.get_size_inches() * panels.DPI
    axes = panels.add_axes(figure, left, bottom, _TILE, _TILE)
    panels.frame_map(axes, evidence, labels=False)
    axes.set_axis_off()
    x, _, y, _ = panels.extent(evidence)
    panels.scale_bar(axes, x + 4.0, y + 2.0, 20.0)
    place = ((left + 6) / width, (bottom + _TILE) / height)
    panels.legend(figure, panels_drawn, *place, fontsize=7.5, ncols=2, columnspacing=0.8, handletextpad=0.5)
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
    panels.mark_vehicle(axes, evidence, outlined=outlined)


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
