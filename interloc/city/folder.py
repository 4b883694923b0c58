"""The folder of a map of many drives.

=====================  ================================================================================================
file                   content
=====================  ================================================================================================
``city.json``          what the map is: format version, settings, drives with their offsets, figures
``city.geojson``       its intersections; properties: `interloc.output.properties.CityProperties`
``drives.geojson``     the tracks of its drives
``roads.geojson``      the roads between them, where the results of drives hold theirs
``changes.geojson``    intersections and branches that came or went between drives
``passes/KEY.npz``     what it keeps of each drive, so that drives can be added and removed later
``state.npz``          votes, offsets, assignments and the register of names: all that would have to be worked out anew
=====================  ================================================================================================
"""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from interloc.city.change import changes_of
from interloc.city.citymap import CityMap
from interloc.city.drives import DriveOnMap
from interloc.city.passes import Pass
from interloc.city.roads import fuse_roads
from interloc.city.settings import CityConfig
from interloc.errors import DamagedResultError, OutputError
from interloc.files import atomic_folder, write_file
from interloc.geometry import thin
from interloc.output.geojson import bearings, positions, read_json, write_collection, write_record
from interloc.output.layers import CITY_LAYERS
from interloc.results import moment

CITY_FILE, STATE_FILE, PASSES = "city.json", "state.npz", "passes"
FORMAT, FORMAT_VERSION = "interloc-city", 2
CITY_NAMES = frozenset(
    [CITY_FILE, STATE_FILE, PASSES, *(f"{name}.geojson" for name in ("city", "drives", "roads", "changes"))]
)

_TRACK_STEP_M = 5.0


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep others from changing a map meanwhile: what they add would be lost.

    Raises
    ------
    OutputError
        Another process has been changing it for a minute.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415 - needed for this alone

    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder.parent / f".{folder.name}.lock", timeout=60):
            yield
    except Timeout as error:
        raise OutputError(f"{folder} is being changed by another process. Try again when it is done.") from error


def is_city(folder: Path) -> bool:
    """Tell whether a folder holds a map of many drives."""
    return (folder / CITY_FILE).is_file()


