"""A server that is killed between a file and its row: what was acknowledged is there, what was not is left out."""

import hashlib
from pathlib import Path

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from app.drives.models import NewDrive
from app.drives.records import create_drive, files_key
from app.http.intake import Intake, Placement
from tests.app import kills
from tests.app.conftest import Serve, keep_file, opened
from tests.app.processes import API

OLD, NEW = b"of before", b"of afterwards, and longer"


def shown(client: httpx.Client, drive: str) -> dict[str, bytes]:
    """The files of a drive as clients see them; what is listed can be fetched, and is what the list says."""
    found = {}
    for row in client.get(f"{API}/drives/{drive}/files").raise_for_status().json()["files"]:
        got = client.get(f"{API}/drives/{drive}/files/{row['path']}").raise_for_status()
        assert (row["size_bytes"], row["sha256"]) == (len(got.content), hashlib.sha256(got.content).hexdigest())
        found[row["path"]] = got.content
    told = client.get(f"{API}/drives/{drive}").json()
    assert (told["files"], told["size_bytes"]) == (len(found), sum(map(len, found.values())))
    return found


@pytest.fixture
def begun(tmp_path: Path) -> tuple[Path, str]:
    """A data folder with a drive of one file, and the id of the drive; no server runs."""
    with opened(tmp_path / "data") as context:
        drive = create_drive(context, "somebody", NewDrive(name="town"))[0].id
        keep_file(context, drive, "poses.txt", OLD)
    return tmp_path / "data", drive


def test_a_new_file_that_was_not_acknowledged_goes_with_the_commit(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    files = data / f"drives/{drive}/files"
    kills.killed(kills.put, data, drive, "velodyne/000000.bin", NEW)
    assert (files / "velodyne/000000.bin").read_bytes() == NEW
    client = serve(data)
    assert shown(client, drive) == {"poses.txt": OLD}
    assert client.put(f"{API}/drives/{drive}/files/velodyne/000001.bin", content=NEW).status_code == 201
    assert client.post(f"{API}/drives/{drive}/commit", headers={"Prefer": "wait=60"}).status_code == 422
    assert shown(client, drive) == {"poses.txt": OLD, "velodyne/000001.bin": NEW}
    assert not (files / "velodyne/000000.bin").exists()


@pytest.mark.parametrize("new", [NEW, OLD[::-1]], ids=["of another size", "of the same size"])
def test_a_file_that_was_being_replaced_is_to_be_sent_again(begun: tuple[Path, str], serve: Serve, new: bytes) -> None:
    data, drive = begun
    kills.killed(kills.put, data, drive, "poses.txt", new)
    client = serve(data)
    (listed,) = client.get(f"{API}/drives/{drive}/files").json()["files"]
    assert listed["sha256"] == hashlib.sha256(OLD).hexdigest()  # by which whoever resumes sends it again
    assert client.put(f"{API}/drives/{drive}/files/poses.txt", content=new).status_code == 200
    assert shown(client, drive) == {"poses.txt": new}


def test_a_file_that_was_being_deleted_is_still_there(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    kills.killed(kills.remove_file, data, drive, "poses.txt")
    client = serve(data)
    assert shown(client, drive) == {"poses.txt": OLD}
    assert client.delete(f"{API}/drives/{drive}/files/poses.txt").status_code == 204
    assert shown(client, drive) == {}


def test_a_database_that_goes_away_at_the_end_leaves_no_row_without_its_file(begun: tuple[Path, str]) -> None:
    """Whether it has committed is not known: the file stays."""
    data, drive = begun
    with opened(data) as context:
        place = context.storage.folder(f"drives/{drive}/files/a.txt")

        def place_and_fail(*, is_gone: bool) -> None:
            with Placement(context.storage, files_key(drive)) as placement:
                placement.move([Intake(context, "a.txt", 1000).finish()])
                raise OperationalError("COMMIT", {}, Exception("closed"), connection_invalidated=is_gone)

        for is_gone in (True, False):
            with pytest.raises(OperationalError):
                place_and_fail(is_gone=is_gone)
            assert place.exists() is is_gone
            place.unlink(missing_ok=True)


def test_a_file_that_is_missing_is_told_where_it_is_asked_for(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    client = serve(data)
    (data / f"drives/{drive}/files/poses.txt").unlink()
    answer = client.get(f"{API}/drives/{drive}/files/poses.txt")
    assert (answer.status_code, answer.json()["title"]) == (410, "File missing")
    assert "interloc admin check" in answer.json()["detail"]
    answer = client.post(f"{API}/drives/{drive}/commit", headers={"Prefer": "wait=60"})
    assert (answer.status_code, answer.json()["detail"].split(":")[0]) == (422, "poses.txt")
    assert client.delete(f"{API}/drives/{drive}/files/poses.txt").status_code == 204
