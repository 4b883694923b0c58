"""The tables come up to date by themselves, whatever state they are found in."""

from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import inspect, text

from app.store.database import Database
from app.store.models import Base, Drive, DriveFile, Job, Token
from interloc.errors import ConfigError, InterLocError
from tests import forks
from tests.app.store.test_database import add_drive, names

TABLES = {"alembic_version", "drives", "drive_files", "jobs", "tokens"}
RELEASED = Path(__file__).parent / "version_0_2_0.sql"


def restore_released(database: Database) -> None:
    """Make the tables of version 0.2.0, each with a row."""
    execute(database, RELEASED.read_text())


def execute(database: Database, statements: str) -> None:
    with database.engine.connect().execution_options(writes=True) as connection, connection.begin():
        for statement in statements.split(";\n"):
            if statement.strip():
                connection.exec_driver_sql(statement)


def upgrade(url: str) -> set[str]:
    with closing(Database(url)) as database:
        database.upgrade()
        return set(inspect(database.engine).get_table_names())


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


def test_a_database_of_the_version_before_is_brought_up_to_date_with_its_content(url: str) -> None:
    database = Database(url)
    restore_released(database)
    database.upgrade()
    with database.reading() as session:
        drive = session.get_one(Drive, "d")
        token = session.get_one(Token, "alice")
        assert session.get_one(Job, "a").name == "mine"
        assert session.get_one(DriveFile, ("d", "A.txt")).size_bytes
    assert (token.scope, token.expires_at, token.max_bytes, token.max_jobs) == ("write", None, None, None)
    assert (drive.name, drive.created_at) == ("old", 1.5)
    with database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, Base.metadata) == []
    database.close()


@pytest.mark.parametrize(("revision", "message"), [("9999", "a newer version of InterLoc"), ("0003", "is too old")])
@pytest.mark.usefixtures("url")
def test_a_database_of_another_version_is_left_alone(revision: str, message: str, database: Database) -> None:
    add_drive(database, "kept")
    with database.writing() as session:
        session.execute(text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})
    with pytest.raises(InterLocError, match=message) as refusal:
        database.upgrade()
    assert repr(revision) in str(refusal.value)
    assert names(database) == {"kept"}


def test_a_file_that_is_no_database_is_named(tmp_path: Path) -> None:
    (tmp_path / "db.sqlite3").write_bytes(b"not a database at all" * 100)
    with pytest.raises(InterLocError, match=r"db\.sqlite3 cannot be reached .*: file is not a database"):
        upgrade(f"sqlite:///{tmp_path / 'db.sqlite3'}")


def test_tables_of_something_else_are_left_alone(url: str) -> None:
    database = Database(url)
    with database.writing() as session:
        session.execute(text("CREATE TABLE jobs (letter VARCHAR(1))"))
    with pytest.raises(InterLocError, match="that InterLoc has not made"):
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
