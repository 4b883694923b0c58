"""Compare all rows of the database with all files of the data folder.

Every look is short and holds no lock; what looks wrong is looked at again under the lock of its drive, so that an
upload that goes on meanwhile is not taken for damage. With ``repair`` rows are made to follow the files, as a server
does at its start; no byte of a drive or of a result is removed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.context import Context
from app.drives.reconcile import Difference, counts_of, differences, reconcile, sha256_of
from app.drives.records import drive_key, files_key, reduced_key
from app.http.problem_types import RESULT_IS_GONE
from app.http.problems import Problem
from app.jobs.queue import active_job
from app.paths import without_folder
from app.states import DriveState, JobKind, JobState
from app.store import sidecars
from app.store.incoming import dead
from app.store.models import Drive, DriveFile, Job
from app.store.storage import INCOMING, LOST
from app.trash.deletion import finish_purges, half_purged
from app.upkeep.cleanup import remove_incoming, set_unknown_aside, unknown_folders
from app.upkeep.transfer import Advance, no_progress
from app.work.places import TRAJECTORY
from interloc.drives.findings import Finding
from interloc.drives.inspect import DriveReport
from interloc.drives.options import LabelFolder
from interloc.drives.scans.reduced import read_ground
from interloc.drives.scans.reduced_format import MANIFEST, ground_path, read_manifest
from interloc.errors import InterLocError
from interloc.output.layout import RUN_FILE

_NAMED = f"{MANIFEST} names it, but it is not there."
_KINDS = {
    (True, False): ("file-missing", "its row says {listed:,} bytes, but there is no such file"),
    (False, True): ("file-unlisted", "a file of {found:,} bytes that no row lists"),
    (True, True): ("file-differs", "its row says {listed:,} bytes, the file has {found:,} or was written later"),
}


@dataclass(frozen=True)
class Discrepancy:
    """Something that is not as it should be."""

    kind: str
    """A word for programs, for example "file-missing"."""
    place: str
    """Where it is, as a path in the data folder."""
    message: str
    """What was found, what was expected, what to do."""
    repair: str | None = None
    """What was done about it."""


def check(
    context: Context, *, repair: bool = False, quick: bool = False, progress: Advance = no_progress
) -> list[Discrepancy]:
    """Compare rows and files; a server may go on meanwhile.

    Parameters
    ----------
    context
        Opened by `Context.open`, which refuses a database and a data folder that do not belong together.
    repair
        Also do what is safe: no byte of a drive or of a result is removed.
    quick
        Compare sizes and times only, without reading the files.
    """
    with context.database.reading() as session:
        drives = session.execute(select(Drive.id, Drive.name).order_by(Drive.created_at)).all()
        of_kind = select(Job.id, Job.error).where(Job.kind == JobKind.INTERSECTIONS)
        jobs = [job_id for job_id, _ in session.execute(of_kind.where(Job.state == JobState.SUCCESSFUL))]
        failed = session.execute(of_kind.where(Job.state == JobState.FAILED)).all()
    found: list[Discrepancy] = []
    for job_id, error in failed:
        if (error or {}).get("type") == RESULT_IS_GONE.type:
            back = list(_check_lost_job(context, job_id, repair=repair))
            found += back
            jobs += [job_id] if back and repair else []
    may_fail = not _are_results_away(context, jobs)
    total = len(drives) + len(jobs)
    for number, (drive_id, name) in enumerate(drives):
        progress(number, total, name)
        found += _DriveCheck(context, drive_id, repair=repair, quick=quick).run()
    for number, job_id in enumerate(jobs, start=len(drives)):
        progress(number, total, f"job {job_id}")
        found += _check_job(context, job_id, repair=repair, may_fail=may_fail)
    return [*found, *_check_folders(context, repair=repair)]


class _DriveCheck:
    """The check of one drive."""

    def __init__(self, context: Context, drive_id: str, *, repair: bool, quick: bool) -> None:
        self._context = context
        self._id = drive_id
        self._repair = repair
        self._quick = quick

    def run(self) -> list[Discrepancy]:
        drive = self._look()
        if drive is None:  # deleted meanwhile
            return []
        found = [*self._state(drive), *self._reduced(drive)]
        found += [*self._files(), *self._sidecar()]
        told = "" if drive.deleted_at is None else " The drive is in the trash."
        return [replace(each, message=f"{each.message}{told}") for each in found]

    def _look(self) -> Drive | None:
        with self._context.database.reading() as session:
            return session.get(Drive, self._id)

    def _may_repair(self, drive: Drive) -> bool:
        return self._repair and drive.deleted_at is None

    def _state(self, drive: Drive) -> Iterator[Discrepancy]:
        """Find a drive that waits for a check that nobody does."""
        if drive.state != DriveState.CHECKING:
            return
        with self._context.database.writing() as session:
            locked = _lock(session, self._id)
            if locked is None or locked.state != DriveState.CHECKING or active_job(session, self._id, JobKind.COMMIT):
                return
            if self._may_repair(drive):
                locked.state = DriveState.UPLOADING
                drive.state = DriveState.UPLOADING
        repair = "it is open again: commit it once more" if self._may_repair(drive) else None
        yield Discrepancy(
            "drive-waits", drive_key(self._id), f"{drive.name} waits for a check that no job does.", repair
        )

    def _reduced(self, drive: Drive) -> Iterator[Discrepancy]:
        """Find a ready drive that jobs cannot use."""
        if drive.state != DriveState.READY:
            return
        root = self._context.storage.folder(reduced_key(self._id))
        faults = list(_faults_of(root, quick=self._quick))
        now = self._look()
        if not faults or now is None or now.state != DriveState.READY:
            return
        repair = None
        if self._may_repair(drive):
            self._reopen(faults)
            repair = "the drive is open again: send what is missing of it, and commit it once more"
        for name, message in faults:
            yield Discrepancy("reduced", f"{reduced_key(self._id)}/{name}".rstrip("/"), message, repair)

    def _reopen(self, faults: list[tuple[str, str]]) -> None:
        """Open a drive whose reduced scans are damaged, with the files listed that are left of it."""
        name, message = faults[0]
        more = f" And {len(faults) - 1} more." if len(faults) > 1 else ""
        fault = Finding("error", name or "reduced", f"{message}{more} Send the drive again, or restore a backup.")
        with self._context.database.writing() as session:
            drive = _lock(session, self._id)
            if drive is None:
                return
            report = DriveReport.model_validate(drive.report or {"path": drive.name, "name": drive.name})
            drive.report = report.model_copy(update={"problems": [fault, *report.problems]}).to_dict()
            drive.state = DriveState.UPLOADING
            drive.touched_at = self._context.database.clock(session)
        reconcile(self._context, self._id, is_news=False)

    def _files(self) -> Iterator[Discrepancy]:
        """Find files whose rows say something else."""
        root = self._context.storage.folder(files_key(self._id))
        drive, differing = self._differing()
        if drive is None:
            return
        repair = None
        if differing and self._may_repair(drive):
            try:
                reconcile(self._context, self._id, is_news=False)
                repair = "its row follows the file"
            except Problem:  # deleted meanwhile
                return
        for each in differing:
            kind, text = _KINDS[each.listed is not None, each.found is not None]
            listed, found = (stamp.size_bytes if stamp is not None else 0 for stamp in (each.listed, each.found))
            yield Discrepancy(kind, self._place(each.path), f"{text.format(listed=listed, found=found)}.", repair)
        if not self._quick:
            yield from self._digests(root, {each.path for each in differing})
        yield from self._counts()

    def _differing(self) -> tuple[Drive | None, list[Difference]]:
        with self._context.database.reading() as session:
            drive = session.get(Drive, self._id)
            found = [] if drive is None else differences(session, self._context, drive)
        if not found:
            return drive, []
        with self._context.database.writing() as session:
            drive = _lock(session, self._id)
            return drive, [] if drive is None else differences(session, self._context, drive)

    def _digests(self, root: Path, known: set[str]) -> Iterator[Discrepancy]:
        """Find files that have the size and the time of their rows, but other bytes."""
        with self._context.database.reading() as session:
            rows = session.execute(select(DriveFile.path, DriveFile.sha256).where(DriveFile.drive_id == self._id)).all()
        for path, sha256 in rows:
            try:
                digest = sha256 if path in known else sha256_of(root / path)
            except FileNotFoundError:  # reduced, or deleted meanwhile: `differences` knows which
                continue
            if digest != sha256 and (finding := self._damage(root, path, digest)) is not None:
                yield finding

    def _damage(self, root: Path, path: str, digest: str) -> Discrepancy | None:
        """Look once more under the lock: the file may have been replaced while it was read."""
        with self._context.database.writing() as session:
            drive, row = _lock(session, self._id), session.get(DriveFile, (self._id, path), populate_existing=True)
            if drive is None or row is None or row.sha256 == digest or sha256_of(root / path) == row.sha256:
                return None
            message = (
                f"its bytes have the SHA-256 {digest}, its row says {row.sha256}: the file was damaged or changed."
            )
            if not self._may_repair(drive) or drive.state != DriveState.UPLOADING:
                return Discrepancy("file-damaged", self._place(path), f"{message} Restore it from a backup.")
            row.sha256 = digest
        return Discrepancy("file-damaged", self._place(path), message, "it is listed with its digest: send it again")

    def _counts(self) -> Iterator[Discrepancy]:
        """Find a drive whose totals are not those of its files."""
        with self._context.database.reading() as session:
            drive = session.get(Drive, self._id)
            wrong = drive is not None and (drive.file_count, drive.size_bytes) != counts_of(session, self._id)
        if not wrong:
            return
        with self._context.database.writing() as session:
            drive, counts = _lock(session, self._id), counts_of(session, self._id)
            if drive is None or (drive.file_count, drive.size_bytes) == counts:
                return
            message = (
                f"{drive.name} counts {drive.file_count:,} files with {drive.size_bytes:,} bytes, but lists "
                f"{counts[0]:,} with {counts[1]:,} bytes."
            )
            if self._may_repair(drive):
                if drive.state != DriveState.READY:
                    drive.stored_bytes = counts[1]
                drive.file_count, drive.size_bytes = counts
        yield Discrepancy("count", drive_key(self._id), message, "counted again" if self._may_repair(drive) else None)

    def _sidecar(self) -> Iterator[Discrepancy]:
        folder = self._context.storage.folder(drive_key(self._id))
        if not folder.is_dir() or sidecars.read_drive(folder) is not None:
            return
        current = self._look()
        if self._repair and current is not None:
            sidecars.write(self._context.storage, current)
        yield _sidecar_discrepancy(f"{drive_key(self._id)}/{sidecars.DRIVE_FILE}", repair=self._repair)

    def _place(self, path: str) -> str:
        return f"{files_key(self._id)}/{path}"


def _lock(session: Session, drive_id: str) -> Drive | None:
    """Return a drive, also one in the trash, and lock it until the transaction ends."""
    return session.get(Drive, drive_id, with_for_update=True, populate_existing=True)


def _sidecar_discrepancy(place: str, *, repair: bool) -> Discrepancy:
    message = "missing or not readable: without the database nobody could tell what this is."
    return Discrepancy("sidecar", place, message, "written anew" if repair else None)


def _faults_of(root: Path, *, quick: bool) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the reduced folder of a ready drive: name and message."""
    if not root.is_dir():
        yield "", "the drive is ready, but its reduced scans are not there."
        return
    try:
        manifest = read_manifest(root)
    except InterLocError as error:
        yield MANIFEST, without_folder(str(error), root, "reduced")
        return
    yield from ((name, _NAMED) for name in manifest.files.paths if not (root / name).exists())
    for labels in manifest.labels:
        for frame in map(int, manifest.kept_frames):
            name = ground_path(labels.folder, frame)
            fault = _fault_of_scan(root, labels.folder, frame, quick=quick)
            if fault is not None:
                yield name, without_folder(fault, root, "reduced")
    if not any((root.parent / name).is_file() for name in TRAJECTORY):
        yield "", "the trajectory beside the reduced scans is not there."


