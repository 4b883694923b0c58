"""Keeps maps up to date: what the end of a job, a drive put in or taken out, or a verdict has changed is done anew.

Nothing is queued. Again and again the rows say what a map should hold and what it holds; where that differs, a worker
does the rest, and the rows are written with its outcome in one transaction. Whatever is killed in between is found
again: nothing is lost, and nothing is done twice.
"""

import logging
import secrets
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar

from sqlalchemy import or_, select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context, Helper
from app.jobs.failures import limit_reached, problem_of
from app.jobs.processes import WorkerLimitError
from app.jobs.queue import FAR_S
from app.jobs.runner import Runner
from app.maps import work
from app.maps.records import Standing, map_key, standings_of
from app.maps.work import Audited, Merged, Source
from app.ogc.index import write_map_rows
from app.store.models import CityMap, Drive, MapDrive
from interloc.errors import InterLocError, OutputError

_LOOK_S = 5.0  # in which what another server changed is found, and files that are gone
_HOLD_S = 1.0  # in which a lease is renewed, and what was left is tried again
_AGAIN_S = 5.0
_OWNER = "maps"
_log = logging.getLogger(__name__)
Outcome = TypeVar("Outcome")


class _LostError(Exception):
    """The lease is lost, or the server stops."""


class Merger(Helper):
    """Brings maps up to date, one after the other; one that is at work when it stops is done again later."""

    def __init__(self, context: Context, runner: Runner) -> None:
        super().__init__("maps", context.maps_changed)
        self._context = context
        self._runner = runner
        self._lease = secrets.token_hex(8)

    def run(self) -> None:
        """Do so."""
        is_behind = True
        while not self.stopping.is_set():
            self._context.maps_changed.wait(_HOLD_S if is_behind else _LOOK_S)
            self._context.maps_changed.clear()
            with suppress(SQLAlchemyError, OSError):  # the database and the disk are told of elsewhere
                is_behind = self._look()

    def _look(self) -> bool:
        """Bring up to date what is not; return whether anything was not."""
        with self._context.database.reading() as session:
            cities = session.scalars(select(CityMap).order_by(CityMap.created_at)).all()
            standings = standings_of(session, self._context, cities)
        waiting = [city for city in cities if standings[city.id].is_waiting(city)]
        for city in waiting:
            if self.stopping.is_set():
                break
            bring = self._merge if standings[city.id].is_stale else self._audit
            try:
                bring(city, standings[city.id])
            except _LostError:
                pass
            except SQLAlchemyError as error:
                _log.warning("map %s: not brought up to date, tried again: %s", city.id, error)
            except Exception as error:  # noqa: BLE001 - the others go on
                _log.exception("map %s: not brought up to date, tried again later", city.id)
                problem = problem_of(error, "the map", 1).detail.replace(f"{self._context.storage.root}/", "")
                self._end(city.id, partial(_leave, problem=problem))
                self.stopping.wait(_AGAIN_S)
        return bool(waiting)

    def _merge(self, city: CityMap, standing: Standing) -> None:
        storage = self._context.storage
        with self._context.database.reading() as session:
            named = select(Drive.id, Drive.name).where(Drive.id.in_([job.drive_id for job in standing.jobs]))
            names: dict[str, str] = dict(session.execute(named).all())
        label_of = _labels(standing, names)
        wanted = {label_of[j.drive_id]: Source(j.id, storage.folder(f"jobs/{j.id}/result")) for j in standing.jobs}
        merged = self._work(city, work.merge, storage.folder(map_key(city.id)), wanted, bool(standing.osm))

        def write(session: Session, row: CityMap) -> None:
            _write_rows(session, city.id, standing, label_of, merged)
            write_map_rows(session, city.id, merged.layers)
            row.revision, row.summary = row.revision + 1, merged.record
            if not standing.osm:
                row.audit = row.audited = None
            row.merged_at = self._context.database.clock(session)

        self._end(city.id, write)
        _log.info("map %s: %d drives merged, %d refused", city.id, len(wanted), len(merged.problems))

    def _audit(self, city: CityMap, standing: Standing) -> None:
        files = {
            path: [label for drive in drives if (label := standing.rows[drive].label)]
            for path, drives in standing.osm.items()
        }
        folder = self._context.storage.folder(map_key(city.id))
        outcome: Audited | Exception
        try:
            outcome = self._work(city, work.audit, folder, files, standing.wrong)
        except OutputError:  # the disk is at fault: it is tried again
            raise
        except InterLocError as error:  # the file is at fault: tried again when something changes
            outcome = error
        except WorkerLimitError as error:
            outcome = Exception(limit_reached(error, "the comparison", "job_stage_s").detail)

        def write(session: Session, row: CityMap) -> None:
            row.audited = standing.audit_key
            if isinstance(outcome, Audited):
                row.audit = outcome.record
                write_map_rows(session, city.id, outcome.layers)
            else:
                text = str(outcome).replace(f"{folder}/osm/", "").replace(f"{self._context.storage.root}/", "")
                row.audit = (row.audit or {}) | {"problem": text}

        self._end(city.id, write)

    def _work(self, city: CityMap, function: Callable[..., Outcome], *args: Any) -> Outcome:  # noqa: ANN401
        """Call a function in a worker under a lease of the map."""
        if not self._hold(city.id):
            raise _LostError
        seconds = self._context.settings.job_stage_s
        future: Future[Outcome] = self._runner.submit(function, *args, client=_OWNER, seconds=seconds)
        while not wait({future}, timeout=_HOLD_S).done:
            if self.stopping.is_set():
                future.cancel()
                self._end(city.id, _leave)
                raise _LostError
            if not self._hold(city.id):
                future.cancel()
                future.add_done_callback(lambda _: self._end(city.id, None))  # the worker may write until then
                raise _LostError
        return future.result()

    def _hold(self, map_id: str) -> bool:
        """Take the lease of a map, or keep it; return whether no other server has it."""
        database = self._context.database
        with database.writing(patient=True) as session:
            now = database.clock(session)
            is_over = or_(CityMap.lease_until.is_(None), CityMap.lease_until < now, CityMap.lease_until > now + FAR_S)
            is_free = or_(is_over, CityMap.lease_owner == self._lease)
            held = {"lease_owner": self._lease, "lease_until": now + self._context.settings.lease_s}
            found = session.execute(update(CityMap).where(CityMap.id == map_id, is_free).values(**held))
            return bool(found.rowcount)  # type: ignore[attr-defined]

    def _end(self, map_id: str, write: Callable[[Session, CityMap], None] | None) -> None:
        """Write an outcome and give the lease back, where this server still has it."""
        with self._context.database.writing(patient=True) as session:
            row = session.get(CityMap, map_id, with_for_update=True)
            if row is None:  # it was deleted meanwhile, and its folder may have come again
                self._context.storage.delete(map_key(map_id))
            if row is None or row.lease_owner != self._lease:
                return
            row.lease_owner = row.lease_until = None
            if write is not None:
                write(session, row)
        if write is not None:
            self._context.maps_changed.set()  # what comes next: a merged map is audited


