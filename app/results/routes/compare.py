"""Results side by side."""

import json
import re
from typing import Annotated, Any

from fastapi import APIRouter, Query

from app.context import ContextDep
from app.http.prices import priced
from app.http.problem_types import DIFFERENT_DRIVES, REQUEST_NOT_VALID
from app.http.problems import Problem
from app.jobs.models import MAX_COMPARED_JOBS
from app.jobs.view import find_job, own_settings, title_of
from app.results.folder import ResultsDep
from interloc.evaluation import compare

_JOBS = rf"^[A-Za-z0-9_-]{{1,64}}( *, *[A-Za-z0-9_-]{{1,64}}){{1,{MAX_COMPARED_JOBS - 1}}}$"

router = APIRouter(tags=["Results"])


@router.get("/compare")
@priced("heavy", bound="the reports of a few jobs")
def compare_jobs(
    context: ContextDep,
    results: ResultsDep,
    jobs: Annotated[
        str,
        Query(
            description=f"Ids of 2 to {MAX_COMPARED_JOBS} jobs, with commas between.",
            max_length=1000,
            examples=["9b1e,44f0"],
        ),
    ],
) -> dict[str, Any]:
    """Show what differs of inputs and settings, the figures at D = 5 m, and intersections that only one job found.

    A setting `is_own` where a job has another value than its preset; jobs that are called the same are numbered.
    """
    ids = [each.strip() for each in jobs.split(",")]
    if re.fullmatch(_JOBS, jobs) is None or len(set(ids)) < len(ids):
        raise Problem(REQUEST_NOT_VALID, f"jobs: {jobs!r}. Expected two to {MAX_COMPARED_JOBS} different job ids: a,b")
    opened = [results.open(job_id) for job_id in ids]
    drives = dict.fromkeys(result.drive_id for result in opened)
    if len(drives) > 1:
        names = ", ".join(f"{result.job_id} of {result.drive_id}" for result in opened)
        raise Problem(DIFFERENT_DRIVES, f"Jobs of one drive can be compared; these are {names}.")
    with context.database.reading() as session:
        titles = [title_of(find_job(session, job_id)[0]) for job_id in ids]
    number = [titles[: i + 1].count(title) for i, title in enumerate(titles)]
    numbered = [
        title if titles.count(title) == 1 else f"{title} ({n})" for title, n in zip(titles, number, strict=True)
    ]
    reports = [json.loads(result.evaluation_file("report.json").read_bytes()) for result in opened]
    runs = [json.loads((result.folder / "run.json").read_bytes()) for result in opened]
    one_drive = {"drive_name": opened[0].drive_id}  # which may have been renamed between the jobs
    compared = compare.compare_reports(ids, reports, [run | one_drive for run in runs])
    own = set().union(*(own_settings(run) for run in runs))
    settings = [{**dict(each), "is_own": each.name in own} for each in compared.settings]
    return {**dict(compared), "drive_id": opened[0].drive_id, "names": numbered, "settings": settings}
