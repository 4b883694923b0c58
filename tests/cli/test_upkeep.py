"""`interloc check`, `adopt`, `trash`: what operators read, and the exit codes that their scripts look at."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from app.context import Context
from app.drives.models import NewDrive
from app.drives.records import create_drive
from app.drives.upload import keep
from app.http.intake import Intake
from app.settings import Settings
from app.trash import deletion as trash


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The data folder that the commands of this test work on."""
    monkeypatch.setenv("INTERLOC_DATA_DIR", str(tmp_path / "data"))
    return tmp_path / "data"


def fill(data: Path, files: int, *, deleted: bool = False) -> str:
    """Make a drive of some files; returns its id."""
    context = Context.open(Settings(data_dir=data))
    drive = create_drive(context, "somebody", NewDrive(name="town"))[0].id
    for number in range(files):
        intake = Intake(context, f"velodyne/{number:06d}.bin", 100)
        intake.write(bytes(10))
        keep(context, drive, [intake.finish()])
    if deleted:
        trash.delete_drive(context, drive, "alice")
    context.close()
    return drive


def test_check_tells_repairs_and_is_content(interloc: Callable, data: Path) -> None:
    drive = fill(data, 12)
    outcome = interloc("check")
    assert (outcome.code, outcome.out) == (0, "nothing found: rows and files agree\n")
    for path in (data / f"drives/{drive}/files/velodyne").iterdir():
        path.unlink()
    outcome = interloc("check", "--quick")
    assert outcome.code == 1
    lines = outcome.out.splitlines()
    assert lines[0] == (f"drives/{drive}/files/velodyne/000000.bin: its row says 10 bytes, but there is no such file.")
    assert lines[10:] == [
        f"drives/{drive}/files: and 2 more of the kind file-missing (--json lists all)",
        "12 found, 0 repaired; --repair does what is safe",
    ]
    found = interloc("check", "--json").json
    assert found["ok"] is False
    assert len(found["findings"]) == 12
    outcome = interloc("check", "--repair")
    assert outcome.code == 1
    assert outcome.out.splitlines()[0].endswith("-> its row follows the file")
    assert "12 found, 12 repaired" in outcome.out
    assert interloc("check", "--json").json == {"ok": True, "findings": []}


def test_a_lost_database_is_found_by_check_and_mended_by_adopt(interloc: Callable, data: Path) -> None:
    drive = fill(data, 1)
    for path in data.glob("interloc.sqlite3*"):
        path.unlink()
    found = interloc("check", "--repair", "--json")
    assert found.code == 1
    (finding,) = found.json["findings"]
    assert (finding["kind"], finding["repair"]) == ("installation", None)
    assert (data / f"drives/{drive}/files/velodyne/000000.bin").is_file()
    planned = interloc("adopt", "--dry-run")
    assert planned.out.splitlines() == [
        f"drives/{drive}: drive 'town' of somebody, open for files: commit it",
        "1 of 1 would be adopted",
    ]
    done = interloc("adopt")
    assert (done.code, done.err) == (0, "")
    assert done.out.splitlines()[-1] == "1 of 1 adopted; database and data folder belong together now"
    assert interloc("check").code == 0


def test_the_trash_is_listed_restored_and_emptied(interloc: Callable, data: Path) -> None:
    drive, other = fill(data, 1, deleted=True), fill(data, 2, deleted=True)
    listed = interloc("trash", "list").out.splitlines()
    assert [line.split()[:4] for line in listed] == [
        [other, "drive", "20", "bytes"],
        [drive, "drive", "10", "bytes"],
    ]
    assert all("deleted by alice" in line and line.endswith("town") for line in listed)
    assert interloc("trash", "restore", drive).out == f"drive {drive} (town) is restored\n"
    outcome = interloc("trash", "restore", drive)
    assert outcome.code == 2
    assert "it is not in the trash; `interloc trash list` shows what is" in outcome.complaint
    assert interloc("trash", "empty", "--older-than", "1").out == "0 deleted for good, 0 bytes\n"
    emptied = interloc("trash", "empty")
    assert emptied.out.splitlines()[-1].startswith("1 deleted for good, ")
    assert not (data / f"drives/{other}").exists()
    assert interloc("trash", "list").err == "the trash is empty\n"
    assert interloc("check").code == 0


def test_a_mistyped_folder_does_not_become_a_service(interloc: Callable, tmp_path: Path) -> None:
    for command in (["check"], ["adopt"], ["trash", "list"], ["trash", "empty"]):
        refused = interloc(*command, "--data-dir", str(tmp_path / "mistyped"))
        assert refused.code == 2
        assert "there is no data folder" in refused.complaint
    assert not (tmp_path / "mistyped").exists()
    refused = interloc("check", "--data-dir", str(tmp_path))
    assert refused.code == 2
    assert "holds no drives of a service" in refused.complaint
    assert not list(tmp_path.iterdir())
