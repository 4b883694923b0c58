"""The road seen by LiDAR as one raster of a whole drive: the patches of its keyframes, pasted where each belongs."""

import zlib
from collections import OrderedDict
from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from types import MappingProxyType

import cv2
import numpy as np

from interloc.arrays import BoolArray, FloatArray, UInt8Array
from interloc.geometry import lonlat_from_enu, projection, rotate_2d, utm_zone
from interloc.results import DriveResult, RoadPatch

TILE = 256
"""Cells per side of a tile."""

CELL_M = 0.5  # finer than the outline of a road is known
_OPEN_TILES = 64  # 4 MB
_MAX_TILES = 250_000  # that a file lists, empty ones too: 64 km by 64 km of the finest cells
_TANGENT_M = 100.0  # arm by which directions are compared


class Tiles(MutableMapping[tuple[int, int], UInt8Array]):
    """Tiles by row and column, of which all but the last ones that were used are kept deflated.

    A tile may be changed until others were used: then it is another array.
    """

    def __init__(self, packed: Mapping[tuple[int, int], bytes] = MappingProxyType({})) -> None:
        self._open: OrderedDict[tuple[int, int], UInt8Array] = OrderedDict()
        self._packed = dict(packed)

    def packed(self) -> dict[tuple[int, int], bytes]:
        """Return all tiles deflated, as a new one takes them."""
        return self._packed | {key: zlib.compress(tile.tobytes(), 1) for key, tile in self._open.items()}

    def __getitem__(self, key: tuple[int, int]) -> UInt8Array:
        if key in self._open:
            self._open.move_to_end(key)
        else:
            cells = zlib.decompress(self._packed[key])
            self[key] = np.frombuffer(bytearray(cells), np.uint8).reshape(TILE, TILE)
        return self._open[key]

    def __setitem__(self, key: tuple[int, int], tile: UInt8Array) -> None:
        self._open[key] = tile
        self._open.move_to_end(key)
        self._packed.pop(key, None)
        if len(self._open) > _OPEN_TILES:
            oldest, cells = self._open.popitem(last=False)
            self._packed[oldest] = zlib.compress(cells.tobytes(), 1)

    def __delitem__(self, key: tuple[int, int]) -> None:
        self._open.pop(key, None)
        self._packed.pop(key, None)

    def __contains__(self, key: object) -> bool:
        return key in self._open or key in self._packed

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter([*self._packed, *self._open])

    def __len__(self) -> int:
        return len(self._open) + len(self._packed)


@dataclass
class Raster:
    """A raster whose tiles exist only where it holds something: its memory grows with the road, not the area."""

    cell_m: float
    """Side of a cell. The cell in row r and column c has its upper left corner at x = c cell_m, y = -r cell_m."""
    tiles: Tiles = field(default_factory=Tiles)
    """mapping of (int, int) to (TILE, TILE) uint8: by row and column of the tile. 0: nothing is known."""

    def add(self, row: int, col: int, cells: UInt8Array) -> None:
        """Add cells to those that are there; sums end at 255."""
        for key, here, there in _overlaps(row, col, *cells.shape):
            piece = cells[here]
            if piece.any():
                tile = self.tiles.get(key)
                if tile is None:
                    tile = self.tiles[key] = np.zeros((TILE, TILE), np.uint8)
                cv2.add(tile[there], piece, tile[there])

    def window(self, row: int, col: int, height: int, width: int) -> UInt8Array | None:
        """Return the cells of a rectangle; None where it holds nothing."""
        cells: UInt8Array | None = None
        for key, here, there in _overlaps(row, col, height, width):
            tile = self.tiles.get(key)
            if tile is not None:
                if cells is None:
                    cells = np.zeros((height, width), np.uint8)
                cells[here] = tile[there]
        return cells

    def at(self, xy: FloatArray) -> UInt8Array:
        """Return the values of the cells at (N, 2) positions, (N,)."""
        cells = np.floor(xy / self.cell_m).astype(np.int64)
        row, col = -cells[:, 1] - 1, cells[:, 0]
        values = np.zeros(len(xy), np.uint8)
        tile_row, tile_col = row // TILE, col // TILE
        for r in np.unique(tile_row).tolist():
            along = np.flatnonzero(tile_row == r)
            for c in np.unique(tile_col[along]).tolist():
                tile = self.tiles.get((r, c))
                if tile is not None:
                    here = along[tile_col[along] == c]
                    values[here] = tile[row[here] % TILE, col[here] % TILE]
        return values

    def extent(self) -> tuple[int, int, int, int]:
        """Return first row, first column, last row and last column of its tiles, of which there must be some."""
        rows, cols = zip(*self.tiles, strict=True)
        return min(rows), min(cols), max(rows), max(cols)

    def coarser(self) -> "Raster":
        """Return it in cells of twice the side, each the greatest of four."""
        coarse = Raster(2 * self.cell_m)
        half = TILE // 2
        for (row, col), tile in self.tiles.items():
            reduced = tile.reshape(half, 2, half, 2).max(axis=(1, 3))
            coarse.add(row * half, col * half, reduced)
        return coarse


