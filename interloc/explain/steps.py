"""What each step of the method draws, and what it says beside that (paper, Fig. 2 and 5)."""

from collections.abc import Callable

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array
from interloc.config import HarrisCandidates
from interloc.detection.candidates import harris_corners
from interloc.detection.image import BinaryImage, Roi
from interloc.drawing import BLUE, GREEN, INK, MUTED, PAPER, PURPLE, SKY, VERMILION, YELLOW
from interloc.explain.canvas import Canvas
from interloc.explain.evidence import ExplainedCandidate, ExplainedKeyframe, GroundTruth, WindowScan
from interloc.geometry import rotate_2d

Draw = Callable[[Canvas, ExplainedKeyframe], None]
"""Draws a part of a step; sizes are metres of a picture of the whole region."""

GROUND, ROAD, CLOSED = "#c3c8ce", "#dfe5ea", "#a9c9e2"  # other ground points; road below what is drawn on it; gaps
OSM = "#6a2c91"
BRANCH_COLOURS = (BLUE, "#E69F00", GREEN, VERMILION, "#7a5c00", INK)

_CAR_M = np.array([[3.4, 0.0], [-2.2, 1.9], [-1.0, 0.0], [-2.2, -1.9]])  # an arrow head as long as a car, in L
_DASHES = (1.1, 0.8)
_BENT = 9  # places of a line that bends
_SHADES = 64
_BEST_CORNER_M = 2.6  # radius of the circle of the best score


# --- the steps of the candidate detection (paper, Fig. 2) ------------------------------------------------------------


