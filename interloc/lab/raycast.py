"""Rays of a spinning LiDAR against a tiled ground raster, a height grid and upright walls."""

import math

import numpy as np

from interloc.arrays import Float32Array, FloatArray, Int32Array, UInt8Array
from interloc.kernels import compiled

PROFILE_STEPS = 96
BUCKETS = 2048
STEP_M = 0.06
"""Surfaces are raised by nothing, by this or by twice this."""


@compiled
def height_at(grid: Float32Array, x0: float, y0: float, cell: float, x: float, y: float) -> float:
    """Interpolate a height grid bilinearly; outside, the nearest edge counts. Samples lie at x0 + column * cell."""
    gx = min(max((x - x0) / cell, 0.0), grid.shape[1] - 1.001)
    gy = min(max((y - y0) / cell, 0.0), grid.shape[0] - 1.001)
    c = int(gx)
    r = int(gy)
    fx = gx - c
    fy = gy - r
    low = grid[r, c] * (1.0 - fx) + grid[r, c + 1] * fx
    high = grid[r + 1, c] * (1.0 - fx) + grid[r + 1, c + 1] * fx
    return float(low * (1.0 - fy) + high * fy)


@compiled
def surface_at(tiles: UInt8Array, index: Int32Array, x0: float, y0: float, tile_m: float, x: float, y: float) -> int:
    """Return the surface code of a place; 0 (terrain) where no tile is loaded."""
    rows, columns = index.shape
    tx = math.floor((x - x0) / tile_m)
    ty = math.floor((y - y0) / tile_m)
    # No branch before the last read: else numba counts references to both arrays at each call, a fifth of the time.
    slot = index[min(max(ty, 0), rows - 1), min(max(tx, 0), columns - 1)]
    n = tiles.shape[1]
    scale = n / tile_m
    c = min(max(int((x - x0 - tx * tile_m) * scale), 0), n - 1)
    r = min(max(int((y - y0 - ty * tile_m) * scale), 0), n - 1)
    code = int(tiles[max(slot, 0), r, c])
    return code if slot >= 0 and 0 <= tx < columns and 0 <= ty < rows else 0


@compiled
def bucket_walls(walls: FloatArray, x: float, y: float, reach: float) -> tuple[Int32Array, Int32Array, FloatArray]:
    """Sort walls into buckets of azimuth as seen from (x, y), the nearest first in each.

    Parameters
    ----------
    walls : (S, 6) float64
        x, y of both ends, bottom, top.
    x, y, reach
        Place of the eye; walls beyond `reach` are left out.

    Returns
    -------
    start : (BUCKETS + 1,) int32
        Where each bucket starts in `member`.
    member : (M,) int32
        Indices of walls.
    nearest : (S,) float64
        Distance of each wall.
    """
    n = walls.shape[0]
    nearest = np.empty(n, np.float64)
    first = np.empty(n, np.int32)
    count = np.zeros(n, np.int32)
    step = 2.0 * math.pi / BUCKETS
    start = np.zeros(BUCKETS + 1, np.int32)
    for i in range(n):
        ax = walls[i, 0] - x
        ay = walls[i, 1] - y
        bx = walls[i, 2] - x
        by = walls[i, 3] - y
        ex = bx - ax
        ey = by - ay
        length2 = ex * ex + ey * ey
        t = 0.0
        if length2 > 0.0:
            t = min(max(-(ax * ex + ay * ey) / length2, 0.0), 1.0)
        nearest[i] = math.hypot(ax + t * ex, ay + t * ey)
        if nearest[i] > reach or length2 == 0.0:
            continue
        a = math.atan2(ay, ax)
        turn = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
        if turn < 0.0:
            a = a + turn
            turn = -turn
        k = math.floor((a + math.pi) / step)
        last = math.floor((a + turn + math.pi) / step)
        first[i] = k
        count[i] = min(last - k + 1, BUCKETS)
        for j in range(k, k + count[i]):
            start[j % BUCKETS + 1] += 1
    for b in range(BUCKETS):
        start[b + 1] += start[b]
    member = np.empty(start[BUCKETS], np.int32)
    fill = start[:BUCKETS].copy()
    for i in np.argsort(nearest, kind="mergesort"):
        for j in range(first[i], first[i] + count[i]):
            b = j % BUCKETS
            member[fill[b]] = i
            fill[b] += 1
    return start, member, nearest


