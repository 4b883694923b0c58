"""The steps of the candidate detection, a picture each (paper, Fig. 2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array
from interloc.detection.image import Roi
from interloc.drawing import BLUE, INK, MUTED, PAPER, VERMILION
from interloc.explain.evidence import Evidence, WindowScan
from interloc.explain.record import pixels
from interloc.explain.sheet import extent, is_set, paint, swatch

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    swatch(axes, CLOSED, "road: gap filled by closing")
    swatch(axes, VERMILION, "cell removed by opening")
    config, area_m2 = evidence.config.occupancy, evidence.roi.resolution_m**2
    return [
        f"{road.sum() * area_m2:,.0f} m² of road",
        f"closing {config.closing_m:g} m, opening {config.opening_m:g} m",
    ]


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
