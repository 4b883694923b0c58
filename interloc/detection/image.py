"""The images of the region of interest: binary, packed, and anchored in W."""

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, Int32Array, UInt8Array, UInt64Array
from interloc.geometry import rotate_2d
from interloc.kernels import bits
from interloc.kernels.turning import turn


@dataclass(frozen=True)
class Roi:
    """Where the image of a keyframe lies: a square of cells of W, turned about its middle (paper, section III-B.3)."""

    left: int
    top: int
    """Cell index along x of the first column, along y of the first row; rows go down, against +y."""
    size: int
    """Cells per side."""
    resolution_m: float
    """Side of a cell."""
    turn_rad: float = 0.0
    """By how much the image is turned about the middle of the square, counter-clockwise."""

    @property
    def centre_xy(self) -> FloatArray:
        """(2,) float64: the middle of the square in W, metres."""
        half = self.size / 2
        return np.array([self.left + half, self.top + 1 - half]) * self.resolution_m

    def world(self, rows: FloatArray, cols: FloatArray) -> FloatArray:
        """Return the x, y in W, metres, (..., 2), of image positions; pixel centres have whole numbers."""
        x = (self.left + np.asarray(cols, np.float64) + 0.5) * self.resolution_m
        y = (self.top - np.asarray(rows, np.float64) + 0.5) * self.resolution_m
        world_xy = np.stack([x, y], axis=-1)
        return self.centre_xy + rotate_2d(world_xy - self.centre_xy, self.turn_rad) if self.turn_rad else world_xy

    def image(self, world_xy: FloatArray) -> FloatArray:
        """Return the row, column, (..., 2), of points of W: the inverse of `world`."""
        if self.turn_rad:
            world_xy = self.centre_xy + rotate_2d(world_xy - self.centre_xy, -self.turn_rad)
        cols = world_xy[..., 0] / self.resolution_m - 0.5 - self.left
        rows = self.top + 0.5 - world_xy[..., 1] / self.resolution_m
        return np.stack([rows, cols], axis=-1)


@dataclass(frozen=True)
class BinaryImage:
    """A binary image packed 64 columns per word (layout: `interloc.kernels.bits`)."""

    words: UInt64Array
    """(H + 2, W) uint64."""
    height: int
    width: int
    """Pixels."""
    resolution_m: float
    """Side of a pixel."""

    @classmethod
    def empty(cls, height: int, width: int, resolution_m: float) -> "BinaryImage":
        """Return an image with no pixel set."""
        return cls(np.zeros((height + 2, bits.words_for(width)), np.uint64), height, width, resolution_m)

    def turned(self, size: int, angle_rad: float) -> "BinaryImage":
        """Return its middle, of so many pixels per side, along axes that are turned counter-clockwise; it is square."""
        if angle_rad == 0.0 and size == self.height:
            return self
        image = BinaryImage.empty(size, size, self.resolution_m)
        turn(self.words, self.height, angle_rad, image.words)
        return image

    def to_array(self) -> UInt8Array:
        """Return the image as (H, W) uint8 of 0 and 1."""
        return bits.unpack(self.words, self.width)

    def pixels(self) -> tuple[Int32Array, Int32Array]:
        """Return rows and columns of the set pixels, (P,) int32 each, in row-major order."""
        return bits.set_pixels(self.words)
