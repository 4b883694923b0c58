"""Rows of maps: which results a map should hold, which it holds, and what was said of its findings."""

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field
from sqlalchemy import select
from sqlalchemy.orm import Session

from app.context import Context
from app.http.fields import ID, Body, Name, Note
from app.http.problem_types import NO_SUCH_MAP
from app.http.problems import Problem
from app.jobs.view import chosen_results
from app.maps.work import CITY
from app.store.models import CityMap, FeatureLayer, Job, MapDrive, MapVerdict, columns_for
from app.store.storage import Storage
from interloc.city.models import Judgement, Precision, Verdict, latest
from interloc.osm.policies import FindingKind
from interloc.osm.untrusted import is_map
from interloc.output.properties import FindingProperties

# Maps of many drives, and the queue of their findings, as clients see them.


class NewMap(Body):
    """A map of many drives to be made."""

    name: Name
    drives: Annotated[list[Annotated[str, Field(pattern=ID)]], Field(max_length=10_000)] = Field(
        [], description="Ids of the drives that belong to it; more can be put into it later."
    )


class MapModel(BaseModel):
    """A map of many drives."""

    id: str
    name: str
    owner: str
    holds_all: bool = Field(
        description="Whether all drives of the server belong to it but those that were taken out: the map `default`."
    )
    created_at: datetime
    revision: int = Field(description="How many times it was brought up to date.")
    merged_at: datetime | None = Field(description="When that was; null: it is empty as yet.")
    is_waiting: bool = Field(description="Whether results wait to be merged, or to be compared with OpenStreetMap.")
    is_at_work: bool = Field(description="Whether a worker merges or compares it now.")
    drives: int = Field(description="Drives on the map.")
    refused: int = Field(description="Drives that could not be merged; its list of drives says why.")
    intersections: int
    seen_by_several: int = Field(description="Intersections that were seen in several passes.")
    median_position_std_m: float | None
    median_relative_std_m: float | None
    findings: int | None = Field(description="What OpenStreetMap has wrong; null: it was not compared yet.")
    junctions_passed: int | None = Field(description="Junctions of OpenStreetMap that enough passes came by.")
    osm: str | None = Field(description="OSM file of the comparison.")
    is_made_up: bool = Field(description="Whether that file is of a made-up town, not of OpenStreetMap.")
    problem: str | None = Field(description="Why it could not be brought up to date, or compared with OpenStreetMap.")
    bbox: list[float] | None = Field(description="West, south, east, north of its drives and intersections, degrees.")


class MapList(BaseModel):
    """A page of the maps of the service, that of the server first."""

    maps: list[MapModel]
    next: str | None = Field(description="Value of `after` for the next page; null on the last page.")


class MapDriveModel(BaseModel):
    """A drive of a map."""

    drive_id: str
    name: str | None = Field(description="Name of the drive; null: it was deleted, and will be taken off the map.")
    label: str | None = Field(description="Its name when it was first merged; no two of a map have the same.")
    job_id: str | None = Field(description="Job whose result was merged; null: none yet.")
    problem: str | None = Field(description="Why it is not on the map.")


class MapDriveList(BaseModel):
    """A page of the drives of a map, by their ids."""

    drives: list[MapDriveModel]
    next: str | None = Field(description="Value of `after` for the next page; null on the last page.")


class NewVerdict(Body):
    """What somebody saw."""

    verdict: Verdict = Field(
        description="right: OpenStreetMap is wrong there; wrong: it is not, and the place never comes back; "
        "cannot_tell; fixed: it was wrong, and has been mended."
    )
    note: Note | None = None


class Links(BaseModel):
    """Where to look at a place, and to mend it."""

    osm: str
    id: str = Field(description="The editor iD.")
    josm: str = Field(description="Remote control of JOSM on the machine of whoever follows the link.")
    mapillary: str
    panoramax: str


class QueueEntry(BaseModel):
    """A finding, and what was said of it."""

    id: str
    lon: float
    lat: float
    properties: FindingProperties | None = Field(
        description="As of the layer `findings`; null: the last audit has it no more, as where it was marked wrong."
    )
    kind: FindingKind
    verdict: Judgement | None = Field(description="The last one; null: nobody has looked at it.")
    picture: str | None = Field(description="Address of the ground around it as the drives saw it.")
    links: Links


class WholeEntry(QueueEntry):
    """The same with its neighbours among those that nobody has looked at, and all that was said of it."""

    next: str | None
    previous: str | None
    history: list[Judgement]


State = Literal["open", "judged", "all"]


class QueuePage(BaseModel):
    """A page of the queue."""

    entries: list[QueueEntry]
    open: int = Field(description="Findings that nobody has looked at.")
    judged: int = Field(description="Findings that somebody has looked at.")
    precision: Precision
    by_kind: dict[FindingKind, Precision]
    next: str | None = Field(description="Value of `after` for the next page; null on the last page.")


SERVER_MAP = "default"
OSM = "osm"


def map_key(map_id: str) -> str:
    """Return the key of the folder of a map."""
    return f"maps/{map_id}"


