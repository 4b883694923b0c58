"""The pictures of one keyframe of a job: short work for a request that waits for it."""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np

from app.work.intersections import config_of, open_input
from app.work.task import Task
from interloc.files import atomic_folder, atomic_write

VIEW = "view.json"
"""Where the pictures of a keyframe lie, and the numbers behind them; the file that makes the folder complete."""

_KEPT = 300  # keyframes of a job whose pictures are kept, some 100 kB each


def draw_keyframe(task: Task, frame: int, folder: Path) -> int:
    """Draw all overlays of a keyframe into a folder.

    Parameters
    ----------
    task
        The job, as it was worked on.
    frame : int
        Scan number.
    folder
        Appears complete or not at all, in a folder of such folders.

    Returns
    -------
    int
        The keyframe nearest to `frame`. Nothing was drawn where it is another one.

    Raises
    ------
    InterLocError
        The drive can no longer be read, or the disk is full.
    """
    from interloc.explain.evidence import gather  # noqa: PLC0415 - not needed for jobs
    from interloc.explain.overlays import OVERLAYS, describe_overlays, draw_overlay  # noqa: PLC0415

    drive, keyframes = open_input(task)
    frames = drive.frames[keyframes]
    nearest = int(frames[np.argmin(np.abs(frames - frame))])
    if nearest != frame:
        return nearest
    evidence = gather(drive, frame, config_of(task))
    folder.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(folder, marker=VIEW) as new:
        for layer in OVERLAYS:
            with atomic_write(new / f"{layer}.png") as file:
                file.write(draw_overlay(evidence, layer))
        view = describe_overlays(evidence, task.drive_name, drive.georeference)
        with atomic_write(new / VIEW) as file:
            file.write(json.dumps(view, allow_nan=False).encode() + b"\n")
    _forget_oldest(folder.parent)
    return nearest


def _forget_oldest(views: Path) -> None:
    with suppress(OSError):
        folders = sorted(views.iterdir(), key=lambda folder: folder.stat().st_mtime)
        for folder in folders[:-_KEPT]:
            shutil.rmtree(folder, ignore_errors=True)
