"""Rows of maps: which results a map should hold, which it holds, and what was said of its findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from app.context import Context
from app.http.problem_types import NO_SUCH_MAP
from app.http.problems import Problem
from app.jobs.view import chosen_results, is_alive
from app.maps.models import MapModel
from app.maps.work import AUDIT, CITY
from app.states import JobKind, JobState
from app.store.database import moment
from app.store.models import CityMap, Drive, FeatureLayer, Job, MapDrive, MapVerdict
from app.store.storage import Storage
from interloc.city.models import Judgement, wrong_ones
from interloc.osm.container import is_map

SERVER_MAP = "default"
OSM = "osm"


def map_key(map_id: str) -> str:
    """Return the key of the folder of a map."""
    return f"maps/{map_id}"


def no_map(map_id: str) -> Problem:
    """Return the problem of a map that does not exist."""
    return Problem(NO_SUCH_MAP, f"There is no map {map_id}. GET /api/v1/maps lists them.")


def find_map(session: Session, map_id: str, *, lock: bool = False) -> CityMap:
    """Return a map.

    Raises
    ------
    Problem
        404.
    """
    found = session.get(CityMap, map_id, with_for_update=lock or None)
    if found is None:
        raise no_map(map_id)
    return found


def make_server_map(context: Context) -> None:
    """Make the map of all drives where there is none."""
    with context.database.writing() as session:
        if session.get(CityMap, SERVER_MAP) is None:
            now = context.database.clock(session)
            session.add(CityMap(id=SERVER_MAP, name="All drives", owner="", holds_all=True, created_at=now))


@dataclass(frozen=True)
class Standing:
    """What a map should hold, and what it holds."""

    jobs: list[Any]
    """`id`, `drive_id`, and `osm`, the file of the drive that it was scored with, of one job per drive."""
    rows: dict[str, MapDrive]
    """By the ids of drives."""
    wrong: list[Judgement]
    is_stale: bool
    """Whether it is to be merged."""
    osm: Path | None
    """The file to compare it with."""
    audit_key: str | None
    """Of the comparison that it should have."""


def standing_of(session: Session, context: Context, city: CityMap) -> Standing:
    """Compare what a map should hold with what it holds; rows are read anew only where something changed."""
    stamp = _stamp(session, city)
    known = context.map_rows.get(city.id)
    if known is None or known[0] != stamp:
        known = context.map_rows[city.id] = stamp, _rows(session, city)
    jobs, rows, wrong = known[1]
    held = {each.drive_id: each.job_id for each in rows.values() if each.job_id is not None}
    folder = context.storage.folder(map_key(city.id))
    is_stale = held != {job.drive_id: job.id for job in jobs}
    if not is_stale and held:
        is_indexed = session.scalar(select(exists().where(FeatureLayer.map_id == city.id)))
        is_whole = is_indexed and "bbox" in (city.summary or {}) and (folder / CITY / "city.json").is_file()
        is_stale = not is_whole
    osm, key = _osm_of(context.storage, folder, jobs) if held else (None, None)
    last = max((each.at for each in wrong), default=None)
    audit_key = None if key is None else f"{city.revision} {len(wrong)} {last} {key}"[-255:]
    if city.audited is not None and audit_key == city.audited and not (folder / AUDIT).is_dir() and not _failed(city):
        audit_key = f"{audit_key} again"[-255:]
    return Standing(jobs, rows, wrong, is_stale, osm, audit_key)


def _stamp(session: Session, city: CityMap) -> tuple[Any, ...]:
    """Return what differs where a row does that says which results a map should hold or holds, or what is wrong."""
    is_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL, is_alive())
    of_jobs = select(func.count(), func.sum(Job.finished_at)).join(Drive, Drive.id == Job.drive_id).where(*is_result)
    of_verdicts = select(func.count(), func.sum(MapVerdict.at)).where(MapVerdict.map_id == city.id)
    named = select(MapDrive.drive_id, MapDrive.is_member).where(MapDrive.map_id == city.id)
    pinned = select(Drive.id, Drive.pinned_job).where(Drive.pinned_job.is_not(None))
    asked = (of_jobs, of_verdicts, named.where(MapDrive.is_member.is_not(None)), pinned)
    return city.revision, *(frozenset(map(tuple, session.execute(each))) for each in asked)


def _rows(session: Session, city: CityMap) -> tuple[list[Any], dict[str, MapDrive], list[Judgement]]:
    drives = {each.drive_id: each for each in session.scalars(select(MapDrive).where(MapDrive.map_id == city.id))}
    named = select(MapDrive.drive_id).where(MapDrive.map_id == city.id, MapDrive.is_member.is_(not city.holds_all))
    chosen = chosen_results(Drive.id.not_in(named) if city.holds_all else Drive.id.in_(named))
    columns = chosen.with_only_columns(Job.id, Job.drive_id, Job.request["osm"]["file"].as_string().label("osm"))
    jobs = list(session.execute(columns.order_by(Job.created_at, Job.id)))
    return jobs, drives, wrong_ones(judgements_of(session, city.id))


def _failed(city: CityMap) -> bool:
    return city.audit is not None and "problem" in city.audit


def _osm_of(storage: Storage, folder: Path, jobs: Sequence[Any]) -> tuple[Path | None, str | None]:
    """Return the OSM file of a map: its own, else that of its newest job that was scored with one of its drive."""
    files = (storage.folder(f"drives/{job.drive_id}/files/{job.osm}") for job in reversed(jobs) if job.osm)
    for path in chain(sorted((folder / OSM).glob("*")), files):
        if path.is_file() and is_map(path.name):
            stat = path.stat()
            return path, f"{path.relative_to(storage.root)} {stat.st_size} {stat.st_mtime_ns}"
    return None, None


def judgements_of(session: Session, map_id: str, finding: str | None = None) -> list[Judgement]:
    """Return what was said of the findings of a map, or of one of them, the oldest first."""
    asked = select(MapVerdict.judgement).where(MapVerdict.map_id == map_id).order_by(MapVerdict.at, MapVerdict.id)
    if finding is not None:
        asked = asked.where(MapVerdict.finding == finding)
    return [Judgement.model_validate(each) for each in session.scalars(asked)]


def map_model(session: Session, context: Context, city: CityMap) -> MapModel:
    """Return a map as clients see it."""
    standing = standing_of(session, context, city)
    summary: dict[str, Any] = city.summary or {}
    audit: dict[str, Any] = city.audit or {}
    return MapModel(
        id=city.id,
        name=city.name,
        owner=city.owner,
        holds_all=city.holds_all,
        created_at=moment(city.created_at),
        revision=city.revision,
        merged_at=None if city.merged_at is None else moment(city.merged_at),
        is_waiting=standing.is_stale or (standing.audit_key is not None and standing.audit_key != city.audited),
        is_at_work=city.lease_owner is not None,
        drives=summary.get("drives", 0),
        refused=sum(row.problem is not None for row in standing.rows.values()),
        intersections=summary.get("intersections", 0),
        seen_by_several=summary.get("seen_by_several", 0),
        median_position_std_m=summary.get("median_position_std_m"),
        median_relative_std_m=summary.get("median_relative_std_m"),
        findings=audit.get("findings"),
        junctions_passed=audit.get("junctions_passed"),
        osm=audit.get("osm"),
        is_made_up=audit.get("is_made_up", False),
        problem=audit.get("problem"),
        bbox=summary.get("bbox"),
    )
