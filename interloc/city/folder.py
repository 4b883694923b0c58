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

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from interloc.arrays import JsonObject
from interloc.city.citymap import CityMap
from interloc.city.drives import Pass
from interloc.city.layers import city_features
from interloc.city.models import CityConfig
from interloc.errors import DamagedResultError, OutputError
from interloc.files import atomic_folder, finish_replacing, write_file
from interloc.output.geojson import Feature, read_json, write_collection, write_record
from interloc.output.road import DAMAGED

CITY_FILE, STATE_FILE, PASSES = "city.json", "state.npz", "passes"
FORMAT, FORMAT_VERSION = "interloc-city", 2
CITY_NAMES = frozenset(
    [CITY_FILE, STATE_FILE, PASSES, *(f"{name}.geojson" for name in ("city", "drives", "roads", "changes"))]
)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep others from changing a map meanwhile: what they add would be lost. Waits for them for a minute.

    What one that was killed has left half replaced is finished first.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415 - needed for this alone

    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder.parent / f".{folder.name}.lock", timeout=60):
            finish_replacing(folder, marker=CITY_FILE, names=CITY_NAMES)
            yield
    except Timeout as error:
        raise OutputError(f"{folder} is being changed by another process. Try again when it is done.") from error


def is_city(folder: Path) -> bool:
    """Tell whether a folder holds a map of many drives."""
    return (folder / CITY_FILE).is_file()


def write_city(city: CityMap, folder: str | os.PathLike[str]) -> dict[str, list[Feature]]:
    """Write a map, whole or not at all; an older one in the folder is replaced, what else is in it stays.

    Returns the features of its layers.

    Raises
    ------
    OutputError
        The folder is something else, or could not be written.
    """
    layers, folder = city_features(city), Path(folder)
    with atomic_folder(folder, marker=CITY_FILE, names=CITY_NAMES) as new:
        (new / PASSES).mkdir()
        for drive in city.drives.values():
            path = new / PASSES / f"{drive.data.key}.npz"
            try:
                os.link(drive.data.file or "", path)  # they are never changed, and may be large
            except OSError:  # a new one, or a file system without links
                drive.data.write(path)
        content = io.BytesIO()
        np.savez_compressed(content, **_state(city))
        write_file(new / STATE_FILE, content.getvalue())
        for name, features in layers.items():
            write_collection(new / f"{name}.geojson", features, local=False)
        write_record(new / CITY_FILE, city_record(city))
    return layers


def read_city(folder: str | os.PathLike[str]) -> CityMap:
    """Read what `write_city` wrote.

    Raises
    ------
    OutputError
        The folder is no such map, is damaged, or was written by a newer version.
    """
    if not is_city(folder := Path(folder)):
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
        # Under the names of the map: those in the files may be older.
        passes = [Pass.read(folder / PASSES / f"{keys[name]}.npz", name) for name in state["names"].tolist()]
        _restore(city, passes, state)
    except DAMAGED as error:
        raise DamagedResultError(f"{folder} is damaged ({error}). Merge its drives again.") from error
    return city


def city_record(city: CityMap) -> JsonObject:
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
                "drift_m": round(drive.offset_range_m, 3),
            }
            for drive in city.in_order
        ],
    }


def _median(values: Any) -> float | None:  # noqa: ANN401 - an array
    return round(float(np.median(values)), 4) if len(values) else None


def _state(city: CityMap) -> dict[str, Any]:
    """Return all that would have to be worked out anew as arrays without objects."""
    drives = city.in_order
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


def _restore(city: CityMap, passes: list[Pass], state: dict[str, NDArray[Any]]) -> None:
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