def find_map(session: Session, map_id: str, *, lock: bool = False) -> CityMap:
    """Return a map; a 404 where there is none."""
    found = session.get(CityMap, map_id, with_for_update=lock or None)
    if found is None:
        raise Problem(NO_SUCH_MAP, f"There is no map {map_id}. GET /api/v1/maps lists them.")
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
    osm: dict[Path, set[str]]
    """The files to compare it with, the newest last, and the ids of drives whose places each is for."""
    audit_key: str | None
    """Of the comparison that it should have."""

    def is_waiting(self, city: CityMap) -> bool:
        """Return whether the map is to be merged or compared."""
        return self.is_stale or (self.audit_key is not None and self.audit_key != city.audited)


def standings_of(session: Session, context: Context, cities: Sequence[CityMap]) -> dict[str, Standing]:
    """Compare what maps should hold with what they hold: a few queries for however many maps."""
    of_these = [city.id for city in cities]
    columns = (Job.id, Job.drive_id, Job.request["osm"]["file"].as_string().label("osm"))
    chosen = chosen_results().with_only_columns(*columns).order_by(Job.created_at, Job.id)
    jobs = {job.drive_id: (place, job) for place, job in enumerate(session.execute(chosen))}
    rows: dict[str, dict[str, MapDrive]] = defaultdict(dict)
    for row in session.scalars(select(MapDrive).where(MapDrive.map_id.in_(of_these))):
        rows[row.map_id][row.drive_id] = row
    are_shown = select(FeatureLayer.map_id).where(FeatureLayer.map_id.in_(of_these), FeatureLayer.layer == CITY)
    shown = set(session.scalars(are_shown))
    judged = judgements_of(session, of_these).items()
    wrong = {key: [each for each in latest(of_map).values() if each.verdict == "wrong"] for key, of_map in judged}
    now = context.database.clock(session)
    return {
        city.id: _standing_of(context.storage, city, jobs, rows[city.id], wrong.get(city.id, []), city.id in shown, now)
        for city in cities
    }


def judgements_of(session: Session, maps: Sequence[str]) -> dict[str, list[Judgement]]:
    """Return what was said of the findings of maps, the oldest first."""
    of = MapVerdict
    asked = select(of.map_id, of.judgement).where(of.map_id.in_(maps)).order_by(of.at, of.id)
    found = defaultdict(list)
    for map_id, judgement in session.execute(asked):
        found[map_id].append(Judgement.model_validate(judgement))
    return found


def _standing_of(
    storage: Storage,
    city: CityMap,
    chosen: dict[str, tuple[int, Any]],
    rows: dict[str, MapDrive],
    wrong: list[Judgement],
    is_shown: bool,
    now: float,
) -> Standing:
    def said(is_member: bool) -> set[str]:
        return {each.drive_id for each in rows.values() if each.is_member is is_member}

    drives = chosen.keys() - said(False) if city.holds_all else chosen.keys() & said(True)
    jobs = [job for _, job in sorted(chosen[drive] for drive in drives)]
    held = {each.drive_id: each.job_id for each in rows.values() if each.job_id is not None}
    folder = storage.folder(map_key(city.id))
    # Work that was given up may have left a map in the folder that no row tells of.
    is_abandoned = city.lease_until is not None and city.lease_until < now
    is_stale = is_abandoned or held != {job.drive_id: job.id for job in jobs}
    if not is_stale and held:
        is_stale = not (is_shown and (folder / CITY / "city.json").is_file())
    osm, key = _osm_of(storage, folder, city.osm, jobs) if held else ({}, "")
    last = max((each.at for each in wrong), default=None)
    audit_key = f"{city.revision} {len(wrong)} {last} {key}" if osm else None
    return Standing(jobs, rows, wrong, is_stale, osm, audit_key)


def _osm_of(storage: Storage, folder: Path, name: str | None, jobs: Sequence[Any]) -> tuple[dict[Path, set[str]], str]:
    """Return the OSM files of a map (its own, else those of its drives), and a text that differs where they do."""
    own = None if name is None else folder / OSM / name
    found: dict[Path, set[str]] = defaultdict(set)
    for job in jobs:
        if own is not None or (job.osm and is_map(job.osm)):
            found[own or storage.folder(f"drives/{job.drive_id}/files/{job.osm}")].add(job.drive_id)
    facts = []
    for path in list(found):
        try:
            stat = path.stat()
            facts.append((str(path.relative_to(storage.root)), stat.st_size, stat.st_mtime_ns, sorted(found[path])))
        except OSError:  # it is gone
            del found[path]
    return found, hashlib.sha256(repr(facts).encode()).hexdigest()[:32]


def map_models(session: Session, context: Context, cities: Sequence[CityMap]) -> list[MapModel]:
    """Return maps as clients see them."""
    standings = standings_of(session, context, cities)
    return [_model(city, standings[city.id]) for city in cities]


def _model(city: CityMap, standing: Standing) -> MapModel:
    summary, audit = city.summary or {}, city.audit or {}
    return MapModel(
        **columns_for(MapModel, city, but=("osm",)),
        is_waiting=standing.is_waiting(city),
        is_at_work=city.lease_owner is not None,
        drives=summary.get("drives", 0),
        refused=sum(row.problem is not None for row in standing.rows.values()),
        intersections=summary.get("intersections", 0),
        seen_by_several=summary.get("seen_by_several", 0),
        is_made_up=audit.get("is_made_up", False),
        **{name: summary.get(name) for name in ("median_position_std_m", "median_relative_std_m", "bbox")},
        **{name: audit.get(name) for name in ("findings", "junctions_passed", "osm", "problem")},
    )
