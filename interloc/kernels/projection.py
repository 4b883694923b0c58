"""Range images: a scan seen from its sensor, one pixel per direction."""

import math

import numpy as np

from interloc.arrays import Float32Array, Int32Array, UInt8Array
from interloc.kernels import compiled


@compiled
def project_points(
    points: Float32Array, height: int, width: int, fov_up: float, fov_down: float
) -> tuple[Int32Array, Int32Array, Float32Array]:
    """Find the pixel of every point, and the nearest point of every pixel.

    Parameters
    ----------
    points : (N, 4) float32
        x (ahead), y (left), z (up) in L, metres; further columns are not looked at.
    height, width : int
        Of the image, pixels.
    fov_up, fov_down : float
        Angles from the horizon to the upper and lower edge of the image, radians, both >= 0, not both 0.

    Returns
    -------
    index : (height, width) int32
        Row of `points` of the nearest point of each pixel, of equally near ones the first; -1 where there is none.
    pixel : (N,) int32
        Pixel of each point, row * width + column; -1 for points that are not finite or lie in the sensor itself.
    depth : (N,) float32
        Distance of each point from the sensor, metres; -1 where it has no pixel.

    Notes
    -----
    RangeNet++ (Milioto et al., IROS 2019), section III-A. Column 0 looks back, the middle ahead, and columns run
    clockwise: what is on the left of the vehicle is in the left half. Points above or below the field of view belong to
    the first or last row, as in the published code that the networks were trained with.

    The published code sorts by depth, unstably, so that equal depths are decided by chance (1 pixel in 1,000); and it
    computes in single precision, which moves points on the border of two pixels (1 point in 10,000). Here angles are
    computed in double precision.
    """
    n = points.shape[0]
    index = np.full((height, width), -1, np.int32)
    flat = index.reshape(-1)
    pixel = np.empty(n, np.int32)
    depth = np.empty(n, np.float32)
    per_radian_x = 0.5 * width / math.pi
    per_radian_y = height / (fov_up + fov_down)
    for i in range(n):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        level = x * x + y * y
        distance = np.float32(math.sqrt(level + z * z))
        if not (distance > 0.0 and distance < np.inf):  # false for NaN too
            pixel[i], depth[i] = -1, -1.0
            continue
        u = 0.5 * width - math.atan2(y, x) * per_radian_x
        v = height - (math.atan2(z, math.sqrt(level)) + fov_down) * per_radian_y
        column = min(max(math.floor(u), 0), width - 1)
        row = min(max(math.floor(v), 0), height - 1)
        at = row * width + column
        pixel[i], depth[i] = at, distance
        nearest = flat[at]
        if nearest < 0 or distance < depth[nearest]:
            flat[at] = i
    return index, pixel, depth


@compiled
def fill_image(points: Float32Array, index: Int32Array, depth: Float32Array) -> Float32Array:
    """Write what the sensor measured into the pixels.

    Parameters
    ----------
    points : (N, 4) float32
        x, y, z in L, metres, and remission.
    index : (H, W) int32
    depth : (N,) float32
        As `project_points` returns them.

    Returns
    -------
    (5, H, W) float32
        Range, x, y, z and remission of the point of each pixel; -1 in pixels without a point. A remission that is not
        finite counts as 0.
    """
    height, width = index.shape
    image = np.empty((5, height, width), np.float32)
    for row in range(height):
        for column in range(width):
            i = index[row, column]
            if i < 0:
                for channel in range(5):
                    image[channel, row, column] = -1.0
                continue
            remission = points[i, 3]
            image[0, row, column] = depth[i]
            for axis in range(3):
                image[1 + axis, row, column] = points[i, axis]
            image[4, row, column] = remission if np.isfinite(remission) else np.float32(0.0)
    return image


@compiled
def normalise_image(
    image: Float32Array, index: Int32Array, channels: Int32Array, means: Float32Array, stds: Float32Array
) -> Float32Array:
    """Subtract the mean of each channel and divide by its standard deviation; empty pixels become zero after that.

    Parameters
    ----------
    image : (5, H, W) float32
        Of `fill_image`.
    index : (H, W) int32
        -1 in empty pixels.
    channels : (C,) int32
        Channel of `image` that each channel of the result is made of; 5 for the mask, 1 where a pixel has a point.
    means, stds : (C,) float32

    Returns
    -------
    (C, H, W) float32
    """
    height, width = index.shape
    count = channels.shape[0]
    normalised = np.empty((count, height, width), np.float32)
    for c in range(count):
        channel, mean, std = channels[c], means[c], stds[c]
        for row in range(height):
            for column in range(width):
                if index[row, column] < 0:
                    normalised[c, row, column] = 0.0
                else:
                    value = image[channel, row, column] if channel < 5 else np.float32(1.0)
                    normalised[c, row, column] = (value - mean) / std
    return normalised


@compiled
def best_classes(scores: Float32Array) -> tuple[UInt8Array, int]:
    """Return the class of the highest score of every pixel, of equal scores the lowest class.

    Parameters
    ----------
    scores : (C, P) float32
        At most 256 classes.

    Returns
    -------
    classes : (P,) uint8
    bad : int
        Number of scores that are NaN, or of pixels with no score above -inf.
    """
    count, pixels = scores.shape
    classes = np.zeros(pixels, np.uint8)
    best = np.full(pixels, -np.inf, np.float32)
    bad = 0
    for c in range(count):
        for p in range(pixels):
            score = scores[c, p]
            bad += score != score  # noqa: PLR0124 - NaN
            if score > best[p]:
                best[p] = score
                classes[p] = c
    for p in range(pixels):
        bad += best[p] == -np.inf
    return classes, bad
