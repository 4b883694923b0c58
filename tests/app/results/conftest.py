"""Jobs that have ended, put into a data folder as the runner leaves them: for tests of what comes after."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy.orm import Session

from app.ogc.index import write_job_rows
from app.ogc.work import rows_of
from app.store.database import Database
from app.store.models import Drive, Job
from interloc.config import preset
from interloc.drives.open import open_drive
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.osm.reader import read_osm
from interloc.output.write import write_results
from interloc.pipeline import detect
from interloc.reduction.reduce import reduce_drive
from tests.app.conftest import client_of, database_of
from tests.app.processes import API
from tests.app.street import write_street
from tests.once import once

SCANS = 40


def work(root: Path, out: Path, *, preset_name: str = "default", scored: bool = True) -> None:
    """Do by the library what a job does."""
    result = detect(open_drive(root), preset(preset_name))
    write_results(result, out)
    if scored:
        graph = read_osm(root / "map.osm")
        write_report(evaluate(result, graph), out)


@dataclass(frozen=True)
class Finished:
    """A server whose data folder holds jobs that have ended.

    Attributes
    ----------
    results : Path
        Result folders by the names of the jobs, as the command line writes them.
    """

    client: httpx.Client
    data_dir: Path
    results: Path

    def get(self, address: str, **options: Any) -> httpx.Response:
        """Ask for something below /api/v1."""
        return self.client.get(f"{API}{address}", **options)

    @contextmanager
    def changing(self) -> Iterator[Session]:
        """Change the rows."""
        with database_of(self.data_dir) as database, database.writing() as session:
            yield session

    @contextmanager
    def older(self) -> Iterator[Path]:
        """Add a job `older` of the street that was not scored, for a while; yields the folder of its result."""
        with database_of(self.data_dir) as database:
            add_job(database, self.data_dir, "older", "street", self.results / "plain")
        try:
            yield self.data_dir / "jobs/older/result"
        finally:
            with self.changing() as session:
                session.delete(session.get_one(Job, "older"))
            shutil.rmtree(self.data_dir / "jobs/older")


def add_drive(database: Database, data_dir: Path, name: str, root: Path) -> None:
    """Register a drive that is ready; its id is its name."""
    reduced = data_dir / f"drives/{name}/reduced"
    reduced.parent.mkdir(parents=True)
    reduce_drive(root, reduced)
    with database.writing() as session:
        now = database.clock(session)
        session.add(
            Drive(id=name, name=f"Straße {name}", owner="anonymous", state="ready", created_at=now, touched_at=now)
        )


def add_job(database: Database, data_dir: Path, name: str, drive: str, result: Path | None, **columns: Any) -> None:
    """Register a job, successful unless said otherwise; its id is its name."""
    config = preset(columns.pop("preset_name", "default")).model_dump(mode="json")
    with database.writing() as session:
        values: dict[str, Any] = {"kind": "intersections", "state": "successful", "owner": "anonymous", **columns}
        session.add(
            Job(id=name, drive_id=drive, request={"config": config}, created_at=database.clock(session), **values)
        )
    if result is not None:
        shutil.copytree(result, data_dir / f"jobs/{name}/result")
        with database.writing() as session:
            write_job_rows(session, session.get_one(Job, name), rows_of(result))


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Result folders: default and paper of a street with its map, plain without, local without georeference."""
    return once(tmp_path_factory, "results", make_results)


def make_results(root: Path) -> None:
    street = write_street(root / "street", SCANS)
    local = root / "unplaced"
    shutil.copytree(street, local, ignore=shutil.ignore_patterns("geo.csv", "map.osm"))
    work(street, root / "default")
    work(street, root / "paper", preset_name="paper")
    work(street, root / "plain", scored=False)
    work(local, root / "local", scored=False)


@pytest.fixture(scope="module")
def finished(results: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Finished]:
    """A server with those jobs, and some that are not successful. Shared by a module."""
    data_dir = tmp_path_factory.mktemp("data")
    with client_of(data_dir) as client:
        with database_of(data_dir) as database:
            for drive, folder in (("street", "street"), ("local", "unplaced"), ("other", "street")):
                add_drive(database, data_dir, drive, results / folder)
            for job, drive in (("default", "street"), ("paper", "street"), ("plain", "street"), ("local", "local")):
                add_job(
                    database, data_dir, job, drive, results / job, preset_name="paper" if job == "paper" else "default"
                )
            add_job(database, data_dir, "elsewhere", "other", results / "default")
            add_job(database, data_dir, "failed", "street", None, state="failed")
            add_job(database, data_dir, "cancelled", "street", None, state="dismissed")
            add_job(database, data_dir, "upload", "street", None, kind="commit")
            add_job(database, data_dir, "lost", "street", None)
        yield Finished(client, data_dir, results)
