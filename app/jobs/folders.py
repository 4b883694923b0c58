"""The folders of a job: its drive, its scratch while it runs, its result once it was successful."""

from __future__ import annotations

import shutil
from contextlib import suppress
from typing import Any

from app.context import Context
from app.http.problems import Problem
from app.jobs.queue import Claim
from app.paths import without_folder
from app.store.storage import Storage
from app.work.places import REDUCED
from app.work.task import Task
from interloc.drives.options import LabelFolder
from interloc.drives.scans.reduced_format import read_manifest
from interloc.errors import InterLocError

_ATTEMPT = "result-"


def task_of(context: Context, claim: Claim, slots: int) -> Task:
    """Return the task of a claimed job for the workers."""
    job, storage = claim.job, context.storage
    name = claim.lease.rpartition("-")[2]
    return Task(
        kind=job.kind,
        job_id=job.id,
        drive_name=claim.drive_name,
        request=job.request,
        drive=storage.folder(f"drives/{job.drive_id}"),
        scratch=storage.folder(f"jobs/{job.id}/scratch"),
        result=storage.folder(f"jobs/{job.id}/{_ATTEMPT}{name}"),
        limits=_limits(context, slots),
        attempt=name,
    )


def _limits(context: Context, slots: int) -> dict[str, Any]:
    settings = context.settings
    by_name = settings.model_dump(mode="json", exclude={"token", "database_url"})
    limits = {name: value for name, value in by_name.items() if name.startswith(("max_", "min_"))}
    cache, models = str(context.storage.folder("cache")), by_name["models"]
    return {**limits, "workers": slots, "cache": cache, "models": models, "overpass_url": settings.overpass_url}


def label_folders(storage: Storage, drive_id: str) -> list[LabelFolder]:
    """Return the label folders by which a ready drive was reduced; none where its files are damaged from outside."""
    try:
        manifest = read_manifest(storage.folder(f"drives/{drive_id}") / REDUCED)
    except InterLocError:  # jobs tell what is wrong
        return []
    return [labels.folder for labels in manifest.labels]


def without_paths(problem: Problem, task: Task) -> Problem:
    """Name the files of a drive and a job as their client knows them."""
    for folder in (task.drive / "files", task.drive / "reduced", task.drive, task.result, task.scratch):
        problem.detail = without_folder(problem.detail, folder, task.drive_name)
    return problem


def place_result(storage: Storage, task: Task) -> None:
    """Move the result of an attempt to its place, in the transaction that ends the job."""
    if task.result.is_dir():
        storage.delete(f"jobs/{task.job_id}/result")
        task.result.rename(task.result.with_name("result"))


def tidy(storage: Storage, job_id: str, *, keep_result: bool) -> None:
    """Remove what a job that has ended leaves behind."""
    if not keep_result:
        storage.delete(f"jobs/{job_id}")
        return
    storage.delete(f"jobs/{job_id}/scratch")
    folder = storage.folder(f"jobs/{job_id}")
    for entry in list(folder.iterdir()) if folder.is_dir() else []:
        if entry.name.startswith((_ATTEMPT, f".{_ATTEMPT}")):
            shutil.rmtree(entry, ignore_errors=True)
    with suppress(OSError):  # not empty: it has a result
        folder.rmdir()


def jobs_with_scratch(storage: Storage) -> list[str]:
    """Return the ids of the jobs that have a scratch folder."""
    root = storage.folder("jobs")
    return [entry.name for entry in root.iterdir() if (entry / "scratch").is_dir()] if root.is_dir() else []
