"""Results as files for other programs, written by the workers when somebody asks for them, and kept with the job."""

from __future__ import annotations

import asyncio
from pathlib import Path

from app.jobs.runner import Runner
from app.results.folder import Result
from app.work.on_demand import write_export


class Exports:
    """Writes each file once, however many ask for it at the same time."""

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._writing: dict[Path, asyncio.Task[None]] = {}

    async def write(self, result: Result, path: Path, layer: str | None) -> None:
        """Write a layer of a result, or all of them.

        Raises
        ------
        Problem
            503: the workers died of it.
        """
        if path not in self._writing:
            task = asyncio.create_task(self._runner.run_in_worker(write_export, result.folder, path, layer))
            self._writing[path] = task
            task.add_done_callback(lambda _: self._writing.pop(path, None))
        await asyncio.shield(self._writing[path])
