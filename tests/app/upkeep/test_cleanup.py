"""Clean-up: what nobody needs goes, what somebody needs stays."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import update

from app.context import Context
from app.drives.commit import finish_drive
from app.drives.records import find_drive, list_drives
from app.jobs.queue import submit
from app.settings import Settings
from app.store.models import Drive, Job
from app.store.storage import LEFT_ALONE_S
from app.trash.deletion import list_trash, restore
from app.upkeep import cleanup
from app.upkeep.cleanup import sweep
from app.work.requests import CommitOutcome
from interloc.drives.inspect import DriveReport
from tests.app.conftest import new_drive, opened
from tests.app.processes import wait_until

HOUR_S = 3600.0


@pytest.fixture
def context(url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Context]:
    """A service that is not running, whose uploads expire after 2 hours."""
    monkeypatch.setattr(Settings, "upload_expires_h", 2.0)
    with opened(tmp_path / "data", database_url=url) as context:
        yield context


def make_drive(context: Context, *, age_h: float = 0, state: str = "uploading", keep_raw: bool = False) -> str:
    """Make a drive of one scan and a map that was touched some hours ago."""
    drive = new_drive(context, {"velodyne/000000.bin": b"1", "map.osm": b"1"}, keep_raw=keep_raw)
    with context.database.writing() as session:
        touched = context.database.clock(session) - age_h * HOUR_S
        session.execute(update(Drive).where(Drive.id == drive).values(touched_at=touched, state=state))
    return drive


def unpack(context: Context, drive: str, archive: str) -> None:
    with context.database.writing() as session:
        request = {"archive": archive}
        submit(session, context.database, kind="unpack", drive_id=drive, owner="somebody", request=request)


def make_old(path: Path) -> Path:
    """Make a file that was last changed before all of this."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"1")
    old = time.time() - LEFT_ALONE_S - 60
    os.utime(path, (old, old))
    return path


def drives(context: Context) -> set[str]:
    return {drive.id for drive in list_drives(context, None, 100).drives}


def test_uploads_that_were_left_alone_expire(context: Context) -> None:
    fresh, old = make_drive(context, age_h=1.9), make_drive(context, age_h=2.1)
    assert sweep(context)["expired"] == 1
    assert drives(context) == {fresh}
    (item,) = list_trash(context, None, 10).items
    assert (item.id, item.deleted_by) == (old, None)
    assert context.storage.folder(f"drives/{old}/files/velodyne/000000.bin").is_file()
    restore(context, old)
    assert sweep(context)["expired"] == 0  # its time begins anew
    assert drives(context) == {fresh, old}
    assert context.storage.folder(f"drives/{fresh}/files/velodyne/000000.bin").is_file()


def test_drives_in_use_do_not_expire(context: Context) -> None:
    ready, checking = make_drive(context, age_h=99, state="ready"), make_drive(context, age_h=99, state="checking")
    unpacking = make_drive(context, age_h=99)
    unpack(context, unpacking, "archives/1")
    with_result = make_drive(context, age_h=99)
    with context.database.writing() as session:
        common = {"drive_id": with_result, "owner": "somebody", "request": {}, "kind": "intersections"}
        session.add(Job(**common, state="successful", created_at=1.0))
    assert sweep(context)["expired"] == 0
    assert drives(context) == {ready, checking, unpacking, with_result}


def test_stale_pieces_of_uploads_go(context: Context) -> None:
    """Those of servers that were killed; what is being received stays."""
    incoming = context.storage.folder("incoming")
    os.utime(make_old(incoming / "dead/old").parent, (0, 0))
    make_old(incoming / "alive/old")
    assert sweep(context)["incoming"] == 1
    assert [path.name for path in incoming.iterdir()] == ["alive"]


