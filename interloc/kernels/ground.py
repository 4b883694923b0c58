"""Loops over the points of a scan: the choice of labelled ones, and ground: the plane under the sensor, cells on it."""

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray, UInt8Array, UInt32Array
from interloc.kernels import compiled

X, Y, Z, COUNT, REMISSION, BEAM, ROUGHNESS, SLOPE = range(8)
"""Columns of a cell of ground."""

BEAM_RAD = np.radians(0.25)
"""Lasers are told apart by the elevation of their points, in steps of this."""

BEAMS = 720


@compiled
def lowest_points(points: Float32Array, near_m: float, far_m: float, cell_m: float) -> FloatArray:
    """Return the lowest point of every cell around the sensor.

    Parameters
    ----------
    points : (N, 4) float32
        x, y, z in L, metres, and the remission.
    near_m, far_m : float
        Distances along x and y between which points count.
    cell_m : float
        Side of the cells.

    Returns
    -------
    (M, 3) float64
    """
    size = int(np.ceil(2.0 * far_m / cell_m))
    lowest = np.full(size * size, -1, np.int64)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        squared = x * x + y * y
        if not (near_m * near_m <= squared < far_m * far_m and np.isfinite(z)):
            continue
        cell = int((y + far_m) / cell_m) * size + int((x + far_m) / cell_m)
        if lowest[cell] < 0 or z < points[lowest[cell], 2]:
            lowest[cell] = i
    return points[lowest[lowest >= 0], :3].astype(np.float64)


