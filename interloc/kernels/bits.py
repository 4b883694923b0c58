"""Binary images packed 64 columns per word.

Layout: row ``r`` of the image is row ``r + 1`` of a (H + 2, words) uint64 array; column ``c`` is bit ``c % 64`` of word
``c // 64``. One empty row above and below and at least one empty column at the right make every 8-neighbour of a
pixel addressable by its flat bit index without a test for the border.
"""

import math

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, UInt8Array, UInt64Array
from interloc.kernels import compiled

NOWHERE = np.zeros((0, 0), np.uint64)
"""In the place of an image that is not known, or not wanted."""

_RUN_STEP = 0.5  # pixels, of the walk across a road
_LEAST_COSINE = -0.9  # of the angle between roads: those that lie farther apart bound nothing


def words_for(width: int) -> int:
    """Return how many words hold a row of ``width`` pixels and one empty column."""
    return width // 64 + 1


def pack(image: UInt8Array | BoolArray) -> UInt64Array:
    """Return an (H, W) image as packed words; what is not 0 is set."""
    height, width = image.shape
    words = np.zeros((height + 2, words_for(width)), np.uint64)
    octets = np.packbits(image, axis=1, bitorder="little")
    words.view(np.uint8)[1:-1, : octets.shape[1]] = octets
    return words


def unpack(words: UInt64Array, width: int) -> UInt8Array:
    """Return packed words as an (H, W) image of 0 and 1."""
    return np.unpackbits(words[1:-1].view(np.uint8), axis=1, count=width, bitorder="little")


