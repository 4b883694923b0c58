"""What the service survives: `make torture`.

Real servers on this machine, on SQLite, on PostgreSQL, and on PostgreSQL with a Dask cluster, and clients that upload
drives (file by file, as archives, by `interloc push`, live), commit them, have them worked on, are told of it, delete
them, take them out of the trash, put them into maps and take them out again, and make backups.

`kill -9` of servers, workers, clients and backups, of the scheduler of Dask, and of the database (SQLite: locked by
somebody else; PostgreSQL: connections cut, or one of its processes killed), at random moments, and of servers that make
a map, have a live session, or are calling a subscriber. Every file and job that was acknowledged is in a ledger. After
each kill: how long until every job goes on; nothing in the ledger is lost, no job is there twice, results are, byte by
byte, those of an undisturbed run, subscribers are told, and `interloc admin check` finds nothing but files of uploads
that were never acknowledged. Then a backup, made while the clients go on, is restored into the other kind of database,
checked and compared with the ledger.

Runs for an hour with the default of 500 kills; `--kills`, `--minutes`, `--seed` and `--on` choose another course.
"""

import argparse
import os
import random
import shutil
import signal
import sqlite3
import statistics
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path

import psycopg
from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from app.context import Context
from app.settings import Settings
from app.store.models import Job
from app.upkeep.backup import BackupRecord, back_up, restore
from app.upkeep.check import Discrepancy, check
from tests import forks
from tests.app.postgres import new_database
from tests.app.processes import kill_if_there, wait_until
from tests.app.street import write_street
from tests.performance.fleet import Backups, Client, Cluster, Fleet, Ledger, clients, undisturbed
from tests.performance.shared import Row, show

SCANS = 40
PAUSE_S = 3.0  # between two kills, on average: long enough for work to get on, short enough to meet every moment of it
KINDS = ("sqlite", "postgresql", "dask")  # of which the last has its rows in PostgreSQL
MENDED_S = 30.0  # time for a server, or the next backup, to remove what one that was killed has left


def look_through(fleet: Fleet, ledger: Ledger, where: str) -> None:
    """Write into the ledger what is not as it was acknowledged, and what `interloc admin check` goes on finding."""
    with closing(Context.open(fleet.settings())) as context:
        ledger.compare_files(context, ledger.snapshot(), where)
        jobs = dict(ledger.jobs)
        with context.database.reading() as session:
            there = Counter(session.scalars(select(Job.drive_id).where(Job.kind == "intersections")))
        for job, drive in jobs.items():
            if there[drive] != 1 and job in ledger.jobs:
                ledger.faults["lost" if not there[drive] else "double"].append(f"{where}: job {job}")
        end = time.monotonic() + MENDED_S
        while (found := _checked(context, ledger)) and time.monotonic() < end:  # what a running server is just mending
            time.sleep(0.2)
        ledger.faults["findings"] += [f"{where}: {each}" for each in found]
        ledger.done["checks"] += 1


def _checked(context: Context, ledger: Ledger) -> list[Discrepancy | str]:
    """What is wrong, but for what the order of writing allows: uploads that were cut off leave a file without a row."""
    try:
        return [each for each in check(context) if not _was_cut_off(each, ledger)]
    except SQLAlchemyError as error:  # of a database that was just killed
        return [f"the check itself: {error}"]


def _was_cut_off(found: Discrepancy, ledger: Ledger) -> bool:
    drive, _, path = found.place.removeprefix("drives/").partition("/files/")
    is_acknowledged = path in ledger.files.get(drive, {})
    return found.kind == "file-unlisted" or (found.kind == "file-differs" and not is_acknowledged)


