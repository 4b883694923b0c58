"""Check says what is missing on either side, and changes nothing."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import update

from app.context import Context
from app.store.models import Drive, Job
from app.trash import deletion as trash
from app.upkeep import check as module
from app.upkeep.check import check
from interloc.output.layout import RUN_FILE
from interloc.reduction.reduce import reduce_drive
from tests.app.conftest import finished_job, new_drive, opened
from tests.app.street import write_street


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of five scans, as a commit reduces it."""
    root = tmp_path_factory.mktemp("drives")
    reduce_drive(write_street(root / "street", 5), root / "reduced", keyframes=None)
    return root / "reduced"


@pytest.fixture
def context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Context]:
    """A service that is not running."""
    monkeypatch.setattr(module, "_AGAIN_S", 0.0)
    with opened(tmp_path / "data") as context:
        yield context


def ready_drive(context: Context, street: Path, *, keep_raw: bool = False) -> str:
    """A drive as a commit leaves it: raw files listed, reduced scans, a map."""
    drive = new_drive(context, {"poses.txt": b"raw", "map.osm": b"map"})
    folder = context.storage.folder(f"drives/{drive}")
    shutil.copytree(street, folder / "reduced")
    (folder / "trajectory.geojson").write_text("{}")
    if not keep_raw:
        (folder / "files/poses.txt").unlink()
    with context.database.writing() as session:
        session.execute(update(Drive).where(Drive.id == drive).values(state="ready", keep_raw=keep_raw))
    return drive


def found(context: Context) -> list[tuple[str, str]]:
    """What is found, twice the same."""
    first, second = ([(each.kind, each.place) for each in check(context)] for _ in range(2))
    assert first == second
    return first


def test_nothing_is_found_where_nothing_is_missing(context: Context, street: Path) -> None:
    new_drive(context, {})
    drive = new_drive(context, {"poses.txt": b"1", "a": b""})
    for keep_raw in (False, True):
        finished_job(context, ready_drive(context, street, keep_raw=keep_raw))
    assert found(context) == []
    trash.delete_drive(context, drive, "somebody")
    assert found(context) == []
    context.storage.folder(f"drives/{drive}/files/a").unlink()  # what is in the trash may be taken back
    assert found(context) == [("file-missing", f"drives/{drive}/files/a")]


def test_files_that_are_not_as_their_rows_say(context: Context) -> None:
    drive = new_drive(context, {"gone": b"1", "grown": b"22", "same": b"333"})
    files = context.storage.folder(f"drives/{drive}/files")
    (files / "gone").unlink()
    (files / "grown").write_bytes(b"2222")
    (files / "new").write_bytes(b"4")
    (files / "same").touch()  # as by a copy of the data folder
    place = f"drives/{drive}/files"
    expected = {"file-missing": f"{place}/gone", "file-differs": f"{place}/grown", "file-unlisted": f"{place}/new"}
    assert dict(found(context)) == expected


def test_files_of_an_archive_that_is_being_unpacked_are_no_leftovers(context: Context) -> None:
    drive = new_drive(context, {"archives/1": b"PK"})
    folder = context.storage.folder(f"drives/{drive}")
    (folder / "files/archives").rename(folder / "archives")
    (folder / "files/scan.bin").write_bytes(b"1")
    with context.database.writing() as session:
        values = {"kind": "unpack", "state": "running", "request": {"archive": "archives/1"}, "created_at": 1.0}
        session.add(Job(drive_id=drive, owner="somebody", **values))
        session.execute(update(Drive).values(state="ready"))  # so that its file counts as reduced
    places = [place for _, place in found(context) if "reduced" not in place and "trajectory" not in place]
    assert places == []
    (folder / "archives/1").unlink()
    assert ("file-missing", f"drives/{drive}/archives/1") in found(context)


@pytest.mark.parametrize("what", ["reduced", "reduced/reduced.json", "reduced/poses.txt", "scan", "trajectory.geojson"])
def test_a_ready_drive_that_is_not_whole(context: Context, street: Path, what: str) -> None:
    drive = ready_drive(context, street)
    folder = context.storage.folder(f"drives/{drive}")
    if what == "scan":
        what = sorted(folder.rglob("*.ground"))[2].relative_to(folder).as_posix()
    (folder / what).rename(folder / "away")
    expected = "reduced/reduced.json" if what == "reduced" else what
    assert found(context) == [("file-missing", f"drives/{drive}/{expected}")]


def test_results_that_are_gone(context: Context) -> None:
    job = finished_job(context, new_drive(context, {}))
    folder = context.storage.folder(f"jobs/{job}/result")
    for name in ("report.json", "intersections.geojson"):
        (folder / name).write_bytes(b"")
        assert found(context) == [("file-differs", f"jobs/{job}/result/{name}")]
        (folder / name).unlink()
        assert found(context) == [("file-missing", f"jobs/{job}/result/{name}")]
        (folder / name).write_text("{}")
    (folder / RUN_FILE).unlink()
    (folder / RUN_FILE).mkdir()
    assert found(context) == [("file-differs", f"jobs/{job}/result/{RUN_FILE}")]
    shutil.rmtree(folder)
    assert ("file-missing", f"jobs/{job}/result/{RUN_FILE}") in found(context)


def test_folders_that_no_row_knows(context: Context) -> None:
    for key in ("drives/0123456789abcdef/files", "jobs/0123456789abcdef/result", "jobs/1123456789abcdef/scratch"):
        context.storage.folder(key).mkdir(parents=True)
    assert found(context) == [("folder-unknown", f"{kind}/0123456789abcdef") for kind in ("drives", "jobs")]
