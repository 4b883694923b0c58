"""Database and data folder belong together, or nothing starts; and nothing is changed by a start that is refused."""

import os
import shutil
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import inspect

from app.context import open_database
from app.settings import Settings
from app.store.database import Database
from app.store.installation import InstallationError, id_of_database, id_of_folder
from app.store.models import Drive
from app.store.storage import DataFolderGoneError
from interloc.cli.main import run
from tests import forks
from tests.app.conftest import Serve, new_drive, opened
from tests.app.processes import API, Command


def settings(data: Path, url: str | None = None) -> Settings:
    return Settings(data_dir=data, database_url=url, min_free_bytes=0)


def sqlite(path: Path) -> str:
    return f"sqlite:///{path}"


def fill(data: Path, url: str | None = None) -> str:
    """Make a service that holds a drive with a file; returns the id of the drive."""
    with opened(data, database_url=url) as context:
        return new_drive(context, {"velodyne/000000.bin": b"scan"})


def contents(folder: Path) -> dict[str, bytes]:
    """All files of a folder, but those of its database."""
    files = [path for path in folder.rglob("*") if path.is_file() and ".sqlite3" not in path.name]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def refuse(data: Path, url: str | None = None) -> str:
    """Try to start on a folder; returns why that is refused. Nothing has changed then."""
    before = contents(data)
    with pytest.raises(InstallationError) as refusal:
        open_database(settings(data, url))
    assert contents(data) == before
    message = str(refusal.value)
    assert "Nothing was changed" in message
    assert "interloc admin restore" in message
    assert str(data.resolve()) in message
    assert "\n" not in message
    return message


def test_a_service_that_is_new_gets_an_id_and_opens_again(tmp_path: Path, url: str) -> None:
    for _ in range(2):
        database = open_database(settings(tmp_path / "data", url))
        with database.reading() as session:
            assert id_of_database(session) == id_of_folder(tmp_path / "data")
        database.close()


def test_another_database_is_refused(tmp_path: Path, url: str) -> None:
    """Moved to PostgreSQL by setting its address, or a typo in the address."""
    drive = fill(tmp_path / "data")
    message = refuse(tmp_path / "data", url)
    assert f"(id {id_of_folder(tmp_path / 'data')}" in message
    assert "INTERLOC_DATABASE_URL was changed or mistyped" in message
    assert "db.sqlite3" in message or "postgresql" in message
    database = Database(url)
    assert inspect(database.engine).get_table_names() == []  # not even tables were made
    database.close()
    with opened(tmp_path / "data") as context, context.database.reading() as session:  # set back: all is there
        assert session.get(Drive, drive) is not None


def test_a_database_file_that_was_removed_is_not_made_anew(tmp_path: Path) -> None:
    """Corrupt, as an operator finds it, and taken away."""
    fill(tmp_path / "data")
    for path in (tmp_path / "data").glob("interloc.sqlite3*"):
        path.unlink()
    assert "the database was lost" in refuse(tmp_path / "data")
    assert not list((tmp_path / "data").glob("interloc.sqlite3*"))
    (tmp_path / "data/interloc.sqlite3").touch()  # as a version before would have made it
    assert "the database was lost" in refuse(tmp_path / "data")


def test_a_volume_that_is_not_mounted_is_noticed(tmp_path: Path, url: str) -> None:
    fill(tmp_path / "data", url)
    shutil.move(tmp_path / "data", tmp_path / "volume")
    message = refuse(tmp_path / "data", url)
    assert ", 1 drives and 0 jobs)" in message
    assert "is not mounted" in message
    assert "geheim" not in message
    shutil.rmtree(tmp_path / "data")
    shutil.move(tmp_path / "volume", tmp_path / "data")
    open_database(settings(tmp_path / "data", url)).close()


def test_two_services_cannot_have_one_folder(tmp_path: Path, url: str) -> None:
    fill(tmp_path / "one")
    fill(tmp_path / "two", url)
    ids = id_of_folder(tmp_path / "one"), id_of_folder(tmp_path / "two")
    message = refuse(tmp_path / "one", url)
    assert all(str(id_) in message for id_ in ids)


def test_a_first_start_that_was_cut_short_is_done_again(tmp_path: Path, url: str) -> None:
    database = open_database(settings(tmp_path / "data", url))
    with database.reading() as session:
        made = id_of_database(session)
    database.close()
    (tmp_path / "data/installation").unlink()
    open_database(settings(tmp_path / "data", url)).close()
    assert id_of_folder(tmp_path / "data") == made