def road_points(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the road points of the keyframe's own scan, and the other ground faintly (paper, III-B.1)."""
    pose, points = explained.keyframe.T_world_lidar, explained.points
    for xyz, colour, name in (
        (points.confusable, GROUND, "other ground"),
        (points.road, BLUE, "road point of this scan"),
    ):
        canvas.dots(xyz.astype(np.float64) @ pose[:2, :3].T, colour, 0.24, name)


def panoramic_scan(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the road points of all keyframes of the window, coloured by keyframe (paper, III-B.2)."""
    from matplotlib import colormaps  # noqa: PLC0415 - slow to import
    from matplotlib.colors import to_hex  # noqa: PLC0415

    roi, window = explained.roi, explained.window
    in_roi = {scan.age: _in_roi(scan, roi) for scan in window}
    near = [age for age, (rows, _) in in_roi.items() if len(rows)]
    low, high = min(near, default=0), max(near, default=0)

    def shade(age: int) -> int:
        return min(max(round(_SHADES * (age - low) / max(high - low, 1)), 0), _SHADES)

    colours = [to_hex(colormaps["viridis"](0.97 * i / _SHADES)) for i in range(_SHADES + 1)]
    numbers = np.zeros((roi.size, roi.size), np.uint8)
    for age in sorted(near, key=lambda age: -abs(age)):  # the nearest keyframe on top
        numbers[in_roi[age]] = 1 + shade(age)
    canvas.paint(numbers, colours)
    for age in dict.fromkeys((low, -(-low // 2), 0, high // 2, high)):
        name = "this keyframe" if age == 0 else f"{abs(age)} keyframes {'later' if age > 0 else 'earlier'}"
        canvas.swatch(colours[shade(age)], f"road point, {name}")
    track = np.array([scan.world_xy for scan in window]) - explained.vehicle
    canvas.mark("disc", track, PAPER, 0.35, "LiDAR at a keyframe", edge=INK)


def _in_roi(scan: WindowScan, roi: Roi) -> tuple[Int32Array, Int32Array]:
    places: Int32Array = np.round(roi.image((scan.cells.astype(np.float64) + 0.5) * roi.resolution_m)).astype(np.int32)
    rows, cols = places.T
    shown = (cols >= 0) & (cols < roi.size) & (rows >= 0) & (rows < roi.size)
    return rows[shown], cols[shown]


def bev(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the binary image (paper, III-B.3)."""
    m = explained.steps.min_points
    canvas.fill(_is_set(explained.steps.bev), INK, f"cell with {m} road {'point' if m == 1 else 'points'} or more")


def occupancy(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the road, and what closing and opening did to make it (paper, III-B.4)."""
    cells, road = _is_set(explained.steps.bev), _is_set(explained.steps.occupancy)
    canvas.fill(road & cells, BLUE, "road: cell of the BEV image")
    canvas.fill(road & ~cells, CLOSED, "road: gap filled")
    canvas.fill(cells & ~road, VERMILION, "cell removed by opening")


def centerline(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the axis of the road, and the dead ends that were dropped (paper, III-B.5)."""
    line = _joints(explained)
    if explained.config.centerline.spur_widths > 0:
        gone = explained.around(explained.steps.centerline.spurs.astype(np.float64))
        canvas.dots(gone, VERMILION, 0.35, "dead end dropped: no road")
    canvas.lines(line, INK, 0.35, "centerline")


def road(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the road faintly, for what stands on it."""
    canvas.fill(_is_set(explained.steps.occupancy), ROAD, "road")


def road_cells(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the road faintly, its cells of the BEV image a little darker."""
    road(canvas, explained)
    canvas.fill(_is_set(explained.steps.bev) & _is_set(explained.steps.occupancy), CLOSED)


def faint_centerline(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the centerline faintly, for what stands on it."""
    canvas.lines(_joints(explained), MUTED, 0.25, "centerline")


# --- the candidates (paper, Fig. 2f) ---------------------------------------------------------------------------------


def corners(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the Harris corners of the centerline by their scores, where candidates are made of them."""
    line, config = explained.steps.centerline, explained.config.candidates
    if not isinstance(config, HarrisCandidates):
        return
    found, scores = harris_corners(line, config.model_copy(update={"min_score": 0.0}))
    best = max(scores[found], default=0.0)
    for corner in found[np.argsort(scores[found], kind="stable")].tolist():
        is_taken = scores[corner] >= config.min_score * best
        place = explained.around(np.array([line.rows[corner], line.cols[corner]], np.float64))
        radius_m = max(_BEST_CORNER_M * scores[corner] / best, 0.4)
        canvas.disc(place, radius_m, GREEN if is_taken else YELLOW, edge=INK)
    if len(found):
        for colour, name in ((YELLOW, f"under {config.min_score:.0%}"), (GREEN, "taken")):
            canvas.swatch(colour, f"Harris corner {name}", "o", markeredgecolor=INK)


def margin(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the line beyond which no intersection is found, where there is one."""
    margin_m = explained.config.branches.margin_m
    if margin_m > 0:
        low = margin_m / explained.roi.resolution_m - 0.5
        high = explained.roi.size - 1 - low
        edges = explained.around(np.array([[low, low], [low, high], [high, high], [high, low], [low, low]]))
        pieces = np.stack([edges[:-1], edges[1:]], axis=1)
        canvas.lines(pieces, MUTED, 0.2, "no intersections beyond", dashes=_DASHES)


def short_branches(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Mark what would have been a branch of a rejected candidate, were it longer."""
    short = [
        piece.pixels
        for each in explained.candidates
        if not each.is_kept
        for piece in each.pieces
        if not piece.is_branch
    ]
    if short:
        canvas.lines(_joints(explained, np.concatenate(short)), VERMILION, 0.5, "too short to be a branch")


def candidates(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw what the candidates were made of, the candidates, and which of them became intersections."""
    harris = isinstance(explained.config.candidates, HarrisCandidates)
    for each in explained.candidates:
        if len(each.merged) > 1:
            ends = np.stack([each.merged, np.broadcast_to(each.position, each.merged.shape)], axis=1)
            canvas.lines(explained.around(ends), INK, 0.25, "merged into one")
    canvas.mark("disc", _places(explained, explained.kept), BLUE, 1.3, "candidate kept", edge=PAPER)
    for each in explained.candidates:
        place, name = explained.around(each.merged), "Harris corner taken" if harris else "junction of the centerline"
        canvas.mark("disc" if harris else "square", place, GREEN if harris else YELLOW, 0.5, name, edge=INK)
        canvas.notes.append((explained.around(each.position), str(each.number)))
    rejected_candidates(canvas, explained)


def rejected_candidates(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the candidates that did not become intersections."""
    rejected = [each for each in explained.candidates if not each.is_kept]
    canvas.mark("cross", _places(explained, rejected), VERMILION, 1.4, "candidate rejected", edge=PAPER)


# --- the branches and the point where they meet (paper, Fig. 5) ------------------------------------------------------


def outer_circles(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw how far branches are followed."""
    for each in explained.kept:
        radius_m = explained.config.branches.outer_radius_m
        canvas.circle(explained.around(each.position), radius_m, MUTED, 0.2, "outer circle", dotted=True)


def branches(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw inner circles, branches and their lines of the intersections (paper, III-C)."""
    for each in explained.kept:
        inner_m = each.inner * explained.roi.resolution_m
        canvas.circle(explained.around(each.position), inner_m, MUTED, 0.2, "inner circle")
        for number, piece in enumerate(piece for piece in each.pieces if piece.is_branch):
            colour = BRANCH_COLOURS[number % len(BRANCH_COLOURS)]
            canvas.lines(_joints(explained, piece.pixels), colour, 0.65, f"branch {number + 1}")
        canvas.lines(_branch_lines(explained, each), INK, 0.25, "line of a branch", dashes=_DASHES)


def refined_points(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the candidates and the points that they were moved to."""
    for each in explained.kept:
        canvas.mark("disc", explained.around(each.position), SKY, 0.8, "candidate", edge=INK)
        refined = np.array([explained.steps.junctions[i].position for i in each.detections])
        canvas.mark("star", explained.around(refined), PURPLE, 1.9, "refined point", edge=INK)


def numbers_of_intersections(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Write the number of its candidate beside each intersection."""
    canvas.notes += [(explained.around(each.position), str(each.number)) for each in explained.kept]


def _branch_lines(explained: ExplainedKeyframe, candidate: ExplainedCandidate) -> FloatArray:
    """Return the lines in pieces, (N, 2, 2): from a little behind the refined point to the end of the branch."""
    lines = [np.empty((0, 2, 2))]
    for i in candidate.detections:
        junction = explained.steps.junctions[i]
        branches = junction.branches
        for k in np.flatnonzero(branches.has_line):
            point, outwards, bend = (branches.lines[name][k] for name in ("point", "direction", "bend"))
            begin = (junction.position - point) @ outwards - 0.7 * branches.inner
            end = branches.reaches[k] - (point - candidate.position) @ outwards
            along = np.linspace(begin, end, _BENT if bend else 2)[:, None]
            places = point + along * outwards + bend * along**2 * [outwards[1], -outwards[0]]
            lines.append(np.stack([places[:-1], places[1:]], axis=1))
    return explained.around(np.concatenate(lines))


# --- what every picture has ------------------------------------------------------------------------------------------


def osm(canvas: Canvas, truth: GroundTruth) -> None:
    """Draw the roads and intersections of the map."""
    canvas.lines(truth.roads, OSM, 0.22, f"OSM road (policy {truth.policy})")
    canvas.box(truth.nodes, OSM, 1.4, 0.4, "OSM intersection")


def vehicle(canvas: Canvas, explained: ExplainedKeyframe) -> None:
    """Draw the vehicle, pointing where it heads."""
    canvas.polygon(rotate_2d(_CAR_M, explained.yaw_rad), VERMILION, PAPER, 0.22)
    canvas.swatch(VERMILION, "vehicle and its heading", ">")


def _places(explained: ExplainedKeyframe, candidates: list[ExplainedCandidate]) -> FloatArray:
    return explained.around(np.array([each.position for each in candidates]).reshape(-1, 2))


def _is_set(image: BinaryImage) -> BoolArray:
    return image.to_array().astype(np.bool_)


def _joints(explained: ExplainedKeyframe, chosen: Int32Array | None = None) -> FloatArray:
    """Return the joints, (S, 2, 2), between pixels of the centerline; of some of the pixels by their positions."""
    line = explained.steps.centerline
    rows = np.arange(len(line.rows))
    mask = np.isin(rows, rows if chosen is None else chosen)
    here, which = np.nonzero((line.neighbours >= 0) & mask[:, None])
    there = line.neighbours[here, which]
    wanted = (there > here) & mask[there]
    pixel = np.stack([line.rows, line.cols], axis=-1).astype(np.float64)
    return explained.around(np.stack([pixel[here[wanted]], pixel[there[wanted]]], axis=1))
