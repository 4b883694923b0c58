"""What the drives of a map saw of the ground at a place: road, other ground, or nothing."""

from __future__ import annotations

import numpy as np

from interloc.arrays import BoolArray, FloatArray
from interloc.city.citymap import CityMap


def ground_at(city: CityMap, name: str, xy: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return where a drive saw road, and where other ground, of (N, 2) positions on the map: else it saw nothing."""
    drive = city.drives[name]
    road = drive.data.road
    nothing = np.zeros(len(xy), dtype=np.bool_)
    if road is None or road.epsg is None or not len(xy):
        return nothing, nothing
    nearest = np.argmin(np.sum((drive.track_xy - xy.mean(axis=0)) ** 2, axis=1))
    knot = np.linspace(0.0, drive.data.track_along_m[-1], len(drive.knots))
    along = drive.data.track_along_m[nearest]
    there = xy + [np.interp(along, knot, drive.knots[:, axis]) for axis in (0, 1)]
    if road.epsg != city.epsg:
        from pyproj import Transformer  # noqa: PLC0415 - slow to import

        turned = Transformer.from_crs(city.epsg, road.epsg, always_xy=True).transform(there[:, 0], there[:, 1])
        there = np.stack(turned, axis=-1)
    is_road = road.raster.at(there) > 0
    other = nothing if road.other is None else (road.other.at(there) > 0) & ~is_road
    return is_road, other
