"""What a restart finds is what was found, to the last bit; what is done is not done again."""

from __future__ import annotations

import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.jobs.work import intersections
from app.jobs.work.checkpoints import read_checkpoint, write_checkpoint
from app.work import kinds
from app.work.documents import IntersectionsJob
from app.work.progress import ProgressFiles
from app.work.task import Cancelled, Part, Task
from interloc.config import preset
from interloc.detection.detector import KeyframeDetections
from interloc.detection.keyframes import Keyframe
from interloc.errors import InterLocError, OutputError
from interloc.pipeline import RangeResult
from interloc.reduction.reduce import reduce_drive
from interloc.results import RoadPatch
from tests.app.street import write_street
from tests.tasks import task_for

SCANS = 120
REALS = st.floats(allow_nan=False, width=64)


@st.composite
def found(draw: st.DrawFn) -> RangeResult:
    def keyframe(frame: int) -> KeyframeDetections:
        count = draw(st.integers(0, 3))
        numbers = np.array([draw(REALS) for _ in range(count)], np.float64)
        branches = [np.array([draw(REALS) for _ in range(draw(st.integers(0, 4)))], np.float64) for _ in range(count)]
        return KeyframeDetections(
            Keyframe(frame, np.full((4, 4), draw(REALS)), draw(st.none() | REALS)),
            np.stack([numbers, numbers[::-1]], axis=1).reshape(-1, 2),
            np.stack([numbers, -numbers], axis=1).reshape(-1, 2),
            branches,
            numbers,
            [np.array([draw(REALS) for _ in angles], np.float64) for angles in branches],
        )

    detections = [keyframe(frame) for frame in range(draw(st.integers(0, 4)))]
    seconds = draw(st.dictionaries(st.sampled_from(["read", "bev", "centerline"]), REALS, max_size=3))
    sizes = draw(st.lists(st.integers(1, 9), max_size=2))
    road = tuple(
        RoadPatch.pack(
            row, np.array([draw(REALS), draw(REALS)]), draw(REALS), image, draw(st.sampled_from([None, 1 - image]))
        )
        for row, image in enumerate(np.eye(size, dtype=np.uint8) for size in sizes)
    )
    return RangeResult(draw(st.integers(0, 9)), detections, seconds, 123, road)


def bits(part: RangeResult) -> list[object]:
    arrays = [
        [a.tobytes() for a in (k.keyframe.T_world_lidar, k.lidar_xy, k.world_xy, k.score, *angles, *widths)]
        for k in part.detections
        for angles, widths in [(k.branch_angles_rad, k.branch_widths_m)]
    ]
    frames = [(k.keyframe.frame, k.keyframe.time_s) for k in part.detections]
    road = [(p.keyframe, p.corner_xy.tobytes(), p.resolution_m, p.size, p.packed, p.packed_other) for p in part.road]
    return [part.start, arrays, frames, part.seconds, part.peak_memory_bytes, road]


@given(part=found())
def test_a_checkpoint_keeps_every_bit(part: RangeResult, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("scratch") / "range.npz"
    write_checkpoint(path, part)
    again = read_checkpoint(path)
    assert again is not None
    assert bits(again) == bits(part)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half a file", None])
def test_a_checkpoint_that_cannot_be_read_is_none(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "range.npz"
    if content is not None:
        path.write_bytes(content)
    assert read_checkpoint(path) is None


def test_a_checkpoint_of_another_version_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "range.npz"
    write_checkpoint(path, RangeResult(0, [], {}, 1))
    monkeypatch.setattr("app.jobs.work.checkpoints._made_by", lambda: "interloc 0.0.1")
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
        write_checkpoint(tmp_path / "range.npz", RangeResult(0, [], {}, 1))
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
