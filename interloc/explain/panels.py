"""The panels: what one step of the method did, drawn with matplotlib on a square of W around the vehicle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array
from interloc.config import HarrisCandidates
from interloc.detection.candidates import harris_corners
from interloc.detection.image import BinaryImage, Roi
from interloc.drawing import BLUE, GREEN, INK, MUTED, PAPER, PURPLE, SKY, VERMILION, YELLOW, new_figure
from interloc.explain.evidence import Evidence, Verdict, WindowScan
from interloc.explain.record import pixels
from interloc.geometry import rotate_2d

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# --- the sheet: a square of W, a key beside it -----------------------------------------------------------------------

DPI = 100
WIDTH, HEIGHT = 1120, 860  # pixels: a picture fits a laptop screen at 100 %
MAP_LEFT, MAP_BOTTOM, MAP_SIDE = 66, 54, 750  # one cell of the usual image is one pixel
_KEY_LEFT = MAP_LEFT + MAP_SIDE + 18
_TICK_M = 20.0
_CAR_M = np.array([[3.4, 0.0], [-2.2, 1.9], [-1.0, 0.0], [-2.2, -1.9]])  # an arrow head as long as a car, in L


def sheet(width: int, height: int) -> Figure:
    """Return an empty figure of a size in pixels whose axes are placed by hand."""
    figure = new_figure(width / DPI, height / DPI)
    figure.set_layout_engine("none")
    return figure


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place given in pixels from the lower left corner."""
    w, h = figure.get_size_inches() * DPI
    return figure.add_axes((left / w, bottom / h, width / w, height / h))


def title(figure: Figure, text: str, subtitle: str) -> None:
    """Write the name of the picture, and below it what it is of, into the upper left corner."""
    w, h = figure.get_size_inches() * DPI
    figure.text(MAP_LEFT / w, 1 - 10 / h, text, fontsize=14, color=INK, va="top", weight="bold")
    figure.text(MAP_LEFT / w, 1 - 34 / h, subtitle, fontsize=9, color=MUTED, va="top", parse_math=False)


def frame_map(axes: Axes, evidence: Evidence, *, labels: bool = True) -> None:
    """Lay the region of interest out in metres along the axes of W, the vehicle in the origin."""
    left, right, bottom, top = extent(evidence)
    frame_square(axes, (left + right) / 2, (bottom + top) / 2, (right - left) / 2, tick_m=_TICK_M)
    if labels:
        axes.set_xlabel("x of W, from the vehicle [m]", fontsize=9, color=INK)
        axes.set_ylabel("y of W, from the vehicle [m]", fontsize=9, color=INK, labelpad=0)
    else:
        axes.tick_params(labelbottom=False, labelleft=False)


def frame_square(axes: Axes, x: float, y: float, half_m: float, *, tick_m: float) -> None:
    """Show a square of the map, with a tick every so many metres."""
    axes.set(xlim=(x - half_m, x + half_m), ylim=(y - half_m, y + half_m), aspect="equal")
    for axis, middle in ((axes.xaxis, x), (axes.yaxis, y)):
        first, last = math.ceil((middle - half_m) / tick_m), math.floor((middle + half_m) / tick_m)
        axis.set_ticks([tick_m * i for i in range(first, last + 1)])
    axes.tick_params(labelsize=8, color=MUTED, labelcolor=INK, length=3)
    axes.spines[:].set_color(MUTED)


def extent(evidence: Evidence) -> tuple[float, float, float, float]:
    """Return left, right, bottom, top of the region of interest, metres from the vehicle."""
    roi = evidence.roi
    left, top = evidence.around(np.array(-0.5), np.array(-0.5))
    side = roi.size * roi.resolution_m
    return left, left + side, top - side, top


