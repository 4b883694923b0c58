"""Endpoints: a whole drive as one archive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from fastapi import APIRouter, Header, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.drives.archives import check_magic, queue_archive, unpacked
from app.drives.batches import BatchReader, boundary_of
from app.drives.intake import Arrival, Intake, receive
from app.drives.limits import check_free_space, declared_length
from app.drives.placement import check_upload
from app.drives.preferences import wait_of
from app.jobs.queue import FINAL
from app.jobs.waiting import wait_for_async
from app.models import Job
from app.routes.files import UPLOAD
from app.schemas.drives import UnpackedArchive
from app.security import ClientDep
from app.service import Service, ServiceDep

router = APIRouter(prefix="/drives/{drive_id}/archive", tags=["Uploads"])

PreferHeader = Annotated[
    str | None,
    Header(description="wait=SECONDS, at most 300, 50 by default; respond-async not to wait (RFC 7240)."),
]
_BINARY = {"schema": {"type": "string", "format": "binary"}}
_KINDS = ("application/octet-stream", "application/zip", "application/x-tar", "application/gzip", "application/zstd")
_FORM = {"schema": {"type": "object", "properties": {"archive": _BINARY["schema"]}, "required": ["archive"]}}


@router.post(
    "",
    response_model=UnpackedArchive,
    responses={202: {"model": UnpackedArchive, "description": "It is still being unpacked."}, **UPLOAD},
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {**dict.fromkeys(_KINDS, _BINARY), "multipart/form-data": _FORM},
        }
    },
    summary="Upload an archive",
)
async def post_archive(
    drive_id: str,
    request: Request,
    response: Response,
    service: ServiceDep,
    client: ClientDep,
    prefer: PreferHeader = None,
) -> UnpackedArchive:
    """Upload the files of a drive as .zip, .tar, .tar.gz or .tar.zst, and wait until it is unpacked.

    A leading folder is stripped. Links, devices, encrypted files, paths that lead out of the archive and archives of
    two drives are refused; nothing is kept of them.
    """
    length = declared_length(request, service.settings.max_archive_bytes, "An archive")
    await run_in_threadpool(check_upload, service, drive_id, "archive", 0)
    await run_in_threadpool(check_free_space, service, length or 0)
    is_form = request.headers.get("content-type", "").startswith("multipart/")
    intake = _Form(service, request) if is_form else _Body(service)

    def finish() -> Job:
        check_free_space(service, 0)
        return queue_archive(service, drive_id, client, intake.finish())

    try:
        job = await receive(request, intake.take, finish)
    finally:
        await run_in_threadpool(intake.discard)
    wait_s = wait_of(prefer)
    job = await wait_for_async(service, job.id, wait_s)
    if job.state not in FINAL:
        response.status_code = 202
        response.headers["Location"] = f"{service.settings.root_path}/api/v1/jobs/{job.id}"
    if prefer:
        response.headers["Preference-Applied"] = f"wait={wait_s}"
    return unpacked(job)


class _Body:
    """An archive that is the body itself; what is none is refused by its first bytes."""

    def __init__(self, service: Service) -> None:
        self._intake = Intake(service, "archive", service.settings.max_archive_bytes)

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

    def __init__(self, service: Service, request: Request) -> None:
        limit = service.settings.max_archive_bytes
        self._reader = BatchReader(
            service,
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
