"""Backups: what is restored is what was backed up, whatever went on meanwhile, and whatever stopped it."""

import errno
import hashlib
import itertools
import json
import os
import shutil
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import select, text

from app.context import Context
from app.drives.commit import begin_commit
from app.drives.models import CommitRequest
from app.drives.upload import queue_archive
from app.http.intake import Arrival
from app.jobs import queue
from app.settings import Settings
from app.store.database import Database
from app.store.models import Drive, Job
from app.trash.deletion import empty_trash, list_trash
from app.upkeep.backup import DATABASE, RECORD, BackupRecord, back_up, restore
from app.upkeep.check import check
from interloc.errors import ConfigError, InterLocError, OutputError
from tests.app.conftest import client_of, make_drive
from tests.app.kills import die, killed
from tests.app.processes import API, archive_of, ended, files_below, submit, upload
from tests.app.street import write_street
from tests.once import once
from tests.small_drives import write_kitti_raw


@pytest.fixture(scope="module")
def used(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data folder of a service with a scored job, a drive that keeps its scans, and an upload. Shared."""

    def make(data: Path) -> None:
        with client_of(data) as client:
            ready = upload(client, street)
            for osm in ({"file": "map.osm"}, None):
                assert ended(client, submit(client, ready, osm=osm))["state"] == "successful"
            upload(client, street, keep_raw=True)
            begun = make_drive(client).rpartition("/")[2]
            for path in ("poses.txt", "velodyne/000000.bin", "labels/000000.label"):
                put(client, begun, path, (street / path).read_bytes())

    return once(tmp_path_factory, "used", make)


def copy_of(used: Path, target: Path) -> Path:
    """Return a data folder like another one: files by links, the database by a copy."""
    shutil.copytree(used, target, copy_function=os.link)
    for name in ("interloc.sqlite3", "installation"):
        (target / name).unlink()
        shutil.copy(used / name, target / name)
    return target


@pytest.fixture
def data(used: Path, tmp_path: Path) -> Path:
    """A data folder like that, for one test."""
    return copy_of(used, tmp_path / "data")


@pytest.fixture(scope="module")
def told(used: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the API tells of it."""
    return answers(copy_of(used, tmp_path_factory.mktemp("told") / "data"))


def put(client: httpx.Client, drive: str, path: str, content: bytes) -> None:
    client.put(f"{API}/drives/{drive}/files/{path}", content=content).raise_for_status()


def service(data: Path, **settings: Any) -> closing[Context]:
    return closing(Context.open_existing(Settings(data_dir=data, min_free_bytes=0, **settings)))


def make_backup(data: Path, out: Path, **settings: Any) -> BackupRecord:
    with service(data, **settings) as context:
        return back_up(context, out, quietly)


def restore_to(data: Path, backup: Path, **settings: Any) -> BackupRecord:
    record = restore(Settings(data_dir=data, **settings), backup, quietly)
    with service(data, **settings) as context:
        assert check(context) == []
    return record


def quietly(_done: int, _total: int, _name: str) -> None:
    """Report to nobody."""


def contents(folder: Path) -> dict[str, str]:
    """SHA-256 of the files that belong to drives, jobs and maps, by their keys."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for place in (folder / "drives", folder / "jobs", *folder.glob("maps/*/city"), *folder.glob("maps/*/audit"))
        for path in files_below(place)
    }


def answers(data: Path, **settings: Any) -> dict[str, Any]:
    """All that the API tells of drives, files, jobs and results."""
    told: dict[str, Any] = {}
    with client_of(data, **settings) as client:

        def get(path: str) -> Any:
            answer = client.get(f"{API}{path}")
            told[path] = answer.status_code, answer.headers.get("etag"), answer.content
            return answer.json() if answer.headers["content-type"].startswith("application/json") else None

        for drive in get("/drives")["drives"]:
            get(f"/drives/{drive['id']}")
            for file in get(f"/drives/{drive['id']}/files")["files"]:
                get(f"/drives/{drive['id']}/files/{file['path']}")
        for job in get("/jobs?kind=all")["jobs"]:
            get(f"/jobs/{job['id']}")
            if job["kind"] == "intersections":
                for file in get(f"/jobs/{job['id']}/files")["files"]:
                    get(f"/jobs/{job['id']}/files/{file['name']}")
    return {path: without_expiry(*answer) for path, answer in told.items()}


def without_expiry(status: int, etag: str | None, content: bytes) -> tuple[int, str | None, bytes]:
    """An answer without the time at which an upload expires: that begins anew with a restoration."""
    if b'"expires_at"' not in content:
        return status, etag, content
    told = json.loads(content)
    for drive in told.get("drives", [told]):
        drive["expires_at"] = None
    return status, None, json.dumps(told).encode()


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_restored_service_answers_as_before(
    kind: str, request: pytest.FixtureRequest, data: Path, told: dict[str, Any], tmp_path: Path
) -> None:
    """Also where the backup is of SQLite and the restored service uses PostgreSQL."""
    settings = {} if kind == "sqlite" else {"database_url": request.getfixturevalue("postgres_url")}
    record = make_backup(data, tmp_path / "backup")
    assert (record.complete, record.drives, record.missing) == (True, 3, [])
    assert restore_to(tmp_path / "restored", tmp_path / "backup", **settings) == record
    assert (tmp_path / "restored/installation").read_text() == (data / "installation").read_text()
    assert answers(tmp_path / "restored", **settings) == told
    assert sum(path.startswith("/jobs/") and "/files/" in path for path in told) > 10
    make_backup(tmp_path / "restored", tmp_path / "again", **settings)
    restore_to(tmp_path / "back", tmp_path / "again")  # from PostgreSQL to SQLite, too
    assert answers(tmp_path / "back") == told


def test_backups_on_another_disk_are_copies(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, out = os.link, tmp_path / "backup"

    def link(source: Path, target: Path) -> None:
        if Path(target).is_relative_to(out):
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        real(source, target)

    monkeypatch.setattr(os, "link", link)
    assert make_backup(data, out).files == len(contents(out)) == len(contents(data))
    assert all(path.stat().st_nlink == 1 for path in files_below(out / "drives"))
    restore_to(tmp_path / "restored", out)
    assert contents(tmp_path / "restored") == contents(out)


def test_a_backup_on_the_same_disk_takes_no_space_and_stays_as_it_is(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    make_backup(data, out)
    before = contents(out)
    assert all(path.stat().st_nlink > 1 for path in files_below(out / "drives"))
    with client_of(data) as client:
        for drive in client.get(f"{API}/drives").json()["drives"]:
            put(client, drive["id"], "map.osm", b"another map")  # a file that the service replaces
            client.delete(f"{API}/drives/{drive['id']}").raise_for_status()
    assert contents(out) == before


def test_folders_within_a_drive_are_backed_up(tmp_path: Path) -> None:
    data, backup = tmp_path / "data", tmp_path / "backup"
    with client_of(data) as client:
        upload(client, write_kitti_raw(tmp_path / "raw"))
    make_backup(data, backup)
    restore_to(tmp_path / "restored", backup)
    assert "reduced/oxts/data/0000000000.txt" in {key.split("/", 2)[2] for key in contents(data)}
    assert contents(tmp_path / "restored") == contents(data)


def test_what_was_going_on_goes_on_where_it_is_restored(tmp_path: Path) -> None:
    """A commit, an unpacking and a job, each leased to a server that is lost with the machine."""
    data, out, street = tmp_path / "data", tmp_path / "backup", write_street(tmp_path / "street", 30)
    with client_of(data) as client:
        ready = upload(client, street)
        request = ended(client, submit(client, ready, osm={"file": "map.osm"}))["request"]
        checking, unpacking = make_drive(client).rpartition("/")[2], make_drive(client).rpartition("/")[2]
        archive = f"{API}/drives/{checking}/archive"
        client.post(archive, content=archive_of(street), headers={"Prefer": "wait=60"}).raise_for_status()
    with service(data) as context:
        begin_commit(context, checking, "me", CommitRequest())
        packed = context.storage.incoming() / "packed"
        packed.write_bytes(archive_of(street))
        queue_archive(context, unpacking, "me", Arrival("archive", packed, packed.stat().st_size, ""))
        with context.database.writing() as session:
            queue.submit(
                session, context.database, kind="intersections", drive_id=ready, owner="me", request=request, key="k"
            )
        held = queue.JobQueue(context.database, 3600.0)
        assert {claim.job.kind for _ in range(3) if (claim := held.claim())} == {"commit", "unpack", "intersections"}
        assert back_up(context, out, quietly).missing == []
    restore_to(tmp_path / "restored", out)
    with service(tmp_path / "restored") as context, context.database.reading() as session:
        rows = session.scalars(select(Job).where(Job.owner == "me")).all()
        assert [(row.state, row.lease_owner, row.attempts) for row in rows] == [("accepted", None, 0)] * 3
    with client_of(tmp_path / "restored") as client:
        for row in rows:
            assert ended(client, row.id)["state"] == "successful"
            if row.kind == "intersections":
                assert client.get(f"{API}/jobs/{row.id}/report").status_code == 200
        assert client.get(f"{API}/drives/{checking}").json()["state"] == "ready"
        listed = client.get(f"{API}/drives/{unpacking}/files", params={"limit": 1000}).json()["files"]
        assert len(listed) == len(files_below(street))


def die_in_backup(data: Path, out: Path) -> None:
    counted = itertools.count(1)
    with service(data) as context:
        back_up(context, out, lambda *_: die() if next(counted) == 50 else None)


def die_in_restoration(data: Path, backup: Path) -> None:
    counted = itertools.count(1)
    restore(Settings(data_dir=data), backup, lambda *_: die() if next(counted) == 100 else None)


def test_a_killed_backup_is_refused(data: Path, tmp_path: Path) -> None:
    out, restored = tmp_path / "backup", tmp_path / "restored"
    killed(die_in_backup, data, out)
    with pytest.raises(ConfigError, match=r"is not a backup: it has no backup\.json"):
        restore_to(restored, out)
    assert not restored.exists()
    with pytest.raises(ConfigError, match="is not empty"):
        make_backup(data, out)
    make_backup(data, tmp_path / "fresh")
    record = json.loads((tmp_path / "fresh" / RECORD).read_bytes())
    (tmp_path / "fresh" / RECORD).write_text(json.dumps(record | {"complete": False}))  # as versions before did
    with pytest.raises(ConfigError, match=r"was not made to its end\. Make it again"):
        restore_to(restored, tmp_path / "fresh")


def test_no_service_starts_on_what_a_killed_restoration_has_left(data: Path, tmp_path: Path) -> None:
    out, restored = tmp_path / "backup", tmp_path / "restored"
    make_backup(data, out)
    killed(die_in_restoration, restored, out)
    with pytest.raises(ConfigError, match="do not belong together"):
        Context.open(Settings(data_dir=restored))
    with pytest.raises(ConfigError, match="is not empty: it holds drives"):
        restore_to(restored, out)


def test_places_where_no_backup_can_be(data: Path, used: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="lies in the data folder"):
        make_backup(data, data / "backup")
    with pytest.raises(ConfigError, match="holds the data folder"):
        make_backup(data, tmp_path)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(ConfigError, match="is a file"):
        make_backup(data, tmp_path / "file")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/cat.jpg").write_bytes(b"cat")
    with pytest.raises(ConfigError, match=r"holds cat\.jpg; a backup is made in a new folder"):
        make_backup(data, tmp_path / "photos")
    assert [path.name for path in (tmp_path / "photos").iterdir()] == ["cat.jpg"]


def test_places_where_no_backup_is_restored(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    make_backup(data, out)
    with pytest.raises(ConfigError, match=r"is not empty: it holds drives, .* into a new data folder only"):
        restore_to(data, out)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(ConfigError, match="is a file"):
        restore_to(tmp_path / "file", out)
    elsewhere = f"sqlite:///{data / 'interloc.sqlite3'}"
    with pytest.raises(ConfigError, match="is not new: it holds the tables"):
        restore_to(tmp_path / "restored", out, database_url=elsewhere)
    assert not (tmp_path / "restored").exists()


def test_a_damaged_backup_is_refused(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    make_backup(data, out)
    lost = next(path for path in files_below(out / "drives") if path.name == "000000.bin")
    lost.unlink()
    with pytest.raises(ConfigError, match=rf"is not whole: {lost.relative_to(out).as_posix()}\."):
        restore_to(tmp_path / "restored", out)
    assert not (tmp_path / "restored").exists()
    lost.write_bytes(b"")
    next(out.glob("jobs/*/result/roads.geojson")).unlink()
    with pytest.raises(ConfigError, match=r"is not whole: it has [\d,]+ of [\d,]+ files"):
        restore_to(tmp_path / "restored", out)
    (out / DATABASE).unlink()
    with pytest.raises(ConfigError, match=r"it has no backup\.sqlite3"):
        restore_to(tmp_path / "again", out)


def test_a_folder_that_cannot_be_read_ends_a_backup(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def scandir(path: str) -> Any:
        if str(path).endswith("figures"):
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return scan(path)

    scan = os.scandir
    monkeypatch.setattr(os, "scandir", scandir)  # the superuser may read everything
    with pytest.raises(OutputError, match=r"figures could not be read or written: permission denied"):
        make_backup(data, tmp_path / "backup")


def test_a_data_folder_that_is_not_whole_is_backed_up_as_it_is(data: Path, tmp_path: Path) -> None:
    gone, cut = (path for path in files_below(data / "drives") if path.name in {"000001.bin", "000002.bin"})
    gone.unlink()
    cut.unlink()
    cut.write_bytes(b"cut off")
    record = make_backup(data, tmp_path / "backup")
    assert (record.complete, record.missing) == (True, [gone.relative_to(data).as_posix()])
    restore(Settings(data_dir=tmp_path / "restored"), tmp_path / "backup", quietly)
    assert contents(tmp_path / "restored") == contents(data)


def test_what_is_removed_while_a_backup_is_made_is_taken_off_its_rows(data: Path, tmp_path: Path) -> None:
    """The service deletes a drive and replaces a file after the rows were read."""
    out, calls = tmp_path / "backup", itertools.count()
    with client_of(data) as client:
        ids = {drive["state"]: drive["id"] for drive in client.get(f"{API}/drives").json()["drives"]}

        def interfere(_done: int, _total: int, _name: str) -> None:
            if next(calls) == 0:
                client.delete(f"{API}/drives/{ids['ready']}", params={"purge": True}).raise_for_status()
                put(client, ids["uploading"], "velodyne/000000.bin", b"other bytes")

        with service(data) as context:
            record = back_up(context, out, interfere)
    assert (record.complete, record.drives, record.missing) == (True, 2, [])
    assert record.files == len(contents(out))
    restore_to(tmp_path / "restored", out)
    sent = tmp_path / f"restored/drives/{ids['uploading']}/files/velodyne/000000.bin"
    assert sent.read_bytes() == b"other bytes"


def test_the_backup_of_a_later_version_is_left_alone(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    make_backup(data, out)
    database = Database(f"sqlite:///{out / DATABASE}")
    with database.writing() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    database.close()
    with pytest.raises(InterLocError, match=r"backup\.sqlite3, written by InterLoc .* made by a newer version"):
        restore_to(tmp_path / "restored", out)
    assert not (tmp_path / "restored").exists()


def test_times_in_the_trash_and_of_uploads_begin_anew(data: Path, tmp_path: Path) -> None:
    """A backup is often restored for the sake of what was deleted by mistake."""
    with service(data, trash_h=1) as context:
        with context.database.writing() as session:
            (drive,) = session.scalars(select(Drive).where(Drive.state == "uploading"))
            drive.deleted_at = context.database.clock(session) - timedelta(days=30).total_seconds()
            drive.touched_at -= timedelta(days=400).total_seconds()
        back_up(context, tmp_path / "backup", quietly)
    restore_to(tmp_path / "restored", tmp_path / "backup")
    with service(tmp_path / "restored", trash_h=1) as context:
        assert empty_trash(context, older_than_s=3600) == []
        assert [item.id for item in list_trash(context, None, 10).items] == [drive.id]
        with context.database.reading() as session:
            age = context.database.clock(session) - session.get_one(Drive, drive.id).touched_at
    assert age < timedelta(days=1).total_seconds()


def test_a_full_disk_is_named(data: Path, small_disk: Path) -> None:
    with (small_disk / "filler").open("wb") as filler:
        filler.write(bytes(60 * 2**20))
    with pytest.raises(OutputError, match=r"no space left on device.*is of no use: remove it") as failure:
        make_backup(data, small_disk / "backup")
    assert str(small_disk) in str(failure.value)
    assert BackupRecord.read(small_disk / "backup") is None