@compiled
def cast_rays(
    origin: FloatArray,
    rotation: FloatArray,
    elevations: FloatArray,
    azimuths: FloatArray,
    tiles: UInt8Array,
    index: Int32Array,
    raster: FloatArray,
    heights: Float32Array,
    height_frame: FloatArray,
    walls: FloatArray,
    wall_surfaces: UInt8Array,
    materials: FloatArray,
    limits: FloatArray,
    normal: Float32Array,
    uniform: Float32Array,
) -> tuple[Float32Array, UInt8Array, UInt8Array]:
    """Measure one turn of the LiDAR.

    Parameters
    ----------
    origin : (3,) float64
        Place of the sensor in M.
    rotation : (3, 3) float64
        R_map_lidar.
    elevations, azimuths : (rings,), (columns,) float64
        Directions of the rays in L, radians, elevations falling.
    tiles, index, raster
        (P, n, n) uint8 surface codes; (rows, columns) int32 slot of each tile or -1; x0, y0, side of a tile.
    heights, height_frame
        (h, w) float32 grid; x0, y0, cell.
    walls, wall_surfaces
        (S, 6) float64 x, y of both ends, bottom, top; (S,) uint8 surface codes.
    materials : (surfaces, 6) float64
        Rows of `interloc.lab.ground.Material`.
    limits : (6,) float64
        Least and largest range, range noise, factor on roughness, share of lost shots, ln of the signal
        seen half of the time (-inf: every shot returns).
    normal, uniform : (2, rings, columns), (rings, columns) float32
        Random numbers: range noise and surface noise; returns.

    Returns
    -------
    points : (rings, columns, 4) float32
        x, y, z in L and remission.
    surfaces : (rings, columns) uint8
    hit : (rings, columns) uint8
        1 where there is a return.
    """
    rings = elevations.shape[0]
    columns = azimuths.shape[0]
    points = np.zeros((rings, columns, 4), np.float32)
    surfaces = np.zeros((rings, columns), np.uint8)
    hit = np.zeros((rings, columns), np.uint8)
    min_range, max_range, range_noise, rough = limits[0], limits[1], limits[2], limits[3]
    dropout, half_signal = limits[4], limits[5]
    ox, oy, oz = origin[0], origin[1], origin[2]
    rx0, ry0, tile_m = raster[0], raster[1], raster[2]
    hx0, hy0, hcell = height_frame[0], height_frame[1], height_frame[2]
    rise = np.sin(elevations)
    reach = np.cos(elevations)
    start, member, nearest = bucket_walls(walls, ox, oy, max_range)
    bucket_scale = BUCKETS / (2.0 * math.pi)
    edge = np.arange(BUCKETS + 1) / bucket_scale - math.pi
    edge_x = np.cos(edge)
    edge_y = np.sin(edge)
    bucket = 0

    distance = np.empty(PROFILE_STEPS, np.float64)
    ratio = (max_range / 1.0) ** (1.0 / (PROFILE_STEPS - 1))
    distance[0] = 1.0
    for k in range(1, PROFILE_STEPS):
        distance[k] = distance[k - 1] * ratio
    profile = np.empty(PROFILE_STEPS, np.float64)

    for column in range(columns):
        ca = math.cos(azimuths[column])
        sa = math.sin(azimuths[column])
        # The ground along this azimuth; the tilt of the rays within a column hardly matters for a smooth ground.
        ux = rotation[0, 0] * ca + rotation[0, 1] * sa
        uy = rotation[1, 0] * ca + rotation[1, 1] * sa
        norm = math.hypot(ux, uy)
        ux /= norm
        uy /= norm
        for k in range(PROFILE_STEPS):
            profile[k] = height_at(heights, hx0, hy0, hcell, ox + ux * distance[k], oy + uy * distance[k])
        k = 1
        for ring in range(rings - 1, -1, -1):
            lx = reach[ring] * ca
            ly = reach[ring] * sa
            lz = rise[ring]
            dx = rotation[0, 0] * lx + rotation[0, 1] * ly + rotation[0, 2] * lz
            dy = rotation[1, 0] * lx + rotation[1, 1] * ly + rotation[1, 2] * lz
            dz = rotation[2, 0] * lx + rotation[2, 1] * ly + rotation[2, 2] * lz
            level = math.hypot(dx, dy)
            ux = dx / level
            uy = dy / level
            slope = dz / level

            # Ground: the first step of the profile that lies above the ray. Higher rays get further.
            while k < PROFILE_STEPS and oz + slope * distance[k] > profile[k]:
                k += 1
            best = 1e9
            surface = 0
            closing = 1.0
            if k < PROFILE_STEPS:
                above = oz + slope * distance[k - 1] - profile[k - 1]
                below = profile[k] - oz - slope * distance[k]
                closing = max((above + below) / (distance[k] - distance[k - 1]), 1e-6)
                s = distance[k - 1] + above / closing
                # From the highest possible kerb down: the first that the ray meets at its own height.
                free = s
                for part in range(2, -1, -1):
                    height = part * STEP_M
                    place = max(s - height / closing, 0.0)
                    surface = surface_at(tiles, index, rx0, ry0, tile_m, ox + ux * place, oy + uy * place)
                    if materials[surface, 1] >= height - 1e-9:
                        best = place
                        break
                    free = place
                if materials[surface, 1] > height + 1e-9 and part < 2:  # its face, somewhere between the two places
                    for _ in range(6):
                        middle = 0.5 * (free + best)
                        there = surface_at(tiles, index, rx0, ry0, tile_m, ox + ux * middle, oy + uy * middle)
                        if materials[there, 1] >= (s - middle) * closing:
                            best = middle
                            surface = there
                        else:
                            free = middle
            facing = closing / math.sqrt(1.0 + slope * slope)  # cosine of incidence, nearly
            wall_hit = False

            # The rays of a column are mostly in one bucket: is this one between its edges?
            right = ux * edge_y[bucket] > uy * edge_x[bucket]
            left = ux * edge_y[bucket + 1] <= uy * edge_x[bucket + 1]
            if right or left:
                bucket = int((math.atan2(uy, ux) + math.pi) * bucket_scale) % BUCKETS
            for m in range(start[bucket], start[bucket + 1]):
                w = member[m]
                if nearest[w] > best:
                    break
                ax = walls[w, 0] - ox
                ay = walls[w, 1] - oy
                ex = walls[w, 2] - walls[w, 0]
                ey = walls[w, 3] - walls[w, 1]
                det = ux * ey - uy * ex
                if abs(det) < 1e-12:
                    continue
                s = (ax * ey - ay * ex) / det
                along = (ax * uy - ay * ux) / det
                if s <= 0.0 or s >= best or along < 0.0 or along > 1.0:
                    continue
                z = oz + slope * s
                if z < walls[w, 4] or z > walls[w, 5]:
                    continue
                best = s
                surface = wall_surfaces[w]
                facing = max(abs(det) / math.hypot(ex, ey), 0.05)
                wall_hit = True

            if best > 1e8:
                continue
            t = best / level
            if t > max_range or t < min_range:
                continue
            if half_signal > -1e8:
                signal = math.log(materials[surface, 5] * max(facing, 1e-6) / (t * t)) - half_signal
                chance = (1.0 - dropout) / (1.0 + math.exp(-2.5 * signal))
            else:
                chance = 1.0 - dropout
            if uniform[ring, column] > chance:
                continue
            roughness = rough * materials[surface, 2] * normal[1, ring, column]
            if not wall_hit:
                roughness = roughness / max(closing, 0.02)
            t = t + roughness + range_noise * normal[0, ring, column]
            points[ring, column, 0] = t * lx
            points[ring, column, 1] = t * ly
            points[ring, column, 2] = t * lz
            # Of the shots that return, uniform / chance is spread evenly: the remission needs no number of its own.
            value = materials[surface, 3] + materials[surface, 4] * 3.46 * (uniform[ring, column] / chance - 0.5)
            points[ring, column, 3] = min(max(value, 0.0), 0.99)
            surfaces[ring, column] = surface
            hit[ring, column] = 1
    return points, surfaces, hit