def _leave(_session: Session, row: CityMap, problem: str | None = None) -> None:
    """Have a map made anew: a worker that failed, or goes on, may leave another one in its folder than the rows say."""
    row.lease_until = 0.0
    if problem is not None:
        row.audit = (row.audit or {}) | {"problem": f"{problem} It is tried again."}


def _labels(standing: Standing, names: dict[str, str]) -> dict[str, str]:
    """Return the names of drives on the map: that of the drive, and its id where another one has that name."""
    label_of = {
        j.drive_id: label for j in standing.jobs if (row := standing.rows.get(j.drive_id)) and (label := row.label)
    }
    taken = set(label_of.values())
    for job in standing.jobs:
        if job.drive_id not in label_of:
            name = names.get(job.drive_id, job.drive_id)
            label_of[job.drive_id] = name if name not in taken else f"{name} {job.drive_id}"
            taken.add(label_of[job.drive_id])
    return label_of


def _write_rows(session: Session, map_id: str, standing: Standing, label_of: dict[str, str], merged: Merged) -> None:
    """Write which results a map holds."""
    job_of = {job.drive_id: job for job in standing.jobs}
    for drive_id in standing.rows.keys() | job_of.keys():
        row = session.get(MapDrive, (map_id, drive_id))
        job = job_of.get(drive_id)
        if row is None and job is None:
            continue
        if row is None:
            row = MapDrive(map_id=map_id, drive_id=drive_id)
            session.add(row)
        row.job_id = None if job is None else job.id
        row.label = None if job is None else label_of[drive_id]
        row.problem = None if row.label is None else merged.problems.get(row.label)
        if job is None and row.is_member is None:
            session.delete(row)