def paint(axes: Axes, evidence: Evidence, layers: Sequence[tuple[BoolArray, str]]) -> None:
    """Draw (H, W) masks in a colour each, later ones on top."""
    from matplotlib.colors import to_rgb  # noqa: PLC0415 - slow to import

    picture = np.full((evidence.roi.size, evidence.roi.size, 3), 255, np.uint8)
    for mask, colour in layers:
        picture[mask] = np.round(255 * np.array(to_rgb(colour)))
    axes.imshow(picture, extent=extent(evidence), origin="upper", zorder=0)


def is_set(image: BinaryImage) -> BoolArray:
    """Return the set pixels of an image as (H, W) bool."""
    return image.to_array().astype(np.bool_)


def swatch(axes: Axes, colour: str, text: str) -> None:
    """Add a colour to the key."""
    axes.plot([], [], linestyle="none", marker="s", markersize=9, color=colour, label=text)


def vehicle_outline(evidence: Evidence) -> FloatArray:
    """Return the outline of the vehicle's mark, (4, 2), from the vehicle along the axes of W."""
    return rotate_2d(_CAR_M, evidence.yaw_rad)


def mark_vehicle(axes: Axes, evidence: Evidence, *, outlined: bool = False) -> None:
    """Draw the vehicle, pointing where it heads; as an outline where it must not hide what is below."""
    outline = vehicle_outline(evidence)
    face, edge = ("none", VERMILION) if outlined else (VERMILION, PAPER)
    axes.fill(*outline.T, facecolor=face, edgecolor=edge, linewidth=1.0 + outlined, zorder=8)
    axes.plot(
        [],
        [],
        linestyle="none",
        marker=">",
        markersize=9,
        markerfacecolor=face,
        markeredgecolor=VERMILION,
        label="vehicle and its heading",
    )


def write_key(figure: Figure, axes: Axes, facts: Sequence[str]) -> None:
    """Put the legend and some numbers beside the map, where they cover nothing."""
    w, h = figure.get_size_inches() * DPI
    legend(figure, [axes], _KEY_LEFT / w, (MAP_BOTTOM + MAP_SIDE) / h)
    figure.text(
        _KEY_LEFT / w,
        MAP_BOTTOM / h,
        "\n".join(facts),
        fontsize=9,
        color=INK,
        va="bottom",
        linespacing=1.5,
        parse_math=False,
    )


def legend(figure: Figure, drawn: Sequence[Axes], x: float, y: float, **options: Any) -> None:  # noqa: ANN401
    """Put the legend of some axes, each name once, with its upper left corner at a place of the figure."""
    entries: dict[str, Artist] = {}
    for axes in drawn:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
    style = {"frameon": False, "fontsize": 9, "labelcolor": INK, "borderpad": 0, "borderaxespad": 0} | options
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="upper left",
        bbox_to_anchor=(x, y),
        labelspacing=0.7,
        **style,
    )


def scale_bar(axes: Axes, x: float, y: float, length_m: float) -> None:
    """Draw a length from a place to the right."""
    axes.plot([x, x + length_m], [y, y], color=INK, linewidth=3, solid_capstyle="butt")
    axes.annotate(
        f"{length_m:g} m", (x + length_m / 2, y), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=9
    )


# --- the steps of the candidate detection (paper, Fig. 2) ------------------------------------------------------------

GROUND, ROAD = "#c3c8ce", "#dfe5ea"  # other ground points; the occupancy below what is drawn on it
CLOSED = "#a9c9e2"


