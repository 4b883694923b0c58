"""Labels of points from the labels of pixels, by a vote of the nearest neighbours in the range image."""

import numpy as np

from interloc.arrays import Float32Array, Int32Array, UInt8Array
from interloc.kernels import compiled

FARTHEST = np.iinfo(np.int64).max
"""Key of a candidate that is out of the question."""


@compiled
def spread_extremes(classes: UInt8Array, index: Int32Array, side: int) -> tuple[UInt8Array, UInt8Array]:
    """Return the lowest and the highest class in a window around every pixel, where pixels have a point.

    Parameters
    ----------
    classes : (H, W) uint8
    index : (H, W) int32
        -1 in pixels without a point.
    side : int
        Of the window, odd, at most W. Columns continue on the other side of the image.

    Returns
    -------
    lowest, highest : (H, W) uint8
        255 and 0 where the whole window is empty.
    """
    height, width = classes.shape
    reach = side // 2
    low = np.empty((height, width + 2 * reach), np.uint8)
    high = np.empty((height, width + 2 * reach), np.uint8)
    for row in range(height):
        for column in range(width):
            is_empty = index[row, column] < 0
            low[row, column + reach] = 255 if is_empty else classes[row, column]
            high[row, column + reach] = 0 if is_empty else classes[row, column]
        for column in range(reach):
            low[row, column], high[row, column] = low[row, column + width], high[row, column + width]
            to = column + width + reach
            low[row, to], high[row, to] = low[row, column + reach], high[row, column + reach]
    low_across = low[:, :width].copy()
    high_across = high[:, :width].copy()
    for row in range(height):
        for shift in range(1, side):
            for column in range(width):
                low_across[row, column] = min(low_across[row, column], low[row, column + shift])
                high_across[row, column] = max(high_across[row, column], high[row, column + shift])
    lowest = low_across.copy()
    highest = high_across.copy()
    for row in range(height):
        for other in range(max(row - reach, 0), min(row + reach + 1, height)):
            for column in range(width):
                lowest[row, column] = min(lowest[row, column], low_across[other, column])
                highest[row, column] = max(highest[row, column], high_across[other, column])
    return lowest, highest


@compiled
def vote_of_neighbours(
    classes: UInt8Array,
    index: Int32Array,
    pixel: Int32Array,
    depth: Float32Array,
    weights: Float32Array,
    neighbours: int,
    limit: float,
    first_class: int,
) -> UInt8Array:
    """Let the nearest neighbours of every point vote on its class.

    Parameters
    ----------
    classes : (H, W) uint8
        Class of every pixel.
    index : (H, W) int32
    pixel : (N,) int32
    depth : (N,) float32
        As `project_points` returns them.
    weights : (S, S) float32
        By which differences of range are multiplied, S odd and at most W.
    neighbours : int
        How many vote at most, 1 to S * S.
    limit : float
        Only neighbours whose weighted difference of range is smaller vote, metres.
    first_class : int
        Lower classes get no vote: 1 where class 0 stands for points without a class.

    Returns
    -------
    (N,) uint8
        Class of every point; 0 for points without a pixel.

    Notes
    -----
    RangeNet++ (Milioto et al., IROS 2019), section III-D. The candidates are the pixels of a window around the point's
    own; how near they are is the difference of their range to the point's, weighted. The point's own pixel is at
    distance 0 whichever point fills it, so that its class always votes. Of equally near candidates the own pixel goes
    first, then row by row; of classes with equal votes the lowest wins, as published.

    Three things differ from the published code, and only at edges (1 point in 10,000 of real scans). Columns continue
    on the other side of the image, which covers the full circle; published, what is beyond an edge has range 0. Pixels
    without a point, and rows beyond the image, never vote; published, they do where there is no cutoff. Where no
    neighbour votes the point keeps the class of its own pixel, which then is below `first_class`; published, it gets
    class 1 (car).

    Most windows are of one class, and there the vote is known without a count.
    """
    height, width = classes.shape
    side = weights.shape[0]
    reach = side // 2
    stride = width + 2 * reach
    ranges = np.full((height + 2 * reach) * stride, np.inf, np.float32)
    padded = np.zeros((height + 2 * reach) * stride, np.uint8)
    for row in range(height):
        to = (row + reach) * stride
        for column in range(stride):
            source = (column - reach) % width
            i = index[row, source]
            if i >= 0:
                ranges[to + column] = depth[i]
            padded[to + column] = classes[row, source]

    size = side * side
    factors = weights.copy().reshape(-1)
    centre = reach * side + reach
    distances = np.empty(size, np.float32)
    bits = distances.view(np.int32)  # distances are not negative: their bits are in the same order
    keys = np.empty(size, np.int64)
    limit_bits = np.array([limit], np.float32).view(np.int32)[0]

    lowest, highest = spread_extremes(classes, index, side)
    lowest_of, highest_of = lowest.reshape(-1), highest.reshape(-1)
    n = pixel.shape[0]
    result = np.zeros(n, np.uint8)
    found = np.empty(neighbours, np.uint8)
    votes = np.zeros(256, np.int32)
    for i in range(n):
        at = pixel[i]
        if at < 0:
            continue
        if lowest_of[at] == highest_of[at]:
            result[i] = lowest_of[at]
            continue
        base = np.uint32((at // width) * stride + at % width)
        own_depth = depth[i]
        own = padded[base + np.uint32(reach * stride + reach)]
        for dy in range(side):
            for dx in range(side):
                other = base + np.uint32(dy * stride + dx)
                distances[dy * side + dx] = abs(ranges[other] - own_depth) * factors[dy * side + dx]
        distances[centre] = np.inf
        for place in range(size):  # the place in the window is part of the key: no two are equal
            keys[place] = (np.int64(bits[place]) << 16) | place
        found[0] = own
        count = 1
        while count < neighbours:
            nearest = FARTHEST
            for place in range(size):  # without branches: several at once
                nearest = min(nearest, keys[place])
            if nearest >> 16 >= limit_bits:
                break
            place = nearest & 0xFFFF
            keys[place] = FARTHEST
            found[count] = padded[base + np.uint32((place // side) * stride + place % side)]
            count += 1
        best, maximum = own, 0
        for slot in range(count):
            each = found[slot]
            if each >= first_class:
                votes[each] += 1
                if votes[each] > maximum or (votes[each] == maximum and each < best):
                    best, maximum = each, votes[each]
        for slot in range(count):
            votes[found[slot]] = 0
        result[i] = best
    return result
