"""The road seen by LiDAR as files: a GeoTIFF in the result folder, and a picture of it for a web map."""

import io
import math
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from interloc.arrays import FloatArray, UInt8Array
from interloc.errors import DamagedResultError
from interloc.files import write_file
from interloc.geometry import WGS84_A_M, projection
from interloc.mapping.mosaic import TILE, Mosaic, Raster, build_mosaic
from interloc.results import DriveResult

ROAD_LAYER = "road"
ROAD_TITLE = "Road seen by LiDAR"

DAMAGED = (OSError, EOFError, ValueError, LookupError, TypeError, NotImplementedError, zipfile.BadZipFile, zlib.error)
"""What the readers of TIFF and NumPy raise for a damaged file."""

MAX_PICTURE_PX = 4096
"""Longest side of the picture; a larger drive is shown in larger cells."""

_HALF_EARTH_M = math.pi * WGS84_A_M  # of x of Web Mercator
_DESCRIPTION = (
    f"{ROAD_TITLE}. Value: number of keyframes, 10 m apart along the drive, from which the cell was seen as road; "
    "0: not seen. The second page holds the same of other ground, such as sidewalks, where it was told apart."
)
_OTHER_DESCRIPTION = "Other ground seen by LiDAR, counted like the road of the first page; 0 in both: not seen."
_PIXEL_SCALE, _TIEPOINT, _GEO_KEYS, _NODATA = 33550, 33922, 34735, 42113  # tags of GeoTIFF and GDAL
_MODEL_TYPE, _RASTER_TYPE, _PROJECTED_CRS = 1024, 1025, 3072  # keys of GeoTIFF
_PROJECTED, _PIXEL_IS_AREA = 1, 1
GREY = (146, 156, 164)
ALPHA = (0, 100, 160, 210)
"""Of cells that 0, 1, 2, 3 and more keyframes saw as road."""

_BLOCK = 256  # pixels of the picture per piece that is taken for plane
_WEB_MERCATOR, _LONLAT = 3857, 4326


def write_road(mosaic: Mosaic, path: Path) -> None:
    """Write a mosaic as GeoTIFF: tiled, deflated, 0 is no data; all empty tiles are one in the file.

    Tiles that are left out, as GDAL can, are no tiles to other readers: OpenCV and Pillow refuse the file.
    """
    from tifffile import TiffWriter  # noqa: PLC0415 - slow to import

    content = io.BytesIO()
    with TiffWriter(content) as tiff:
        _write_page(tiff, mosaic.raster, mosaic.epsg, _DESCRIPTION)
        if mosaic.other is not None:
            _write_page(tiff, mosaic.other, mosaic.epsg, _OTHER_DESCRIPTION)
    _share_empty_tile(content)
    write_file(path, content.getvalue())


def _write_page(tiff: Any, raster: Raster, epsg: int | None, description: str) -> None:  # noqa: ANN401 - a TiffWriter
    top, left, bottom, right = raster.extent()
    side = TILE * raster.cell_m
    keys = [(_RASTER_TYPE, _PIXEL_IS_AREA)]
    if epsg is not None:
        keys = [(_MODEL_TYPE, _PROJECTED), *keys, (_PROJECTED_CRS, epsg)]
    directory = [1, 1, 0, len(keys), *(number for key, value in keys for number in (key, 0, 1, value))]
    tags: list[tuple[int, str, int, Any, bool]] = [
        (_PIXEL_SCALE, "d", 3, (raster.cell_m, raster.cell_m, 0.0), True),
        (_TIEPOINT, "d", 6, (0.0, 0.0, 0.0, left * side, -top * side, 0.0), True),
        (_GEO_KEYS, "H", len(directory), tuple(directory), True),
        (_NODATA, "s", 0, "0", True),
    ]
    there = (raster.tiles.get((row, col)) for row in range(top, bottom + 1) for col in range(left, right + 1))
    tiles = (b"" if tile is None else zlib.compress(tile.tobytes()) for tile in there)
    tiff.write(
        tiles,
        shape=((bottom - top + 1) * TILE, (right - left + 1) * TILE),
        dtype=np.uint8,
        tile=(TILE, TILE),
        compression="zlib",
        photometric="minisblack",
        description=description,
        software="InterLoc",
        metadata=None,
        extratags=tags,
    )


def _share_empty_tile(content: io.BytesIO) -> None:
    """Let the tiles that were left out be one that is empty, at the end of the file."""
    from tifffile import TiffFile  # noqa: PLC0415

    empty = zlib.compress(bytes(TILE * TILE))
    place = content.seek(0, io.SEEK_END)
    content.write(empty)
    content.seek(0)
    with TiffFile(content) as tiff:
        pages: Any = list(tiff.pages)
        for tags in (page.tags for page in pages):
            offsets, counts = (list(tags[name].value) for name in ("TileOffsets", "TileByteCounts"))
            tags["TileOffsets"].overwrite([offset or place for offset in offsets])
            tags["TileByteCounts"].overwrite([count or len(empty) for count in counts])


def read_road(path: Path) -> Mosaic:
    """Read what `write_road` wrote; a DamagedResultError says that it is missing or damaged."""
    from tifffile import TiffFile, TiffFileError  # noqa: PLC0415

    try:
        with TiffFile(path) as tiff:
            (raster, epsg), *others = (_read_page(page) for page in tiff.pages)
    except (*DAMAGED, TiffFileError) as error:
        raise DamagedResultError(f"{path} is missing or damaged. Run `interloc run` again.") from error
    return Mosaic(raster, epsg, others[0][0] if others else None)