@dataclass(frozen=True)
class Mosaic:
    """The road seen on a drive."""

    raster: Raster
    """How many of the patches, which lie 10 m apart along the drive, hold road in the cell; 255 for more."""
    epsg: int | None
    """The raster is in metres of this coordinate system, x to the east, y to the north; None: in metres of W."""
    other: Raster | None = None
    """The same of other ground, such as a sidewalk: what is 0 in both was not seen. None where nobody can tell."""

    def seen_at(self, lonlat: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Return whether road, and else other ground, was seen at (N, 2) degrees, (N,) each; it is georeferenced."""
        xy = projection(4326, self.epsg)(lonlat)
        road = self.raster.at(xy) > 0
        return road, np.zeros_like(road) if self.other is None else (self.other.at(xy) > 0) & ~road


def build_mosaic(result: DriveResult) -> Mosaic:
    """Paste the patches of a run.

    Each patch is placed as the detections of its keyframe are (paper, eq. 12): by the fix of that keyframe where the
    run is georeferenced, so the drift of the poses over the drive does not reach the raster. The coordinate system is
    then the UTM zone of the first keyframe; else it is W.
    """
    table = result.keyframes
    rows = [patch.keyframe for patch in result.road]
    world_xy, origin = table.world_xy[rows], table.world_xy[rows]
    turn = np.broadcast_to(np.eye(2), (len(rows), 2, 2))  # from W to the raster
    epsg = None
    if table.lonlat is not None and table.enu_yaw_rad is not None and rows:
        epsg = utm_zone(*table.lonlat[0].tolist())
        angle = table.enu_yaw_rad[rows] - table.world_yaw_rad[rows]
        origin, turn = _in_utm(table.lonlat[rows], angle, epsg)
    raster, other = (Raster(_cell_m(origin)) for _ in range(2))
    for patch, here, at, matrix in zip(result.road, world_xy, origin, turn, strict=True):
        _paste(raster, other, patch, at + matrix @ (patch.corner_xy - here), matrix)
    return Mosaic(raster, epsg, other if other.tiles else None)


def _in_utm(lonlat: FloatArray, angle_rad: FloatArray, epsg: int) -> tuple[FloatArray, FloatArray]:
    """Return where fixes are in a UTM zone, (N, 2), and the matrices from W to the zone, (N, 2, 2)."""
    to_utm = projection(4326, epsg)

    def place(enu_xy: FloatArray) -> FloatArray:
        return to_utm(lonlat_from_enu(lonlat[:, 1], lonlat[:, 0], enu_xy))

    axes = [rotate_2d(np.broadcast_to(axis, lonlat.shape), angle_rad) for axis in np.eye(2)]
    origin = place(np.zeros_like(lonlat))
    columns = [(place(_TANGENT_M * axis) - origin) / _TANGENT_M for axis in axes]  # scale and grid north are in them
    return origin, np.stack(columns, axis=-1)


def _cell_m(places: FloatArray) -> float:
    """Return the side of the cells: coarser where the area of a drive has more tiles than can be listed."""
    cell_m = CELL_M
    if len(places):
        across = np.ptp(places, axis=0) + 2 * _TANGENT_M
        while np.prod(across / (TILE * cell_m) + 1) > _MAX_TILES:
            cell_m *= 2
    return cell_m


def _paste(raster: Raster, other: Raster, patch: RoadPatch, corner_xy: FloatArray, turn: FloatArray) -> None:
    """Add a patch whose upper left corner lies at a place of the rasters, turned by a matrix."""
    cells, ground = patch.cells(), patch.other_cells()
    flip = np.diag([1.0, -1.0])  # rows go down
    matrix = flip @ turn @ flip * (patch.resolution_m / raster.cell_m)
    shift = flip @ corner_xy / raster.cell_m
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * float(patch.size) @ matrix.T + shift
    first = np.floor(corners.min(axis=0)).astype(int)
    width, height = (np.ceil(corners.max(axis=0)).astype(int) - first).tolist()
    middle = matrix @ [0.5, 0.5] + shift - first - 0.5  # OpenCV counts from the middles of pixels
    affine = np.column_stack([matrix, middle])
    image = cells if ground is None else cells | (ground + ground)  # both at once
    turned = np.asarray(cv2.warpAffine(image, affine, (width, height), flags=cv2.INTER_NEAREST), np.uint8)
    raster.add(int(first[1]), int(first[0]), turned & np.uint8(1))
    if ground is not None:
        other.add(int(first[1]), int(first[0]), turned >> np.uint8(1))


def _overlaps(
    row: int, col: int, height: int, width: int
) -> Iterator[tuple[tuple[int, int], tuple[slice, slice], tuple[slice, slice]]]:
    """Yield each tile that a rectangle touches, and the same cells of both as slices: of the rectangle, of the tile."""
    for tile_row in range(row // TILE, (row + height - 1) // TILE + 1):
        for tile_col in range(col // TILE, (col + width - 1) // TILE + 1):
            top, left = tile_row * TILE, tile_col * TILE
            rows = max(row, top), min(row + height, top + TILE)
            cols = max(col, left), min(col + width, left + TILE)
            here = slice(rows[0] - row, rows[1] - row), slice(cols[0] - col, cols[1] - col)
            there = slice(rows[0] - top, rows[1] - top), slice(cols[0] - left, cols[1] - left)
            yield (tile_row, tile_col), here, there
