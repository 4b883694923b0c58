"""Loops that lay the ground of many scans on one grid: its surface, how each scan is tilted against it, its features.

All take points as ``(N, 3 or more)`` float32 with x, y, z first, and ``T``, (3, 4) float64, from their frame into that
of the grid. A grid is an image; ``x0, y0`` is the corner of its cell (0, 0), rows go with y and columns with x.
"""

import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray, UInt8Array, UInt32Array
from interloc.kernels import compiled
from interloc.kernels.ground import BEAM, COUNT, REMISSION, ROUGHNESS, SLOPE

WEIGHT, BRIGHTNESS, HEIGHT, ROUGH_WEIGHT, ROUGH, STEEP = range(6)
FEATURES = 6
"""Channels of the sums of `add_features`; all but the weights are to be divided by theirs."""


@compiled
def _placed(point: Float32Array, T: FloatArray) -> tuple[float, float, float]:
    px, py, pz = float(point[0]), float(point[1]), float(point[2])
    return (
        T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3],
        T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3],
        T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3],
    )


@compiled
def scan_minima(points: Float32Array, T: FloatArray, x0: float, y0: float, cell_m: float, lowest: Float32Array) -> None:
    """Write the lowest z of a scan in every cell of a grid.

    Parameters
    ----------
    lowest : (H, W) float32
        Changed in place; infinite where the scan has no point.
    """
    rows, columns = lowest.shape
    lowest[:] = np.inf
    for i in range(points.shape[0]):
        x, y, z = _placed(points[i], T)
        r, c = int(np.floor((y - y0) / cell_m)), int(np.floor((x - x0) / cell_m))
        if 0 <= r < rows and 0 <= c < columns and z < lowest[r, c]:
            lowest[r, c] = z


@compiled
def tilt_against(
    points: Float32Array,
    T: FloatArray,
    surface: Float32Array,
    x0: float,
    y0: float,
    cell_m: float,
    reach_m: FloatArray,
    prior: tuple[float, float],
) -> FloatArray:
    """Return how much a scan has to be raised and tilted to lie on a surface.

    Parameters
    ----------
    surface : (H, W) float32
        Heights; NaN where unknown.
    reach_m : (K,) float64
        How far from the surface points count, in each of K rounds: at the sensor; twice as far 20 m from it.
    prior : tuple of float
        Expected size of the raise, metres, and of the tilt, metres per metre.

    Returns
    -------
    (3,) float64
        Raise at the origin of the scan, metres; and slopes along x and y of the grid.
    """
    rows, columns = surface.shape
    u, v, w = 0.0, 0.0, 0.0
    error = 0.05
    for k in range(len(reach_m)):
        a00, a01, a02, a11, a12, a22 = (error / prior[0]) ** 2, 0.0, 0.0, (error / prior[1]) ** 2, 0.0, 0.0
        a22 = a11
        b0, b1, b2 = 0.0, 0.0, 0.0
        for i in range(points.shape[0]):
            x, y, z = _placed(points[i], T)
            r, c = int(np.floor((y - y0) / cell_m)), int(np.floor((x - x0) / cell_m))
            if not (0 <= r < rows and 0 <= c < columns):
                continue
            dx, dy = x - T[0, 3], y - T[1, 3]
            missing = surface[r, c] - z
            squared = dx * dx + dy * dy
            if not abs(missing - u - v * dx - w * dy) < reach_m[k] * (1.0 + np.sqrt(squared) / 20.0):
                continue
            weight = 1.0 / (1.0 + squared / 400.0)
            a00 += weight
            a01 += weight * dx
            a02 += weight * dy
            a11 += weight * dx * dx
            a12 += weight * dx * dy
            a22 += weight * dy * dy
            b0 += weight * missing
            b1 += weight * missing * dx
            b2 += weight * missing * dy
        c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
        determinant = a00 * c00 + a01 * c01 + a02 * c02
        c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
        u = (c00 * b0 + c01 * b1 + c02 * b2) / determinant
        v = (c01 * b0 + c11 * b1 + c12 * b2) / determinant
        w = (c02 * b0 + c12 * b1 + c22 * b2) / determinant
    return np.array([u, v, w])


