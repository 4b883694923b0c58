"""Endpoint for a whole drive as one archive."""

from __future__ import annotations

from collections.abc import Callable

from fastapi import APIRouter, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.context import Context, ContextDep
from app.drives.archive import check_magic, queue_archive, unpacked
from app.drives.models import UnpackedArchive
from app.drives.routes.drives import DriveId
from app.drives.routes.files import UPLOAD
from app.drives.upload import check_upload
from app.http.headers import WaitSeconds
from app.http.intake import Arrival, Intake, receive
from app.http.limits import Booking, check_free_space, declared_length
from app.http.multipart import BatchReader, boundary_of
from app.http.openapi import BINARY, body_of
from app.http.security import ClientDep
from app.jobs.watcher import wait_for_job
from app.states import FINAL
from app.store.models import Job

router = APIRouter(prefix="/drives/{drive_id}/archive", tags=["Uploads"])

_FORM = {
    "type": "object",
    "properties": {"archive": BINARY},
    "required": ["archive"],
    "additionalProperties": False,
}


@router.post(
    "",
    response_model=UnpackedArchive,
    responses={202: {"model": UnpackedArchive, "description": "It is still being unpacked."}, **UPLOAD},
    openapi_extra=body_of({"application/octet-stream": BINARY, "multipart/form-data": _FORM}),
    summary="Upload an archive",
)
async def post_archive(
    drive_id: DriveId,
    request: Request,
    response: Response,
    context: ContextDep,
    client: ClientDep,
    wait_s: WaitSeconds,
) -> UnpackedArchive:
    """Upload the files of a drive as .zip, .tar, .tar.gz or .tar.zst, and wait until it is unpacked.

    As the body itself, whose Content-Type does not matter (its first bytes tell what it is), or as the part `archive`
    of a form. A leading folder is stripped. Links, devices, encrypted files, paths that lead out of the archive and
    archives of two drives are refused; nothing is kept of them.
    """
    length = declared_length(request, context.settings.max_archive_bytes, "An archive")
    await run_in_threadpool(check_upload, context, drive_id, "archive", length or 0, client, is_packed=True)
    is_form = request.headers.get("content-type", "").startswith("multipart/")
    intake = _Form(context, request) if is_form else _Body(context)

    def finish() -> Job:
        check_free_space(context, 0)
        return queue_archive(context, drive_id, client, intake.finish())

    with Booking(context) as booking:
        await run_in_threadpool(booking.announce, length)
        try:
            job = await receive(request, booking.taking(intake.take), finish)
        finally:
            await run_in_threadpool(intake.discard)
    job = await wait_for_job(context, job.id, wait_s)
    if job.state not in FINAL:
        response.status_code = 202
        response.headers["Location"] = f"{context.settings.root_path}/api/v1/jobs/{job.id}"
    return unpacked(job)


class _Body:
    """An archive as the body itself; what is not an archive is refused by its first bytes."""

    def __init__(self, context: Context) -> None:
        self._intake = Intake(context, "archive", context.settings.max_archive_bytes)

    def take(self, data: bytes) -> None:
        if not self._intake.size_bytes:
            check_magic(data)
        self._intake.write(data)

    def finish(self) -> Arrival:
        return self._intake.finish()

    def discard(self) -> None:
        self._intake.discard()


class _Form:
    """An archive in the part `archive` of a form."""

    def __init__(self, context: Context, request: Request) -> None:
        limit = context.settings.max_archive_bytes
        self._reader = BatchReader(
            context,
            boundary_of(request.headers.get("content-type")),
            {"archive": lambda _filename: "archive"},
            max_bytes=limit + (1 << 16),
            max_files=1,
            max_file_bytes=limit,
        )
        self.take: Callable[[bytes], None] = self._reader.take

    def finish(self) -> Arrival:
        (arrival,) = self._reader.finish()
        with arrival.temporary.open("rb") as file:
            check_magic(file.read(512))
        return arrival

    def discard(self) -> None:
        self._reader.discard()