def _fault_of_scan(root: Path, folder: LabelFolder, frame: int, *, quick: bool) -> str | None:
    if not (root / ground_path(folder, frame)).is_file():
        return _NAMED
    try:
        if not quick:
            read_ground(root, folder, frame)
    except InterLocError as error:
        return str(error)
    return None


def _are_results_away(context: Context, jobs: list[str]) -> bool:
    """Return whether no job has a result: rather than all of them, their folder is gone, perhaps for a while."""
    root = context.storage.folder("jobs")
    return len(jobs) > 1 and not any((root / job_id / "result" / RUN_FILE).exists() for job_id in jobs)


def _check_lost_job(context: Context, job_id: str, *, repair: bool) -> Iterator[Discrepancy]:
    """Find a job that failed here because its result was gone, and has it again."""
    folder = context.storage.folder(f"jobs/{job_id}")
    if _fault_of_result(folder / "result") is not None or sidecars.read_job(folder) is None:
        return
    if repair:
        with context.database.writing() as session:
            job = session.get(Job, job_id, with_for_update=True)
            if job is None or job.state != JobState.FAILED:  # deleted meanwhile
                return
            job.state, job.error = JobState.SUCCESSFUL, None
            job.version += 1
    message = "the job failed because its result was gone, and it is there again."
    yield Discrepancy("result", f"jobs/{job_id}/result", message, "the job is successful again" if repair else None)


