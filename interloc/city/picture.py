"""Evidence for a person: the ground around a place as the drives of a map saw it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from interloc.arrays import FloatArray
from interloc.city.citymap import CityMap

HALF_M = 40.0
_CELL_M = 0.5
_SIDE = round(2 * HALF_M / _CELL_M)
_SCALE = 4  # pixels per cell
_UNSEEN, _OTHER, _ROAD, _TRACK, _PLACE, _NODE = (
    tuple(int(colour[i : i + 2], 16) for i in (5, 3, 1))  # OpenCV: blue, green, red
    for colour in ("#ffffff", "#d9e6cf", "#6f7880", "#0072b2", "#d55e00", "#b3478c")
)


def picture_of(city: CityMap, xy: FloatArray, names: tuple[str, ...], node_xy: FloatArray | None = None) -> bytes:
    """Draw the 80 m around a place, north up, as PNG.

    Parameters
    ----------
    city
    xy : (2,) float64
        In the plane of the map: a cross.
    names
        Drives whose ground and tracks (blue) are drawn: the darker the road, the more of them saw it.
    node_xy : (2,) float64, optional
        The node of OpenStreetMap that it is about: a ring.
    """
    step = (np.arange(_SIDE) + 0.5) * _CELL_M - HALF_M
    east, south = np.meshgrid(step, step)
    cells = xy + np.stack([east, -south], axis=-1).reshape(-1, 2)
    road, other = np.zeros((2, len(cells)))
    for name in names:
        saw_road, saw_other = city.drives[name].ground_at(cells, city.epsg)
        road, other = road + saw_road / len(names), np.maximum(other, saw_other)
    image = np.full((len(cells), 3), _UNSEEN, dtype=np.float64)
    image[other > 0] = _OTHER
    depth = np.where(road > 0, 0.35 + 0.65 * road, 0.0)[:, None]
    image = (1.0 - depth) * image + depth * np.array(_ROAD)
    small = image.reshape(_SIDE, _SIDE, 3).astype(np.uint8)
    drawn = np.ascontiguousarray(np.kron(small, np.ones((_SCALE, _SCALE, 1), dtype=np.uint8)))

    def pixel(at: FloatArray) -> Any:  # noqa: ANN401 - as OpenCV takes them
        return np.round((np.array([1.0, -1.0]) * (at - xy) + HALF_M) * _SCALE / _CELL_M).astype(np.int32)

    for name in names:
        drive = city.drives[name]
        cv2.polylines(drawn, [pixel(drive.track_xy - drive.knots.mean(axis=0))], False, _TRACK, 2, cv2.LINE_AA)
    cv2.drawMarker(drawn, pixel(xy).tolist(), _PLACE, cv2.MARKER_TILTED_CROSS, 22, 3, cv2.LINE_AA)
    if node_xy is not None:
        cv2.circle(drawn, pixel(node_xy).tolist(), 11, _NODE, 3, cv2.LINE_AA)
    return bytes(cv2.imencode(".png", drawn)[1])
