"""A look at a folder of a client, before any of it is sent."""

from __future__ import annotations

from fastapi.concurrency import run_in_threadpool

from app.context import Context
from app.drives.models import LookRequest
from app.drives.work.look import look
from app.jobs.runner import Runner
from interloc.reduction.look import FolderLook

_LIMITS = ("max_file_bytes", "max_recording_bytes", "max_drive_bytes", "max_drive_files")


async def look_at(context: Context, runner: Runner, request: LookRequest, client: str) -> FolderLook:
    """Look into a folder.

    Raises
    ------
    Problem
        As of `Runner.run_in_worker`.
    """
    return await runner.run_in_worker(
        look,
        request.files,
        request.contents,
        request.name,
        request.root,
        request.options.model_dump(mode="json"),
        request.keyframes,
        {name: getattr(context.settings, name) for name in _LIMITS},
        await run_in_threadpool(context.storage.incoming),
        client=client,
    )