def _check_job(context: Context, job_id: str, *, repair: bool, may_fail: bool) -> list[Discrepancy]:
    """Find a successful job whose result is gone."""
    folder = context.storage.folder(f"jobs/{job_id}")
    fault = _fault_of_result(folder / "result")
    if fault is None and sidecars.read_job(folder) is not None:
        return []
    with context.database.writing() as session:
        job = session.get(Job, job_id, with_for_update=True)
        if job is None:  # deleted meanwhile
            return []
        if fault is not None and repair and may_fail:
            _fail(job, fault)
    if fault is not None:
        done = "the job is failed now: submit it again" if repair and may_fail else None
        if not may_fail:
            fault = f"{fault} No job has its result: is the folder jobs/ where it should be, and its volume mounted?"
        return [Discrepancy("result", f"jobs/{job_id}/result", fault, done)]
    if repair:
        sidecars.write(context.storage, job)
    return [_sidecar_discrepancy(f"jobs/{job_id}/{sidecars.JOB_FILE}", repair=repair)]


def _fault_of_result(folder: Path) -> str | None:
    try:
        run: Any = json.loads((folder / RUN_FILE).read_bytes())
    except FileNotFoundError:
        return f"the job was successful, but its result has no {RUN_FILE}."
    except (OSError, ValueError) as error:
        return f"the job was successful, but {RUN_FILE} of its result cannot be read: {error}."
    return None if isinstance(run, dict) else f"the job was successful, but {RUN_FILE} of its result is no JSON object."