@compiled
def popcount(x: np.uint64) -> int:
    """Count the set bits of a word."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


@compiled
def lowest_bit(x: np.uint64) -> int:
    """Return the index of the lowest set bit of a word that is not 0."""
    return popcount((x & (~x + np.uint64(1))) - np.uint64(1))


@compiled
def count_pixels(words: UInt64Array) -> int:
    """Return how many pixels are set."""
    count = 0
    for word in words.reshape(-1):
        count += popcount(word)
    return count


@compiled
def set_pixels(words: UInt64Array) -> tuple[Int32Array, Int32Array]:
    """Return rows and columns of the set pixels, (P,) int32 each, in row-major order."""
    count = count_pixels(words)
    rows = np.empty(count, np.int32)
    cols = np.empty(count, np.int32)
    i = 0
    for r in range(1, words.shape[0] - 1):
        for w in range(words.shape[1]):
            word = words[r, w]
            while word != 0:
                rows[i] = r - 1
                cols[i] = w * 64 + lowest_bit(word)
                word &= word - np.uint64(1)
                i += 1
    return rows, cols


@compiled
def highest_bit(x: np.uint64) -> int:
    """Return the index of the highest set bit of a word that is not 0."""
    for shift in (1, 2, 4, 8, 16, 32):
        x |= x >> np.uint64(shift)
    return popcount(x) - 1


@compiled
def _columns_to_clear(words: UInt64Array, row: int, col: int, width: int, limit: int) -> int:
    """Return how many columns from a place the nearest clear pixel of its row is, at most ``limit``."""
    nearest = limit
    for side in range(2):
        w, within = col >> 6, col & 63
        # The bit of the pixel itself comes to the end of the word that is looked at first, whatever is behind is gone.
        clear = ~words[row + 1, w]
        clear = clear >> np.uint64(within) if side == 0 else clear << np.uint64(63 - within)
        passed = 0
        while clear == 0 and passed < nearest:
            w += 1 if side == 0 else -1
            if w < 0 or w >= words.shape[1]:
                break
            clear = ~words[row + 1, w]
            passed = 64 * w - col if side == 0 else col - (64 * w + 63)
        if clear != 0:
            distance = passed + (lowest_bit(clear) if side == 0 else 63 - highest_bit(clear))
            if side == 1 or col + distance < width:
                nearest = min(nearest, distance)
    return nearest


@compiled
def nearest_clear(words: UInt64Array, row: int, col: int, height: int, width: int, limit: int) -> float:
    """Return the distance in pixels from a set pixel to the nearest clear one, at most ``limit``.

    The distance transform at one pixel. Outside of the image nothing is clear: a road that leaves the window
    does not end there.
    """
    nearest = _columns_to_clear(words, row, col, width, limit)  # these first, and straight up and down: little is left
    best, bit = nearest * nearest, np.uint64(1) << np.uint64(col & 63)
    for dy in range(1, nearest):
        is_end = row - dy >= 0 and words[row - dy + 1, col >> 6] & bit == 0
        if is_end or (row + dy < height and words[row + dy + 1, col >> 6] & bit == 0):
            best = dy * dy
            break
    dy, reach = 1, nearest + 1
    w, within = (col - 32) >> 6, np.uint64((col - 32) & 63)  # where the 64 columns around begin
    has_around = 0 <= w < words.shape[1] - 1
    while dy * dy < best:
        while (reach - 1) ** 2 > best - dy * dy:
            reach -= 1
        for r in (row + dy, row - dy):
            if not 0 <= r < height:
                continue
            if has_around and reach <= 32:
                around = (words[r + 1, w] >> within) | (words[r + 1, w + 1] << np.uint64(1) << (np.uint64(63) - within))
                if ~around >> np.uint64(33 - reach) << np.uint64(65 - 2 * reach) == 0:
                    continue  # amid the road all that are near enough are set
            dx = _columns_to_clear(words, r, col, width, reach)
            best = min(best, dx * dx + dy * dy)
        dy += 1
    return math.sqrt(best)


@compiled
def run_through(
    words: UInt64Array, height: int, width: int, row: float, col: float, dr: float, dc: float, limit: float
) -> float:
    """Measure how far the set pixels run through a point, along a line.

    Parameters
    ----------
    words, height, width
        A packed image.
    row, col, dr, dc : float
        The point, and the unit direction of the line.
    limit : float
        Longest run, pixels.

    Returns
    -------
    float
        Pixels; 0 where the pixel at the point is clear, and where the run is longer or leaves the image.
    """
    total = -_RUN_STEP  # the middle is counted from both sides
    for side in range(2):
        step = _RUN_STEP if side == 0 else -_RUN_STEP
        count = 0
        while True:
            r = math.floor(row + count * step * dr + 0.5)
            c = math.floor(col + count * step * dc + 0.5)
            if r < 0 or r >= height or c < 0 or c >= width or total > limit:
                return 0.0
            if ((words[r + 1, c >> 6] >> np.uint64(c & 63)) & np.uint64(1)) == 0:
                break
            total += _RUN_STEP
            count += 1
    return max(total, 0.0)


@compiled
def median_runs_across(
    words: UInt64Array,
    height: int,
    width: int,
    start: FloatArray,
    directions: FloatArray,
    distances: FloatArray,
    longest: float,
    alike: float,
    minimum: int,
) -> FloatArray:
    """Measure how far the set pixels run at right angles to some rays: the median along each.

    One that is longer than from bisector to bisector of a ray and the nearest others is theirs, and does not count.

    Parameters
    ----------
    words, height, width
        A packed image.
    start : (2,) float64
        Row and column where they start.
    directions : (B, 2) float64
        Unit direction (row, column) of each.
    distances : (S,) float64
        Where along each, pixels.
    longest : float
        Longest run that counts, pixels.
    alike : float
        Cosine of the angle between rays up to which they run side by side, and share no bisector.
    minimum : int
        Number of runs that make a median.

    Returns
    -------
    (B,) float64
        Pixels; NaN where there are too few runs.
    """
    medians = np.full(directions.shape[0], np.nan)
    runs = np.empty(distances.size)
    for b in range(directions.shape[0]):
        (dr, dc), count, cosine = directions[b], 0, _LEAST_COSINE
        for other_dr, other_dc in directions:
            if cosine < dr * other_dr + dc * other_dc <= alike:
                cosine = dr * other_dr + dc * other_dc
        tangent = math.sqrt((1.0 - cosine) / (1.0 + cosine))  # of half the angle
        for distance in distances:
            row, col = start[0] + distance * dr, start[1] + distance * dc
            run = run_through(words, height, width, row, col, -dc, dr, min(2.0 * tangent * distance, longest))
            if run > 0.0:
                runs[count] = run
                count += 1
        if count >= minimum:
            medians[b] = np.median(runs[:count])
    return medians
