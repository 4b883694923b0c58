"""What a restart finds is what was found, to the last bit; what is done is not done again."""

import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from app.jobs.work import intersections
from app.jobs.work.intersections import read_checkpoint, write_checkpoint
from app.work import kinds
from app.work.requests import IntersectionsJob
from app.work.task import Cancelled, Part, ProgressFiles, Task
from interloc.config import preset
from interloc.errors import InterLocError, OutputError
from interloc.pipeline import RangeResult
from interloc.reduction.reduce import reduce_drive
from tests.app.street import write_street
from tests.tasks import task_for

SCANS = 120


@pytest.mark.parametrize("content", [b"", b"half a file", b"a head\nand more", None])
def test_a_checkpoint_that_cannot_be_read_is_none(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "range"
    if content is not None:
        path.write_bytes(content)
    assert read_checkpoint(path) is None


def test_a_checkpoint_of_another_version_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "range"
    write_checkpoint(path, RangeResult(0, [], {}, 1))
    monkeypatch.setattr(intersections, "versions", lambda: {"interloc": "0.0.1"})
    assert read_checkpoint(path) is None


@contextmanager
def small_files(limit: int) -> Iterator[None]:
    """Let no file grow beyond a limit: the system refuses as it does on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_no_checkpoint(tmp_path: Path) -> None:
    with small_files(100), pytest.raises(OutputError, match="could not be written") as caught:
        write_checkpoint(tmp_path / "range", RangeResult(0, [], {}, 1))
    assert caught.value.http_status == 507
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a committed drive; each scan is a keyframe."""
    folder = tmp_path_factory.mktemp("drive")
    street = write_street(folder / "street", SCANS)
    reduce_drive(street, folder / "reduced", keyframes=None)
    return folder


@pytest.fixture
def task(drive: Path, tmp_path: Path) -> Task[IntersectionsJob]:
    task = replace(task_for("intersections", IntersectionsJob(config=preset("default")), tmp_path), drive=drive)
    ProgressFiles.of(task).open()
    return task


def test_a_part_that_is_done_is_not_done_again(task: Task[IntersectionsJob], tmp_path: Path) -> None:
    plan = kinds.prepare(task)
    assert (plan.total, [(part.start, part.stop) for part in plan.parts]) == (SCANS, [(0, SCANS)])
    kinds.run(task, plan.parts[0])
    nowhere = replace(task, drive=tmp_path / "nowhere", attempt="b")  # another attempt could not do it
    ProgressFiles.of(nowhere).open()
    kinds.run(nowhere, plan.parts[0])
    assert ProgressFiles.of(nowhere).read().done == {0: SCANS}


def test_the_cut_does_not_matter(task: Task[IntersectionsJob]) -> None:
    whole = kinds.prepare(task)
    kinds.run(task, whole.parts[0])
    kinds.finish(task, whole)
    expected = {path.name: path.read_bytes() for path in task.result.glob("*.geojson")}
    assert len(expected) == 7
    shutil.rmtree(task.result)
    cut = replace(whole, parts=[Part(0, 0, 1), Part(1, 1, 52), Part(2, 52, SCANS)])
    for part in cut.parts:
        kinds.run(task, part)
    kinds.finish(task, cut)
    assert {path.name: path.read_bytes() for path in task.result.glob("*.geojson")} == expected


def test_work_stops_when_it_is_told_to(task: Task[IntersectionsJob]) -> None:
    plan = kinds.prepare(task)
    ProgressFiles.of(task).stop()
    with pytest.raises(Cancelled):
        kinds.run(task, plan.parts[0])
    with pytest.raises(Cancelled):
        intersections.run(task, plan.parts[0], ProgressFiles.of(task).report_of(plan.parts[0]))
    with pytest.raises(Cancelled):
        kinds.finish(task, plan)
    assert not task.result.exists()


def test_two_attempts_do_not_stop_each_other(task: Task[IntersectionsJob]) -> None:
    other = replace(task, attempt="b")
    ProgressFiles.of(other).open()
    ProgressFiles.of(task).stop()
    kinds.prepare(other)
    ProgressFiles.of(other).check()


def test_a_worker_that_does_not_see_the_data_says_so(task: Task[IntersectionsJob], tmp_path: Path) -> None:
    with pytest.raises(InterLocError, match=r"does not see .*at the same place"):
        kinds.prepare(replace(task, scratch=tmp_path / "not mounted"))
