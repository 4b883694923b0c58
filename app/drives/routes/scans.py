"""Endpoint for several files in one request."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool

from app.context import ContextDep
from app.drives.models import UploadedBatch, UploadedFile
from app.drives.routes.drives import DriveId
from app.drives.routes.files import UPLOAD
from app.drives.upload import check_upload, keep
from app.http.intake import receive
from app.http.limits import Booking, check_free_space, declared_length
from app.http.multipart import FIELDS, BatchReader, boundary_of
from app.http.openapi import BINARY, body_of
from app.http.security import ClientDep

router = APIRouter(prefix="/drives/{drive_id}/scans", tags=["Uploads"])

_FILES = {"type": "array", "items": BINARY}
_ABOUT = {
    "scans": {**_FILES, "description": "Scans, with file names such as 000000.bin."},
    "labels": {**_FILES, "description": "Their labels, with file names such as 000000.label."},
    "predictions": {**_FILES, "description": "Labels predicted by a network, with the same file names."},
    "poses": {**BINARY, "description": "poses.txt"},
    "calib": {**BINARY, "description": "calib.txt"},
    "times": {**BINARY, "description": "times.txt"},
    "geo": {**BINARY, "description": "geo.csv"},
    "files": {**_FILES, "description": "Any other files, with their paths in the drive as file names."},
}
_FORM = {"type": "object", "properties": _ABOUT, "minProperties": 1, "additionalProperties": False}


@router.post(
    "",
    response_model=UploadedBatch,
    responses=UPLOAD,
    openapi_extra=body_of({"multipart/form-data": _FORM}),
    summary="Upload a batch of scans",
)
async def post_scans(drive_id: DriveId, request: Request, context: ContextDep, client: ClientDep) -> UploadedBatch:
    """Upload several files at once, all or none of them. A repeated request replaces files of the same names."""
    limits = context.settings
    length = declared_length(request, limits.max_batch_bytes, "A request with several files")
    boundary = boundary_of(request.headers.get("content-type"))
    await run_in_threadpool(check_upload, context, drive_id, "batch", length or 0, client)
    reader = BatchReader(
        context,
        boundary,
        FIELDS,
        max_bytes=limits.max_batch_bytes,
        max_files=limits.max_batch_files,
        max_file_bytes=limits.max_file_bytes,
    )

    def finish() -> list[UploadedFile]:
        check_free_space(context, 0)
        arrivals = reader.finish()
        keep(context, drive_id, arrivals, client)
        return [UploadedFile(path=each.path, size_bytes=each.size_bytes, sha256=each.sha256) for each in arrivals]

    with Booking(context) as booking:
        await run_in_threadpool(booking.announce, length)
        try:
            return UploadedBatch(files=await receive(request, booking.taking(reader.take), finish))
        finally:
            await run_in_threadpool(reader.discard)
