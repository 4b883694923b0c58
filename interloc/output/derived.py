"""Layers that are made of the intersections of a result: their branches as lines, their uncertainty as circles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import lonlat_from_enu
from interloc.output.credits import OWN_CREDIT
from interloc.output.geojson import positions
from interloc.output.layers import DERIVED, Rows

BRANCH_M = 20.0
"""Length of a branch as it is drawn; how long the road is, the result does not say."""

SIGMAS = 2.4477
"""Radius in sigmas of the circle that holds 95 % of a normal distribution in the plane: sqrt(-2 ln 0.05)."""

_CORNERS = 48


def derive(name: str, intersections: Rows) -> Rows:
    """Return a layer of `DERIVED`, as if it had been read.

    Parameters
    ----------
    name
    intersections
        The layer `intersections` of a result with longitude and latitude.
    """
    return DERIVED[name].rows(_MAKERS[name](intersections), OWN_CREDIT, intersections.path)


def _branches(intersections: Rows) -> list[dict[str, Any]]:
    lines, ids, bearings, widths, drives = [], [], [], [], []
    for feature in intersections.features:
        start, properties = np.array(feature.geometry.coordinates), feature.properties
        measured = properties.branch_widths_m or [None] * len(properties.branch_bearings_deg)  # none of older versions
        for bearing, width in zip(properties.branch_bearings_deg, measured, strict=True):
            angle = np.radians(bearing)
            end = _around(start, BRANCH_M * np.array([[np.sin(angle), np.cos(angle)]]))
            lines.append(positions(np.vstack([start, end]), local=False))
            ids.append(properties.id)
            bearings.append(bearing)
            widths.append(width)
            drives.append(properties.drive)
    return DERIVED["branches"].features(lines, intersection=ids, bearing_deg=bearings, width_m=widths, drive=drives)


def _uncertainty(intersections: Rows) -> list[dict[str, Any]]:
    turn = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=-1)  # counter-clockwise (RFC 7946, 3.1.6)
    std_m = intersections.numbers("position_std_m")
    polygons = []
    for centre, radius in zip(intersections.points(), SIGMAS * std_m, strict=True):
        ring = positions(_around(centre, radius * circle), local=False)
        polygons.append([[*ring, ring[0]]])
    return DERIVED["uncertainty"].features(
        polygons,
        intersection=intersections.column("id"),
        position_std_m=std_m,
        radius_m=SIGMAS * std_m,
        drive=intersections.column("drive"),
    )


def _around(lonlat: FloatArray, enu_xy: FloatArray) -> FloatArray:
    return lonlat_from_enu(lonlat[1], lonlat[0], enu_xy)


_MAKERS: dict[str, Callable[[Rows], list[dict[str, Any]]]] = {"branches": _branches, "uncertainty": _uncertainty}
