"""A server that is killed between a file and its row: afterwards list, bytes and digests agree, and nothing is lost."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from sqlalchemy import update

from app.context import Context
from app.drives.models import NewDrive
from app.drives.reconcile import reconcile, reconcile_all
from app.drives.records import create_drive, list_drives
from app.drives.upload import keep
from app.http.intake import Intake
from app.http.problems import Problem
from app.jobs.queue import submit
from app.settings import Settings
from app.store.models import Drive, DriveFile
from tests.app import kills
from tests.app.street import write_street

API = "/api/v1"
OLD, NEW = b"of before", b"of afterwards, and longer"

Serve = Callable[..., httpx.Client]


@pytest.fixture
def context(url: str, tmp_path: Path) -> Iterator[Context]:
    """A service that is not running."""
    opened = Context.open(Settings(data_dir=tmp_path / "data", database_url=url, min_free_bytes=0))
    yield opened
    opened.close()


def put(context: Context, drive: str, **files: bytes) -> None:
    """Upload files; two underscores in a name stand for a slash."""
    for name, content in files.items():
        intake = Intake(context, name.replace("__", "/"), 1000)
        intake.write(content)
        keep(context, drive, [intake.finish()])


def new_drive(context: Context, **files: bytes) -> str:
    drive = create_drive(context, "somebody", NewDrive(name="town"))[0].id
    put(context, drive, **files)
    return drive


def listed(context: Context, drive: str) -> dict[str, tuple[int, str]]:
    with context.database.reading() as session:
        rows = session.query(DriveFile).where(DriveFile.drive_id == drive)
        return {row.path: (row.size_bytes, row.sha256) for row in rows}


def counted(context: Context, drive: str) -> tuple[int, int, int]:
    with context.database.reading() as session:
        row = session.get_one(Drive, drive)
        return row.file_count, row.size_bytes, row.stored_bytes


def files_of(context: Context, drive: str) -> Path:
    return context.storage.folder(f"drives/{drive}/files")


def as_listed(content: bytes) -> tuple[int, str]:
    return len(content), hashlib.sha256(content).hexdigest()


def shown(client: httpx.Client, drive: str) -> dict[str, tuple[int, str]]:
    """The files of a drive as clients see them; what is listed can be fetched, and is what the list says."""
    rows = client.get(f"{API}/drives/{drive}/files").raise_for_status().json()["files"]
    for row in rows:
        got = client.get(f"{API}/drives/{drive}/files/{row['path']}").raise_for_status()
        assert as_listed(got.content) == (row["size_bytes"], row["sha256"])
        assert got.headers["etag"] == f'"{row["sha256"]}"'
    told = client.get(f"{API}/drives/{drive}").json()
    assert (told["files"], told["size_bytes"]) == (len(rows), sum(row["size_bytes"] for row in rows))
    return {row["path"]: (row["size_bytes"], row["sha256"]) for row in rows}


@pytest.fixture
def begun(tmp_path: Path) -> tuple[Path, str]:
    """A data folder with a drive of one file, and the id of the drive; no server runs."""
    opened = Context.open(Settings(data_dir=tmp_path / "data"))
    drive = new_drive(opened, poses=OLD)
    opened.close()
    return tmp_path / "data", drive


def test_a_new_file_that_was_not_acknowledged_is_listed_as_it_is(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    kills.killed(kills.put, data, drive, "velodyne/000000.bin", NEW)
    assert (data / f"drives/{drive}/files/velodyne/000000.bin").read_bytes() == NEW
    assert shown(serve(data), drive) == {"poses": as_listed(OLD), "velodyne/000000.bin": as_listed(NEW)}


@pytest.mark.parametrize("new", [NEW, OLD[::-1]], ids=["of another size", "of the same size"])
def test_a_file_that_was_being_replaced_is_listed_as_it_is(begun: tuple[Path, str], serve: Serve, new: bytes) -> None:
    data, drive = begun
    kills.killed(kills.put, data, drive, "poses", new)
    assert shown(serve(data), drive) == {"poses": as_listed(new)}


def test_a_file_that_was_being_deleted_is_not_listed(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    kills.killed(kills.remove_file, data, drive, "poses")
    client = serve(data)
    assert shown(client, drive) == {}
    assert client.put(f"{API}/drives/{drive}/files/poses", content=NEW).status_code == 201  # a client sends it again
    assert shown(client, drive) == {"poses": as_listed(NEW)}


def test_what_a_dead_server_was_receiving_goes_and_what_a_living_one_receives_stays(
    begun: tuple[Path, str], serve: Serve
) -> None:
    data, drive = begun
    living = Context.open(Settings(data_dir=data))
    intake = Intake(living, "velodyne/000001.bin", 1000)
    intake.write(NEW)
    kills.killed(kills.receive, data, OLD)
    assert len(list((data / "incoming").iterdir())) == 2
    client = serve(data)
    with living.database.reading() as session:
        assert session.get(Drive, drive) is not None
    keep(living, drive, [intake.finish()])
    living.close()
    assert shown(client, drive) == {"poses": as_listed(OLD), "velodyne/000001.bin": as_listed(NEW)}


def test_a_drive_is_checked_as_it_is_listed(begun: tuple[Path, str], serve: Serve, tmp_path: Path) -> None:
    """A file that came past the service, while it runs: the next commit lists it."""
    data, drive = begun
    client = serve(data)
    files = data / f"drives/{drive}/files"
    shutil.copytree(write_street(tmp_path / "street", 3), files, dirs_exist_ok=True)
    (files / "poses").unlink()
    answer = client.post(f"{API}/drives/{drive}/commit", headers={"Prefer": "wait=120"})
    assert (answer.status_code, answer.json()["state"]) == (200, "ready"), answer.text
    paths = {row["path"] for row in client.get(f"{API}/drives/{drive}/files").json()["files"]}
    assert {"poses.txt", "velodyne/000002.bin", "map.osm"} <= paths
    assert "poses" not in paths


def test_a_file_that_is_missing_is_not_said_to_be_reduced(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    client = serve(data)
    (data / f"drives/{drive}/files/poses").unlink()
    answer = client.get(f"{API}/drives/{drive}/files/poses")
    assert (answer.status_code, answer.json()["title"]) == (410, "File missing")
    assert "interloc check" in answer.json()["detail"]


def test_rows_follow_files_whatever_differs(context: Context) -> None:
    drive = new_drive(context, same=b"1", gone=b"22", grown=b"333", changed=b"4444", touched=b"55555")
    files = files_of(context, drive)
    (files / "gone").unlink()
    (files / "grown").write_bytes(b"333333")
    (files / "changed").write_bytes(b"xxxx")
    os.utime(files / "changed", ns=(1, 1))
    os.utime(files / "touched", ns=(2, 2))
    (files / "deep").mkdir()
    (files / "deep/new").write_bytes(b"7")
    (files / ".hidden").write_bytes(b"cannot be named")
    (files / "link").symlink_to(files / "same")
    corrections = reconcile(context, drive)
    assert corrections == {"gone": "unlisted", "grown": "renewed", "changed": "renewed", "deep/new": "listed"}
    contents = {"same": b"1", "grown": b"333333", "changed": b"xxxx", "touched": b"55555", "deep/new": b"7"}
    assert listed(context, drive) == {path: as_listed(content) for path, content in contents.items()}
    assert counted(context, drive) == (5, 17, 17)
    assert reconcile(context, drive) == {}


def test_a_file_that_is_listed_anew_still_keeps_similar_names_out(context: Context) -> None:
    drive = new_drive(context, Map=b"1")
    (files_of(context, drive) / "Map").write_bytes(b"22")
    assert [*reconcile(context, drive).values()] == ["renewed"]
    with pytest.raises(Problem, match="Map differ only in upper and lower case"):
        put(context, drive, map=b"3")


def test_rows_of_an_older_version_are_compared_by_size(context: Context) -> None:
    drive = new_drive(context, poses=b"1")
    with context.database.writing() as session:
        session.execute(update(DriveFile).values(mtime_ns=None))
    assert reconcile(context, drive) == {}
    (files_of(context, drive) / "poses").write_bytes(b"22")
    assert [*reconcile(context, drive).values()] == ["renewed"]


@pytest.mark.parametrize("keep_raw", [False, True])
def test_a_ready_drive_lists_what_was_reduced_but_no_map_that_is_gone(context: Context, *, keep_raw: bool) -> None:
    drive = new_drive(context, velodyne__0=b"scan")
    put(context, drive, **{"map.osm": b"22", "gone.osm.gz": b"333"})
    files = files_of(context, drive)
    (files / "velodyne/0").unlink()
    (files / "gone.osm.gz").unlink()
    (files / "new.OSM.PBF").write_bytes(b"4444")
    with context.database.writing() as session:
        session.execute(update(Drive).values(state="ready", keep_raw=keep_raw, stored_bytes=100))
    corrections = reconcile(context, drive, maps_only=True)
    assert corrections == {"new.OSM.PBF": "listed"}
    found = reconcile(context, drive)
    assert found == {"gone.osm.gz": "unlisted"} | ({"velodyne/0": "unlisted"} if keep_raw else {})
    kept = 100 - 3 + 4 - (4 if keep_raw else 0)
    assert counted(context, drive)[2] == kept


def test_a_start_leaves_drives_alone_whose_archive_is_still_to_be_unpacked(context: Context) -> None:
    """The job places its files once more, all or none."""
    open_, unpacking = new_drive(context), new_drive(context)
    with context.database.writing() as session:
        work = {"archive": "archives/1"}
        submit(session, context.database, kind="unpack", drive_id=unpacking, owner="somebody", request=work)
    for drive in (open_, unpacking):
        files_of(context, drive).mkdir()
        (files_of(context, drive) / "poses.txt").write_bytes(b"1")
    reconcile_all(context)
    assert (list(listed(context, open_)), list(listed(context, unpacking))) == (["poses.txt"], [])
    assert {each.files for each in list_drives(context, None, 10).drives} == {0, 1}


def test_only_drives_that_are_there_are_compared(context: Context) -> None:
    with pytest.raises(Problem, match="There is no drive 0123"):
        reconcile(context, "0123")


@pytest.mark.parametrize("drives", [1, 2, 10])
def test_a_start_unlists_nothing_that_it_cannot_see_at_large(
    context: Context, caplog: pytest.LogCaptureFixture, drives: int
) -> None:
    """As in a copy of the data folder that is older than what was uploaded."""
    made = [new_drive(context, a=b"1", b=b"2", c=b"3") for _ in range(drives)]
    before = [listed(context, drive) for drive in made]
    for drive in made:
        files = files_of(context, drive)
        for path in [files / "a"] if drives == 10 else [files / "a", files / "b"]:
            path.unlink()
        (files / "d").write_bytes(b"4")
    reconcile_all(context)
    assert [list(listed(context, drive)) for drive in made] == [["a", "b", "c", "d"]] * drives
    assert all(before[i].items() <= listed(context, drive).items() for i, drive in enumerate(made))
    assert "they stay listed" in caplog.text