def test_only_empty_folders_that_no_row_knows_go(context: Context) -> None:
    """What holds files or a result stays, as where an older database was brought back."""
    known = make_drive(context)
    os.utime(context.storage.folder(f"drives/{known}"), (0, 0))
    empty, young, full = "jobs/0123456789abcdef", "drives/fedcba9876543210", ("drives/1", "jobs/2")
    for key, name in ((empty, "scratch"), (young, ""), (full[0], "files"), (full[1], "result")):
        (context.storage.folder(key) / name).mkdir(parents=True)
        if key != young:
            os.utime(context.storage.folder(key), (0, 0))
    assert sweep(context, by_age=False)["unknown"] == 0
    assert sweep(context)["unknown"] == 1
    there = [context.storage.folder(key).exists() for key in (empty, young, *full, f"drives/{known}")]
    assert there == [False, True, True, True, True]


@pytest.mark.parametrize("keep_raw", [False, True])
def test_raw_scans_of_a_ready_drive_go_even_after_a_crash(context: Context, *, keep_raw: bool) -> None:
    drive = make_drive(context, state="ready", keep_raw=keep_raw)
    context.storage.folder(f"drives/{drive}/reduced").mkdir()
    for _ in range(2):
        sweep(context)
        files = context.storage.folder(f"drives/{drive}/files")
        left = sorted(path.relative_to(files).as_posix() for path in files.rglob("*") if path.is_file())
        assert left == (["map.osm", "velodyne/000000.bin"] if keep_raw else ["map.osm"])


def test_raw_scans_go_once_all_else_is_on_disk(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a power cut could leave neither them nor what was made of them."""
    drive = make_drive(context, state="ready")
    context.storage.folder(f"drives/{drive}/reduced").mkdir()
    scan = context.storage.folder(f"drives/{drive}/files/velodyne/000000.bin")
    seen = []
    monkeypatch.setattr(os, "sync", lambda: seen.append(scan.is_file()))
    for _ in range(2):  # nothing is left to wait for the second time
        sweep(context)
    assert seen == [True]
    assert not scan.exists()


def test_the_end_of_a_commit_is_written_again_where_the_database_failed(context: Context) -> None:
    drive = make_drive(context, state="checking")
    with context.database.writing() as session:
        work = {"options": {}, "keep_raw": False}
        job, _ = submit(session, context.database, kind="commit", drive_id=drive, owner="somebody", request=work)
    built = context.storage.folder(f"jobs/{job.id}/result/reduced")
    built.mkdir(parents=True)
    (built / "reduced.json").write_bytes(b"{}")
    outcome = CommitOutcome(ok=True, reduced_bytes=2, report=DriveReport(path="town", name="town"))

    def end(*, fails: bool) -> None:
        with context.database.writing() as session:
            finish_drive(session, context, session.merge(job), outcome)
            if fails:
                raise ConnectionError

    with pytest.raises(ConnectionError):
        end(fails=True)
    end(fails=False)
    with context.database.reading() as session:
        assert find_drive(session, drive).state == "ready"
    assert context.storage.folder(f"drives/{drive}/reduced/reduced.json").read_bytes() == b"{}"
    assert not context.storage.folder(f"drives/{drive}/files/velodyne").exists()


def test_raw_scans_stay_where_nothing_replaces_them(context: Context, caplog: pytest.LogCaptureFixture) -> None:
    drive = make_drive(context, state="ready")
    sweep(context)
    assert context.storage.folder(f"drives/{drive}/files/velodyne/000000.bin").is_file()
    assert "its reduced folder is not there" in caplog.text


def test_nothing_goes_for_its_age_within_the_first_hour(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    swept: list[bool] = []
    monkeypatch.setattr(cleanup, "sweep", lambda _, by_age: swept.append(by_age))
    monkeypatch.setattr(cleanup, "PERIOD_S", 0.0)
    monkeypatch.setattr(cleanup, "_USES_S", 0.01)
    sweeper = cleanup.Sweeper(context)
    sweeper.start()
    wait_until(lambda: len(swept) > 2, "three sweeps")
    sweeper.stop()
    assert swept[:3] == [False, True, True]
