"""Check finds each kind of damage, says where, repairs what can be repaired, and is content afterwards."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import update

from app.context import Context
from app.drives.models import NewDrive
from app.drives.records import create_drive, list_files
from app.drives.upload import keep
from app.http.intake import Intake
from app.settings import Settings
from app.store import sidecars
from app.store.models import Drive, DriveFile, Job
from app.trash import deletion as trash
from app.upkeep.check import Discrepancy, check
from interloc.output.layout import RUN_FILE
from interloc.reduction.reduce import reduce_drive
from tests.app import kills
from tests.app.street import write_street


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of five scans, as a commit reduces it."""
    root = tmp_path_factory.mktemp("drives")
    reduce_drive(write_street(root / "street", 5), root / "reduced", keyframes=None)
    return root / "reduced"


@pytest.fixture
def context(tmp_path: Path) -> Iterator[Context]:
    """A service that is not running."""
    opened = Context.open(Settings(data_dir=tmp_path / "data", min_free_bytes=0))
    yield opened
    opened.close()


def new_drive(context: Context, **files: bytes) -> str:
    drive = create_drive(context, "somebody", NewDrive(name="town"))[0].id
    for path, content in files.items():
        intake = Intake(context, path, 1000)
        intake.write(content)
        keep(context, drive, [intake.finish()])
    return drive


def ready_drive(context: Context, street: Path, *, keep_raw: bool = False) -> str:
    """A drive as a commit leaves it: raw files listed, reduced scans, a map."""
    drive = new_drive(context, **{"poses.txt": b"raw", "map.osm": b"map"})
    folder = context.storage.folder(f"drives/{drive}")
    shutil.copytree(street, folder / "reduced")
    (folder / "trajectory.geojson").write_text("{}")
    if not keep_raw:
        (folder / "files/poses.txt").unlink()
    with context.database.writing() as session:
        session.execute(update(Drive).where(Drive.id == drive).values(state="ready", keep_raw=keep_raw))
        row = session.get_one(Drive, drive)
    sidecars.write(context.storage, row)
    return drive


def finished_job(context: Context, drive: str) -> str:
    with context.database.writing() as session:
        values = {"kind": "intersections", "state": "successful", "summary": {}, "created_at": 1.0, "finished_at": 2.0}
        job = Job(drive_id=drive, owner="somebody", request={}, **values)
        session.add(job)
    folder = context.storage.folder(f"jobs/{job.id}")
    (folder / "result").mkdir(parents=True)
    (folder / "result" / RUN_FILE).write_text("{}")
    sidecars.write(context.storage, job)
    return job.id


def kinds(found: list[Discrepancy]) -> list[tuple[str, str]]:
    return sorted((each.kind, each.place) for each in found)


def repaired(context: Context, **options: Any) -> list[tuple[str, str]]:
    """What is found; all of it is repaired, and nothing is found any more."""
    found = check(context, **options)
    assert [each.repair for each in found] == [None] * len(found)
    told = check(context, repair=True, **options)
    assert kinds(told) == kinds(found)
    assert all(each.repair for each in told), told
    assert check(context) == []
    return kinds(found)


def test_nothing_is_found_where_nothing_is_wrong(context: Context, street: Path) -> None:
    new_drive(context)
    drive = new_drive(context, **{"poses.txt": b"1", "a": b""})
    for keep_raw in (False, True):
        finished_job(context, ready_drive(context, street, keep_raw=keep_raw))
    trash.delete_drive(context, drive, "somebody")
    steps: list[tuple[int, int]] = []
    assert check(context, progress=lambda done, total, _: steps.append((done, total))) == []
    assert steps == [(number, 6) for number in range(6)]