def write_city(city: CityMap, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Write a map, whole or not at all; an older one in the folder is replaced, what else is in it stays.

    Returns the features of its layers.

    Raises
    ------
    OutputError
        The folder is something else, or could not be written.
    """
    layers = city_features(city)
    with atomic_folder(folder, marker=CITY_FILE, names=CITY_NAMES) as new:
        (new / PASSES).mkdir()
        for drive in city.drives.values():
            there = folder / PASSES / f"{drive.data.key}.npz"
            try:
                os.link(there, new / PASSES / there.name)  # they are never changed, and may be large
            except OSError:  # a new one, or a file system without links
                drive.data.write(new / PASSES / there.name)
        content = io.BytesIO()
        np.savez_compressed(content, **_state(city))
        write_file(new / STATE_FILE, content.getvalue())
        for name, features in layers.items():
            write_collection(new / f"{name}.geojson", features, local=False)
        write_record(new / CITY_FILE, city_record(city))
    return layers


def read_city(folder: Path) -> CityMap:
    """Read what `write_city` wrote.

    Raises
    ------
    OutputError
        The folder is no such map, is damaged, or was written by a newer version.
    """
    if not is_city(folder):
        raise OutputError(
            f"{folder} is not a map of many drives: it has no {CITY_FILE}. Give the folder that `interloc merge` wrote."
        )
    record = read_json(folder / CITY_FILE)
    version = record.get("format_version")
    if record.get("format") != FORMAT or not isinstance(version, int) or version > FORMAT_VERSION:
        raise OutputError(
            f"{folder / CITY_FILE}: format {record.get('format')!r} {version}; expected {FORMAT!r} up to "
            f"{FORMAT_VERSION}. Usual cause: a newer InterLoc wrote it."
        )
    try:
        with np.load(folder / STATE_FILE) as archive:
            state = dict(archive)
        keys = {str(each["drive"]): str(each["key"]) for each in record["drives"]}
        city = CityMap(CityConfig.model_validate(record["config"]))
        passes = [Pass.read(folder / PASSES / f"{keys[str(name)]}.npz") for name in state["names"]]
        _restore(city, passes, state)
    except (OSError, ValueError, KeyError, TypeError, IndexError, zipfile.BadZipFile) as error:
        raise DamagedResultError(f"{folder} is damaged ({error}). Merge its drives again.") from error
    return city


def city_record(city: CityMap) -> dict[str, Any]:
    """Return what `city.json` holds."""
    places = city.places
    shown = places.is_shown
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "config": city.config.model_dump(),
        "epsg": city.epsg,
        "intersections": int(shown.sum()),
        "left_out": int((~shown).sum()),
        "seen_by_several": int((places.passes[shown] > 1).sum()),
        "median_position_std_m": _median(places.position_std_m[shown]),
        "median_relative_std_m": _median(places.relative_std_m[shown]),
        "drives": [
            {
                "drive": drive.data.name,
                "key": drive.data.key,
                "intersections": len(drive.data),
                "offset_m": [round(value, 3) for value in drive.knots.mean(axis=0).tolist()],
                "drift_m": round(_range_of(drive), 3),
            }
            for drive in _sorted(city)
        ],
    }


def city_features(city: CityMap) -> dict[str, list[dict[str, Any]]]:
    """Return the features of each layer of a map; intersections that too few drives saw are left out."""
    table, drives = city.places, _sorted(city)
    rows = np.flatnonzero(table.is_shown).tolist()
    intersections = CITY_LAYERS["city"].features(
        positions(table.lonlat[rows], local=False),
        uid=[table.uid[row] for row in rows],
        observations=table.observations[rows],
        drives=[len(table.drives[row]) for row in rows],
        passes=table.passes[rows],
        drives_near=[len(table.near[row]) for row in rows],
        drive_names=[", ".join(table.drives[row]) for row in rows],
        position_std_m=table.position_std_m[rows],
        position_cov_m2=table.position_cov_m2[rows],
        relative_std_m=table.relative_std_m[rows],
        branch_count=[len(table.bearings_deg[row]) for row in rows],
        branch_bearings_deg=[bearings(table.bearings_deg[row]) for row in rows],
        branch_widths_m=[table.widths_m[row].tolist() for row in rows],
        branch_drives=[table.branch_drives[row].tolist() for row in rows],
        confidence=table.confidence[rows],
        first_time=[moment(seconds) for seconds in table.seen_s[rows, 0].tolist()],
        last_time=[moment(seconds) for seconds in table.seen_s[rows, 1].tolist()],
    )
    offsets = np.array([drive.knots.mean(axis=0) for drive in drives]).reshape(-1, 2)
    tracks = [drive.track_xy - offset for drive, offset in zip(drives, offsets, strict=True)]
    lines = CITY_LAYERS["drives"].features(
        [positions(city.lonlat(track[thin(track, _TRACK_STEP_M)]), local=False) for track in tracks],
        drive=[drive.data.name for drive in drives],
        intersections=[len(drive.data) for drive in drives],
        offset_east_m=offsets[:, 0],
        offset_north_m=offsets[:, 1],
        offset_range_m=[_range_of(drive) for drive in drives],
        fix_std_m=[float(np.median(drive.data.fix_std_m)) if len(drive.data) else np.nan for drive in drives],
        first_time=[moment(float(drive.data.span_s[0])) for drive in drives],
        last_time=[moment(float(drive.data.span_s[1])) for drive in drives],
    )
    return {
        "city": intersections,
        "drives": lines,
        "roads": _road_features(city),
        "changes": _change_features(city),
    }


def _road_features(city: CityMap) -> list[dict[str, Any]]:
    roads = fuse_roads(city)
    return CITY_LAYERS["roads"].features(
        [positions(city.lonlat(road.xy), local=False) for road in roads],
        id=list(range(1, len(roads) + 1)),
        start_uid=[road.start for road in roads],
        end_uid=[road.end for road in roads],
        length_m=[road.length_m for road in roads],
        width_m=[road.width_m for road in roads],
        width_std_m=[road.width_std_m for road in roads],
        is_driven=[road.is_driven for road in roads],
        drives=[len(road.drives) for road in roads],
        drive_names=[", ".join(road.drives) for road in roads],
    )


def _change_features(city: CityMap) -> list[dict[str, Any]]:
    changes = changes_of(city)
    xy = np.array([each.xy for each in changes]).reshape(-1, 2)
    return CITY_LAYERS["changes"].features(
        positions(city.lonlat(xy), local=False) if changes else [],
        id=[
            f"{each.kind}-{each.uid}" + ("" if each.bearing_deg is None else f"-{round(each.bearing_deg)}")
            for each in changes
        ],
        kind=[each.kind for each in changes],
        uid=[each.uid for each in changes],
        bearing_deg=[each.bearing_deg for each in changes],
        seen_by=[", ".join(each.seen_by) for each in changes],
        not_seen_by=[", ".join(each.not_seen_by) for each in changes],
        after_time=[moment(each.between_s[0]) for each in changes],
        before_time=[moment(each.between_s[1]) for each in changes],
    )


def _sorted(city: CityMap) -> list[DriveOnMap]:
    return [city.drives[name] for name in sorted(city.drives)]


def _range_of(drive: DriveOnMap) -> float:
    return float(np.hypot(*np.ptp(drive.knots, axis=0)))


def _median(values: Any) -> float | None:  # noqa: ANN401 - an array
    return round(float(np.median(values)), 4) if len(values) else None


def _state(city: CityMap) -> dict[str, Any]:
    """Return all that would have to be worked out anew as arrays without objects."""
    drives = _sorted(city)
    pairs = sorted(city.votes)
    return {
        "names": np.array([drive.data.name for drive in drives], dtype=np.str_),
        "epsg": city.epsg or 0,
        "next_number": city.next_number,
        "shift": np.array([drive.shift for drive in drives]).reshape(-1, 2),
        **{
            name: np.concatenate([getattr(drive, name) for drive in drives]) if drives else np.zeros(0)
            for name in ("knots", "place", "neighbourhood")
        },
        "voters": np.array(pairs, dtype=np.str_).reshape(-1, 2),
        "votes": np.array([city.votes[pair] for pair in pairs]).reshape(-1, 3),
        "place_number": np.array(list(city.uid_of), dtype=np.int64),
        "place_uid": np.array(list(city.uid_of.values()), dtype=np.str_),
        "register_uid": np.array(list(city.register), dtype=np.str_),
        "register_xy": np.array(list(city.register.values())).reshape(-1, 2),
    }


def _restore(city: CityMap, passes: list[Pass], state: dict[str, Any]) -> None:
    """Fill an empty map with what `_state` gave."""
    city.epsg = int(state["epsg"]) or None
    city.next_number = int(state["next_number"])
    knot = row = 0
    for data, shift in zip(passes, state["shift"], strict=True):
        drive = city.placed(data)
        next_knot, next_row = knot + len(drive.knots), row + len(data)
        drive.knots, drive.shift = state["knots"][knot:next_knot], shift
        drive.place, drive.neighbourhood = (state[name][row:next_row] for name in ("place", "neighbourhood"))
        city.drives[data.name] = drive
        knot, row = next_knot, next_row
    for (a, b), (x, y, pairs) in zip(state["voters"].tolist(), state["votes"].tolist(), strict=True):
        city.votes[a, b] = x, y, pairs
    city.uid_of = dict(zip(state["place_number"].tolist(), state["place_uid"].tolist(), strict=True))
    for uid, (x, y) in zip(state["register_uid"].tolist(), state["register_xy"].tolist(), strict=True):
        city.register[uid] = x, y
