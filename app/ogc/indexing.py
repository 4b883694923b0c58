"""The index of features follows the results: filled when a job ends, and for older ones later.

The features of a job that goes to the trash stay, and are not shown; they go with its row.
"""

from __future__ import annotations

import logging
import zlib
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import delete, insert, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.ogc.work import CONTENT, FOOTPRINTS, Chunk, chunks_of, is_on_earth
from app.states import JobKind, JobState
from app.store.models import FeatureChunk, FeatureColumn, Job
from interloc.errors import InterLocError

_log = logging.getLogger(__name__)


def read_chunks(context: Context, job_id: str) -> list[Chunk]:
    """Return the features of the result of a job.

    Raises
    ------
    OutputError
        A file of the result is damaged.
    """
    return list(chunks_of(context.storage.folder(f"jobs/{job_id}/result")))


def write_chunks(session: Session, job: Job, chunks: list[Chunk]) -> None:
    """Write the features of a job into the index, in the place of those that it had."""
    session.execute(delete(FeatureChunk).where(FeatureChunk.job_id == job.id))
    labels = job.request.get("labels")
    for chunk in chunks:
        _write(session, chunk, job_id=job.id, preset=job.request.get("preset"), labels=chunk.labels or labels)


def write_map_chunks(session: Session, map_id: str, chunks: list[Chunk]) -> None:
    """Write layers of a map of many drives into the index, in the place of the same layers that it had."""
    layers = {chunk.layer for chunk in chunks}
    session.execute(delete(FeatureChunk).where(FeatureChunk.map_id == map_id, FeatureChunk.layer.in_(layers)))
    for chunk in chunks:
        _write(session, chunk, map_id=map_id)


def _write(session: Session, chunk: Chunk, **of: str | None) -> None:
    row = FeatureChunk(
        layer=chunk.layer,
        number=chunk.number,
        count=chunk.count,
        attribution=chunk.attribution,
        license=chunk.license,
        **of,
        **chunk.extent,
    )
    session.add(row)
    session.flush()
    if chunk.columns:
        columns = [{"chunk_id": row.id, "name": name, "content": content} for name, content in chunk.columns.items()]
        session.execute(insert(FeatureColumn), columns)


def index_result(result: Path) -> Callable[[Session, Job], None]:
    """Read the features of a new result; what is returned writes them into the index."""
    chunks = list(chunks_of(result))
    return lambda session, job: write_chunks(session, job, chunks)


def index_job(context: Context, job_id: str) -> None:
    """Write the features of a job into the index, as its result has them now.

    Raises
    ------
    OutputError
        A file of the result is damaged.
    """
    chunks = read_chunks(context, job_id)
    with context.database.writing(patient=True) as session:
        job = session.get(Job, job_id, with_for_update=True)
        if job is not None:  # not purged meanwhile
            write_chunks(session, job, chunks)


def is_indexed(session: Session, job_id: str) -> bool:
    """Return whether the features of a job are in the index."""
    return session.scalar(select(FeatureChunk.id).where(FeatureChunk.job_id == job_id).limit(1)) is not None


def is_indexed_as(session: Session, job_id: str, chunks: list[Chunk]) -> bool:
    """Return whether the index holds these features of a job, and no others."""
    chunk, column = FeatureChunk, FeatureColumn
    rows = session.execute(select(chunk.layer, chunk.number, chunk.count).where(chunk.job_id == job_id))
    if sorted(tuple(row) for row in rows) != sorted((each.layer, each.number, each.count) for each in chunks):
        return False
    columns = session.execute(
        select(chunk.layer, chunk.number, column.name, column.content)
        .join(chunk, chunk.id == column.chunk_id)
        .where(chunk.job_id == job_id, chunk.layer != FOOTPRINTS.name)  # made by a library, another way in each version
    )
    found = {(layer, number, name): _unpacked(name, content) for layer, number, name, content in columns}
    return found == {
        (each.layer, each.number, name): _unpacked(name, content)
        for each in chunks
        if each.layer != FOOTPRINTS.name
        for name, content in each.columns.items()
    }


def _unpacked(name: str, content: bytes) -> bytes:
    """Return a column without what the version of a library has made of it."""
    return zlib.decompress(content) if name == CONTENT else content


def index_missing(context: Context) -> int:
    """Write the features of jobs that are not in the index, of older versions and adopted ones; return of how many."""
    indexed = select(FeatureChunk.job_id).where(FeatureChunk.job_id.is_not(None)).distinct()
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
