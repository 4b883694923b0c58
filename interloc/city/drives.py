"""A drive in the plane of the map, and the sightings of several drives as one system."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.city.adjustment import Prior, Sightings
from interloc.city.passes import Pass
from interloc.city.settings import CityConfig

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


@dataclass
class DriveOnMap:
    """A drive of M sightings on the map."""

    data: Pass
    xy: FloatArray
    track_xy: FloatArray
    """(M, 2), (K, 2) float64: sightings and keyframes in the plane of the map, as the drive has them."""
    knot: IntArray
    share: FloatArray
    """(M,) int64, float64: see `interloc.city.adjustment.Sightings`."""
    prior: Prior
    knots: FloatArray
    """(k, 2) float64: offset of the drive at each knot: what it says minus what is, metres."""
    shift: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    """(2,) float64: offset against the other drives by voting, rounded."""
    place: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    neighbourhood: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """(M,) int64: which each sighting belongs to; -1: not yet known."""

    def __post_init__(self) -> None:
        if not len(self.place):
            self.place, self.neighbourhood = (np.full(len(self.xy), -1, dtype=np.int64) for _ in range(2))

    @cached_property
    def track(self) -> cKDTree:
        """The keyframes, to find the nearest one."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

        return cKDTree(self.track_xy)

    @cached_property
    def track_each_m(self) -> FloatArray:
        """Positions each metre along the keyframes, (n, 2)."""
        travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(self.track_xy, axis=0).T)))
        at = np.arange(0.0, travelled[-1] + 0.5)
        return np.stack([np.interp(at, travelled, axis) for axis in self.track_xy.T], axis=-1)

    @cached_property
    def branches(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Bearings and widths of the branches of all sightings, one after the other, and how many each has."""
        data = self.data
        bearing, width = (np.concatenate([np.zeros(0), *each]) for each in (data.bearings_deg, data.widths_m))
        return bearing, width, np.array([len(each) for each in data.bearings_deg], dtype=np.int64)

    @cached_property
    def box(self) -> FloatArray:
        """Lowest and highest x and y of what it saw, (2, 2); without anything the lowest is the higher one."""
        return np.stack([self.xy.min(axis=0, initial=np.inf), self.xy.max(axis=0, initial=-np.inf)])

    @cached_property
    def track_box(self) -> FloatArray:
        """The same of its keyframes."""
        return np.stack([self.track_xy.min(axis=0), self.track_xy.max(axis=0)])

    def ground_at(self, xy: FloatArray, epsg: int | None) -> tuple[BoolArray, BoolArray]:
        """Return where it saw road, and where other ground, of (N, 2) positions on the map: else it saw nothing."""
        road, nothing = self.data.road, np.zeros(len(xy), dtype=np.bool_)
        if road is None or road.epsg is None or not len(xy):
            return nothing, nothing
        along = self.data.track_along_m
        nearest = np.argmin(np.sum((self.track_xy - xy.mean(axis=0)) ** 2, axis=1))
        knots = np.linspace(0.0, along[-1], len(self.knots))
        there = xy + [np.interp(along[nearest], knots, axis) for axis in self.knots.T]
        if road.epsg != epsg:
            from pyproj import Transformer  # noqa: PLC0415 - slow to import

            turned = Transformer.from_crs(epsg, road.epsg, always_xy=True).transform(there[:, 0], there[:, 1])
            there = np.stack(turned, axis=-1)
        is_road = road.raster.at(there) > 0
        return is_road, nothing if road.other is None else (road.other.at(there) > 0) & ~is_road


def system_of(drives: Sequence[DriveOnMap], config: CityConfig) -> tuple[Sightings, IntArray]:
    """Return the sightings of drives, with places numbered anew, and the number that each place had before."""
    first = np.cumsum([0, *(len(d.knots) for d in drives)])
    numbers, place = np.unique(np.concatenate([d.place for d in drives]), return_inverse=True)
    sightings = Sightings(
        xy=np.concatenate([d.xy for d in drives]),
        weight=np.concatenate([1.0 / (d.data.scatter_std_m**2 + config.noise_std_m**2) for d in drives]),
        place=place.reshape(-1),
        knot=np.concatenate([d.knot + start for d, start in zip(drives, first[:-1].tolist(), strict=True)]),
        share=np.concatenate([d.share for d in drives]),
    )
    return sightings, numbers
