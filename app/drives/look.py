"""A look at a folder of a client, before any of it is sent."""

from __future__ import annotations

from fastapi.concurrency import run_in_threadpool

from app.context import Context
from app.drives.models import LookRequest
from app.drives.work.look import look
from app.jobs.runner import Runner
from app.work.documents import UploadOptions
from app.work.task import WorkSettings
from interloc.reduction.look import FolderLook


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
        UploadOptions.model_validate(dict(request.options)),
        request.keyframes,
        request.ranges,
        WorkSettings.model_validate(context.settings),
        await run_in_threadpool(context.storage.incoming),
        client=client,
    )
