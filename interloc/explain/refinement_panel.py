"""The branches of each intersection and the point where they meet (paper, Fig. 5)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from interloc.arrays import FloatArray
from interloc.drawing import BLUE, GREEN, INK, MUTED, PURPLE, SKY, VERMILION
from interloc.explain.candidate_panel import label_points
from interloc.explain.evidence import Evidence
from interloc.explain.panels import backdrop, draw_lines, segments
from interloc.explain.verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BRANCH_COLOURS = (BLUE, "#E69F00", GREEN, VERMILION, "#7a5c00", INK)


def refinement(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw all intersections of the region (paper, III-C)."""
    backdrop(axes, evidence)
    kept = [v for v in evidence.verdicts if v.is_kept]
    for verdict in kept:
        draw_intersection(axes, evidence, verdict)
    label_points(axes, evidence, kept)
    return [describe(evidence, v) for v in kept] or ["no candidate became an intersection"]


def describe(evidence: Evidence, verdict: Verdict) -> str:
    """Say in a line what the refinement did."""
    metre = evidence.roi.resolution_m
    parts = []
    for i in verdict.detections:
        junction = evidence.steps.junctions[i]
        if not math.isfinite(junction.residual):
            parts.append("the lines do not fix a point, the candidate stays")
            continue
        moved_m = float(np.hypot(*(junction.position - verdict.position))) * metre
        parts.append(f"moved {moved_m:.2f} m, lines pass within {junction.residual * metre:.2f} m (rms)")
    split = "" if len(parts) == 1 else f", split into {len(parts)}"
    without = int((verdict.branches.weights <= 0).sum())
    lineless = f" ({without} too short for a line)" if without else ""
    return f"Candidate {verdict.number}: {verdict.branches.count} branches{lineless}{split}; {'; '.join(parts)}"


def draw_intersection(axes: Axes, evidence: Evidence, verdict: Verdict, *, scale: float = 1.0) -> None:
    """Draw circles, branches, their lines, the candidate and the refined point."""
    from matplotlib.patches import Circle  # noqa: PLC0415 - slow to import

    metre = evidence.roi.resolution_m
    here = evidence.around(verdict.position[0], verdict.position[1])
    outer_m = evidence.config.branches.outer_radius_m
    inner_m = verdict.branches.inner * metre
    for radius, style, name in ((inner_m, "-", "inner circle"), (outer_m, (0, (1, 2)), "outer circle")):
        axes.add_patch(Circle((here[0], here[1]), radius, fill=False, edgecolor=MUTED, linestyle=style, zorder=2))
        axes.plot([], [], color=MUTED, linewidth=1.0, linestyle=style, label=name)
    inside = np.zeros(len(evidence.steps.centerline.rows), np.bool_)
    branches = [piece for piece in verdict.pieces if piece.is_branch]
    for i, piece in enumerate(branches):
        inside[:] = False
        inside[piece.pixels] = True
        colour = BRANCH_COLOURS[i % len(BRANCH_COLOURS)]
        draw_lines(axes, segments(evidence, inside), color=colour, linewidth=3.2 * scale, label=f"branch {i + 1}")
    for i, ends in enumerate(branch_lines(evidence, verdict)):
        axes.plot(*ends.T, color=INK, linewidth=1.2 * scale, linestyle=(0, (4, 3)), zorder=5)
        if i == 0:
            axes.plot([], [], color=INK, linewidth=1.2, linestyle=(0, (4, 3)), label="line of a branch")
    refined = np.array([evidence.steps.junctions[i].position for i in verdict.detections])
    points = (
        (here[None], "o", SKY, 9, "candidate"),
        (evidence.around(refined[:, 0], refined[:, 1]), "*", PURPLE, 15, "refined point"),
    )
    for place, marker, colour, size, name in points:
        axes.plot(
            *place.T,
            linestyle="none",
            marker=marker,
            markersize=size * scale,
            markerfacecolor=colour,
            markeredgecolor=INK,
            markeredgewidth=0.9,
            zorder=9,
            label=name,
        )


def branch_lines(evidence: Evidence, verdict: Verdict) -> list[FloatArray]:
    """Return the ends, (2, 2), of the lines: from a little behind the refined point to the end of the branch."""
    lines = []
    for i in verdict.detections:
        junction = evidence.steps.junctions[i]
        branches = junction.branches
        for k in np.flatnonzero(branches.weights > 0):
            point, outwards = branches.points[k], branches.directions[k]
            middle = point + ((junction.position - point) @ outwards) * outwards
            far = point + (branches.reaches[k] - (point - verdict.position) @ outwards) * outwards
            ends = np.stack([middle - 0.7 * branches.inner * outwards, far])
            lines.append(evidence.around(ends[:, 0], ends[:, 1]))
    return lines