class Killer:
    """Kills at random moments, and measures how long it takes until all goes on."""

    def __init__(
        self, fleet: Fleet, living: list[Client], backups: Backups, ledger: Ledger, rng: random.Random
    ) -> None:
        self._fleet = fleet
        self._ledger = ledger
        self._living = living
        self._backups = backups
        self._rng = rng
        self._targets: dict[str, Callable[[], bool]] = {
            "server": self._kill_server,
            "worker": self._kill_worker,
            "client": self._kill_client,
            "backup": self._kill_backup,
            "database": self._kill_database,
            "scheduler": self._kill_scheduler,
            "server that makes a map": partial(self._kill_while, "map"),
            "server of a live session": partial(self._kill_while, "live"),
            "server that calls": self._kill_caller,
        }
        self._weights = [4, 3, 2, 2, 2, 0 if fleet.cluster is None else 1, 2, 2, 2]
        self.recovered_s: dict[str, list[float]] = defaultdict(list)

    def kill_one(self) -> str:
        """Kill something, and wait until all goes on; returns what it was."""
        while True:
            time.sleep(min(self._rng.expovariate(1 / PAUSE_S), 5 * PAUSE_S))
            (target,) = self._rng.choices(list(self._targets), weights=self._weights)
            held, began = self._leases(), time.monotonic()
            if self._targets[target]():
                break
        wait_until(lambda: self._goes_on(held), f"all to go on after the kill of a {target}", every_s=0.05)
        self.recovered_s[target].append(time.monotonic() - began)
        return target

    def _kill_server(self) -> bool:
        number = self._rng.randrange(len(self._fleet.servers))
        self._fleet.servers[number].kill()
        time.sleep(self._rng.choice([0, 0, 1.0]))
        self._fleet.restart(number)
        return True

    def _kill_while(self, what: str) -> bool:
        """Kill a server while a client waits for a map, or drives."""
        time.sleep(self._rng.uniform(0, 0.5))
        return self._ledger.doing[what] > 0 and self._kill_server()

    def _kill_caller(self) -> bool:
        """Kill a server that is telling a subscriber of a job."""
        return self._ledger.receiver.is_called.wait(1.0) and self._kill_server()

    def _kill_worker(self) -> bool:
        workers = [worker for server in self._fleet.servers for worker in server.workers()]
        if self._fleet.cluster is not None:
            workers = self._fleet.cluster.workers()
        if workers:
            kill_if_there(self._rng.choice(workers))
        return bool(workers)

    def _kill_scheduler(self) -> bool:
        assert self._fleet.cluster is not None
        self._fleet.cluster.scheduler().kill()
        return True

    def _kill_client(self) -> bool:
        pushes = [client.process for client in self._living if client.process and client.process.is_alive()]
        if pushes:
            self._rng.choice(pushes).kill()
        return bool(pushes)

    def _kill_backup(self) -> bool:
        return self._backups.kill()

    def _kill_database(self) -> bool:
        url = self._fleet.database_url
        if url is None:
            lock = sqlite3.connect(self._fleet.data / "interloc.sqlite3", timeout=30, isolation_level=None)
            lock.execute("BEGIN EXCLUSIVE")
            time.sleep(self._rng.uniform(0.1, 3.0))
            lock.close()
            return True
        with psycopg.connect(url.replace("+psycopg", ""), autocommit=True) as connection:
            others = "FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"
            if self._rng.random() < 0.5:
                connection.execute(f"SELECT pg_terminate_backend(pid) {others}")
                return True
            pids = [row[0] for row in connection.execute(f"SELECT pid {others}")]
        with suppress(ProcessLookupError, IndexError):
            os.kill(self._rng.choice(pids), signal.SIGKILL)  # PostgreSQL then restarts as after a crash
        return bool(pids)

    def _leases(self) -> dict[str, float]:
        """Who works on what, and until when."""
        end = time.monotonic() + 30
        while True:
            try:
                return self._look()
            except (sqlite3.Error, psycopg.Error):
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)

    def _look(self) -> dict[str, float]:
        query = "SELECT lease_owner, lease_until FROM jobs WHERE state = 'running' AND lease_owner IS NOT NULL"
        url = self._fleet.database_url
        if url is None:
            with closing(sqlite3.connect(self._fleet.data / "interloc.sqlite3", timeout=30)) as connection:
                return dict(connection.execute(query).fetchall())
        with psycopg.connect(url.replace("+psycopg", "")) as database:
            return dict(database.execute(query).fetchall())

    def _goes_on(self, held: dict[str, float]) -> bool:
        """Whether every job that was held is held by somebody who renews it, or by nobody any more."""
        now = self._leases()
        return self._fleet.is_ready() and all(now[lease] > until for lease, until in held.items() if lease in now)


