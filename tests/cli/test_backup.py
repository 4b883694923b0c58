"""`interloc backup` and `interloc restore`: what they print, and with what they end."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from app.context import Context
from app.drives.models import NewDrive
from app.drives.records import create_drive
from app.drives.upload import keep
from app.http.intake import Arrival
from app.settings import Settings
from app.upkeep.generations import Retention

Interloc = Callable[..., Any]


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Data folder of a service with one file."""
    context = Context.open(Settings(data_dir=tmp_path / "data", min_free_bytes=0))
    drive = create_drive(context, "somebody", NewDrive(name="town"))[0]
    received = context.storage.incoming() / "received"
    received.write_bytes(b"1 0 0 0")
    keep(context, drive.id, [Arrival("poses.txt", received, 7, "0" * 64)])
    context.close()
    return tmp_path / "data"


def test_from_a_backup_to_a_service(interloc: Interloc, data: Path, tmp_path: Path) -> None:
    out = tmp_path / "backup"
    first = interloc("backup", out, "--data-dir", data).out
    assert first.startswith(f"backup   {out}\ndrives   1, with 0 jobs\nsize     2 files, ")
    assert "no drive was locked for longer than" in first
    assert "nothing: all was there" in interloc("backup", out, "--data-dir", data).out
    report = interloc("backup", out, "--data-dir", data, "--json").json
    assert (report["complete"], report["drives"], report["files"], report["brought_files"]) == (True, 1, 2, 0)
    assert interloc("backup", out, "--data-dir", data, "--quiet").out == ""
    restored = interloc("restore", out, "--data-dir", tmp_path / "restored")
    assert restored.code == 0
    assert "drives    1, with 0 jobs" in restored.out
    assert "check     rows and files agree" in restored.out
    (file,) = (tmp_path / "restored").glob("drives/*/files/poses.txt")
    assert file.read_bytes() == b"1 0 0 0"
    again = interloc("restore", out, "--data-dir", tmp_path / "again", "--json").json
    assert (again["drives"], again["findings"]) == (1, [])


def test_generations_share_files_and_each_can_be_restored(interloc: Interloc, data: Path, tmp_path: Path) -> None:
    out, keep = tmp_path / "backups", ("--keep-daily", "2", "--keep-monthly", "2")
    days = ["2026-01-31", "2026-02-27", "2026-02-28"]
    for day in days:
        made = Path(interloc("backup", out, "--data-dir", data, *keep, "--json").json["out"])
        made.rename(out / f"{day}T030000Z")
        (out / ".cloning").mkdir(exist_ok=True)  # of one that was killed
    context = Context.open_existing(Settings(data_dir=data))
    create_drive(context, "somebody", NewDrive(name="later"))
    context.close()
    last = interloc("backup", out, "--data-dir", data, *keep, "--json").json
    assert (last["drives"], last["removed_generations"]) == (2, ["2026-02-27T030000Z"])
    older, newer = (next(folder.glob("drives/*/files/poses.txt")) for folder in sorted(out.glob("2*")))
    assert older.samefile(newer)
    restored = interloc("restore", out, "--generation", days[-1], "--data-dir", tmp_path / "restored", "--json")
    assert restored.json["drives"] == 1
    assert interloc("restore", out, "--data-dir", tmp_path / "newest", "--json").json["drives"] == 2
    assert "It has: 2026-02-28" in interloc("restore", out, "--generation", "2025", "--data-dir", data).complaint
    single = next(out.glob("2026-02-28*"))
    assert "Generations need a folder of their own" in interloc("backup", single, "--data-dir", data, *keep).complaint
    assert "a folder" in interloc("backup", "s3://bucket/backup", "--data-dir", data).err


def test_the_newest_of_each_period_stays() -> None:
    times = [datetime(2026, 1, 1, 3, tzinfo=UTC) + timedelta(hours=12 * n) for n in range(100)]
    kept = sorted(Retention(daily=2, weekly=2, monthly=3).kept(times))
    assert [f"{time:%m-%d %H}" for time in kept] == ["01-31 15", "02-15 15", "02-18 15", "02-19 15"]
    assert Retention().kept(times) == {times[-1]}
    assert Retention(daily=1).kept([]) == set()


def test_a_service_that_is_not_whole_is_told(interloc: Interloc, data: Path, tmp_path: Path) -> None:
    (file,) = data.glob("drives/*/files/poses.txt")
    file.unlink()
    outcome = interloc("backup", tmp_path / "backup", "--data-dir", data, "--quiet")
    assert (outcome.code, "poses.txt is not there" in outcome.complaint) == (1, True)
    outcome = interloc("restore", tmp_path / "backup", "--data-dir", tmp_path / "restored")
    assert (outcome.code, "is not whole" in outcome.complaint) == (2, True)
    outcome = interloc("restore", tmp_path / "backup", "--data-dir", tmp_path / "restored", "--incomplete")
    assert (outcome.code, "`interloc check --repair`" in outcome.complaint) == (1, True)
    assert "check     1 findings" in outcome.out


def test_refusals_say_what_to_do(interloc: Interloc, data: Path, tmp_path: Path) -> None:
    outcome = interloc("backup", tmp_path / "backup", "--data-dir", tmp_path / "nowhere")
    assert (outcome.code, "--data-dir (INTERLOC_DATA_DIR) names it" in outcome.complaint) == (2, True)
    assert not (tmp_path / "nowhere").exists()
    outcome = interloc("backup", data / "backup", "--data-dir", data)
    assert (outcome.code, "a backup belongs elsewhere" in outcome.complaint) == (2, True)
    outcome = interloc("restore", data, "--data-dir", tmp_path / "restored")
    assert (outcome.code, "is not a backup" in outcome.complaint) == (2, True)
