"""What a row says, once more beside the files: from it `interloc adopt` makes the row again where the database is lost.

``drives/<id>/drive.json`` and ``jobs/<id>/job.json`` are written after the transaction, whole or not at all. They
follow the rows and are never read while the database has them; one that is missing is written by the clean-up.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, Field, ValidationError

from app.states import DriveState
from app.store.models import Drive, Job
from app.store.storage import Storage
from interloc.errors import OutputError
from interloc.files import atomic_write

DRIVE_FILE = "drive.json"
JOB_FILE = "job.json"

_MAX_BYTES = 64 << 20

_log = logging.getLogger(__name__)


class DriveSidecar(BaseModel):
    """What cannot be told from the files of a drive."""

    name: str = Field(min_length=1, max_length=255)
    note: str | None = None
    owner: str = Field(min_length=1, max_length=255)
    state: DriveState
    options: dict[str, Any]
    keep_raw: bool
    created_at: float = Field(gt=0, allow_inf_nan=False)
    report: dict[str, Any] | None = None
    deleted_at: float | None = Field(None, gt=0, allow_inf_nan=False)
    pinned_job: str | None = Field(None, max_length=255)
    source: str | None = None


class JobSidecar(BaseModel):
    """What cannot be told from the result of a successful job."""

    kind: str = Field(max_length=255)
    drive_id: str = Field(max_length=255)
    owner: str = Field(min_length=1, max_length=255)
    request: dict[str, Any]
    name: str | None = None
    note: str | None = None
    summary: dict[str, Any]
    done: int = Field(ge=0)
    total: int | None = Field(None, ge=0)
    attempts: int = Field(1, ge=0)
    created_at: float = Field(gt=0, allow_inf_nan=False)
    started_at: float | None = Field(None, gt=0, allow_inf_nan=False)
    finished_at: float = Field(gt=0, allow_inf_nan=False)


Sidecar = TypeVar("Sidecar", DriveSidecar, JobSidecar)


def write(storage: Storage, row: Drive | Job) -> None:
    """Write what the row of a drive, or of a successful job, says into its folder."""
    of_drive = "drives", DRIVE_FILE, DriveSidecar
    kind, name, model = of_drive if isinstance(row, Drive) else ("jobs", JOB_FILE, JobSidecar)
    path = storage.folder(f"{kind}/{row.id}") / name
    try:
        sidecar = model.model_validate(row, from_attributes=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(sidecar.model_dump_json(indent=1).encode())
    except (OSError, OutputError, ValidationError) as error:  # the row is what counts
        _log.warning("%s could not be written: %s", path, error)


def read_drive(folder: Path) -> DriveSidecar | None:
    """Return what was written into the folder of a drive; None if that is nothing of use."""
    return _read(folder / DRIVE_FILE, DriveSidecar)


def read_job(folder: Path) -> JobSidecar | None:
    """Return what was written into the folder of a job; None if that is nothing of use."""
    return _read(folder / JOB_FILE, JobSidecar)


def _read(path: Path, model: type[Sidecar]) -> Sidecar | None:
    try:
        with path.open("rb") as file:
            return model.model_validate_json(file.read(_MAX_BYTES))
    except (OSError, ValidationError):
        return None