Rows = Iterator[Row]


def measure(folder: Path, street: Path, reference: dict[str, str], options: argparse.Namespace) -> Rows:
    for kind in options.on:
        ledger, kills = Ledger(), options.kills // len(options.on)
        end = time.monotonic() + 60 * options.minutes / len(options.on)
        with ExitStack() as stack:
            url = None if kind == "sqlite" else stack.enter_context(new_database())
            cluster = Cluster(folder / "cluster") if kind == "dask" else None
            if cluster is not None:
                stack.callback(cluster.close)
            fleet = Fleet(folder / kind, url, cluster=cluster)
            stack.callback(fleet.close)
            backups = Backups(fleet, folder / kind / "backup", ledger)
            with clients(fleet, ledger, street, reference, f"{options.seed}-{kind}") as living:
                killer = Killer(fleet, living, backups, ledger, random.Random(f"{options.seed}-{kind}"))  # noqa: S311
                for number in range(kills):
                    if time.monotonic() > end:
                        break
                    target = killer.kill_one()
                    look_through(fleet, ledger, f"kill {number + 1}, of a {target}")
                    sys.stderr.write(f"{kind}: {number + 1} of {kills} kills: {target}\n")
                backups.stop()
                known = ledger.snapshot()
                ledger.faults["backup"] += _back_up(fleet, backups.out.with_name("last")).missing
            ledger.compare_told()
            look_through(fleet, ledger, "at the end")
            other = stack.enter_context(new_database()) if url is None else None
            _restore(folder / kind / "restored", backups.out.with_name("last"), other, known, ledger)
        for target, seconds in killer.recovered_s.items():
            times = f"{min(seconds):.1f} / {statistics.median(seconds):.1f} / {max(seconds):.1f} s"
            yield f"{kind}: kills of a {target}", f"{len(seconds)}; all went on after {times} (min/median/max)"
        yield from _told(kind, ledger)


def _told(kind: str, ledger: Ledger) -> Rows:
    yield f"{kind}: done meanwhile", ", ".join(f"{count} {what}" for what, count in sorted(ledger.done.items()))
    names = dict.fromkeys(["findings", "lost", "double", "unequal", "untold", *ledger.faults])
    yield f"{kind}: faults", ", ".join(f"{len(ledger.faults[name])} {name}" for name in names)
    for name in names:
        for fault in ledger.faults[name][:5]:
            yield f"  {name}", fault


def _back_up(fleet: Fleet, out: Path) -> BackupRecord:
    with closing(Context.open(fleet.settings())) as context:
        return back_up(context, out, lambda *_: None)


def _restore(data: Path, backup: Path, url: str | None, known: dict[str, dict[str, str]], ledger: Ledger) -> None:
    settings = Settings(data_dir=data, database_url=url, min_free_bytes=0)
    restore(settings, backup, lambda *_: None)
    with closing(Context.open(settings)) as context:
        ledger.faults["findings"] += [f"{data.name}: {each}" for each in check(context)]
        ledger.compare_files(context, known, data.name)
    shutil.rmtree(data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=500, help="as many on each kind of service")
    parser.add_argument("--on", nargs="+", choices=KINDS, default=list(KINDS), help="kinds of service")
    parser.add_argument("--minutes", type=float, default=180.0, help="after which no further kill begins")
    parser.add_argument("--seed", default=f"{random.SystemRandom().getrandbits(32):x}")
    options = parser.parse_args()
    show([("seed", options.seed)])
    forks.begin()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        street = write_street(folder / "street", SCANS)
        show(measure(folder, street, undisturbed(folder / "undisturbed", street), options))


if __name__ == "__main__":
    main()
