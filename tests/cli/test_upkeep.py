"""`interloc admin`: check, backup, restore, trash: what operators read, and the exit codes that scripts look at."""

from collections.abc import Callable
from pathlib import Path

import pytest

from app.context import Context
from app.settings import Settings
from app.trash import deletion as trash
from tests.app.conftest import new_drive


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The data folder that the commands of this test work on."""
    monkeypatch.setenv("INTERLOC_DATA_DIR", str(tmp_path / "data"))
    return tmp_path / "data"


def fill(data: Path, files: int, *, deleted: bool = False) -> str:
    context = Context.open(Settings(data_dir=data))
    drive = new_drive(context, {f"velodyne/{number:06d}.bin": bytes(10) for number in range(files)})
    if deleted:
        trash.delete_drive(context, drive, "alice")
    context.close()
    return drive


def test_check_names_what_is_missing(interloc: Callable, data: Path) -> None:
    drive = fill(data, 12)
    outcome = interloc("admin", "check")
    assert (outcome.code, outcome.out) == (0, "check  rows and files agree\n")
    for path in (data / f"drives/{drive}/files/velodyne").iterdir():
        path.unlink()
    outcome = interloc("admin", "check")
    assert outcome.code == 1
    lines = outcome.out.splitlines()
    assert lines[0] == (
        f"file-missing  drives/{drive}/files/velodyne/000000.bin: a row says that it is there: no such file or "
        "directory. Bring it back from a backup."
    )
    assert lines[10:] == [f"file-missing  drives/{drive}/files: and 2 more (--json lists all)"]
    found = interloc("admin", "check", "--json").json
    assert found["ok"] is False
    assert len(found["findings"]) == 12
    for path in data.glob("interloc.sqlite3*"):
        path.unlink()
    outcome = interloc("admin", "check")
    assert (outcome.code, "the database was lost" in outcome.complaint) == (2, True)


def test_from_a_backup_to_a_service(interloc: Callable, data: Path, tmp_path: Path) -> None:
    fill(data, 2)
    out = tmp_path / "backup"
    first = interloc("admin", "backup", out).out
    assert first.startswith(f"backup  {out}\ndrives  1, with 0 jobs\nsize    2 files, 20 bytes\n")
    assert "is not empty" in interloc("admin", "backup", out).complaint
    report = interloc("admin", "backup", tmp_path / "second", "--json").json
    assert (report["complete"], report["drives"], report["files"]) == (True, 1, 2)
    assert interloc("admin", "backup", tmp_path / "third", "--quiet").out == ""
    restored = interloc("admin", "restore", out, "--data-dir", tmp_path / "restored")
    assert restored.code == 0
    assert "drives    1, with 0 jobs" in restored.out
    assert interloc("admin", "check", "--data-dir", tmp_path / "restored").code == 0
    again = interloc("admin", "restore", out, "--data-dir", tmp_path / "again", "--json").json
    assert (again["drives"], again["missing"]) == (1, [])


def test_a_service_that_is_not_whole_is_told(interloc: Callable, data: Path, tmp_path: Path) -> None:
    fill(data, 2)
    next(data.glob("drives/*/files/velodyne/000001.bin")).unlink()
    outcome = interloc("admin", "backup", tmp_path / "backup", "--quiet")
    assert (outcome.code, "000001.bin. `interloc admin check` names all" in outcome.complaint) == (1, True)
    outcome = interloc("admin", "restore", tmp_path / "backup", "--data-dir", tmp_path / "restored")
    assert (outcome.code, "000001.bin." in outcome.complaint) == (1, True)


def test_the_trash_is_listed_restored_and_emptied(interloc: Callable, data: Path) -> None:
    drive, other = fill(data, 1, deleted=True), fill(data, 2, deleted=True)
    listed = interloc("admin", "trash", "list").out.splitlines()
    assert [line.split()[:3] for line in listed] == [[other, "20", "bytes"], [drive, "10", "bytes"]]
    assert all("deleted by alice" in line and line.endswith("town") for line in listed)
    assert interloc("admin", "trash", "restore", drive).out == f"drive {drive} (town) is restored\n"
    outcome = interloc("admin", "trash", "restore", drive)
    assert outcome.code == 2
    assert "it is not in the trash; `interloc admin trash list` shows what is" in outcome.complaint
    emptied = interloc("admin", "trash", "empty")
    assert emptied.out.splitlines()[-1].startswith("1 deleted for good, ")
    assert not (data / f"drives/{other}").exists()
    assert interloc("admin", "trash", "list").err == "the trash is empty\n"
    assert interloc("admin", "check").code == 0


def test_a_mistyped_folder_does_not_become_a_service(interloc: Callable, tmp_path: Path) -> None:
    for command in (["check"], ["backup", tmp_path / "out"], ["trash", "list"], ["trash", "empty"]):
        refused = interloc("admin", *command, "--data-dir", str(tmp_path / "mistyped"))
        assert refused.code == 2
        assert "there is no data folder" in refused.complaint
    assert not (tmp_path / "mistyped").exists()
    refused = interloc("admin", "check", "--data-dir", str(tmp_path))
    assert refused.code == 2
    assert "holds no drives of a service" in refused.complaint
    assert not list(tmp_path.iterdir())
