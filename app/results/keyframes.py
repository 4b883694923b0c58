"""The pictures of keyframes, drawn by the workers when somebody asks for them, and kept for a while."""

from __future__ import annotations

import asyncio
from pathlib import Path

from app.http.problems import Problem
from app.jobs.runner import Runner
from app.results.folder import Result
from app.states import JobKind
from app.work.on_demand import VIEW, draw_keyframe
from app.work.task import Task

_AT_ONCE = 2  # workers that a server lends to pictures: jobs go on meanwhile
_WAITING = 64


class KeyframeViews:
    """Draws each keyframe once, however many ask for it at the same time."""

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._drawing: dict[Path, asyncio.Task[int]] = {}
        self._turn = asyncio.Semaphore(_AT_ONCE)

    async def open(self, result: Result, frame: int) -> Path:
        """Return the folder of the pictures of a keyframe.

        Raises
        ------
        Problem
            404: no such keyframe; 503: too many wait for pictures, or the worker died.
        """
        folder = result.cache / "bev" / str(frame)
        if (folder / VIEW).exists():
            return folder
        drawing = self._drawing.get(folder)
        if drawing is None:
            if len(self._drawing) >= _WAITING:
                raise Problem(503, "Busy", "Too many keyframes are being drawn.", headers={"Retry-After": "2"})
            drawing = asyncio.create_task(self._draw(_task_of(result), frame, folder))
            self._drawing[folder] = drawing
            drawing.add_done_callback(lambda _: self._drawing.pop(folder, None))
        nearest = await asyncio.shield(drawing)
        if nearest != frame:
            raise Problem(
                404,
                "No such keyframe",
                f"Scan {frame} is no keyframe of job {result.job_id}; the nearest one is {nearest}. "
                f"GET {result.address}/keyframes lists them.",
                nearest=nearest,
            )
        return folder

    async def _draw(self, task: Task, frame: int, folder: Path) -> int:
        async with self._turn:
            return await self._runner.run_in_worker(draw_keyframe, task, frame, folder)


def _task_of(result: Result) -> Task:
    return Task(
        kind=JobKind.INTERSECTIONS,
        job_id=result.job_id,
        drive_name=result.drive_name,
        request=result.request,
        drive=result.drive,
        scratch=result.cache,
        result=result.folder,
    )
