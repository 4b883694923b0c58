"""The rows of features follow the results: written when a job ends or a map is merged, and for older jobs later.

The features of a job that goes to the trash stay, and are not shown; they go with its row.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from pathlib import Path

from sqlalchemy import delete, insert, select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.ogc.work import LayerRows, is_on_earth, rows_of
from app.states import JobKind, JobState
from app.store.database import Database
from app.store.features import OF_MAPS, OF_RESULTS
from app.store.models import FeatureLayer, Job
from interloc.errors import InterLocError

_AT_ONCE = 10_000
_UNSEEN = "~"  # begins the name of a layer of a map that is being written, or goes
_log = logging.getLogger(__name__)


def write_job_rows(session: Session, job: Job, layers: Iterable[LayerRows]) -> None:
    """Write the features of a job, in the place of those that it had."""
    session.execute(delete(FeatureLayer).where(FeatureLayer.job_id == job.id))
    preset, labels = job.request.get("preset"), job.request.get("labels")
    for each in layers:
        facts = {**each.facts, "preset": preset, "labels": each.facts["labels"] or labels}
        row = FeatureLayer(job_id=job.id, layer=each.layer, **facts)
        session.add(row)
        session.flush()
        for start in range(0, len(each.rows), _AT_ONCE):
            rows = [{**values, "layer_id": row.id} for values in each.rows[start : start + _AT_ONCE]]
            session.connection().execute(insert(OF_RESULTS[each.layer]), rows)


def write_map_rows(
    database: Database, map_id: str, layers: Iterable[LayerRows], go_on: Callable[[], object]
) -> Callable[[Session], None]:
    """Write layers of a map of many drives, unseen; what is returned shows them in the place of those that it had.

    Others write between the slices; before each `go_on` is called, which may raise. What a kill leaves behind goes with
    the next call, and with the map.
    """
    sweep_map_rows(database, map_id)
    new = {}
    for each in layers:
        with database.writing(patient=True) as session:
            row = FeatureLayer(map_id=map_id, layer=f"{_UNSEEN}new {each.layer}", **each.facts)
            session.add(row)
            session.flush()
            new[each.layer] = row.id
        for start in range(0, len(each.rows), _AT_ONCE):
            go_on()
            with database.writing(patient=True) as session:
                rows = [{**values, "layer_id": new[each.layer]} for values in each.rows[start : start + _AT_ONCE]]
                session.connection().execute(insert(OF_MAPS[each.layer]), rows)

    def show(session: Session) -> None:
        _hide(session, map_id, *new)
        for name, layer_id in new.items():
            session.execute(update(FeatureLayer).where(FeatureLayer.id == layer_id).values(layer=name))

    return show


def sweep_map_rows(database: Database, map_id: str, *, is_gone: bool = False) -> None:
    """Delete the layers of a map that nobody is shown, or all of them, some rows at a time."""
    of = FeatureLayer
    if is_gone:
        with database.writing() as session:
            _hide(session, map_id, *OF_MAPS)
    with database.reading() as session:
        asked = select(of.id, of.layer, of.count).where(of.map_id == map_id, of.layer.startswith(_UNSEEN))
        unseen = session.execute(asked).all()
    for layer_id, name, count in unseen:
        table = OF_MAPS[name.partition(" ")[2]]
        for end in range(_AT_ONCE, count + _AT_ONCE, _AT_ONCE):
            with database.writing(patient=True) as session:
                session.execute(delete(table).where(table.c.layer_id == layer_id, table.c.number < end))
        with database.writing(patient=True) as session:
            session.execute(delete(of).where(of.id == layer_id))


def _hide(session: Session, map_id: str, *layers: str) -> None:
    of = FeatureLayer
    for layer_id, name in session.execute(select(of.id, of.layer).where(of.map_id == map_id, of.layer.in_(layers))):
        session.execute(update(of).where(of.id == layer_id).values(layer=f"{_UNSEEN}{layer_id} {name}"))


def index_result(result: Path) -> Callable[[Session, Job], None]:
    """Read the features of a new result; what is returned writes them."""
    layers = list(rows_of(result))
    return lambda session, job: write_job_rows(session, job, layers)


def index_job(context: Context, job_id: str) -> None:
    """Write the features of a job as its result has them now.

    Raises
    ------
    OutputError
        A file of the result is damaged.
    """
    layers = list(rows_of(context.storage.folder(f"jobs/{job_id}/result")))
    with context.database.writing(patient=True) as session:
        job = session.get(Job, job_id, with_for_update=True)
        if job is not None:  # not purged meanwhile
            write_job_rows(session, job, layers)


def is_indexed(session: Session, job_id: str) -> bool:
    """Return whether the features of a job are there as rows."""
    return session.scalar(select(FeatureLayer.id).where(FeatureLayer.job_id == job_id).limit(1)) is not None


def index_missing(context: Context) -> int:
    """Write the features of jobs that have no rows, as of older versions; return of how many."""
    indexed = select(FeatureLayer.job_id).where(FeatureLayer.job_id.is_not(None)).distinct()
    is_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL)
    with context.database.reading() as session:
        missing = session.scalars(
            select(Job.id).where(*is_result, Job.id.not_in(indexed)).order_by(Job.created_at.desc())
        ).all()
    count = 0
    for job_id in missing:
        if context.stopping.is_set():
            break
        if not is_on_earth(context.storage.folder(f"jobs/{job_id}/result")):
            continue
        try:
            index_job(context, job_id)
            count += 1
        except (InterLocError, OSError, SQLAlchemyError) as error:
            _log.warning("job %s: its features could not be indexed: %s", job_id, error, extra={"job": job_id})
    if count:
        _log.info("the features of %d jobs were indexed", count)
    return count