@compiled
def best_plane(points: FloatArray, triples: IntArray, near_m: float, min_up: float) -> FloatArray:
    """Return the plane through three of the points that has most others close to it.

    Parameters
    ----------
    points : (M, 3) float64
    triples : (K, 3) int64
        Rows of the points that are tried.
    near_m : float
        How far from a plane its points lie at most.
    min_up : float
        Least z of the normal: no wall is ground.

    Returns
    -------
    (4,) float64
        Unit normal, upwards, and the height of the origin over the plane; zeros where no triple makes one.
    """
    best, maximum = np.zeros(4), 0
    for k in range(triples.shape[0]):
        a, b, c = points[triples[k, 0]], points[triples[k, 1]], points[triples[k, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if abs(nz) < min_up * length or length < 1.0:
            continue
        length = np.copysign(length, nz)
        nx, ny, nz = nx / length, ny / length, nz / length
        height = -(nx * a[0] + ny * a[1] + nz * a[2])
        if height < near_m:  # ground lies below the sensor
            continue
        count = 0
        for i in range(points.shape[0]):
            count += abs(nx * points[i, 0] + ny * points[i, 1] + nz * points[i, 2] + height) < near_m
        if count > maximum:
            maximum = count
            best[0], best[1], best[2], best[3] = nx, ny, nz, height
    return best


@compiled
def ground_cells(
    points: Float32Array,
    T_ground_lidar: FloatArray,
    near_m: float,
    far_m: float,
    cone: tuple[float, float],
    above_m: float,
    cell_m: float,
    reach: int,
    stiffness_m: float,
) -> Float32Array:
    """Gather the points of a scan that may be ground in cells, and measure how rough and steep it is around each.

    Parameters
    ----------
    points : (N, 4) float32
        x, y, z in L, metres, and the remission.
    T_ground_lidar : (3, 4) float64
        Into the frame of the scan's ground: z = 0 is the plane below the sensor.
    near_m, far_m : float
        Distances between which points count.
    cone : tuple of float
        Height over or under the plane at the sensor, and how much more per metre, within which ground is looked for.
    above_m : float
        How much higher than the lowest point of the same 0.5 m ground can be.
    cell_m : float
        Side of the cells.
    reach : int
        Cells to each side whose points make the plane that roughness is measured against.
    stiffness_m : float
        Points this far apart tilt the plane half as much as they would alone: those of one ring leave it level.

    Returns
    -------
    (M, 8) float32
        Cells in the order of their first points: mean x, y, z; number of points; mean remission of those points that
        the laser of the first one saw; that laser; root mean square distance of the points around from their plane,
        metres, NaN where they are less than five; slope of that plane.
    """
    n, coarse_m = points.shape[0], 0.5
    coarse_size, size = int(np.ceil(2 * far_m / coarse_m)) + 1, int(np.ceil(2 * far_m / cell_m)) + 1
    lowest = np.full(coarse_size * coarse_size, np.inf, np.float32)
    local = np.empty((n, 3), np.float32)
    for i in range(n):
        px, py, pz = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        x = T_ground_lidar[0, 0] * px + T_ground_lidar[0, 1] * py + T_ground_lidar[0, 2] * pz + T_ground_lidar[0, 3]
        y = T_ground_lidar[1, 0] * px + T_ground_lidar[1, 1] * py + T_ground_lidar[1, 2] * pz + T_ground_lidar[1, 3]
        z = T_ground_lidar[2, 0] * px + T_ground_lidar[2, 1] * py + T_ground_lidar[2, 2] * pz + T_ground_lidar[2, 3]
        distance = np.sqrt(x * x + y * y)
        if not (near_m <= distance < far_m and abs(z) < cone[0] + cone[1] * distance):
            local[i, 0] = np.nan
            continue
        local[i, 0], local[i, 1], local[i, 2] = x, y, z
        at = int((y + far_m) / coarse_m) * coarse_size + int((x + far_m) / coarse_m)
        lowest[at] = min(lowest[at], local[i, 2])

    number = np.full((size, size), -1, np.int32)
    place = np.empty((n, 2), np.int32)
    sums = np.zeros((n, 10))  # x, y, z, xx, xy, yy, xz, yz, zz, count
    remission = np.zeros((n, 3))  # laser, sum, count
    cells = 0
    for i in range(n):
        if np.isnan(local[i, 0]):
            continue
        x, y, z = float(local[i, 0]), float(local[i, 1]), float(local[i, 2])
        if z > lowest[int((y + far_m) / coarse_m) * coarse_size + int((x + far_m) / coarse_m)] + above_m:
            continue
        px, py, pz = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        beam = np.floor((np.arctan2(pz, np.sqrt(px * px + py * py)) + np.pi / 2) / BEAM_RAD)
        r, c = int((y + far_m) / cell_m), int((x + far_m) / cell_m)
        k = number[r, c]
        if k < 0:
            k = number[r, c] = cells
            place[k, 0], place[k, 1] = r, c
            remission[k, 0] = beam
            cells += 1
        if remission[k, 0] == beam:
            remission[k, 1] += points[i, 3] if np.isfinite(points[i, 3]) else 0.0
            remission[k, 2] += 1.0
        values = (x, y, z, x * x, x * y, y * y, x * z, y * z, z * z, np.float32(1.0))
        for j in range(10):
            sums[k, j] += values[j]

    found = np.empty((cells, 8), np.float32)
    around = np.empty(10)
    ridge = stiffness_m * stiffness_m
    for k in range(cells):
        around[:] = 0.0
        for r in range(max(0, place[k, 0] - reach), min(size, place[k, 0] + reach + 1)):
            for c in range(max(0, place[k, 1] - reach), min(size, place[k, 1] + reach + 1)):
                other = number[r, c]
                if other >= 0:
                    for j in range(10):
                        around[j] += sums[other, j]
        count, own = around[9], sums[k, 9]
        found[k, X], found[k, Y], found[k, Z] = sums[k, 0] / own, sums[k, 1] / own, sums[k, 2] / own
        found[k, COUNT] = own
        found[k, REMISSION], found[k, BEAM] = remission[k, 1] / remission[k, 2], remission[k, 0]
        if count < 5.0:
            found[k, ROUGHNESS] = found[k, SLOPE] = np.nan
            continue
        mx, my, mz = around[0] / count, around[1] / count, around[2] / count
        xx, xy, yy = around[3] / count - mx * mx, around[4] / count - mx * my, around[5] / count - my * my
        xz, yz, zz = around[6] / count - mx * mz, around[7] / count - my * mz, around[8] / count - mz * mz
        determinant = (xx + ridge) * (yy + ridge) - xy * xy
        a = (xz * (yy + ridge) - yz * xy) / determinant
        b = (yz * (xx + ridge) - xz * xy) / determinant
        squared = zz - 2.0 * (a * xz + b * yz) + a * a * xx + 2.0 * a * b * xy + b * b * yy
        found[k, ROUGHNESS] = np.sqrt(max(0.0, squared))
        found[k, SLOPE] = np.sqrt(a * a + b * b)
    return found


@compiled
def select_points(points: Float32Array, labels: UInt32Array, group_of: UInt8Array) -> tuple[Float32Array, int, int]:
    """Pick the points of two groups of labels, those of the first group in front.

    Parameters
    ----------
    points : (N, 4) float32
        x, y, z in L, metres, and the remission, which is not kept.
    labels : (N,) uint32
        The label id is in the lower 16 bits.
    group_of : (65536,) uint8
        Group of every label id: 1 (road), 2 (confusable), anything else is left out.

    Returns
    -------
    xyz : (M, 3) float32
        Points of group 1, then those of group 2, each in the order of the scan.
    first_group : int
        Number of points of group 1.
    bad_point : int
        Row of `points` of the first kept point that is not finite; -1 where all are.
    """
    n = labels.shape[0]
    first, second = 0, 0
    for i in range(n):
        group = group_of[labels[i] & 0xFFFF]
        first += group == 1
        second += group == 2

    xyz = np.empty((first + second, 3), np.float32)
    a, b, one = np.uint64(0), np.uint64(first), np.uint64(1)
    unlike = np.float32(0.0)  # a number that is not finite is the only one that differs from itself
    for i in range(n):
        group = group_of[labels[i] & 0xFFFF]
        if group == 1:
            to = a
            a += one
        elif group == 2:
            to = b
            b += one
        else:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        xyz[to, 0], xyz[to, 1], xyz[to, 2] = x, y, z
        unlike += (x - x) + (y - y) + (z - z)
    bad_point = -1
    if unlike != 0.0:
        for i in range(n - 1, -1, -1):
            is_kept = group_of[labels[i] & 0xFFFF] == 1 or group_of[labels[i] & 0xFFFF] == 2
            if is_kept and not np.isfinite(points[i, :3]).all():
                bad_point = i
    return xyz, first, bad_point
