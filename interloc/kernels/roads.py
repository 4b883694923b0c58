"""Loops over the roads of a map: drawing them, scoring a track laid on them, finding the nearest way.

The raster of roads is two images of one grid: `distance` in units of 0.1 m (255: none near), and `directions`, a bit
for each of 16 sectors of 11.25 degrees of the undirected bearing of the roads near the cell.
"""

import numpy as np

from interloc.arrays import FloatArray, IntArray, UInt8Array, UInt16Array
from interloc.kernels import compiled


@compiled
def draw_roads(
    distance: UInt8Array,
    directions: UInt16Array,
    segments: FloatArray,
    origin: FloatArray,
    cell_m: float,
    reach_m: float,
    near_m: float,
) -> None:
    """Draw road segments into the two images.

    Parameters
    ----------
    distance : (H, W) uint8
        Changed in place: the least distance of the centre of the cell from a segment, 0.1 m.
    directions : (H, W) uint16
        Changed in place: the sectors of the segments within `near_m`, and their neighbours.
    segments : (S, 4) float64
        x, y of both ends, metres.
    origin : (2,) float64
        x, y of the corner of cell (0, 0).
    cell_m, reach_m, near_m : float
        Side of a cell; how far from a segment distances and directions are drawn.
    """
    rows, columns = distance.shape
    for s in range(segments.shape[0]):
        ax, ay, bx, by = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        dx, dy = bx - ax, by - ay
        length2 = dx * dx + dy * dy
        if length2 <= 0.0:
            continue
        sector = int(np.floor((np.arctan2(dy, dx) % np.pi) / np.pi * 16.0)) % 16
        bits = np.uint16((1 << sector) | (1 << ((sector + 1) % 16)) | (1 << ((sector + 15) % 16)))
        c0, c1, r0, r1 = _cells(segments, s, origin, cell_m, rows, columns, reach_m)
        for r in range(r0, r1 + 1):
            y = origin[1] + (r + 0.5) * cell_m
            for c in range(c0, c1 + 1):
                x = origin[0] + (c + 0.5) * cell_m
                t = ((x - ax) * dx + (y - ay) * dy) / length2
                t = min(1.0, max(0.0, t))
                ex, ey = ax + t * dx - x, ay + t * dy - y
                d = np.sqrt(ex * ex + ey * ey)
                if d > reach_m:
                    continue
                tenths = min(254, int(d * 10.0))
                distance[r, c] = min(distance[r, c], tenths)
                if d <= near_m:
                    directions[r, c] |= bits


@compiled
def score_poses(
    distance: UInt8Array,
    directions: UInt16Array,
    origin: FloatArray,
    cell_m: float,
    points: FloatArray,
    poses: FloatArray,
    weight: FloatArray,
    wrong_way: float,
    hopeless: float,
) -> FloatArray:
    """Score how well a track lies on the roads at each of many places.

    Parameters
    ----------
    distance, directions, origin, cell_m
        The raster of roads.
    points : (P, 3) float64
        x, y and heading of the points of the track, in its own frame; in any order.
    poses : (H, 3) float64
        Where that frame is put: x, y, turn.
    weight : (256,) float64
        What a point counts by the distance of its cell, 0..1.
    wrong_way : float
        Factor of a point that no road near it runs along.
    hopeless : float
        A place whose score is bound to stay below this is given up; its score is then -1.

    Returns
    -------
    (H,) float64
        Mean of the points, 0..1.
    """
    rows, columns = distance.shape
    count = points.shape[0]
    need = hopeless * count
    per_m, per_rad = 1.0 / cell_m, 16.0 / np.pi
    sectors = points[:, 2] * per_rad
    scores = np.empty(poses.shape[0])
    for h in range(poses.shape[0]):
        turn = poses[h, 2]
        cosine, sine = np.cos(turn), np.sin(turn)
        x0, y0, turned = poses[h, 0] - origin[0], poses[h, 1] - origin[1], turn * per_rad
        total = 0.0
        for i in range(count):
            x = cosine * points[i, 0] - sine * points[i, 1] + x0
            y = sine * points[i, 0] + cosine * points[i, 1] + y0
            r, c = int(np.floor(y * per_m)), int(np.floor(x * per_m))
            if r >= 0 and c >= 0 and r < rows and c < columns:
                w = weight[distance[r, c]]
                if w > 0.0:
                    sector = int(np.floor(sectors[i] + turned)) & 15
                    if (directions[r, c] >> sector) & 1 == 0:
                        w *= wrong_way
                    total += w
            if (i & 15) == 15 and total + (count - 1 - i) < need:
                total = -count
                break
        scores[h] = total / count
    return scores


