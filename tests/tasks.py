"""Tasks as the service makes them, for tests of work alone."""

from pathlib import Path
from typing import TypeVar

from app.settings import Settings
from app.work.requests import JobRequest
from app.work.task import Task, WorkSettings

Request = TypeVar("Request", bound=JobRequest)


def task_for(kind: str, request: Request, folder: Path) -> Task[Request]:
    """A task whose drive, scratch and result lie in a folder; its scratch is made."""
    (folder / "scratch").mkdir(exist_ok=True)
    return Task(
        kind=kind,
        job_id="job",
        drive_name="street",
        request=request,
        drive=folder / "drive",
        scratch=folder / "scratch",
        result=folder / "result",
        cache=folder / "cache",
        settings=WorkSettings.model_validate(Settings()),
        workers=1,
        attempt="a",
    )
