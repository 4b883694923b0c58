"""The coordinate system of a cloud: what it must be, and how its axes lie on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError
from interloc.geometry import WGS84_A_M, enu_from_lonlat

_STEP_M = 10.0


@dataclass(frozen=True)
class Grid:
    """A projected coordinate system in metres."""

    crs: Any
    """Its horizontal part."""
    source: str
    """Where it is stated."""

    @property
    def name(self) -> str:
        """Its code or name."""
        code = self.crs.to_epsg(min_confidence=70)
        return f"EPSG:{code}" if code else str(self.crs.name)

    def from_lonlat(self, lonlat: FloatArray) -> FloatArray:
        """Return (N, 2) easting, northing of (N, 2) longitudes and latitudes; infinite where the system ends."""
        return _transform("EPSG:4326", self.crs, lonlat)

    def to_lonlat(self, xy: FloatArray) -> FloatArray:
        """Return (N, 2) longitudes, latitudes on WGS84 of (N, 2) easting, northing; infinite where there are none."""
        return _transform(self.crs, "EPSG:4326", xy)

    def axes(self, xyz: FloatArray) -> FloatArray:
        """Return how the axes lie on the ground: steps east and north, in metres, of a step along each.

        It holds the scale of the projection, the meridian convergence, and the height over the ellipsoid.

        Parameters
        ----------
        xyz : (N, 3) float64
            Points of the grid.

        Returns
        -------
        (N, 2, 2) float64
            ``enu_xy = axes @ grid_xy`` near each point.
        """
        here = self.to_lonlat(xyz[:, :2])
        columns = []
        for step in ((_STEP_M, 0.0), (0.0, _STEP_M)):
            ahead, behind = self.to_lonlat(xyz[:, :2] + step), self.to_lonlat(xyz[:, :2] - step)
            there = enu_from_lonlat(here[:, 1], here[:, 0], ahead) - enu_from_lonlat(here[:, 1], here[:, 0], behind)
            columns.append(there / (2 * _STEP_M))
        axes: FloatArray = np.stack(columns, axis=-1) * (1 + xyz[:, 2] / WGS84_A_M)[:, None, None]
        return axes


def _transform(source: Any, target: Any, xy: FloatArray) -> FloatArray:  # noqa: ANN401 - pyproj.CRS
    from pyproj import Transformer  # noqa: PLC0415 - slow to import

    first, second = Transformer.from_crs(source, target, always_xy=True).transform(xy[:, 0], xy[:, 1])
    return np.stack([first, second], axis=-1)


def grid_of(crs: Any, source: str, file: SourceFile) -> Grid:  # noqa: ANN401 - pyproj.CRS or its name
    """Check a coordinate system, and take its horizontal part.

    Raises
    ------
    DriveError
        There is no such system, or it is not projected, or not in metres.
    """
    from pyproj import CRS  # noqa: PLC0415 - slow to import
    from pyproj.exceptions import CRSError  # noqa: PLC0415

    try:
        crs = CRS.from_user_input(crs)
    except CRSError as error:
        raise DriveFileError(
            f"crs {crs!r}", "is not known. Expected a coordinate system such as EPSG:25832 (--crs)."
        ) from error
    horizontal = crs
    while horizontal.is_bound or (horizontal.is_compound and horizontal.sub_crs_list):
        horizontal = horizontal.source_crs if horizontal.is_bound else horizontal.sub_crs_list[0]
    advice = "Reproject the cloud, with pdal translate IN OUT reprojection --filters.reprojection.out_srs=EPSG:25832."
    if not horizontal.is_projected:
        raise file.fault(
            f"is in {crs.name} ({source}), which is not projected. Expected easting, northing and height in metres, "
            f"such as UTM. {advice}"
        )
    units = {axis.unit_name for axis in crs.axis_info if axis.unit_conversion_factor != 1.0}
    if units:
        raise file.fault(f"is in {crs.name} ({source}), in units of {', '.join(units)}. Expected metres. {advice}")
    return Grid(horizontal.to_2d(), source)
