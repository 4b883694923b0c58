"""What the map of a city keeps of one drive: its intersections, what is sure of each, its track."""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.errors import DamagedResultError, GeoreferenceError
from interloc.files import write_file
from interloc.geometry import enu_from_lonlat
from interloc.mapping.mosaic import Mosaic, Raster, Tiles
from interloc.output.geojson import read_json
from interloc.output.road import mosaic_of
from interloc.results import EPOCH_S, DriveResult

ASSUMED_STD_M = 0.3
"""Standard deviation along each axis of fixes, and of scatter, that a result does not state."""

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

    def __len__(self) -> int:
        return len(self.lonlat)

    @classmethod
    def of(cls, result: DriveResult) -> Pass:
        """Take from a result what the map needs.

        Raises
        ------
        GeoreferenceError
            It has no georeference.

        Notes
        -----
        Results of versions before do not tell the parts of the covariance of a position. Then fix and scatter are taken
        to be 0.3 m each, where the whole allows it, and all else is taken for the part that all drives share: too wide,
        the more so the more drives there are, but never too narrow.
        """
        keyframes, table = result.keyframes, result.intersections
        if keyframes.lonlat is None or table.lonlat is None or not len(keyframes):
            raise GeoreferenceError(
                f"{result.drive}: it has no georeference, so nobody knows where it lies beside other drives. "
                "Detect again with --oxts or a geo.csv in the drive, or place it by `interloc locate`."
            )
        steps = np.hypot(*np.diff(keyframes.world_xy, axis=0).T)
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
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
        arrays: dict[str, Any] = {
            "lonlat": table.lonlat,
            "fix_std_m": fix_std,
            "shape_cov_m2": shape,
            "scatter_std_m": scatter_std,
            "confidence": table.confidence,
            "observations": table.observations,
            "number": table.id,
            "along_m": travelled[nearest],
            "bearings_deg": tuple(table.bearings_deg),
            "widths_m": tuple(table.widths_m),
            "seen_s": np.stack([time_s[first], time_s[last]], axis=-1).reshape(-1, 2),
            "track_lonlat": keyframes.lonlat,
            "track_along_m": travelled,
            "span_s": np.array([known.min(), known.max()] if len(known) else [np.nan, np.nan]),
        }
        digest = hashlib.sha256()
        for name in ("lonlat", "confidence", "track_lonlat"):
            digest.update(np.round(arrays[name], 7).tobytes())
        return cls(name=result.drive, key=digest.hexdigest()[:16], road=mosaic_of(result), **arrays, **_roads(result))

    def write(self, path: Path) -> None:
        """Write it as an archive of arrays."""
        arrays: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(self) if each.name != "road"}
        if self.road is not None:
            arrays["road_epsg"], arrays["road_cell_m"] = self.road.epsg or 0, self.road.raster.cell_m
            for name, raster in (("road", self.road.raster), ("other", self.road.other)):
                packed = {} if raster is None else raster.tiles.packed()
                arrays[f"{name}_keys"] = np.array(list(packed), dtype=np.int64).reshape(-1, 2)
                arrays[f"{name}_bytes"] = np.array([len(cells) for cells in packed.values()], dtype=np.int64)
                arrays[f"{name}_packed"] = np.frombuffer(b"".join(packed.values()), np.uint8)
        lines = arrays.pop("roads_lonlat")
        arrays["road_points"] = np.concatenate([np.zeros((0, 2)), *lines])
        arrays["road_sizes"] = np.array([len(line) for line in lines], dtype=np.int64)
        arrays["branches"] = np.array([len(each) for each in self.bearings_deg], dtype=np.int64)
        for name in _RAGGED:
            arrays[name] = np.concatenate([np.zeros(0), *arrays[name]])
        content = io.BytesIO()
        np.savez_compressed(content, **arrays)
        write_file(path, content.getvalue())

    @classmethod
    def read(cls, path: Path) -> Pass:
        """Read what `write` wrote.

        Raises
        ------
        DamagedResultError
            The file is missing or damaged.
        """
        try:
            with np.load(path) as archive:
                arrays: dict[str, Any] = dict(archive)
            sizes = arrays.pop("branches")
            ragged: dict[str, Any] = {name: _cut(arrays.pop(name), sizes) for name in _RAGGED}
            if "road_sizes" in arrays:
                ragged["roads_lonlat"] = _cut(arrays.pop("road_points"), arrays.pop("road_sizes"))
            road = _mosaic(arrays) if "road_epsg" in arrays else None
            texts: dict[str, Any] = {name: str(arrays.pop(name)) for name in _TEXTS}
            return cls(**texts, **arrays, **ragged, road=road)
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            raise DamagedResultError(f"{path} is missing or damaged ({error}). Merge the drives again.") from error


def _cut(flat: FloatArray, sizes: IntArray) -> tuple[FloatArray, ...]:
    ends = np.cumsum(sizes).tolist()
    return tuple(flat[end - size : end] for size, end in zip(sizes.tolist(), ends, strict=True))


def _roads(result: DriveResult) -> dict[str, Any]:
    """Return the roads of a result folder that has them; those of older versions, and results in memory, do not."""
    path = None if result.road_file is None else result.road_file.with_name("roads.geojson")
    if path is None or not path.is_file():
        return {}
    found = [each for each in read_json(path)["features"] if len(each["geometry"]["coordinates"]) > 1]
    facts = [each["properties"] for each in found]
    return {
        "roads_lonlat": tuple(np.array(each["geometry"]["coordinates"], dtype=np.float64) for each in found),
        "road_width_m": np.array([each["width_m"] for each in facts], dtype=np.float64),
        "road_driven": np.array([each["is_driven"] for each in facts], dtype=np.bool_),
    }


def _mosaic(arrays: dict[str, Any]) -> Mosaic:
    """Take the arrays of the road out of those of a file."""
    cell_m, epsg = float(arrays.pop("road_cell_m")), int(arrays.pop("road_epsg")) or None
    road, other = (Raster(cell_m, _tiles(arrays, name)) for name in ("road", "other"))
    return Mosaic(road, epsg, other if other.tiles else None)


def _tiles(arrays: dict[str, Any], name: str) -> Tiles:
    keys = [(row, column) for row, column in arrays.pop(f"{name}_keys").tolist()]
    if f"{name}_tiles" in arrays:  # of an older version
        found = Tiles()
        found.update(zip(keys, arrays.pop(f"{name}_tiles"), strict=True))
        return found
    cells, ends = arrays.pop(f"{name}_packed").tobytes(), np.cumsum(sizes := arrays.pop(f"{name}_bytes"))
    starts = (ends - sizes).tolist()
    return Tiles({key: cells[a:b] for key, a, b in zip(keys, starts, ends.tolist(), strict=True)})


def _parts(result: DriveResult) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return fix, shape and scatter of the positions of a result, assumed where it does not tell them."""
    table = result.intersections
    if table.parts is not None and all(np.isfinite(each).all() for each in vars(table.parts).values()):
        return table.parts.fix_std_m, table.parts.shape_cov_m2, table.parts.scatter_std_m
    whole = table.covariances
    narrow = np.linalg.eigvalsh(whole)[:, 0] if len(table) else np.zeros(0)
    assumed = np.sqrt(np.minimum(ASSUMED_STD_M**2, np.maximum(narrow, 0.0) / 2.0))
    shape = (whole - 2.0 * assumed[:, None, None] ** 2 * np.eye(2)).reshape(-1, 2, 2)
    return np.maximum(assumed, 0.05), shape[:, [0, 0, 1], [0, 1, 1]], assumed
