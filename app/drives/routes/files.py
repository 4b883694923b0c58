"""Endpoints: the files of a drive, one by one."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.context import ContextDep
from app.drives import records
from app.drives.models import FileList, UploadedFile
from app.drives.routes.drives import DriveId
from app.drives.upload import check_upload, keep
from app.http.delivery import WholeFile
from app.http.headers import sha256_of
from app.http.intake import PIECE_BYTES, Intake, receive
from app.http.limits import Booking, check_free_space, declared_length
from app.http.openapi import BINARY, PAGED, Responses, body_of, problems
from app.http.paging import answer_page
from app.http.patterns import TEXT
from app.http.security import ClientDep
from app.paths import MAX_PATH, PATH_PATTERN, check_path
from interloc.drives.kinds import is_recording

router = APIRouter(prefix="/drives/{drive_id}/files", tags=["Uploads"])

FilePath = Annotated[
    str,
    Path(
        description="Path in the folder of the drive.",
        openapi_examples={"scan": {"value": "velodyne/000000.bin"}},
        json_schema_extra={"pattern": PATH_PATTERN, "maxLength": MAX_PATH},
    ),
]

NOT_FOUND = problems({404: "There is no such drive or file."})
CLOSED = problems({409: "The drive takes no such files in its state, or names are in conflict."})
UPLOAD: Responses = {
    **problems({400: "The body ended too soon, or is only a part of a file."}),
    **NOT_FOUND,
    **CLOSED,
    **problems(
        {
            413: "The file is too large, or the drive would become too large.",
            415: "The body is compressed, or of a kind that is not taken.",
            507: "The disk is full.",
        }
    ),
}


@router.get(
    "",
    responses={**PAGED, **NOT_FOUND},
    response_model=FileList,
    summary="List the files of a drive",
)
def list_files(
    drive_id: DriveId,
    request: Request,
    context: ContextDep,
    _client: ClientDep,
    after: Annotated[
        str | None, Query(max_length=MAX_PATH, pattern=TEXT, description="`next` of the previous page.")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
) -> Response:
    """List what was uploaded, in the order of the paths. To resume an upload, send what is missing or differs."""
    page = records.list_files(context, drive_id, after, limit)
    return answer_page(request, page)


@router.put(
    "/{path:path}",
    response_model=UploadedFile,
    responses={201: {"model": UploadedFile, "description": "The file is new."}, **UPLOAD},
    openapi_extra={
        **body_of({"application/octet-stream": BINARY}),
        "parameters": [
            {
                "in": "header",
                "name": "Content-Digest",
                "required": False,
                "description": "SHA-256 of the body (RFC 9530); a body that differs is refused.",
                "schema": {"type": "string", "pattern": "^sha-256=:[A-Za-z0-9+/]{42}[AEIMQUYcgkosw048]=:$"},
                "example": "sha-256=:RK/0qy18MlBSVnWgjwz6lZEWjP/lF5HF9bvEF8FabDg=:",
            }
        ],
    },
    summary="Upload a file",
)
async def put_file(
    drive_id: DriveId, path: FilePath, request: Request, response: Response, context: ContextDep, client: ClientDep
) -> UploadedFile:
    """Upload one file as it is: 201 if it is new, 200 if it replaced a file of the same name.

    It gets its name only when it was received completely and is on disk; repeating the request changes nothing.
    """
    check_path(path)
    sha256 = sha256_of(request.headers)
    settings = context.settings
    limit = settings.max_recording_bytes if is_recording(path) else settings.max_file_bytes
    length = declared_length(request, limit, path)
    intake = Intake(context, path, limit)

    def finish() -> tuple[UploadedFile, bool]:
        check_free_space(context, 0)
        arrival = intake.finish(sha256)
        new = keep(context, drive_id, [arrival], client)
        return UploadedFile(path=path, size_bytes=arrival.size_bytes, sha256=arrival.sha256), new

    with Booking(context) as booking:
        if length is None or length > PIECE_BYTES:  # a small body is read sooner than the drive is looked up
            await run_in_threadpool(check_upload, context, drive_id, path, length or 0, client)
            await run_in_threadpool(booking.announce, length)
        try:
            file, new = await receive(request, booking.taking(intake.write), finish)
        finally:
            intake.discard()
    response.status_code = 201 if new else 200
    return file


@router.get(
    "/{path:path}",
    response_class=WholeFile,
    responses={
        200: {"content": {"application/octet-stream": {}}, "description": "The bytes."},
        206: {"content": {"application/octet-stream": {}}, "description": "The range that was asked for."},
        **NOT_FOUND,
        **problems({410: "It was reduced to what the method needs.", 416: "There is no such range."}),
    },
    summary="Download a file",
)
def get_file(drive_id: DriveId, path: FilePath, context: ContextDep, _client: ClientDep) -> WholeFile:
    """Return an uploaded file, as long as it is kept."""
    file, sha256 = records.open_file(context, drive_id, path)
    headers = {"ETag": f'"{sha256}"', "X-Content-Type-Options": "nosniff"}
    with file:
        name = path.rpartition("/")[2]
        return WholeFile(file, media_type="application/octet-stream", filename=name, headers=headers)


@router.delete("/{path:path}", status_code=204, responses={**NOT_FOUND, **CLOSED}, summary="Delete a file")
def delete_file(drive_id: DriveId, path: FilePath, context: ContextDep, _client: ClientDep) -> None:
    """Remove a file of a drive that is not committed yet, or a map of a ready one that no job waits for or reads."""
    records.delete_file(context, drive_id, path)
