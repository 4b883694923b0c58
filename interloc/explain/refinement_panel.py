"""The branches of each intersection and the point where they meet (paper, Fig. 5)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from interloc.evaluate.drawing import BLUE, GREEN, INK, MUTED, PURPLE, SKY, VERMILION
from interloc.explain.candidate_panel import label_points
from interloc.explain.evidence import Evidence
from interloc.explain.panels import backdrop, draw_lines, segments
from interloc.explain.sheet import Floats
from interloc.explain.verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BRANCHES = (BLUE, "#E69F00", GREEN, VERMILION, "#7a5c00", INK)


def refinement(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw all intersections of the region (paper, III-C)."""
    backdrop(axes, evidence)
    kept = [v for v in evidence.verdicts if v.detection is not None]
    for verdict in kept:
        draw_intersection(axes, evidence, verdict)
    label_points(axes, evidence, kept)
    return [describe(evidence, v) for v in kept] or ["no candidate became an intersection"]


def describe(evidence: Evidence, verdict: Verdict) -> str:
    """Say in a line what the refinement did."""
    assert verdict.detection is not None
    junction, metre = evidence.steps.junctions[verdict.detection], evidence.roi.resolution_m
    moved_m = float(np.hypot(*(junction.position - verdict.position))) * metre
    text = f"candidate {verdict.number}: {verdict.branches.count} branches, moved {moved_m:.2f} m"
    if math.isfinite(junction.residual):
        return f"{text}, lines pass within {junction.residual * metre:.2f} m (rms)"
    return f"{text}: lines nearly parallel, the candidate stays"


def draw_intersection(axes: Axes, evidence: Evidence, verdict: Verdict, *, scale: float = 1.0) -> None:
    """Draw circles, branches, their lines, the candidate and the refined point."""
    from matplotlib.patches import Circle  # noqa: PLC0415 - slow to import

    assert verdict.detection is not None
    junction, metre = evidence.steps.junctions[verdict.detection], evidence.roi.resolution_m
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
        colour = _BRANCHES[i % len(_BRANCHES)]
        draw_lines(axes, segments(evidence, inside), color=colour, linewidth=3.2 * scale, label=f"branch {i + 1}")
    for i, ends in enumerate(_lines(evidence, verdict)):
        axes.plot(*ends.T, color=INK, linewidth=1.2 * scale, linestyle=(0, (4, 3)), zorder=5)
        if i == 0:
            axes.plot([], [], color=INK, linewidth=1.2, linestyle=(0, (4, 3)), label="line of a branch")
    refined = evidence.around(junction.position[0], junction.position[1])
    points = ((here, "o", SKY, 9, "candidate"), (refined, "*", PURPLE, 15, "refined point"))
    for place, marker, colour, size, name in points:
        axes.plot(
            *place,
            linestyle="none",
            marker=marker,
            markersize=size * scale,
            markerfacecolor=colour,
            markeredgecolor=INK,
            markeredgewidth=0.9,
            zorder=9,
            label=name,
        )


def _lines(evidence: Evidence, verdict: Verdict) -> list[Floats]:
    """Return the ends, (2, 2), of the line of each branch: from a little behind the point to the end of the branch."""
    branches = verdict.branches
    assert verdict.detection is not None
    refined = evidence.steps.junctions[verdict.detection].position
    reaches = [piece.reach for piece in verdict.pieces if piece.is_branch]
    if len(reaches) != len(branches.points):  # a branch too short to have a line
        reaches = [max(reaches)] * len(branches.points)
    lines = []
    for point, normal, reach in zip(branches.points, branches.normals, reaches, strict=True):
        direction = np.array([-normal[1], normal[0]])
        middle = point + ((refined - point) @ direction) * direction
        outwards = direction if (point - verdict.position) @ direction >= 0 else -direction
        ends = np.stack([middle - 0.7 * branches.inner * outwards, middle + reach * outwards])
        lines.append(evidence.around(ends[:, 0], ends[:, 1]))
    return lines
