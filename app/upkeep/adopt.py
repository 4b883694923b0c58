"""Make rows for the folders of drives and jobs that have none: after the database was lost, or from ``lost+found/``.

What a folder holds is looked at; what it is called and whose it is says the sidecar that was written beside it
(`app.store.sidecars`). Neither is believed blindly: what is not valid is left out, and what makes no sense is left
where it is. At the end database and data folder are bound to each other.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from sqlalchemy import select

from app.context import Context
from app.drives.models import DriveOptionsModel, NewDrive
from app.drives.reconcile import reconcile
from app.drives.records import note_extent
from app.jobs.models import NewJob
from app.states import DriveState, JobKind, JobState
from app.store import sidecars
from app.store.incoming import is_used, size_of
from app.store.installation import InstallationError, id_of_database, id_of_folder, make_id, remark_folder
from app.store.models import Drive, Job
from app.store.sidecars import DriveSidecar, JobSidecar
from app.store.storage import INCOMING, LOST
from app.upkeep.cleanup import unknown_folders
from app.upkeep.transfer import Advance, no_progress
from interloc.drives.inspect import DriveReport
from interloc.drives.scans.reduced_format import read_manifest
from interloc.errors import ConfigError, InterLocError
from interloc.osm.container import is_map
from interloc.output.layout import RUN_FILE

_NAME = re.compile(r"([0-9a-f]{16})(?:-\d+)?")
_UNKNOWN_OWNER = "unknown"


@dataclass(frozen=True)
class Adoption:
    """What became of a folder that no row knew."""

    place: str
    """Where it lay, as a path in the data folder."""
    is_adopted: bool
    """False if it was left where it is."""
    text: str
    """What it is now, or why it was left."""


class _LeftError(Exception):
    """The folder cannot be adopted; the text says why."""


def adopt(context: Context, *, dry_run: bool = False, progress: Advance = no_progress) -> list[Adoption]:
    """Make rows for folders that have none, and bind database and data folder.

    Parameters
    ----------
    context
        Opened with ``bound=False``.
    dry_run
        Only tell what would be done.

    Raises
    ------
    ConfigError
        A server with another database is at work in the data folder.
    """
    _refuse_if_used(context)
    folders = list(_candidates(context))
    adopted: dict[str, str] = {}  # id of a drive -> its name, where it is adopted now
    outcomes = []
    for number, (place, kind) in enumerate(folders):
        progress(number, len(folders), place)
        try:
            if kind == "drives":
                drive, text = _adopt_drive(context, place, _id_in(place), dry_run=dry_run)
                adopted[drive.id] = drive.name
            else:
                text = _adopt_job(context, place, _id_in(place), adopted, dry_run=dry_run)
            outcomes.append(Adoption(place, is_adopted=True, text=text))
        except _LeftError as reason:
            outcomes.append(Adoption(place, is_adopted=False, text=f"{reason}; left where it is"))
    if not dry_run:
        with context.database.writing() as session:
            installation = id_of_database(session) or make_id(session, context.database)
        remark_folder(context.storage.root, installation)
    return outcomes


def _refuse_if_used(context: Context) -> None:
    with context.database.reading() as session:
        in_database = id_of_database(session)
    try:
        in_folder = id_of_folder(context.storage.root)
    except InstallationError:  # not readable: written anew
        in_folder = None
    if in_folder != in_database and is_used(context.storage.folder(INCOMING)):
        raise ConfigError(
            f"a server is at work in the data folder {context.storage.root}, with another database (installation "
            f"{in_folder}). Stop it first; afterwards it can be started with this database only."
        )


def _candidates(context: Context) -> Iterator[tuple[str, str]]:
    """Yield the folders without a row, drives first: place and kind."""
    lost = context.storage.folder(LOST)
    places = [*unknown_folders(context)]
    places += sorted(path.relative_to(context.storage.root).as_posix() for path in lost.glob("*/*"))
    for kind in ("drives", "jobs"):
        for place in places:
            path = context.storage.folder(place)
            if place.split("/")[-2] == kind and path.is_dir() and any(path.iterdir()):
                yield place, kind


def _id_in(place: str) -> str:
    """Return the id of a drive or job by the name of its folder."""
    match = _NAME.fullmatch(place.rpartition("/")[2])
    if match is None:
        raise _LeftError("its name is not the id of a drive or a job")
    return match[1]


def _adopt_drive(context: Context, place: str, id_: str, *, dry_run: bool) -> tuple[Drive, str]:
    folder = context.storage.folder(place)
    with context.database.reading() as session:
        if session.get(Drive, id_) is not None:
            raise _LeftError(f"there is a drive {id_} already")
    sidecar = sidecars.read_drive(folder)
    is_deleted = sidecar is not None and sidecar.deleted_at is not None
    is_whole = _has_manifest(folder / "reduced")
    files = folder / "files"
    raw = [path for path in files.rglob("*") if path.is_file() and not is_map(path.name)]
    if sidecar is None and not raw and not (folder / "reduced").is_dir():
        raise _LeftError("it holds nothing of a drive")
    is_ready = is_whole and (sidecar is None or sidecar.state == DriveState.READY)
    drive = _drive_of(sidecar, id_, keep_raw=is_ready and bool(raw))
    drive.state = DriveState.READY if is_ready else DriveState.UPLOADING
    drive.stored_bytes = size_of(folder / "reduced") if is_ready else 0
    if not dry_run:
        _move(context, place, f"drives/{id_}")
        with context.database.writing() as session:
            now = context.database.clock(session)
            drive.touched_at = now
            drive.created_at = min(drive.created_at or now, now)
            note_extent(drive, context.storage)
            session.add(drive)
        reconcile(context, id_, is_news=False)
        with context.database.writing() as session:
            drive = session.get_one(Drive, id_)
            if is_deleted:
                drive.deleted_at = context.database.clock(session)  # its time in the trash begins anew
        sidecars.write(context.storage, drive)
    state = "ready" if is_ready else "open for files: commit it"
    state = "in the trash" if is_deleted else state
    return drive, f"drive {drive.name!r} of {drive.owner}, {state}"


def _has_manifest(reduced: Path) -> bool:
    try:
        read_manifest(reduced)
    except (InterLocError, OSError):
        return False
    return True


def _drive_of(sidecar: DriveSidecar | None, id_: str, *, keep_raw: bool) -> Drive:
    """Return a row, by the sidecar as far as that holds.

    Without one, raw scans beside reduced ones are taken for wanted: otherwise the clean-up would remove them.
    """
    name = f"recovered {id_[:8]}"
    options = DriveOptionsModel().model_dump(mode="json")
    if sidecar is None:
        return Drive(id=id_, name=name, owner=_UNKNOWN_OWNER, options=options, keep_raw=keep_raw)
    try:
        new = NewDrive.model_validate({"name": sidecar.name, "options": sidecar.options})
        name, options = new.name, new.options.model_dump(mode="json")
    except ValidationError:
        pass
    try:
        report = None if sidecar.report is None else DriveReport.model_validate(sidecar.report).to_dict()
    except ValidationError:
        report = None
    as_it_says = sidecar.model_dump(include={"owner", "keep_raw", "note", "pinned_job", "source", "created_at"})
    return Drive(id=id_, name=name, options=options, report=report, **as_it_says)


def _adopt_job(context: Context, place: str, id_: str, adopted: dict[str, str], *, dry_run: bool) -> str:
    folder = context.storage.folder(place)
    sidecar = sidecars.read_job(folder)
    if sidecar is None:
        raise _LeftError(f"no {sidecars.JOB_FILE} says of which drive it is")
    _check_result(folder / "result", sidecar)
    with context.database.reading() as session:
        if session.get(Job, id_) is not None:
            raise _LeftError(f"there is a job {id_} already")
        name = session.scalar(select(Drive.name).where(Drive.id == sidecar.drive_id)) or adopted.get(sidecar.drive_id)
    if name is None:
        raise _LeftError(f"its drive {sidecar.drive_id} is not there")
    if not dry_run:
        _move(context, place, f"jobs/{id_}")
        with context.database.writing() as session:
            job = Job(id=id_, state=JobState.SUCCESSFUL, stage="finished", **sidecar.model_dump())
            if "name" not in sidecar.model_fields_set:  # of an older version
                job.name = sidecar.request.get("name")
            session.add(job)
        sidecars.write(context.storage, job)
    return f"job of drive {name!r}, of {sidecar.owner}, with its result"


def _check_result(result: Path, sidecar: JobSidecar) -> None:
    try:
        json.loads((result / RUN_FILE).read_bytes())
    except (OSError, ValueError):
        raise _LeftError(f"its result has no {RUN_FILE} that can be read") from None
    try:
        NewJob.model_validate({**sidecar.request, "drive_id": sidecar.drive_id})
    except ValidationError:
        raise _LeftError(f"the request in its {sidecars.JOB_FILE} is not that of a job") from None
    if sidecar.kind != JobKind.INTERSECTIONS or not {"georeferenced", "report"} <= sidecar.summary.keys():
        raise _LeftError(f"the outcome in its {sidecars.JOB_FILE} is not that of a successful job")


def _move(context: Context, place: str, key: str) -> None:
    if place == key:
        return
    target = context.storage.folder(key)
    if target.exists():
        raise _LeftError(f"there is {key} already")
    target.parent.mkdir(parents=True, exist_ok=True)
    context.storage.folder(place).rename(target)
