"""The newest result of every drive: what maps of everything show."""

from __future__ import annotations

from sqlalchemy import ColumnElement, Select, func, select

from app.http.paging import newest_first
from app.jobs.view import is_alive
from app.states import JobKind, JobState
from app.store.models import Drive, Job


def newest_results(*conditions: ColumnElement[bool]) -> Select[Job]:
    """Return the query for the newest successful job of each drive that has one; nothing in the trash counts.

    Parameters
    ----------
    conditions
        On `Drive` and `Job`: which drives and jobs come into question.
    """
    place = func.row_number().over(partition_by=Job.drive_id, order_by=newest_first(Job))
    is_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL, is_alive())
    ranked = select(Job.id, place.label("place")).join(Drive, Drive.id == Job.drive_id).where(*is_result, *conditions)
    found = ranked.subquery()
    return select(Job).join(found, found.c.id == Job.id).where(found.c.place == 1)
