"""`interloc batch`: many drives, each as by itself."""

import csv
import json
import os
import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from interloc.cli import batch
from interloc.cli.batch import Records, Unit, do_all

TIMED = {"seconds", "stage_seconds", "peak_memory_bytes"}


def contents(folder: Path) -> dict[str, object]:
    """Every file of a result, times and memory left out."""
    found: dict[str, object] = {
        str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }
    run = json.loads((folder / "run.json").read_bytes())
    found["run.json"] = {name: value for name, value in run.items() if name not in TIMED}
    if (folder / "report.html").is_file():
        found["report.html"] = re.sub(
            r"<tr><td>(seconds|stage_seconds|peak_memory).*", "", (folder / "report.html").read_text()
        )
    return found


@pytest.fixture
def drives(drive: Path, short_drive: Path, osm: Path, tmp_path: Path) -> Path:
    """A list: the drive with a map, the drive without one, and one that is damaged."""
    (short_drive / "labels/000003.label").rename(tmp_path / "good.label")
    (short_drive / "labels/000003.label").write_bytes(b"x")
    rows = [["drive", "name", "osm", "preset"], [drive, "", osm, ""], [drive, "plain", "", "paper"]]
    with (tmp_path / "list.csv").open("w", newline="") as file:
        csv.writer(file).writerows([*rows, ["short", "", "", ""]])
    return tmp_path / "list.csv"


def test_each_drive_is_as_by_itself_and_one_that_fails_stops_nothing(
    drives: Path, finished: Path, tmp_path: Path, interloc: Callable
) -> None:
    out = tmp_path / "out"
    outcome = interloc("batch", drives, "-o", out, "--workers", "2", "--json")
    assert outcome.code == 1
    assert outcome.err.startswith("interloc: 1 of 3 drives failed, the first one short: ")
    told = {row["name"]: row for row in outcome.json["drives"]}
    assert [row["state"] for row in told.values()] == ["successful", "successful", "failed"]
    assert "000003.label" in told["short"]["error"]
    assert contents(out / "crossing") == contents(finished)
    assert json.loads((out / "plain/run.json").read_bytes())["config"]["preset"] == "paper"
    with (out / "batch.csv").open(newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert rows["crossing"]["verdict"] == json.loads((finished / "report.json").read_bytes())["map_line"]
    made = (out / "crossing/run.json").stat().st_mtime_ns
    shutil.copy(tmp_path / "good.label", tmp_path / "short/labels/000003.label")
    again = interloc("batch", drives, "-o", out)
    assert "2 drives of 3 done already" in again.err
    assert again.code == 0
    assert (out / "crossing/run.json").stat().st_mtime_ns == made


def test_mistakes_are_told_before_any_work(drive: Path, tmp_path: Path, interloc: Callable) -> None:
    listed = tmp_path / "list.csv"
    listed.write_text("drive,colour\nx,red\n")
    assert "line 2: 'colour' is neither drive nor name" in interloc("batch", listed, "-o", tmp_path / "a").err
    listed.write_text("name\nx\n")
    assert "line 2 names no drive" in interloc("batch", listed, "-o", tmp_path / "a").err
    listed.write_text("drive\n")
    assert "list.csv names no drive" in interloc("batch", listed, "-o", tmp_path / "a").err
    assert "could not be written: not a directory" in interloc("batch", drive, "-o", listed / "a").err
    assert "names two drives" in interloc("batch", drive, drive, "-o", tmp_path / "a").err
    assert "not the folder of a batch" in interloc("batch", drive, "-o", tmp_path).err
    assert "bev.none" in interloc("batch", drive, "-o", tmp_path / "a", "--set", "bev.none=1").err
    assert not (tmp_path / "a").exists()


def die(_: Unit, out: str) -> batch.Row:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError(out)


def test_a_worker_that_dies_stops_nothing_and_costs_another_try(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unit = Unit("short", str(short_drive), ())
    records = Records(str(tmp_path / "out"))
    with monkeypatch.context() as patched:
        patched.setattr(batch, "work", die)
        row = do_all([unit], records, 1, None, progress=lambda _: None)["short"]
    assert "its process was ended from outside. Usual cause: too little memory" in str(row.error)
    assert records.done(unit) is None
    row = do_all([unit], records, 1, None, progress=lambda _: None)["short"]
    assert row.error is None
    assert Records(str(tmp_path / "out")).done(unit) == row
    assert records.done(Unit("short", str(short_drive), ("--preset", "paper"))) is None
    shutil.rmtree(tmp_path / "out/short")
    lost = records.write(unit, row)  # of a worker that does not see the folder
    assert "its worker wrote no result here" in str(lost.error)
