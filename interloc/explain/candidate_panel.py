"""The candidates: corners or junctions, what was merged, what was kept (paper, Fig. 2f)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import HarrisCandidates
from interloc.detection.candidates import harris_corners
from interloc.drawing import BLUE, GREEN, INK, MUTED, PAPER, VERMILION, YELLOW
from interloc.explain.evidence import Evidence
from interloc.explain.panels import backdrop, draw_lines, segments
from interloc.explain.sheet import extent
from interloc.explain.verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BEST_CORNER_M = 2.6  # radius of the circle of the best score
_LISTED = 16


def candidates(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw what the candidates were made of, the candidates, and which of them became intersections."""
    backdrop(axes, evidence)
    if isinstance(evidence.config.candidates, HarrisCandidates):
        _draw_corners(axes, evidence, evidence.config.candidates)
    else:
        _draw_junctions(axes, evidence)
    _draw_merging(axes, evidence)
    _draw_short(axes, evidence)
    _draw_margin(axes, evidence)
    for kept in (True, False):
        _draw_candidates(axes, evidence, kept=kept)
    harris = isinstance(evidence.config.candidates, HarrisCandidates)
    facts = ["radius of a corner: its score,", "in per cent of the best one", ""] if harris else []
    rows = [f"{v.number:>2}  {v.why_not or _kept(v)}" for v in evidence.verdicts]
    rows = [part for row in rows for part in _wrapped(row)]
    more = [f"... {len(rows) - _LISTED} more lines: explain.json"] if len(rows) > _LISTED else []
    return [*facts, "candidates:", *rows[:_LISTED], *more] if rows else ["no candidates"]


def label_points(axes: Axes, evidence: Evidence, verdicts: list[Verdict]) -> None:
    """Write the number of each candidate beside it, towards the middle of the picture."""
    from matplotlib.patheffects import withStroke  # noqa: PLC0415 - slow to import

    right = extent(evidence)[1]
    for verdict in verdicts:
        x, y = evidence.around(verdict.position[0], verdict.position[1])
        flip = x > right - 8.0
        axes.annotate(
            str(verdict.number),
            (x, y),
            xytext=(-9 if flip else 9, 6),
            textcoords="offset points",
            ha="right" if flip else "left",
            fontsize=11,
            weight="bold",
            color=INK,
            path_effects=[withStroke(linewidth=3, foreground=PAPER)],
            zorder=10,
        )


def _draw_corners(axes: Axes, evidence: Evidence, config: HarrisCandidates) -> None:
    line = evidence.steps.centerline
    corners, scores = harris_corners(line, config.model_copy(update={"min_score": 0.0}))
    if not len(corners):
        return
    best = scores[corners].max()
    taken = scores[corners] >= config.min_score * best
    for mask, colour, name in (
        (~taken, YELLOW, f"Harris corner under {config.min_score:.0%}"),
        (taken, GREEN, "Harris corner taken"),
    ):
        chosen = corners[mask]
        place = evidence.around(line.rows[chosen].astype(np.float64), line.cols[chosen].astype(np.float64))
        _circles(axes, place, _BEST_CORNER_M * scores[chosen] / best, colour)
        axes.plot(
            [],
            [],
            linestyle="none",
            marker="o",
            markersize=9,
            markerfacecolor=colour,
            markeredgecolor=INK,
            markeredgewidth=0.6,
            label=name,
        )


def _circles(axes: Axes, place: FloatArray, radii: FloatArray, colour: str) -> None:
    from matplotlib.collections import EllipseCollection  # noqa: PLC0415 - slow to import

    sizes = np.maximum(2 * radii, 0.8)
    axes.add_collection(
        EllipseCollection(
            sizes,
            sizes,
            np.zeros(len(sizes)),
            units="xy",
            offsets=place,
            offset_transform=axes.transData,
            facecolors=colour,
            edgecolors=INK,
            linewidths=0.6,
            alpha=0.85,
            zorder=4,
        ),
        autolim=False,
    )


def _draw_junctions(axes: Axes, evidence: Evidence) -> None:
    points = np.concatenate([np.zeros((0, 2)), *(v.merged for v in evidence.verdicts)])
    axes.plot(
        *evidence.around(points[:, 0], points[:, 1]).T,
        linestyle="none",
        marker="s",
        markersize=4,
        markerfacecolor=YELLOW,
        markeredgecolor=INK,
        markeredgewidth=0.6,
        zorder=9.5,
        label="junction of the centerline",
    )


def _draw_merging(axes: Axes, evidence: Evidence) -> None:
    lines = [
        np.stack([evidence.around(point[0], point[1]), evidence.around(v.position[0], v.position[1])])
        for v in evidence.verdicts
        if len(v.merged) > 1
        for point in v.merged
    ]
    if lines:
        draw_lines(axes, np.array(lines), color=INK, linewidth=1.3, label="merged into one", zorder=5)


def _draw_short(axes: Axes, evidence: Evidence) -> None:
    """Mark what would have been a branch of a rejected candidate, were it longer."""
    short = np.zeros(len(evidence.steps.centerline.rows), np.bool_)
    for verdict in evidence.verdicts:
        for piece in verdict.pieces:
            short[piece.pixels] |= not verdict.is_kept and not piece.is_branch
    if short.any():
        draw_lines(axes, segments(evidence, short), color=VERMILION, linewidth=2.4, label="too short to be a branch")


def _draw_margin(axes: Axes, evidence: Evidence) -> None:
    """Draw the line beyond which candidates are left out, where there is one."""
    margin_m = evidence.config.branches.margin_m
    if margin_m > 0:
        left, right, bottom, top = extent(evidence)
        x, y = (left + margin_m, right - margin_m), (bottom + margin_m, top - margin_m)
        corners = ([x[0], x[1], x[1], x[0], x[0]], [y[0], y[0], y[1], y[1], y[0]])
        axes.plot(*corners, color=MUTED, linewidth=0.8, linestyle=(0, (6, 4)), zorder=2, label="no candidates beyond")


def _draw_candidates(axes: Axes, evidence: Evidence, *, kept: bool) -> None:
    chosen = [v for v in evidence.verdicts if v.is_kept == kept]
    marker, colour, name = ("o", BLUE, "candidate kept") if kept else ("X", VERMILION, "candidate rejected")
    points = np.array([v.position for v in chosen]).reshape(-1, 2)
    axes.plot(
        *evidence.around(points[:, 0], points[:, 1]).T,
        linestyle="none",
        markeredgecolor=PAPER,
        markeredgewidth=1.0,
        zorder=9 if kept else 9.8,
        marker=marker,
        markersize=9 if kept else 11,
        color=colour,
        label=name,
    )
    label_points(axes, evidence, chosen)


def _kept(verdict: Verdict) -> str:
    split = len(verdict.detections)
    return f"{verdict.branches.count} branches: " + ("kept" if split == 1 else f"split into {split} intersections")


def _wrapped(row: str) -> list[str]:
    first, _, rest = row.partition("; ")
    return [first, f"      {rest}"] if rest else [first]
