"""The data folder under a running server: where it goes, nothing is acknowledged until it is back."""

import shutil
from pathlib import Path

import pytest

from app.store.storage import DataFolderGoneError
from tests.app.conftest import Serve, opened
from tests.app.processes import API


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
