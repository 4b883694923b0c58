"""The result that stands for a drive: what maps of everything show."""

from __future__ import annotations

from typing import Literal

from sqlalchemy import ColumnElement, Select, case, func, select

from app.http.paging import newest_first
from app.jobs.view import is_alive
from app.states import JobKind, JobState
from app.store.models import Drive, Job

Choice = Literal["pinned", "best"]
"""Why a job stands for its drive."""


def chosen_results(*conditions: ColumnElement[bool]) -> Select[Job]:
    """Return the query for the job that stands for each drive that has a successful one; nothing in the trash counts.

    The one that somebody has pinned; else the best by the map: one with the settings of this version before one with
    those of the paper, then the highest F1 of its intersections, then the newest. One that was not scored comes last.

    Parameters
    ----------
    conditions
        On `Drive` and `Job`: which drives and jobs come into question.
    """
    is_pinned = case((Drive.pinned_job == Job.id, 0), else_=1)
    asked = Job.request
    preset = func.coalesce(asked["preset"].as_string(), asked["config"]["preset"].as_string())
    is_paper = case((preset == "paper", 1), else_=0)
    report = Job.summary["report"]
    f1 = func.coalesce(report["map_f1"].as_float(), report["f1_at_5"].as_float(), -1.0)  # older ones have the second
    place = func.row_number().over(
        partition_by=Job.drive_id, order_by=(is_pinned, is_paper, f1.desc(), *newest_first(Job))
    )
    is_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL, is_alive())
    ranked = select(Job.id, place.label("place")).join(Drive, Drive.id == Job.drive_id).where(*is_result, *conditions)
    found = ranked.subquery()
    return select(Job).join(found, found.c.id == Job.id).where(found.c.place == 1)


def choice_of(drive_pinned: str | None, job: str | None) -> Choice | None:
    """Return why a job stands for a drive, by the job that is pinned; None where there is no job."""
    return None if job is None else "pinned" if drive_pinned == job else "best"
