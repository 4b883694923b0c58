"""Ideal roads, drawn on the ground and seen in one scan."""

from itertools import pairwise

import numpy as np

from interloc.arrays import Float32Array
from interloc.config import DEFAULT, DetectorConfig
from interloc.detection.detector import Detector, KeyframeDetections
from interloc.detection.scan import Scan

Polyline = tuple[tuple[float, float], ...]


def draw_roads(*roads: Polyline, width_m: float, turned_deg: float = 0.0, extent_m: float = 62.0) -> Float32Array:
    """Return one point a 16 cm cell on all that lies within half a width of one of the polylines, (N, 3).

    The whole is turned counter-clockwise about the origin. It covers the window around a vehicle at the origin.
    """
    resolution_m = 0.16
    half = int(extent_m / resolution_m)
    centres = (np.arange(-half, half) + 0.5) * resolution_m
    c, s = np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))
    is_road = np.zeros((2 * half, 2 * half), np.bool_)
    for road in roads:
        ends = np.array(road, np.float64) @ np.array([[c, s], [-s, c]])
        for a, b in pairwise(ends):
            left, low = np.searchsorted(centres, np.minimum(a, b) - width_m)
            right, high = np.searchsorted(centres, np.maximum(a, b) + width_m)
            x, y = centres[None, left:right], centres[low:high, None]
            (ax, ay), (dx, dy) = a, b - a
            along = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0, 1)
            is_near = (x - ax - along * dx) ** 2 + (y - ay - along * dy) ** 2 <= width_m**2 / 4
            is_road[low:high, left:right] |= is_near
    rows, cols = np.nonzero(is_road)
    return np.column_stack([centres[cols], centres[rows], np.full(rows.size, -1.73)]).astype(np.float32)


def detect(points: Float32Array, config: DetectorConfig = DEFAULT) -> KeyframeDetections:
    """Push one scan taken at the origin of W; one point makes a cell road."""
    values = config.model_dump()
    values["bev"] |= {"min_points": 1}
    values["keyframes"] |= {"lookahead": 0}
    found = Detector(DetectorConfig.model_validate(values)).push(Scan(0, np.eye(4), points))
    assert found is not None
    return found