def _fail(job: Job, fault: str) -> None:
    problem = Problem(RESULT_IS_GONE, f"{fault[:1].upper()}{fault[1:]} Found by `interloc check`; submit it again.")
    job.state = JobState.FAILED
    job.error = problem.document() | {"instance": f"/api/v1/jobs/{job.id}"}
    job.version += 1


def _check_folders(context: Context, *, repair: bool) -> Iterator[Discrepancy]:
    """Find what belongs to no row."""
    storage = context.storage
    for key in sorted(unknown_folders(context)):
        message = "no row knows this folder. `interloc adopt` makes a row for it."
        moved = dict(set_unknown_aside(context, only=key)) if repair else {}
        yield Discrepancy("folder-unknown", key, message, f"moved to {moved[key]}" if key in moved else None)
    lost = storage.folder(LOST)
    for path in sorted(lost.glob("*/*")):
        key = path.relative_to(storage.root).as_posix()
        yield Discrepancy("lost", key, "a folder that no row knows. `interloc adopt` makes a row for it, or remove it.")
    for path, kind, id_ in half_purged(context):
        message = f"the deletion of {kind[:-1]} {id_} has begun and not ended. A running server completes it."
        key = path.relative_to(storage.root).as_posix()
        yield Discrepancy("purge", key, message, "completed" if repair else None)
    if repair:
        finish_purges(context)
    left = dead(storage.folder(INCOMING))
    for path in left:
        message = "what a server was receiving that is dead. The next start of a server removes it."
        yield Discrepancy("incoming", f"{INCOMING}/{path.name}", message, "removed" if repair else None)
    if left and repair:
        remove_incoming(context)
