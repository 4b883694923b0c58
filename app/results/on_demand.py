"""Files that are made from a result when somebody asks for them, by the workers, and kept with the job."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from app.context import part_of_app
from app.http.problem_types import BUSY, NO_SUCH_KEYFRAME, RESULT_DAMAGED
from app.http.problems import Problem
from app.jobs.runner import Runner
from app.results.folder import Result
from app.results.work import VIEW, draw_keyframe, draw_road_picture, write_export
from app.work.documents import IntersectionsJob
from interloc.errors import DamagedResultError

_MAX_DRAWING = 2  # workers that a server lends to pictures: jobs go on in the meantime
_MAX_RUNNING = 64

_log = logging.getLogger(__name__)


class OnDemand:
    """Makes each file once, however many ask for it at the same time."""

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._running: dict[Path, asyncio.Task[Any]] = {}
        self._drawing = asyncio.Semaphore(_MAX_DRAWING)

    async def export(self, result: Result, path: Path, layer: str | None, client: str) -> None:
        """Write a layer of a result, or all, as a file for other programs; 500 where the result is damaged."""
        write = partial(
            self._runner.run_in_worker, write_export, result.folder, path, layer, result.drive_name, client=client
        )
        await self._once_of(result, path, write)

    async def road(self, result: Result, client: str) -> Path:
        """Return the folder of the picture of the road seen by LiDAR; problems as of `export`."""
        folder = result.cache / "road"
        if not (folder / VIEW).exists():
            draw = partial(self._runner.run_in_worker, draw_road_picture, result.folder, folder, client=client)
            await self._once_of(result, folder, draw)
        return folder

    async def keyframe(self, result: Result, frame: int, client: str) -> Path:
        """Return the folder of the pictures of a keyframe (else a 404); 503 where too many wait for pictures."""
        folder = result.cache / "bev" / str(frame)
        if (folder / VIEW).exists():
            return folder
        if folder not in self._running and len(self._running) >= _MAX_RUNNING:
            raise Problem(BUSY, "Too many keyframes are being drawn.", headers={"Retry-After": "2"})
        nearest = await self._once(folder, lambda: self._draw(result, frame, folder, client))
        if nearest != frame:
            raise Problem(
                NO_SUCH_KEYFRAME,
                f"Scan {frame} is not a keyframe of job {result.job_id}; the nearest one is {nearest}. "
                f"GET {result.address}/layers/keyframes lists them.",
                nearest=nearest,
            )
        return folder

    async def _draw(self, result: Result, frame: int, folder: Path, client: str) -> int:
        request = IntersectionsJob.model_validate(result.request)
        async with self._drawing:
            return await self._runner.run_in_worker(
                draw_keyframe, result.drive, result.drive_name, request, frame, folder, client=client
            )

    async def _once_of(self, result: Result, path: Path, work: Callable[[], Coroutine[Any, Any, Any]]) -> None:
        """Wait for the work on a file that is made of a result only."""
        try:
            await self._once(path, work)
        except DamagedResultError as error:
            _log.error("job %s: %s", result.job_id, error)
            raise Problem(
                RESULT_DAMAGED,
                f"A file of the result of job {result.job_id} is damaged or missing; the log of the service has the "
                "details. Submit the job again.",
            ) from error

    async def _once(self, path: Path, work: Callable[[], Coroutine[Any, Any, Any]]) -> Any:  # noqa: ANN401
        """Wait for the work on a file, begun here or by another request; a request that goes away does not end it."""
        if path not in self._running:
            task = asyncio.create_task(work())
            self._running[path] = task
            task.add_done_callback(lambda _: self._running.pop(path, None))
        return await asyncio.shield(self._running[path])


OnDemandDep = Annotated[OnDemand, part_of_app("on_demand")]