@compiled
def add_brightness(
    cells: Float32Array, T: FloatArray, x0: float, y0: float, cell_m: float, strip: BoolArray, table: FloatArray
) -> None:
    """Add the remission of the cells of a scan that lie on the driven strip to the sums of their lasers.

    Parameters
    ----------
    cells : (N, 8) float32
        From `interloc.kernels.ground.ground_cells`.
    strip : (H, W) bool
    table : (B, 3) float64
        Changed in place: number, sum and sum of squares per laser.
    """
    rows, columns = strip.shape
    for i in range(cells.shape[0]):
        x, y, _ = _placed(cells[i], T)
        r, c = int(np.floor((y - y0) / cell_m)), int(np.floor((x - x0) / cell_m))
        if 0 <= r < rows and 0 <= c < columns and strip[r, c]:
            value, beam = float(cells[i, REMISSION]), int(cells[i, BEAM])
            table[beam, 0] += 1.0
            table[beam, 1] += value
            table[beam, 2] += value * value


@compiled
def add_features(
    cells: Float32Array,
    T: FloatArray,
    x0: float,
    y0: float,
    cell_m: float,
    surface: Float32Array,
    near_m: float,
    brightness: FloatArray,
    sums: Float32Array,
) -> None:
    """Add the cells of a scan that lie on the surface to the weighted sums of a grid.

    Parameters
    ----------
    cells : (N, 8) float32
        From `interloc.kernels.ground.ground_cells`.
    surface : (H', W') float32
        Heights on a grid whose cells are a whole number of times larger; NaN where unknown.
    near_m : float
        How far from the surface ground lies at most.
    brightness : (B, 3) float64
        Per laser: what to subtract from the remission, what to divide it by, what to add.
    sums : (H, W, 6) float32
        Changed in place. A cell weighs the less the farther it is from the sensor; one with two points or more counts
        twice one with a single point, so that no scan outvotes the others.
    """
    rows, columns = sums.shape[:2]
    times = rows // surface.shape[0]
    for i in range(cells.shape[0]):
        x, y, z = _placed(cells[i], T)
        r, c = int(np.floor((y - y0) / cell_m)), int(np.floor((x - x0) / cell_m))
        if not (0 <= r < rows and 0 <= c < columns and abs(z - surface[r // times, c // times]) < near_m):
            continue
        dx, dy = x - T[0, 3], y - T[1, 3]
        weight = min(2.0, cells[i, COUNT]) / (1.0 + (dx * dx + dy * dy) / 400.0)
        beam = int(cells[i, BEAM])
        shade = (cells[i, REMISSION] - brightness[beam, 0]) / brightness[beam, 1] + brightness[beam, 2]
        sums[r, c, WEIGHT] += weight
        sums[r, c, BRIGHTNESS] += weight * shade
        sums[r, c, HEIGHT] += weight * z
        if not np.isnan(cells[i, ROUGHNESS]):
            sums[r, c, ROUGH_WEIGHT] += weight
            sums[r, c, ROUGH] += weight * cells[i, ROUGHNESS]
            sums[r, c, STEEP] += weight * cells[i, SLOPE]


@compiled
def label_points(
    points: Float32Array,
    T: FloatArray,
    x0: float,
    y0: float,
    cell_m: float,
    surface: Float32Array,
    classes: UInt8Array,
    road: int,
    near_m: tuple[float, float],
    range_m: tuple[float, float],
) -> UInt32Array:
    """Label the points of a scan by the class of the cell that they lie on.

    Parameters
    ----------
    surface : (H', W') float32
        Heights on a grid whose cells are a whole number of times larger; NaN where unknown.
    classes : (H, W) uint8
        Label ids.
    road : int
        The id of road.
    near_m : tuple of float
        How far from the surface points of road, and of other ground, lie at most: at the sensor; twice as far 40 m
        from it.
    range_m : tuple of float
        Distances from the sensor between which points are labelled.

    Returns
    -------
    (N,) uint32
        Label ids; 0 for what is no ground.
    """
    rows, columns = classes.shape
    times = rows // surface.shape[0]
    labels = np.zeros(points.shape[0], np.uint32)
    for i in range(points.shape[0]):
        x, y, z = _placed(points[i], T)
        dx, dy = x - T[0, 3], y - T[1, 3]
        if not range_m[0] ** 2 <= dx * dx + dy * dy < range_m[1] ** 2:  # also where a coordinate is NaN
            continue
        r, c = int(np.floor((y - y0) / cell_m)), int(np.floor((x - x0) / cell_m))
        if 0 <= r < rows and 0 <= c < columns:
            off = abs(z - surface[r // times, c // times]) / (1.0 + np.sqrt(dx * dx + dy * dy) / 40.0)
            label = classes[r, c]
            if off < (near_m[0] if label == road else near_m[1]):
                labels[i] = label
    return labels