def road_points(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw the road points of the keyframe's own scan, and the other ground faintly (paper, III-B.1)."""
    pose, points = evidence.keyframe.T_world_lidar, evidence.points
    left, right, bottom, top = extent(evidence)
    for xyz, colour, size, name in (
        (points.confusable, GROUND, 1.0, "other ground"),
        (points.road, BLUE, 1.4, "road point of this scan"),
    ):
        x, y = (xyz.astype(np.float64) @ pose[:2, :3].T).T
        shown = (x > left) & (x < right) & (y > bottom) & (y < top)
        axes.scatter(x[shown], y[shown], s=size, color=colour, linewidths=0, zorder=2)
        swatch(axes, colour, name)
    return [f"{points.road_count:,} road points", f"{len(points.confusable):,} points of other ground"]


def panoramic_scan(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw the road points of all keyframes of the window, coloured by keyframe (paper, III-B.2)."""
    from matplotlib import colormaps  # noqa: PLC0415 - slow to import
    from matplotlib.colors import to_hex  # noqa: PLC0415

    roi, config = evidence.roi, evidence.config.keyframes
    colours = colormaps["viridis"]
    near = [scan.age for scan in evidence.window if len(_in_roi(scan, roi)[0])]
    low, high = min(near, default=0), max(near, default=0)
    picture = np.full((roi.size, roi.size, 3), 255, np.uint8)

    def colour(age: int) -> tuple[float, float, float]:
        return colours(0.97 * (age - low) / max(high - low, 1))[:3]

    inside = 0
    for scan in sorted(evidence.window, key=lambda scan: -abs(scan.age)):  # the nearest keyframe on top
        rows, cols = _in_roi(scan, roi)
        inside += len(rows)
        picture[rows, cols] = np.round(255 * np.array(colour(scan.age)))
    axes.imshow(picture, extent=extent(evidence), origin="upper", zorder=0)
    for age in dict.fromkeys((low, -(-low // 2), 0, high // 2, high)):
        name = "this keyframe" if age == 0 else f"{abs(age)} keyframes {'later' if age > 0 else 'earlier'}"
        swatch(axes, to_hex(colour(age)), f"road point, {name}")
    track = np.array([scan.world_xy for scan in evidence.window]) - evidence.vehicle
    axes.plot(
        *track.T,
        linestyle="none",
        marker="o",
        markersize=4,
        markerfacecolor=PAPER,
        markeredgecolor=INK,
        markeredgewidth=0.8,
        zorder=6,
        label="LiDAR at a keyframe",
    )
    before = sum(scan.age < 0 for scan in evidence.window)
    return [
        f"window: {before} of {config.window} keyframes before,",
        f"{len(evidence.window) - before - 1} of {config.after} after",
        f"{len(near)} of them see this region",
        f"{inside:,} road points in the region",
    ]


def _in_roi(scan: WindowScan, roi: Roi) -> tuple[Int32Array, Int32Array]:
    """Return rows and columns of the road points of a scan that lie in the region of interest."""
    cols, rows = scan.cells[:, 0] - roi.left, roi.top - scan.cells[:, 1]
    shown = (cols >= 0) & (cols < roi.size) & (rows >= 0) & (rows < roi.size)
    return rows[shown], cols[shown]


def bev(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw the binary image (paper, III-B.3)."""
    image = evidence.steps.bev
    paint(axes, evidence, [(is_set(image), INK)])
    m, full = evidence.steps.min_points, evidence.config.bev.min_points
    points = "point" if m == 1 else "points"
    swatch(axes, INK, f"cell with {m} road {points} or more")
    metre = evidence.roi.resolution_m
    facts = [f"{pixels(image):,} of {image.height:,} x {image.width:,} cells", f"cells of {metre:g} m"]
    return facts if m == full else [*facts, f"m = {m}; {full} in a full window"]


def occupancy(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw the road, and what closing and opening did to make it (paper, III-B.4)."""
    cells, road = is_set(evidence.steps.bev), is_set(evidence.steps.occupancy)
    paint(axes, evidence, [(road, CLOSED), (road & cells, BLUE), (cells & ~road, VERMILION)])
    swatch(axes, BLUE, "road: cell of the BEV image")
    swatch(axes, CLOSED, "road: gap filled")
    swatch(axes, VERMILION, "cell removed by opening")
    config, area_m2 = evidence.config.occupancy, evidence.roi.resolution_m**2
    facts = [
        f"{road.sum() * area_m2:,.0f} m² of road",
        f"closing {config.closing_m:g} m, opening {config.opening_m:g} m",
    ]
    return [*facts, f"islands up to {config.island_m2:g} m²"] if config.island_m2 > 0 else facts


def centerline(axes: Axes, evidence: Evidence) -> list[str]:
    """Draw the axis of the road, and the dead ends that were dropped (paper, III-B.5)."""
    steps = evidence.steps
    paint(axes, evidence, [(is_set(steps.occupancy), ROAD)])
    swatch(axes, ROAD, "road")
    facts = []
    line = segments(evidence, np.ones(len(steps.centerline.rows), np.bool_))
    if evidence.config.centerline.spur_widths > 0:
        x, y = evidence.around(*steps.centerline.spurs.T.astype(np.float64)).T
        axes.scatter(x, y, s=5, marker="s", linewidths=0, color=VERMILION, zorder=3)
        axes.plot([], [], color=VERMILION, linewidth=2.2, label="dead end dropped: no road")
        facts = [f"dead ends up to {evidence.config.centerline.spur_widths:g} x road width dropped"]
    draw_lines(axes, line, color=INK, linewidth=1.8, label="centerline")
    length_m = float(np.hypot(*(line[:, 1] - line[:, 0]).T).sum())
    return [f"{length_m:,.0f} m of centerline", *facts]


def backdrop(axes: Axes, evidence: Evidence) -> None:
    """Draw road and centerline faintly, for what stands on them."""
    steps = evidence.steps
    paint(axes, evidence, [(is_set(steps.occupancy), ROAD)])
    line = segments(evidence, np.ones(len(steps.centerline.rows), np.bool_))
    draw_lines(axes, line, color=MUTED, linewidth=1.0, label="centerline")


def segments(evidence: Evidence, mask: BoolArray) -> FloatArray:
    """Return the joints, (S, 2, 2), between pixels of the centerline that are all in a (P,) mask."""
    line = evidence.steps.centerline
    place = evidence.around(line.rows.astype(np.float64), line.cols.astype(np.float64))
    here, which = np.nonzero((line.neighbours >= 0) & mask[:, None])
    there = line.neighbours[here, which]
    wanted = (there > here) & mask[there]
    joints: FloatArray = np.stack([place[here[wanted]], place[there[wanted]]], axis=1)
    return joints


def draw_lines(
    axes: Axes, lines: FloatArray, *, color: str, linewidth: float, label: str = "", zorder: int = 3
) -> None:
    """Draw (S, 2, 2) straight pieces, with one entry in the key."""
    from matplotlib.collections import LineCollection  # noqa: PLC0415 - slow to import

    axes.add_collection(
        LineCollection(list(lines), colors=color, linewidths=linewidth, capstyle="round", zorder=zorder),
        autolim=False,
    )
    if label:
        axes.plot([], [], color=color, linewidth=max(linewidth, 1.2), label=label)


# --- the candidates (paper, Fig. 2f) ---------------------------------------------------------------------------------

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


# --- the branches and the point where they meet (paper, Fig. 5) ------------------------------------------------------

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
    """Describe in one line what the refinement did."""
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
    without = int((~verdict.branches.has_line).sum())
    lineless = f" ({without} too short for a line)" if without else ""
    return f"Candidate {verdict.number}: {verdict.branches.count} branches{lineless}{split}; {'; '.join(parts)}"


def draw_intersection(axes: Axes, evidence: Evidence, verdict: Verdict) -> None:
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
        draw_lines(axes, segments(evidence, inside), color=colour, linewidth=3.2, label=f"branch {i + 1}")
    for i, ends in enumerate(branch_lines(evidence, verdict)):
        axes.plot(*ends.T, color=INK, linewidth=1.2, linestyle=(0, (4, 3)), zorder=5)
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
            markersize=size,
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
        for k in np.flatnonzero(branches.has_line):
            point, outwards = branches.lines["point"][k], branches.lines["direction"][k]
            middle = point + ((junction.position - point) @ outwards) * outwards
            far = point + (branches.reaches[k] - (point - verdict.position) @ outwards) * outwards
            ends = np.stack([middle - 0.7 * branches.inner * outwards, far])
            lines.append(evidence.around(ends[:, 0], ends[:, 1]))
    return lines
