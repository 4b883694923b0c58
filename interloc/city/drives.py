"""What the map of a city keeps of one drive, the drive in the plane of the map, and several drives as one system."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.city.alignment import Prior, Sightings
from interloc.city.models import CityConfig
from interloc.errors import DamagedResultError, GeoreferenceError, expect
from interloc.files import write_file
from interloc.geometry import enu_from_lonlat, projection, travelled, tree_of
from interloc.mapping.mosaic import Mosaic, Raster, Tiles
from interloc.output.layers import LAYERS
from interloc.output.road import DAMAGED, mosaic_of
from interloc.results import EPOCH_S, DriveResult

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

ASSUMED_STD_M = 0.3
"""Standard deviation along each axis of fixes, and of scatter, that a result does not state."""

HOLE_M = 15.0
"""Nobody knows where a drive went between keyframes farther apart: scans were lost."""

_MAX_LOST_SHARE = 0.05
_TEXTS = ("name", "key")
_RAGGED = ("bearings_deg", "widths_m")


@dataclass(frozen=True)
class Pass:
    """One drive on the map: M intersections, K keyframes."""

    name: str
    """Of the drive; no two of a map have the same."""
    key: str
    """Of what it holds: the same drive, read again, has the same."""
    lonlat: FloatArray
    """(M, 2) float64: intersections, degrees."""
    fix_std_m: FloatArray
    shape_cov_m2: FloatArray
    scatter_std_m: FloatArray
    """(M,), (M, 3), (M,) float64: as of `interloc.results.PositionParts`, all known."""
    confidence: FloatArray
    """(M,) float64."""
    observations: IntArray
    number: IntArray
    """(M,) int64: detections fused; number of the intersection in the result of the drive."""
    along_m: FloatArray
    """(M,) float64: distance driven where it was nearest."""
    bearings_deg: tuple[FloatArray, ...]
    widths_m: tuple[FloatArray, ...]
    """tuple of M (B,) float64: of the branches."""
    seen_s: FloatArray
    """(M, 2) float64: first and last time seen, seconds since 1970; NaN where the drive has no times of the day."""
    track_lonlat: FloatArray
    """(K, 2) float64: keyframes, degrees."""
    track_along_m: FloatArray
    """(K,) float64: distance driven up to each."""
    span_s: FloatArray
    """(2,) float64: first and last time of the drive, as `seen_s`."""
    road: Mosaic | None = None
    """The road that it saw, and other ground."""
    roads_lonlat: tuple[FloatArray, ...] = ()
    """tuple of E (n, 2) float64: centrelines of its roads, where its result has them."""
    road_width_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    road_driven: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    """(E,) float64, bool: their widths, NaN where not known; whether it went along them."""
    dropped_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """(D, 2) float64: from where to where along its track scans were lost."""
    file: Path | None = field(default=None, init=False, compare=False)
    """Where it was read from; None of one that was made, or changed by `replace`."""

    @property
    def is_whole(self) -> bool:
        """Whether it counts as a pass: no scans were lost along more than a twentieth of it."""
        return bool(np.diff(self.dropped_m).sum() <= _MAX_LOST_SHARE * self.track_along_m[-1])

    @cached_property
    def track(self) -> bytes:
        """Digest of when and where it went: no two drives have the same."""
        own = self.key.encode() if len(self.track_lonlat) == 1 else b""  # many begin at one surveyed point
        return hashlib.sha256(self.span_s.tobytes() + np.round(self.track_lonlat, 7).tobytes() + own).digest()

    def __len__(self) -> int:
        return len(self.lonlat)

    @classmethod
    def of(cls, result: DriveResult) -> Pass:
        """Take from a result what the map needs; a GeoreferenceError where it has no georeference."""
        expect(result, DriveResult)
        keyframes, table = result.keyframes, result.intersections
        if keyframes.lonlat is None or table.lonlat is None or not len(keyframes):
            raise GeoreferenceError(
                f"{result.drive}: it has no georeference, so nobody knows where it lies beside other drives. "
                "Run it again with --oxts or a geo.csv in the drive, or place it by `interloc locate`."
            )
        along_m = travelled(keyframes.world_xy)
        time_s = np.where(keyframes.time_s >= EPOCH_S, keyframes.time_s, np.nan)
        first, last = (np.searchsorted(keyframes.frame, each) for each in (table.first_frame, table.last_frame))
        nearest = np.array(
            [
                a + np.argmin(np.hypot(*enu_from_lonlat(place[1], place[0], keyframes.lonlat[a : b + 1]).T))
                for a, b, place in zip(first.tolist(), last.tolist(), table.lonlat, strict=True)
            ],
            dtype=np.int64,
        )
        fix_std, shape, scatter_std = _parts(result)
        known = time_s[np.isfinite(time_s)]
        digest = hashlib.sha256()
        for each in (table.lonlat, table.confidence, keyframes.lonlat):
            digest.update(np.round(each, 7).tobytes())
        dropped = result.run.get("dropped")
        lines, width, is_driven = _roads(result)
        return cls(
            name=result.drive,
            key=digest.hexdigest()[:16],
            lonlat=table.lonlat,
            fix_std_m=fix_std,
            shape_cov_m2=shape,
            scatter_std_m=scatter_std,
            confidence=table.confidence,
            observations=table.observations,
            number=table.id,
            along_m=along_m[nearest],
            bearings_deg=tuple(table.bearings_deg),
            widths_m=tuple(table.widths_m),
            seen_s=np.stack([time_s[first], time_s[last]], axis=-1).reshape(-1, 2),
            track_lonlat=keyframes.lonlat,
            track_along_m=along_m,
            span_s=np.array([known.min(), known.max()] if len(known) else [np.nan, np.nan]),
            road=mosaic_of(result),
            roads_lonlat=lines,
            road_width_m=width,
            road_driven=is_driven,
            dropped_m=np.array(dropped["stretches_m"] if dropped else [], np.float64).reshape(-1, 2),
        )

    def write(self, path: Path) -> None:
        """Write it as an archive of arrays."""
        apart = {"file", "road", "roads_lonlat", *([] if len(self.dropped_m) else ["dropped_m"])}
        arrays = {each.name: getattr(self, each.name) for each in fields(self) if each.name not in apart}
        if self.road is not None:
            arrays["road_epsg"], arrays["road_cell_m"] = self.road.epsg or 0, self.road.raster.cell_m
            for name, raster in (("road", self.road.raster), ("other", self.road.other)):
                packed = {} if raster is None else raster.tiles.packed()
                arrays[f"{name}_keys"] = np.array(list(packed), dtype=np.int64).reshape(-1, 2)
                arrays[f"{name}_bytes"] = np.array([len(cells) for cells in packed.values()], dtype=np.int64)
                arrays[f"{name}_packed"] = np.frombuffer(b"".join(packed.values()), np.uint8)
        arrays["road_points"] = np.concatenate([np.zeros((0, 2)), *self.roads_lonlat])
        arrays["road_sizes"] = np.array([len(line) for line in self.roads_lonlat], dtype=np.int64)
        arrays["branches"] = np.array([len(each) for each in self.bearings_deg], dtype=np.int64)
        for name in _RAGGED:
            arrays[name] = np.concatenate([np.zeros(0), *arrays[name]])
        content = io.BytesIO()
        np.savez_compressed(content, **arrays)
        write_file(path, content.getvalue())

    @classmethod
    def read(cls, path: Path, name: str | None = None) -> Pass:
        """Read what `write` wrote, under that name or another."""
        try:
            with np.load(path) as archive:
                arrays = dict(archive)
            road = None
            if "road_epsg" in arrays:
                cell_m, epsg = float(arrays.pop("road_cell_m")), int(arrays.pop("road_epsg")) or None
                seen, other = (Raster(cell_m, _tiles(arrays, name)) for name in ("road", "other"))
                road = Mosaic(seen, epsg, other if other.tiles else None)
            sizes = arrays.pop("branches")
            made: dict[str, Any] = {name: _cut(arrays.pop(name), sizes) for name in _RAGGED}
            made |= {name: str(arrays.pop(name)) for name in _TEXTS}
            made["roads_lonlat"] = _cut(arrays.pop("road_points"), arrays.pop("road_sizes"))
            found = cls(**made | ({"name": name} if name else {}), **arrays, road=road)
        except DAMAGED as error:
            raise DamagedResultError(f"{path} is missing or damaged ({error}). Merge the drives again.") from error
        object.__setattr__(found, "file", path)
        return found


def _cut(flat: FloatArray, sizes: IntArray) -> tuple[FloatArray, ...]:
    ends = np.cumsum(sizes).tolist()
    return tuple(flat[end - size : end] for size, end in zip(sizes.tolist(), ends, strict=True))


def _roads(result: DriveResult) -> tuple[tuple[FloatArray, ...], FloatArray, BoolArray]:
    """Return lines, widths, and which were driven, of the roads of a result folder.

    Those of older versions, and results in memory, have none.
    """
    path = None if result.road_file is None else result.road_file.with_name("roads.geojson")
    if path is None or not path.is_file():
        return (), np.zeros(0), np.zeros(0, dtype=np.bool_)
    rows = LAYERS["roads"].read(path)
    lines = [each.geometry.coordinates if each.geometry else [] for each in rows.features]
    kept = np.flatnonzero([len(line) > 1 for line in lines])
    width, is_driven = rows.numbers("width_m"), np.array(rows.column("is_driven"), dtype=np.bool_)
    return tuple(np.array(lines[row], dtype=np.float64) for row in kept.tolist()), width[kept], is_driven[kept]


def _tiles(arrays: dict[str, NDArray[Any]], name: str) -> Tiles:
    """Take the arrays of a raster out of those of a file."""
    keys = [(row, column) for row, column in arrays.pop(f"{name}_keys").tolist()]
    cells, ends = arrays.pop(f"{name}_packed").tobytes(), np.cumsum(sizes := arrays.pop(f"{name}_bytes"))
    starts = (ends - sizes).tolist()
    return Tiles({key: cells[a:b] for key, a, b in zip(keys, starts, ends.tolist(), strict=True)})


def _parts(result: DriveResult) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return fix, shape and scatter of the positions of a result.

    Results of versions before do not tell them. Then fix and scatter are taken to be 0.3 m each, where the whole allows
    it, and all else for the part that all drives share: too wide, the more so the more drives there are.
    """
    table = result.intersections
    if table.parts is not None and all(np.isfinite(each).all() for each in vars(table.parts).values()):
        return table.parts.fix_std_m, table.parts.shape_cov_m2, table.parts.scatter_std_m
    whole = table.covariances
    narrow = np.linalg.eigvalsh(whole)[:, 0] if len(table) else np.zeros(0)
    assumed = np.sqrt(np.minimum(ASSUMED_STD_M**2, np.maximum(narrow, 0.0) / 2.0))
    shape = (whole - 2.0 * assumed[:, None, None] ** 2 * np.eye(2)).reshape(-1, 2, 2)
    return np.maximum(assumed, 0.05), shape[:, [0, 0, 1], [0, 1, 1]], assumed


@dataclass
class DriveOnMap:
    """A drive of M sightings on the map."""

    data: Pass
    xy: FloatArray
    track_xy: FloatArray
    """(M, 2), (K, 2) float64: sightings and keyframes in the plane of the map, as the drive has them."""
    knot: IntArray
    share: FloatArray
    """(M,) int64, float64: see `interloc.city.alignment.Sightings`."""
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

    @property
    def offset_range_m(self) -> float:
        """How far its offset ranges along its track."""
        return float(np.hypot(*np.ptp(self.knots, axis=0)))

    @cached_property
    def track(self) -> cKDTree:
        """The keyframes, to find the nearest one."""
        return tree_of(self.track_xy)

    @cached_property
    def track_each_m(self) -> FloatArray:
        """Positions each metre along the keyframes, (n, 2), but within holes: keyframes farther apart than `HOLE_M`."""
        steps = np.hypot(*np.diff(self.track_xy, axis=0).T)
        travelled = np.append(0.0, np.cumsum(steps))
        at = np.arange(0.0, travelled[-1] + 0.5)
        at = at[np.append(steps, 0.0)[np.searchsorted(travelled, at, side="right") - 1] <= HOLE_M]
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
            there = projection(epsg, road.epsg)(there)
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
