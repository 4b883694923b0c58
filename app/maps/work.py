"""Work of workers on a map of many drives: bringing it up to date, and comparing it with OpenStreetMap.

The folder of a map says by itself which results it holds (``jobs.json``). Work is told which it should hold, and does
what is missing: done again, after a kill or by two servers, it changes nothing.
"""

import hashlib
import json
import logging
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.ogc.work import LayerRows, rows_of_map
from interloc.arrays import JsonObject
from interloc.city.audit import OwnMap
from interloc.city.audit import audit as compare
from interloc.city.citymap import CityMap
from interloc.city.drives import Pass
from interloc.city.folder import city_record, is_city, locked, read_city, write_city
from interloc.city.maproulette import audit_record, known_findings, write_audit
from interloc.city.models import AuditConfig, Judgement
from interloc.errors import DamagedResultError, InterLocError, OutputError
from interloc.evaluation.coverage import map_bounds
from interloc.files import write_file
from interloc.osm.reader import read_osm
from interloc.output.credits import map_credit
from interloc.output.geojson import box_around
from interloc.output.read import read_results

CITY, AUDIT = "city", "audit"
JOBS_FILE = "jobs.json"

_FEW_FILES = 3  # whose names are said
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Source:
    """A result that the map should hold."""

    job: str
    folder: Path


@dataclass(frozen=True)
class Merged:
    """What came of bringing a map up to date."""

    problems: dict[str, str]
    """Name of a drive -> why the map does not hold it."""
    record: JsonObject
    """Of `city.json`, without its drives."""
    layers: list[LayerRows]
    """Its features."""


def merge(folder: Path, wanted: Mapping[str, Source], is_compared: bool) -> Merged:
    """Bring the map in a folder up to date: it should hold a result of each wanted drive, by their names.

    Without a map that can be read, a new one is made. What is not compared any more has no findings.
    """
    problems: dict[str, str] = {}
    new = []
    with locked(folder / CITY):
        city, held = _opened(folder / CITY)
        for name, source in wanted.items():
            if held.get(name) == source.job and name in city.drives:
                continue
            try:
                new.append(replace(Pass.of(read_results(source.folder)), name=name))
            except InterLocError as error:
                problems[name] = str(error).replace(f"{source.folder}/", "")
        kept = wanted.keys() - problems.keys() - {each.name for each in new}
        city.remove(*(name for name in city.drives if name not in kept))
        try:
            city.add(*new)
        except InterLocError:  # one of them is at fault
            for each in new:
                try:
                    city.add(each)
                except InterLocError as error:
                    problems[each.name] = str(error)
        (folder / CITY / JOBS_FILE).unlink(missing_ok=True)  # of the map before
        layers = write_city(city, folder / CITY)
        if not is_compared:
            shutil.rmtree(folder / AUDIT, ignore_errors=True)
            layers["findings"] = []
        jobs = {name: source.job for name, source in wanted.items() if name in city.drives}
        write_file(folder / CITY / JOBS_FILE, json.dumps(jobs))
        bbox = box_around(each["geometry"] for name in ("city", "drives") for each in layers[name])
        record = {**city_record(city), "drives": len(city.drives), "bbox": bbox}
        return Merged(problems, record, rows_of_map(layers))


def _opened(folder: Path) -> tuple[CityMap, dict[str, str]]:
    """Return the map in a folder, and the job of each drive on it; a new one where there is none, or it is damaged."""
    try:
        if is_city(folder):
            jobs = folder / JOBS_FILE
            return read_city(folder), json.loads(jobs.read_text()) if jobs.exists() else {}
    except (OutputError, OSError, ValueError) as error:
        _log.warning("%s: made anew: %s", folder, error)
    shutil.rmtree(folder, ignore_errors=True)
    return CityMap(), {}


@dataclass(frozen=True)
class Audited:
    """What came of comparing a map with OpenStreetMap."""

    record: JsonObject
    """Of `audit.json`, and whether the OSM file is of a made-up town."""
    layers: list[LayerRows]
    """The findings."""


def audit(folder: Path, files: Mapping[Path, Sequence[str]], wrong: Sequence[Judgement]) -> Audited:
    """Compare the map in a folder with OSM files, the newest last, each for the drives of some names.

    Nothing is found where people marked a finding wrong. An `InterLocError` says that no file can be read, or that the
    map is damaged.
    """
    with locked(folder / CITY):
        city, config = read_city(folder / CITY), AuditConfig()
    if not city.drives:
        raise DamagedResultError(f"{folder.name}: the map holds no drives.")
    maps = _maps_of(city, files)
    made_up = all(graph.is_made_up for graph, _ in maps)
    names = sorted({graph.source for graph, _ in maps})
    source = ", ".join(names) if len(names) <= _FEW_FILES else f"{len(names)} files"
    found = compare(city, maps, config, known=known_findings(folder / AUDIT), wrong=wrong)
    features = write_audit(found, city, folder / AUDIT, config, source=source, made_up=made_up)
    layers = rows_of_map({"findings": features}, map_credit(is_made_up=made_up))
    return Audited({**audit_record(found, config, source), "is_made_up": made_up}, layers)


def _maps_of(city: CityMap, files: Mapping[Path, Sequence[str]]) -> list[OwnMap]:
    """Read OSM files around the drives that each is for; those that hold the same are one."""
    same: dict[str, tuple[Path, list[str]]] = {}
    for path, names in files.items():
        with suppress(FileNotFoundError), path.open("rb") as file:  # deleted meanwhile
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            same.setdefault(digest, (path, []))[1].extend(name for name in names if name in city.drives)
    found: list[OwnMap] = []
    problem: InterLocError | None = None
    for path, names in same.values():
        try:
            if names:
                track = np.concatenate([city.drives[name].data.track_lonlat for name in names])
                found.append((read_osm(path, map_bounds(track)), names))
        except InterLocError as error:  # another one may do
            problem = error
            _log.warning("%s: not compared with it: %s", path, error)
    if not found:
        raise problem or DamagedResultError("no OSM file is of a drive of the map.")
    return found