def test_files_that_are_not_as_their_rows_say(context: Context) -> None:
    drive = new_drive(context, gone=b"1", grown=b"22", same=b"333")
    files = context.storage.folder(f"drives/{drive}/files")
    (files / "gone").unlink()
    (files / "grown").write_bytes(b"2222")
    (files / "new").write_bytes(b"4")
    place = f"drives/{drive}/files"
    expected = [
        ("file-differs", f"{place}/grown"),
        ("file-missing", f"{place}/gone"),
        ("file-unlisted", f"{place}/new"),
    ]
    assert repaired(context, quick=True) == expected
    assert [file.path for file in list_files(context, drive, None, 10).files] == ["grown", "new", "same"]


def damage(path: Path) -> None:
    """Change a byte as a bad disk does: size and time stay the same."""
    stat = path.stat()
    path.write_bytes(b"X" + path.read_bytes()[1:])
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def test_bytes_that_a_bad_disk_has_changed(context: Context, street: Path) -> None:
    open_, ready = new_drive(context, **{"poses.txt": b"1"}), ready_drive(context, street)
    damage(context.storage.folder(f"drives/{open_}/files/poses.txt"))
    damage(context.storage.folder(f"drives/{ready}/files/map.osm"))
    assert check(context, quick=True) == []
    found = {each.place: each for each in check(context, repair=True)}
    assert {each.kind for each in found.values()} == {"file-damaged"}
    assert found[f"drives/{open_}/files/poses.txt"].repair == "it is listed with its digest: send it again"
    assert found[f"drives/{ready}/files/map.osm"].repair is None  # only a backup helps
    assert [each.place for each in check(context)] == [f"drives/{ready}/files/map.osm"]


@pytest.mark.parametrize("what", ["folder", "manifest", "scan", "broken scan", "trajectory"])
def test_a_ready_drive_that_is_damaged_is_opened_again(context: Context, street: Path, what: str) -> None:
    drive = ready_drive(context, street)
    job = finished_job(context, drive)
    reduced = context.storage.folder(f"drives/{drive}/reduced")
    scan = sorted(reduced.rglob("*.ground"))[2]
    name = {
        "manifest": "/reduced.json",
        "scan": f"/{scan.relative_to(reduced)}",
        "broken scan": f"/{scan.relative_to(reduced)}",
    }
    if what == "folder":
        shutil.rmtree(reduced)
    elif what == "manifest":
        (reduced / "reduced.json").write_text("{")
    elif what == "scan":
        scan.unlink()
    elif what == "broken scan":
        scan.write_bytes(scan.read_bytes()[:-5])
        assert check(context, quick=True) == []
    else:
        (reduced.parent / "trajectory.geojson").unlink()
    assert repaired(context) == [("reduced", f"drives/{drive}/reduced{name.get(what, '')}")]
    with context.database.reading() as session:
        row = session.get_one(Drive, drive)
        assert session.get_one(Job, job).state == "successful"
    assert row.state == "uploading"
    assert row.report is not None
    assert row.report["problems"][0]["severity"] == "error"
    assert str(context.storage.root) not in json.dumps(row.report)
    assert [file.path for file in list_files(context, drive, None, 10).files] == ["map.osm"]  # the rest is to be sent


def test_raw_files_that_should_have_been_kept(context: Context, street: Path) -> None:
    drive = ready_drive(context, street, keep_raw=True)
    context.storage.folder(f"drives/{drive}/files/poses.txt").unlink()
    assert repaired(context) == [("file-missing", f"drives/{drive}/files/poses.txt")]


def test_totals_that_are_not_those_of_the_files(context: Context) -> None:
    drive = new_drive(context, a=b"22", b=b"333")
    with context.database.writing() as session:
        session.execute(update(Drive).values(file_count=7))
    assert repaired(context) == [("count", f"drives/{drive}")]


def test_a_drive_that_waits_for_no_job(context: Context) -> None:
    drive = new_drive(context)
    with context.database.writing() as session:
        session.execute(update(Drive).values(state="checking"))
    assert repaired(context) == [("drive-waits", f"drives/{drive}")]


