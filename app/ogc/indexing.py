"""The rows of features follow the results: written when a job ends or a map is merged, and for older jobs later.

The features of jobs whose drive is in the trash stay, and are not shown; they go with its row.
"""

import logging
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import Table, delete, insert, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.ogc.work import LayerRows, is_on_earth, rows_of
from app.states import JobKind, JobState
from app.store.models import OF_MAPS, OF_RESULTS, FeatureLayer, Job
from interloc.errors import InterLocError

_AT_ONCE = 10_000  # rows
_log = logging.getLogger(__name__)


def write_job_rows(session: Session, job: Job, layers: Iterable[LayerRows]) -> None:
    """Write the features of a job, in the place of those that it had."""
    session.execute(delete(FeatureLayer).where(FeatureLayer.job_id == job.id))
    preset, labels = job.request.get("preset"), job.request.get("labels")
    for each in layers:
        facts = {**each.facts, "preset": preset, "labels": each.facts["labels"] or labels}
        _write(session, OF_RESULTS[each.layer], FeatureLayer(job_id=job.id, layer=each.layer, **facts), each.rows)


def write_map_rows(session: Session, map_id: str, layers: Sequence[LayerRows]) -> None:
    """Write layers of a map of many drives, in the place of those that it had."""
    names = [each.layer for each in layers]
    session.execute(delete(FeatureLayer).where(FeatureLayer.map_id == map_id, FeatureLayer.layer.in_(names)))
    for each in layers:
        _write(session, OF_MAPS[each.layer], FeatureLayer(map_id=map_id, layer=each.layer, **each.facts), each.rows)


def _write(session: Session, table: Table, layer: FeatureLayer, rows: Sequence[dict[str, Any]]) -> None:
    session.add(layer)
    session.flush()
    for start in range(0, len(rows), _AT_ONCE):
        some = [{**values, "layer_id": layer.id} for values in rows[start : start + _AT_ONCE]]
        session.connection().execute(insert(table), some)


def index_result(result: Path) -> Callable[[Session, Job], None]:
    """Read the features of a new result; what is returned writes them."""
    layers = list(rows_of(result))
    return lambda session, job: write_job_rows(session, job, layers)


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
            layers = list(rows_of(context.storage.folder(f"jobs/{job_id}/result")))
            with context.database.writing(patient=True) as session:
                job = session.get(Job, job_id, with_for_update=True)
                if job is not None:  # not purged meanwhile
                    write_job_rows(session, job, layers)
                    count += 1
        except (InterLocError, OSError, SQLAlchemyError) as error:
            _log.warning("job %s: its features could not be indexed: %s", job_id, error, extra={"job": job_id})
    if count:
        _log.info("the features of %d jobs were indexed", count)
    return count
