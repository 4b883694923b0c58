"""A commit reads the small files of a drive once, and once more to copy them."""

from pathlib import Path
from types import ModuleType

import numpy as np

from app.drives.work import commit
from app.work.requests import CommitJob
from tests.opens import counted_opens
from tests.small_drives import make
from tests.tasks import task_for

__all__ = ["make"]


def test_a_commit_with_two_label_folders(tmp_path: Path, make: ModuleType) -> None:
    files = make.write_semantickitti(tmp_path / "drive/files")
    (files / "labels").rename(files / "predictions")
    make.write_semantickitti(files)
    (files / "oxts").mkdir()
    for frame, row in enumerate(make.oxts_lines(make.lidar_poses(), T_lidar_imu=np.eye(4))):
        (files / "oxts" / f"{frame:010d}.txt").write_text(row + "\n")
    task = task_for("commit", CommitJob(), tmp_path)
    with counted_opens() as opens:
        plan = commit.prepare(task)
    small = [files / "poses.txt", files / "times.txt", *sorted((files / "oxts").iterdir())]
    assert [opens[path] for path in small] == [1] * 14
    with counted_opens() as opens:
        for part in plan.parts:
            commit.run(task, part, lambda _done: None)
        outcome = commit.finish(task, plan)
    assert outcome.ok
    assert [opens[path] for path in small] == [1] * 14
    assert sorted(path.name for path in (task.result / "reduced/ground").iterdir()) == ["labels", "predictions"]
