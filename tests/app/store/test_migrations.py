"""The tables come up to date by themselves, whatever state they are found in."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from sqlalchemy import inspect, text

from app.store import database as module
from app.store.database import Database
from app.store.models import Base, Drive, DriveFile, Job, Token
from interloc.errors import ConfigError, InterLocError
from tests import forks

TABLES = {"alembic_version", "drives", "drive_files", "jobs", "tokens"}
RELEASED = "0006"  # of 0.2.0
BEFORE = "0011"
OLD_DRIVE = """
INSERT INTO drives
(id, name, owner, state, options, keep_raw, file_count, size_bytes, stored_bytes, created_at, touched_at)
VALUES ('d', 'old', 'me', 'ready', '{}', false, 0, 0, 0, 1.5, 2.5)
"""
OLD_JOB = """
INSERT INTO jobs
(id, kind, drive_id, owner, request, name, state, stage, done, version, created_at, attempts, cancel_requested)
VALUES ('a', 'intersections', 'd', 'me', '{"name": "mine"}', 'mine', 'failed', 'finished', 0, 1, 1.5, 1, false)
"""


def config() -> Config:
    made = Config()
    made.set_main_option("script_location", str(Path(module.__file__).parent / "migrations"))
    return made


def migrate(database: Database, revision: str) -> None:
    with database.engine.connect().execution_options(writes=True) as connection, connection.begin():
        made = config()
        made.attributes["connection"] = connection
        command.upgrade(made, revision)


def upgrade(url: str) -> set[str]:
    database = Database(url)
    database.upgrade()
    try:
        return set(inspect(database.engine).get_table_names())
    finally:
        database.close()


def add_drive(database: Database, name: str) -> None:
    with database.writing() as session:
        now = database.clock(session)
        session.add(Drive(name=name, owner="me", created_at=now, touched_at=now))


def names(database: Database) -> set[str]:
    with database.reading() as session:
        return set(session.scalars(text("SELECT name FROM drives")))


def test_an_empty_database_gets_all_tables_and_keeps_them(url: str) -> None:
    assert upgrade(url) >= TABLES
    database = Database(url)
    add_drive(database, "kept")
    database.upgrade()
    assert names(database) == {"kept"}
    database.close()


def test_processes_that_start_together_agree(url: str) -> None:
    with ProcessPoolExecutor(3, mp_context=forks.context) as pool:
        for tables in pool.map(upgrade, [url] * 6):
            assert tables >= TABLES


@pytest.mark.parametrize("revision", [RELEASED, BEFORE])
def test_a_database_of_before_is_brought_up_to_date_with_its_content(revision: str, url: str) -> None:
    database = Database(url)
    migrate(database, revision)
    with database.engine.connect().execution_options(writes=True) as connection, connection.begin():
        connection.execute(text(OLD_DRIVE))
        connection.execute(text(OLD_JOB))
        connection.execute(
            text("INSERT INTO drive_files (drive_id, path, size_bytes, sha256) VALUES ('d', 'A.txt', 1, 'abc')")
        )
        connection.execute(text("INSERT INTO tokens (name, sha256, created_at) VALUES ('alice', 'abc', 1.5)"))
    database.upgrade()
    with database.reading() as session:
        drive = session.get_one(Drive, "d")
        token = session.get_one(Token, "alice")
        assert session.get_one(Job, "a").name == "mine"
        assert session.get_one(DriveFile, ("d", "A.txt")).folded is None
    assert (token.scope, token.expires_at, token.max_bytes, token.max_jobs) == ("write", None, None, None)
    assert (drive.name, drive.created_at) == ("old", 1.5)
    database.close()


@pytest.mark.parametrize("how", [Database.upgrade, partial(migrate, revision="head")], ids=["new", "migrated"])
def test_models_and_migrations_describe_the_same_tables(how: Callable[[Database], None], url: str) -> None:
    database = Database(url)
    how(database)
    with database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, Base.metadata) == []
    database.close()


@pytest.mark.parametrize(("revision", "message"), [("9999", "a newer version of InterLoc"), ("0003", "is too old")])
def test_a_database_of_another_version_is_left_alone(revision: str, message: str, url: str) -> None:
    database = Database(url)
    database.upgrade()
    add_drive(database, "kept")
    with database.writing() as session:
        session.execute(text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})
    with pytest.raises(InterLocError, match=message) as refusal:
        database.upgrade()
    assert repr(revision) in str(refusal.value)
    assert names(database) == {"kept"}
    database.close()


def test_a_file_that_is_no_database_is_named(tmp_path: Path) -> None:
    (tmp_path / "db.sqlite3").write_bytes(b"not a database at all" * 100)
    with pytest.raises(InterLocError, match=r"db\.sqlite3 cannot be reached .*: file is not a database"):
        upgrade(f"sqlite:///{tmp_path / 'db.sqlite3'}")


def test_tables_of_something_else_are_left_alone(url: str) -> None:
    database = Database(url)
    with database.writing() as session:
        session.execute(text("CREATE TABLE jobs (letter VARCHAR(1))"))
    with pytest.raises(InterLocError, match=r"\bjobs\b.* already exists"):
        database.upgrade()
    assert set(inspect(database.engine).get_table_names()) == {"jobs"}  # not one of ours
    database.close()


@pytest.mark.parametrize("other", ["", "here.sqlite3", "mysql://host/x", "http://host", "oracle://x"])
def test_other_databases_are_refused(other: str) -> None:
    with pytest.raises(ConfigError, match="SQLite and PostgreSQL can be used"):
        Database(other)


def test_passwords_are_not_shown() -> None:
    with pytest.raises(InterLocError) as refusal:
        Database("postgres://me:geheim@127.0.0.1:1/x").upgrade()
    assert "geheim" not in str(refusal.value)
    assert "\n" not in str(refusal.value)
