"""Layers that are made of the intersections of a result: their branches as lines, their uncertainty as ellipses."""

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
"""Semi-axes in sigmas of the ellipse that holds 95 % of a normal distribution in the plane: sqrt(-2 ln 0.05)."""

_CORNERS = 48


def derive(name: str, intersections: Rows) -> Rows:
    """Return a layer of `DERIVED` of a result with longitude and latitude, as if it had been read."""
    return DERIVED[name].rows(derived_features(name, intersections), OWN_CREDIT, intersections.path)


def derived_features(name: str, intersections: Rows) -> list[dict[str, Any]]:
    """Return a layer of `DERIVED` as GeoJSON features; those at the antimeridian are not cut."""
    return _MAKERS[name](intersections)


def _branches(intersections: Rows) -> list[dict[str, Any]]:
    lines, ids, bearings, widths = [], [], [], []
    for feature in intersections.features:
        start, properties = np.array(feature.geometry.coordinates), feature.properties
        for bearing, width in zip(properties.branch_bearings_deg, properties.branch_widths_m, strict=True):
            angle = np.radians(bearing)
            end = _around(start, BRANCH_M * np.array([[np.sin(angle), np.cos(angle)]]))
            lines.append(positions(np.vstack([start, end]), local=False))
            ids.append(properties.id)
            bearings.append(bearing)
            widths.append(width)
    return DERIVED["branches"].features(lines, intersection=ids, bearing_deg=bearings, width_m=widths)


def _uncertainty(intersections: Rows) -> list[dict[str, Any]]:
    turn = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    std_m = intersections.numbers("position_std_m")
    polygons, axes = [], []
    for feature, centre, std in zip(intersections.features, intersections.points(), std_m, strict=True):
        major, minor, bearing = _ellipse(feature.properties.position_cov_m2 or [std**2, 0.0, std**2])
        axes.append((SIGMAS * major, SIGMAS * minor, bearing))
        along = np.array([np.sin(np.radians(bearing)), np.cos(np.radians(bearing))])
        across = np.array([-along[1], along[0]])  # to the left: counter-clockwise (RFC 7946, 3.1.6)
        ellipse = np.outer(np.cos(turn), major * along) + np.outer(np.sin(turn), minor * across)
        ring = positions(_around(centre, SIGMAS * ellipse), local=False)
        polygons.append([[*ring, ring[0]]])
    major_m, minor_m, bearing_deg = np.array(axes, dtype=np.float64).reshape(-1, 3).T
    return DERIVED["uncertainty"].features(
        polygons,
        intersection=intersections.column("id"),
        position_std_m=std_m,
        radius_m=SIGMAS * std_m,
        semi_major_m=major_m,
        semi_minor_m=minor_m,
        bearing_deg=bearing_deg,
    )


def _ellipse(covariance: list[float]) -> tuple[float, float, float]:
    """Return the semi-axes of one sigma, metres, and the bearing of the longer one in [0, 180) degrees."""
    east, both, north = covariance
    middle, half = (east + north) / 2.0, np.hypot((east - north) / 2.0, both)
    bearing = np.degrees(0.5 * np.arctan2(2.0 * both, north - east)) % 180.0
    return float(np.sqrt(middle + half)), float(np.sqrt(max(middle - half, 0.0))), round(float(bearing), 3) % 180.0


def _around(lonlat: FloatArray, enu_xy: FloatArray) -> FloatArray:
    return lonlat_from_enu(lonlat[1], lonlat[0], enu_xy)


_MAKERS: dict[str, Callable[[Rows], list[dict[str, Any]]]] = {"branches": _branches, "uncertainty": _uncertainty}