@compiled
def nearest_ways(
    points: FloatArray,
    segments: FloatArray,
    origin: FloatArray,
    cell_m: float,
    starts: IntArray,
    items: IntArray,
    reach_m: float,
    turn_cost_m: float,
) -> tuple[IntArray, FloatArray]:
    """Find the way that each point of a track most likely runs on.

    Parameters
    ----------
    points : (P, 3) float64
        x, y, heading.
    segments : (S, 4) float64
        x, y of both ends.
    origin, cell_m
        Grid of buckets: corner and side of a cell.
    starts : (rows, columns + 1) int64
        Where the segments near each cell begin in `items`, row by row; the last column ends the row.
    items : (I,) int64
        Segments by cells; each segment stands in all cells within `reach_m` of it.
    reach_m : float
        Farther segments do not count.
    turn_cost_m : float
        A segment at an angle a to the heading counts as farther by this times sin(a)^2.

    Returns
    -------
    segment : (P,) int64
        -1 where none is near.
    foot : (P, 4) float64
        x, y of the nearest point on it, and its unit direction, turned to agree with the heading.
    """
    rows, columns = starts.shape[0], starts.shape[1] - 1
    found = np.full(len(points), -1, np.int64)
    foot = np.zeros((len(points), 4))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        r, c = int(np.floor((y - origin[1]) / cell_m)), int(np.floor((x - origin[0]) / cell_m))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            continue
        hx, hy = np.cos(points[i, 2]), np.sin(points[i, 2])
        best = 1e18
        for k in range(starts[r, c], starts[r, c + 1]):
            s = items[k]
            ax, ay = segments[s, 0], segments[s, 1]
            dx, dy = segments[s, 2] - ax, segments[s, 3] - ay
            length = np.sqrt(dx * dx + dy * dy)
            if length <= 0.0:
                continue
            dx, dy = dx / length, dy / length
            t = min(length, max(0.0, (x - ax) * dx + (y - ay) * dy))
            fx, fy = ax + t * dx, ay + t * dy
            d = np.sqrt((fx - x) ** 2 + (fy - y) ** 2)
            if d > reach_m:
                continue
            across = dx * hy - dy * hx
            cost = d + turn_cost_m * across * across
            if cost < best:
                best = cost
                found[i] = s
                sign = 1.0 if dx * hx + dy * hy >= 0.0 else -1.0
                foot[i, 0], foot[i, 1], foot[i, 2], foot[i, 3] = fx, fy, sign * dx, sign * dy
    return found, foot


@compiled
def bucket_segments(
    segments: FloatArray, origin: FloatArray, cell_m: float, rows: int, columns: int, reach_m: float
) -> tuple[IntArray, IntArray]:
    """Sort segments into the cells of a grid that they come within `reach_m` of; see `nearest_ways`.

    Returns
    -------
    starts : (rows, columns + 1) int64
    items : (I,) int64
    """
    counts = np.zeros((rows, columns), np.int64)
    for s in range(segments.shape[0]):
        c0, c1, r0, r1 = _cells(segments, s, origin, cell_m, rows, columns, reach_m)
        for r in range(r0, r1 + 1):
            for c in range(c0, c1 + 1):
                if _touches(segments, s, r, c, origin, cell_m, reach_m):
                    counts[r, c] += 1
    starts = np.zeros((rows, columns + 1), np.int64)
    total = 0
    for r in range(rows):
        for c in range(columns):
            starts[r, c] = total
            total += counts[r, c]
        starts[r, columns] = total
    items = np.empty(total, np.int64)
    fill = starts[:, :columns].copy()
    for s in range(segments.shape[0]):
        c0, c1, r0, r1 = _cells(segments, s, origin, cell_m, rows, columns, reach_m)
        for r in range(r0, r1 + 1):
            for c in range(c0, c1 + 1):
                if _touches(segments, s, r, c, origin, cell_m, reach_m):
                    items[fill[r, c]] = s
                    fill[r, c] += 1
    return starts, items


@compiled
def _cells(
    segments: FloatArray, s: int, origin: FloatArray, cell_m: float, rows: int, columns: int, reach_m: float
) -> tuple[int, int, int, int]:
    """Return first and last column, first and last row of the box around a segment."""
    ax, ay, bx, by = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
    c0 = max(0, int(np.floor((min(ax, bx) - reach_m - origin[0]) / cell_m)))
    c1 = min(columns - 1, int(np.floor((max(ax, bx) + reach_m - origin[0]) / cell_m)))
    r0 = max(0, int(np.floor((min(ay, by) - reach_m - origin[1]) / cell_m)))
    r1 = min(rows - 1, int(np.floor((max(ay, by) + reach_m - origin[1]) / cell_m)))
    return c0, c1, r0, r1


@compiled
def _touches(segments: FloatArray, s: int, r: int, c: int, origin: FloatArray, cell_m: float, reach_m: float) -> bool:
    """Return whether a segment may come within reach of a point of a cell."""
    x, y = origin[0] + (c + 0.5) * cell_m, origin[1] + (r + 0.5) * cell_m
    ax, ay = segments[s, 0], segments[s, 1]
    dx, dy = segments[s, 2] - ax, segments[s, 3] - ay
    length2 = dx * dx + dy * dy
    t = 0.0 if length2 <= 0.0 else min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / length2))
    ex, ey = ax + t * dx - x, ay + t * dy - y
    near: bool = np.sqrt(ex * ex + ey * ey) <= reach_m + 0.7072 * cell_m
    return near
