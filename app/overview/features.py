"""All drives on one map: simplified tracks, and the intersections of the result that stands for each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from app.jobs.chosen import choice_of
from app.jobs.view import title_of
from app.store.models import Job
from app.store.storage import Storage
from app.work.places import TRAJECTORY
from interloc.arrays import FloatArray
from interloc.errors import InterLocError
from interloc.output.geojson import cut, joined, positions, read_json
from interloc.output.layout import file_names

MAX_TRACK_POINTS = 300
MAX_INTERSECTIONS = 5000
"""Per drive."""

_TOLERANCE_M = 1.0
_METRES_PER_DEGREE = 111_320.0
_KEPT = 4096
_DECIMALS = 6  # 0.1 m

_FILES = file_names(georeferenced=True)


def drive_features(
    storage: Storage, drive_id: str, name: str, job: Job | None, pinned: str | None
) -> Iterator[dict[str, Any]]:
    """Yield the track of a drive as a line and its intersections as points, both GeoJSON features.

    Parameters
    ----------
    drive_id, name
        Of the drive.
    job
        That stands for it; None: it has none.
    pinned
        Id of the job that was pinned.

    Notes
    -----
    The track of a result comes first: a drive without GNSS may have been placed on the map by that job. A track that
    has no longitude and latitude, or is no longer on disk, has no geometry.
    """
    result = None if job is None else storage.folder(f"jobs/{job.id}/result")
    own = storage.folder(f"drives/{drive_id}") / TRAJECTORY[0]
    track = (None if result is None else _layer(result / _FILES["trajectory"])[0]) or _layer(own)[0]
    points, outcomes = (None, []) if result is None else _layer(result / _FILES["intersections"])
    job_id = None if job is None else job.id
    common = {"drive": drive_id, "name": name, "job": job_id, "chosen": choice_of(pinned, job_id)}
    summary = {} if job is None else job.summary or {}
    figures = {
        "intersections": summary.get("intersections"),
        "title": None if job is None else title_of(job),
        "verdict": (summary.get("report") or {}).get("map_line"),
    }
    yield {
        "type": "Feature",
        "id": drive_id,
        "geometry": track,
        "properties": {"layer": "drives", **common, **figures},
    }
    if points is not None:
        yield {
            "type": "Feature",
            "id": f"{drive_id}/intersections",
            "geometry": points,
            "properties": {"layer": "intersections", **common, **figures, "outcomes": list(outcomes)},
        }


def _layer(path: Path) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """Return a layer as one geometry, its line simplified, or its points, or None; and the verdicts on its points."""
    try:
        stat = path.stat()
    except OSError:
        return None, ()
    return _read_layer(path, stat.st_mtime_ns, stat.st_size)


@lru_cache(_KEPT)
def _read_layer(path: Path, _mtime_ns: int, _size: int) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    try:
        features = [each for each in read_json(path)["features"] if each["geometry"] is not None]
        found = [each["geometry"] for each in features]
        outcomes = tuple(str(each["properties"].get("outcome", "unscored")) for each in features[:MAX_INTERSECTIONS])
    except (InterLocError, KeyError, TypeError, AttributeError):  # damaged: `interloc check` finds it
        return None, ()
    lines = [
        whole["coordinates"] for whole in map(joined, found) if whole is not None and whole["type"] == "LineString"
    ]
    if lines:
        lonlat = np.array(lines[0])[:, :2]
        lonlat[:, 0] = np.unwrap(lonlat[:, 0], period=360.0)  # across the antimeridian without a jump
        return cut({"type": "LineString", "coordinates": _rounded(simplified(lonlat))}), ()
    points = [each["coordinates"][:2] for each in found if each["type"] == "Point"][:MAX_INTERSECTIONS]
    return ({"type": "MultiPoint", "coordinates": _rounded(np.array(points))} if points else None), outcomes


def simplified(lonlat: FloatArray) -> FloatArray:
    """Return a line to within a metre, or more where that would leave more than `MAX_TRACK_POINTS` points.

    Parameters
    ----------
    lonlat : (N, 2) float64
        Degrees.

    Returns
    -------
    (M, 2) float64
    """
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    scale = _METRES_PER_DEGREE * np.array([math.cos(math.radians(lonlat[0, 1])), 1.0])
    tolerance_m = _TOLERANCE_M
    while len(lonlat) > 2:
        line = shapely.linestrings(lonlat * scale)
        lonlat = shapely.get_coordinates(shapely.simplify(line, tolerance_m, preserve_topology=False)) / scale
        if len(lonlat) <= MAX_TRACK_POINTS:
            break
        tolerance_m *= 2
    return lonlat


def _rounded(lonlat: FloatArray) -> list[list[float]]:
    return positions(np.round(lonlat, _DECIMALS), local=False)
