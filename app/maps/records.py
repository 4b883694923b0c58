"""Rows of maps: which results a map should hold, which it holds, and what was said of its findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from app.context import Context
from app.http.problem_types import NO_SUCH_MAP
from app.http.problems import Problem
from app.jobs.chosen import chosen_results
from app.maps.models import MapModel
from app.maps.work import AUDIT, CITY
from app.store.database import moment
from app.store.models import CityMap, Drive, FeatureChunk, Job, MapDrive, MapVerdict
from app.store.storage import Storage
from interloc.city.verdicts import Judgement, wrong_ones
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
    """What a map should hold, and what it holds.

    Attributes
    ----------
    jobs : list of Job
        One per drive.
    rows : dict of str to MapDrive
        By the ids of drives.
    is_stale : bool
        Whether it is to be merged.
    osm : Path or None
        The file to compare it with.
    audit_key : str or None
        Of the comparison that it should have.
    wrong : list of Judgement
    """

    jobs: list[Job]
    rows: dict[str, MapDrive]
    is_stale: bool
    osm: Path | None
    audit_key: str | None
    wrong: list[Judgement]


def standing_of(session: Session, storage: Storage, city: CityMap) -> Standing:
    """Compare what a map should hold with what it holds."""
    rows = {each.drive_id: each for each in session.scalars(select(MapDrive).where(MapDrive.map_id == city.id))}
    named = select(MapDrive.drive_id).where(MapDrive.map_id == city.id, MapDrive.is_member.is_(not city.holds_all))
    chosen = chosen_results(Drive.id.not_in(named) if city.holds_all else Drive.id.in_(named))
    jobs = list(session.scalars(chosen.order_by(Job.created_at, Job.id)))
    held = {each.drive_id: each.job_id for each in rows.values() if each.job_id is not None}
    folder = storage.folder(map_key(city.id))
    is_stale = held != {job.drive_id: job.id for job in jobs}
    if not is_stale and held:
        is_indexed = session.scalar(select(exists().where(FeatureChunk.map_id == city.id)))
        is_stale = not (is_indexed and (folder / CITY / "city.json").is_file())
    wrong = wrong_ones(judgements_of(session, city.id))
    osm, key = _osm_of(storage, folder, jobs) if held else (None, None)
    last = max((each.at for each in wrong), default=None)
    audit_key = None if key is None else f"{city.revision} {len(wrong)} {last} {key}"[-255:]
    if city.audited is not None and audit_key == city.audited and not (folder / AUDIT).is_dir() and not _failed(city):
        audit_key = f"{audit_key} again"[-255:]
    return Standing(jobs, rows, is_stale, osm, audit_key, wrong)


def _failed(city: CityMap) -> bool:
    return city.audit is not None and "problem" in city.audit


def _osm_of(storage: Storage, folder: Path, jobs: Sequence[Job]) -> tuple[Path | None, str | None]:
    """Return the OSM file of a map: its own, else that of its newest job that was scored with one of its drive."""
    own = sorted((folder / OSM).glob("*"))
    files = [storage.folder(f"drives/{job.drive_id}/files/{name}") for job in jobs if (name := _file_of(job))]
    for path in (*own, *reversed(files)):
        if path.is_file() and is_map(path.name):
            stat = path.stat()
            return path, f"{path.relative_to(storage.root)} {stat.st_size} {stat.st_mtime_ns}"
    return None, None


def _file_of(job: Job) -> str | None:
    found = (job.request.get("osm") or {}).get("file")
    return found if isinstance(found, str) else None


def judgements_of(session: Session, map_id: str, finding: str | None = None) -> list[Judgement]:
    """Return what was said of the findings of a map, or of one of them, the oldest first."""
    asked = select(MapVerdict.judgement).where(MapVerdict.map_id == map_id).order_by(MapVerdict.at, MapVerdict.id)
    if finding is not None:
        asked = asked.where(MapVerdict.finding == finding)
    return [Judgement.model_validate(each) for each in session.scalars(asked)]


def map_model(session: Session, storage: Storage, city: CityMap) -> MapModel:
    """Return a map as clients see it."""
    standing = standing_of(session, storage, city)
    summary: dict[str, Any] = city.summary or {}
    audit: dict[str, Any] = city.audit or {}
    chunk = FeatureChunk
    box = session.execute(
        select(func.min(chunk.west), func.min(chunk.south), func.max(chunk.east), func.max(chunk.north)).where(
            chunk.map_id == city.id, chunk.layer == "city"
        )
    ).one()
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
        problem=audit.get("problem"),
        bbox=None if box[0] is None else list(box),
    )
