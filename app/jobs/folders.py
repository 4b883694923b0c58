"""The folders of a job: its drive, its scratch while it runs, its result once it was successful."""

import shutil
from contextlib import suppress
from pathlib import Path

from app.context import Context
from app.http.problems import Problem
from app.jobs.queue import Claim
from app.paths import without_folder
from app.store.storage import Storage
from app.work.kinds import KINDS
from app.work.requests import JobRequest
from app.work.task import REDUCED, ProgressFiles, Task, WorkSettings
from interloc.drives.options import LabelFolder
from interloc.drives.scans.reduced_format import read_manifest
from interloc.errors import InterLocError

_ATTEMPT = "result-"


def progress_files(storage: Storage, claim: Claim) -> ProgressFiles:
    """Return the files by which the workers of a claimed job report their progress."""
    return ProgressFiles(_scratch(storage, claim.job.id), _attempt(claim))


def task_of(context: Context, claim: Claim, slots: int) -> Task[JobRequest]:
    """Return the task of a claimed job for the workers.

    A `ValidationError` says that its row does not hold a request of its kind.
    """
    job, storage = claim.job, context.storage
    name = _attempt(claim)
    return Task(
        kind=job.kind,
        job_id=job.id,
        drive_name=claim.drive_name,
        request=KINDS[job.kind].request.model_validate(job.request),
        drive=storage.folder(f"drives/{job.drive_id}"),
        scratch=_scratch(storage, job.id),
        result=storage.folder(f"jobs/{job.id}/{_ATTEMPT}{name}"),
        cache=storage.folder("cache"),
        settings=WorkSettings.model_validate(context.settings),
        workers=slots,
        attempt=name,
    )


def _attempt(claim: Claim) -> str:
    return claim.lease.rpartition("-")[2]


def _scratch(storage: Storage, job_id: str) -> Path:
    return storage.folder(f"jobs/{job_id}/scratch")


def label_folders(storage: Storage, drive_id: str) -> list[LabelFolder]:
    """Return the label folders by which a ready drive was reduced; none where its files are damaged from outside."""
    try:
        manifest = read_manifest(storage.folder(f"drives/{drive_id}") / REDUCED)
    except InterLocError:  # jobs tell what is wrong
        return []
    return [labels.folder for labels in manifest.labels]


def without_paths(problem: Problem, task: Task[JobRequest]) -> Problem:
    """Name the files of a drive and a job as their client knows them."""
    for folder in (task.drive / "files", task.drive / "reduced", task.drive, task.result, task.scratch):
        problem.detail = without_folder(problem.detail, folder, task.drive_name)
    return problem


def place_result(storage: Storage, task: Task[JobRequest]) -> None:
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