def starts(data: Path, url: str) -> bool:
    """Try to start; return whether that is possible."""
    try:
        open_database(settings(data, url)).close()
    except InstallationError:
        return False
    return True


def test_services_that_start_together_on_one_folder_do_not_both_get_it(tmp_path: Path) -> None:
    urls = [sqlite(tmp_path / f"{number}.sqlite3") for number in range(6)]
    with ProcessPoolExecutor(3, mp_context=forks.context) as pool:  # Alembic has one state for a process
        assert sum(pool.map(starts, [tmp_path / "data"] * 6, urls)) == 1


def test_a_file_that_is_no_id_is_named(tmp_path: Path) -> None:
    fill(tmp_path / "data")
    (tmp_path / "data/installation").write_text("nonsense\n")
    with pytest.raises(InstallationError, match="id nonsense"):
        open_database(settings(tmp_path / "data"))


def test_the_command_line_says_it_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(tmp_path / "data")
    (tmp_path / "data/interloc.sqlite3").unlink()
    for arguments in (["admin", "token", "list"], ["admin", "trash", "list"]):
        assert run([*arguments, "--data-dir", str(tmp_path / "data")]) == 2
        said = capsys.readouterr().err
        assert said.startswith("interloc: the data folder")
        assert said.count("\n") == 1
    out, err = tmp_path / "out", tmp_path / "err"
    server = Command(["serve", "--port", 0, "--data-dir", tmp_path / "data"], os.environ, out, err)
    assert server.ended() == (2, "", said)


@pytest.mark.parametrize("instead", ["nothing", "an empty folder", "a copy"])
def test_nothing_is_acknowledged_while_the_data_folder_is_elsewhere(serve: Serve, tmp_path: Path, instead: str) -> None:
    client = serve()
    data, moved = tmp_path / "data", tmp_path / "moved"
    drive = client.post(f"{API}/drives", json={"name": "town"}).json()["id"]
    files = f"{API}/drives/{drive}/files"
    assert client.put(f"{files}/poses.txt", content=b"1").status_code == 201
    data.rename(moved)
    if instead == "an empty folder":
        data.mkdir()
    elif instead == "a copy":
        shutil.copytree(moved, data)
    before = sorted(data.rglob("*"))
    for answer in (
        client.put(f"{files}/times.txt", content=b"0"),
        client.post(f"{API}/drives", json={"name": "other"}),
        client.post(f"{API}/drives/{drive}/archive", content=b"PK\x03\x04"),
        client.delete(f"{files}/poses.txt"),
        client.get(f"{files}/poses.txt"),
    ):
        assert (answer.status_code, answer.json()["type"]) == (503, "/problems/data-folder-gone"), answer.text
        assert answer.headers["retry-after"] == "5"
        assert str(tmp_path) not in answer.text
    ready = client.get("/readyz")
    assert (ready.status_code, client.get("/healthz").status_code) == (503, 200)
    assert "is not where it was" in ready.json()["reasons"]["disk"]
    assert sorted(data.rglob("*")) == before
    if data.exists():
        shutil.rmtree(data)
    moved.rename(data)
    assert client.get("/readyz").json() == {"ready": True, "reasons": {}}
    assert client.put(f"{files}/times.txt", content=b"0").status_code == 201
    assert [each["path"] for each in client.get(files).json()["files"]] == ["poses.txt", "times.txt"]


def test_a_folder_that_goes_while_a_transaction_writes_is_noticed(tmp_path: Path) -> None:
    with opened(tmp_path / "data") as context:
        with pytest.raises(DataFolderGoneError), context.database.writing():
            (tmp_path / "data").rename(tmp_path / "moved")
        (tmp_path / "moved").rename(tmp_path / "data")
        with context.database.writing():
            pass


def test_no_new_database_is_made_in_the_place_of_one_that_is_gone(tmp_path: Path) -> None:
    with opened(tmp_path / "data") as context:
        context.database.close()  # all connections: the next one is new
        (tmp_path / "data").rename(tmp_path / "moved")
        (tmp_path / "data").mkdir()
        with pytest.raises(Exception, match="unable to open database file"), context.database.reading() as session:
            session.connection()
        assert list((tmp_path / "data").iterdir()) == []
