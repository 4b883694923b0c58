"""What a map should hold, and which rows it has."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event, select
from sqlalchemy.orm import Session

from app.context import Context
from app.maps.records import SERVER_MAP, Standing, find_map, make_server_map, standings_of
from app.ogc.collections import OF_MAP
from app.ogc.index import Query, Source, find_page, write_map_rows
from app.ogc.work import rows_of_map
from app.store.models import OF_MAPS, CityMap, Drive, Job, MapDrive, MapVerdict
from interloc.output.layers import CITY_LAYERS
from tests.app.conftest import opened


@pytest.fixture
def context(tmp_path: Path) -> Iterator[Context]:
    """Two drives with a job that has ended each, and an older one of the first."""
    with opened(tmp_path) as context:
        make_server_map(context)
        with context.database.writing() as session:
            for name in ("monday", "tuesday"):
                session.add(Drive(id=name, name=name, owner="me", state="ready", created_at=1.0, touched_at=1.0))
            session.flush()
            for job, drive, at in (("old", "monday", 1.0), ("first", "monday", 2.0), ("second", "tuesday", 3.0)):
                add_job(session, job, drive, at)
        yield context


def add_job(session: Session, job: str, drive: str, at: float) -> None:
    values = {"owner": "me", "kind": "intersections", "state": "successful", "request": {"osm": {"file": "map.osm"}}}
    session.add(Job(id=job, drive_id=drive, created_at=at, finished_at=at, **values))


def judge(session: Session, number: str, verdict: str) -> None:
    at = f"2026-11-25T12:0{number}:00Z"
    judgement = {"finding": "moved-7", "kind": "moved", "verdict": verdict, "by": "Anna", "at": at, "lon": 8, "lat": 49}
    session.add(MapVerdict(id=number, map_id=SERVER_MAP, finding="moved-7", at=float(number), judgement=judgement))


def pin(session: Session, job: str) -> None:
    session.get_one(Drive, "monday").pinned_job = job


def trash(session: Session, kind: type[Drive | Job], name: str, at: float | None = 5.0) -> None:
    session.get_one(kind, name).deleted_at = at


def belong(session: Session, drive: str, is_member: bool | None) -> None:
    session.merge(MapDrive(map_id=SERVER_MAP, drive_id=drive, is_member=is_member))


def standing(context: Context) -> Standing:
    with context.database.reading() as session:
        return standings_of(session, context, [find_map(session, SERVER_MAP)])[SERVER_MAP]


def test_many_maps_cost_few_queries(context: Context) -> None:
    asked: list[str] = []
    event.listen(context.database.engine, "before_cursor_execute", lambda *of: asked.append(of[2]))
    with context.database.writing() as session:
        for number in range(300):
            session.add(CityMap(id=f"m{number}", name="m", owner="me", created_at=float(number)))
            session.flush()
            session.add(MapDrive(map_id=f"m{number}", drive_id="monday", is_member=True))
    asked.clear()
    with context.database.reading() as session:
        cities = session.scalars(select(CityMap)).all()
        found = standings_of(session, context, cities)
        assert [[job.id for job in found[name].jobs] for name in ("m0", "m299")] == [["first"]] * 2
        assert len(asked) < 10


def test_rows_of_a_map_take_the_place_of_those_before(context: Context) -> None:
    def place(number: int) -> dict[str, Any]:
        facts = {each.name: None for each in CITY_LAYERS["city"].attributes} | {"uid": f"p{number}", "passes": number}
        return {"id": f"p{number}", "geometry": {"type": "Point", "coordinates": [8.4, 49.0]}, "properties": facts}

    for count in (7, 3):
        with context.database.writing() as session:
            write_map_rows(session, SERVER_MAP, rows_of_map({"city": [place(number) for number in range(count)]}))
            assert session.query(OF_MAPS["city"]).count() == count
            assert find_page(session, Source(map=SERVER_MAP), OF_MAP["city"], Query()).matched == count


CHANGES: list[tuple[Callable[[Session], None], list[str], int]] = [
    (lambda session: add_job(session, "third", "tuesday", 4.0), ["first", "third"], 0),
    (lambda session: pin(session, "old"), ["old", "third"], 0),
    (lambda session: pin(session, "first"), ["first", "third"], 0),
    (lambda session: trash(session, Job, "third"), ["first", "second"], 0),
    (lambda session: trash(session, Drive, "monday"), ["second"], 0),
    (lambda session: trash(session, Drive, "monday", None), ["first", "second"], 0),
    (lambda session: belong(session, "tuesday", False), ["first"], 0),
    (lambda session: belong(session, "tuesday", None), ["first", "second"], 0),
    (lambda session: judge(session, "1", "wrong"), ["first", "second"], 1),
    (lambda session: judge(session, "2", "right"), ["first", "second"], 0),
    (lambda session: session.delete(session.get_one(MapVerdict, "2")), ["first", "second"], 1),
    (lambda session: session.delete(session.get_one(Job, "first")), ["old", "second"], 1),
]


def test_every_change_is_seen_at_once(context: Context) -> None:
    assert [(job.id, job.osm) for job in standing(context).jobs] == [("first", "map.osm"), ("second", "map.osm")]
    for change, jobs, wrong in CHANGES:
        with context.database.writing() as session:
            change(session)
        now = standing(context)
        assert ([job.id for job in now.jobs], len(now.wrong), now.is_stale) == (jobs, wrong, True)