@pytest.mark.parametrize("left", [None, b"", b"[]"])
def test_a_job_whose_result_is_gone_fails(context: Context, left: bytes | None) -> None:
    job = finished_job(context, new_drive(context))
    run = context.storage.folder(f"jobs/{job}/result/{RUN_FILE}")
    run.unlink() if left is None else run.write_bytes(left)
    assert repaired(context) == [("result", f"jobs/{job}/result")]
    with context.database.reading() as session:
        row = session.get_one(Job, job)
    assert (row.state, row.error and row.error["title"]) == ("failed", "Result is gone")


def test_a_result_that_is_back_makes_its_job_successful_again(context: Context) -> None:
    job = finished_job(context, new_drive(context))
    result = context.storage.folder(f"jobs/{job}/result")
    result.rename(result.with_name("away"))
    assert repaired(context) == [("result", f"jobs/{job}/result")]
    result.with_name("away").rename(result)
    assert repaired(context) == [("result", f"jobs/{job}/result")]
    with context.database.reading() as session:
        row = session.get_one(Job, job)
    assert (row.state, row.error) == ("successful", None)


def test_no_job_fails_where_all_results_are_away(context: Context) -> None:
    drive = new_drive(context)
    jobs = [finished_job(context, drive) for _ in range(2)]
    root = context.storage.folder("jobs")
    root.rename(root.with_name("away"))
    found = check(context, repair=True)
    assert [(each.kind, each.repair) for each in found] == [("result", None)] * 2
    assert "No job has its result" in found[0].message
    root.with_name("away").rename(root)
    assert check(context) == []
    with context.database.reading() as session:
        assert {session.get_one(Job, job).state for job in jobs} == {"successful"}


def test_sidecars_are_written_anew(context: Context) -> None:
    drive = new_drive(context)
    job = finished_job(context, drive)
    context.storage.folder(f"drives/{drive}/drive.json").unlink()
    context.storage.folder(f"jobs/{job}/job.json").write_text("{")
    assert repaired(context) == [("sidecar", f"drives/{drive}/drive.json"), ("sidecar", f"jobs/{job}/job.json")]


def test_folders_that_no_row_knows_are_set_aside_and_told_until_they_are_adopted(context: Context) -> None:
    for key in ("drives/0123456789abcdef", "jobs/0123456789abcdef"):
        context.storage.folder(key).mkdir(parents=True)
        (context.storage.folder(key) / "file").write_bytes(b"1")
    expected = [("folder-unknown", f"{kind}/0123456789abcdef") for kind in ("drives", "jobs")]
    assert kinds(check(context)) == expected
    told = check(context, repair=True)
    assert kinds(told)[:2] == expected
    lost = [("lost", f"lost+found/{kind}/0123456789abcdef") for kind in ("drives", "jobs")]
    assert kinds(check(context)) == lost
    assert len(list(context.storage.folder("lost+found").rglob("file"))) == 2


def test_what_killed_servers_leave_is_found_and_tidied(context: Context) -> None:
    data = context.storage.root
    drive = new_drive(context, a=b"1")
    trash.delete_drive(context, drive, "somebody")
    kills.killed(kills.purge_before_the_bytes, data, drive)
    kills.killed(kills.receive, data, b"half")
    (found,) = [place for kind, place in repaired(context) if kind == "incoming"]
    assert not (data / found).exists()
    assert not list((data / "trash").iterdir())


def test_damage_in_the_trash_is_told_but_left(context: Context) -> None:
    drive = new_drive(context, a=b"1")
    trash.delete_drive(context, drive, "somebody")
    context.storage.folder(f"drives/{drive}/files/a").unlink()
    (found,) = check(context, repair=True)
    assert (found.kind, found.repair) == ("file-missing", None)
    assert found.message.endswith("The drive is in the trash.")
    with context.database.reading() as session:
        assert session.get(DriveFile, (drive, "a")) is not None