def _read_page(page: Any) -> tuple[Raster, int | None]:  # noqa: ANN401 - of tifffile
    raster = Raster(float(page.tags[_PIXEL_SCALE].value[0]))
    _, _, _, x, y, _ = page.tags[_TIEPOINT].value
    side = TILE * raster.cell_m
    left, top = round(x / side), round(-y / side)
    keys = page.tags[_GEO_KEYS].value[4:]
    epsg = next((int(keys[i + 3]) for i in range(0, len(keys), 4) if keys[i] == _PROJECTED_CRS), None)
    for cells, index, _ in page.segments():
        if cells is not None and cells.any():
            raster.tiles[top + index[-3] // TILE, left + index[-2] // TILE] = cells.reshape(TILE, TILE)
    return raster, epsg


def mosaic_of(result: DriveResult) -> Mosaic:
    """Return the road that a run saw: from its patches, or from `road.tif` where it was read from a folder."""
    return build_mosaic(result) if result.road_file is None else read_road(result.road_file)


@dataclass(frozen=True)
class Picture:
    """A picture of the road for a web map."""

    png: bytes
    """Transparent where no road was seen."""
    bounds: tuple[float, float, float, float]
    """West, south, east, north: degrees, of a picture in Web Mercator; or metres of W."""
    size: tuple[int, int]
    """Width and height, pixels."""
    cell_m: float
    """Side of the cells that it is drawn of."""


def draw_road(mosaic: Mosaic) -> Picture:
    """Draw a mosaic, in coarser cells where it is too large for a picture."""
    forward, backward = _projections(mosaic.epsg)
    raster = mosaic.raster
    box = _bounds(raster, forward)
    across = max(box[2] - box[0], box[3] - box[1])
    top, left, bottom, right = raster.extent()
    own = max(bottom - top + 1, right - left + 1) * TILE * raster.cell_m
    stretch = across / max(own, 1e-9)  # Web Mercator makes things larger
    while across / (raster.cell_m * stretch) > MAX_PICTURE_PX:
        raster = raster.coarser()
    pixel = raster.cell_m * stretch
    width, height = (max(1, math.ceil((box[i + 2] - box[i]) / pixel)) for i in (0, 1))
    cells = np.zeros((height, width), np.uint8)
    for row in range(0, height, _BLOCK):
        for col in range(0, width, _BLOCK):
            part = cells[row : row + _BLOCK, col : col + _BLOCK]
            corner = np.array([[box[0] + col * pixel, box[3] - row * pixel]])
            step = _BLOCK * pixel
            corners = backward(corner + np.array([[0.0, 0.0], [step, 0.0], [0.0, -step]]))
            _draw_block(raster, corners * [1.0, -1.0] / raster.cell_m, part)
    edge = np.array([[box[0], box[3] - height * pixel], [box[0] + width * pixel, box[3]]])
    if mosaic.epsg is not None:
        edge = projection(_WEB_MERCATOR, _LONLAT)(edge)
    (west, south), (east, north) = edge.tolist()
    east += 360.0 * (mosaic.epsg is not None and east < west)  # across the 180th meridian
    return Picture(png_of(cells), (west, south, east, north), (width, height), raster.cell_m)


def _draw_block(raster: Raster, corners: FloatArray, part: UInt8Array) -> None:
    """Draw a block of the picture; its upper left, upper right and lower left corner are given in cells x, y."""
    matrix = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]]) / _BLOCK
    far = corners[1] + corners[2] - corners[0]
    every = np.vstack([corners, far])
    first = np.floor(every.min(axis=0)).astype(int) - 1
    size = np.ceil(every.max(axis=0)).astype(int) + 1 - first
    window = raster.window(int(first[1]), int(first[0]), int(size[1]), int(size[0]))
    if window is None:
        return
    middle = corners[0] - first + matrix @ [0.5, 0.5] - 0.5
    affine = np.column_stack([matrix, middle])
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    part[:] = cv2.warpAffine(window, affine, part.shape[::-1], flags=flags)


def png_of(cells: UInt8Array) -> bytes:
    """Return cells as a picture: the more keyframes saw a cell, the less transparent it is."""
    from PIL import Image  # noqa: PLC0415

    picture = Image.fromarray(np.minimum(cells, len(ALPHA) - 1))
    picture.putpalette(GREY * len(ALPHA))
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", transparency=bytes(ALPHA), bits=2, compress_level=6)
    return buffer.getvalue()


Projection = Callable[[FloatArray], FloatArray]


def _projections(epsg: int | None) -> tuple[Projection, Projection]:
    """Return what leads from the metres of a raster to those of its picture, and back."""
    if epsg is None:
        return (lambda xy: xy), (lambda xy: xy)
    return projection(epsg, _WEB_MERCATOR), projection(_WEB_MERCATOR, epsg)


def _bounds(raster: Raster, forward: Projection) -> tuple[float, float, float, float]:
    side = TILE * raster.cell_m
    corners = [(col + i, -(row + j)) for row, col in raster.tiles for i in (0, 1) for j in (0, 1)]
    places = forward(side * np.array(corners, dtype=np.float64))
    if np.ptp(places[:, 0]) > _HALF_EARTH_M:  # across the 180th meridian
        places[places[:, 0] < 0.0, 0] += 2.0 * _HALF_EARTH_M
    (west, south), (east, north) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return west, south, east, north
