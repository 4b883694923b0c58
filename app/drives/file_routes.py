"""Endpoints: the files of a drive, one by one, several at once, or as an archive."""

from typing import Annotated

from fastapi import Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.context import ContextDep
from app.drives import records
from app.drives.models import FileList, UnpackedArchive, UploadedFile
from app.drives.routes import DriveId
from app.drives.upload import check_magic, check_upload, keep, queue_archive, unpacked
from app.http.delivery import WholeFile
from app.http.fields import TEXT
from app.http.gate import ClientDep
from app.http.headers import WaitSeconds
from app.http.intake import Arrival, BatchReader, Intake, boundary_of, declared_length, receive, receive_file
from app.http.openapi import BINARY, body_of
from app.http.parameters import answer_page
from app.http.prices import priced
from app.http.routing import API, ApiRouter
from app.jobs.view import wait_for_job
from app.paths import MAX_PATH, check_path
from app.states import FINAL
from app.store.models import Job
from interloc.drives.layouts import is_recording

router = ApiRouter(f"{API}/drives/{{drive_id}}", tags=["Uploads"])

FilePath = Annotated[
    str,
    Path(
        description="Path in the folder of the drive.",
        openapi_examples={"scan": {"value": "velodyne/000000.bin"}},
        json_schema_extra={"maxLength": MAX_PATH},
    ),
]


@router.get_and_head("/files", response_model=FileList, summary="List the files of a drive")
@priced("cheap")
def list_files(
    drive_id: DriveId,
    request: Request,
    context: ContextDep,
    after: Annotated[
        str | None, Query(max_length=MAX_PATH, pattern=TEXT, description="`next` of the previous page.")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
) -> Response:
    """List what was uploaded, in the order of the paths. To resume an upload, send what is missing or differs."""
    page = records.list_files(context, drive_id, after, limit)
    return answer_page(request, page)


@router.put(
    "/files/{path:path}",
    responses={201: {"model": UploadedFile, "description": "The file is new."}},
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
@priced("streaming")
async def put_file(
    drive_id: DriveId, path: FilePath, request: Request, response: Response, context: ContextDep, client: ClientDep
) -> UploadedFile:
    """Upload one file as it is: 201 if it is new, 200 if it replaced a file of the same name.

    It gets its name only when it was received completely and is on disk; repeating the request changes nothing.
    """
    check_path(path)
    settings = context.settings
    limit = settings.max_recording_bytes if is_recording(path) else settings.max_file_bytes

    def keep_file(arrival: Arrival) -> UploadedFile:
        response.status_code = 201 if keep(context, drive_id, [arrival], client) else 200
        return UploadedFile(path=path, size_bytes=arrival.size_bytes, sha256=arrival.sha256)

    def check(length: int) -> None:
        check_upload(context, drive_id, [path], length, client)

    return await receive_file(request, path, limit, keep_file, check)


@router.get_and_head(
    "/files/{path:path}",
    response_class=WholeFile,
    responses={
        200: {"content": {"application/octet-stream": {}}, "description": "The bytes."},
        206: {"content": {"application/octet-stream": {}}, "description": "The range that was asked for."},
    },
    summary="Download a file",
)
@priced("streaming")
def get_file(drive_id: DriveId, path: FilePath, context: ContextDep) -> WholeFile:
    """Return an uploaded file, as long as it is kept."""
    with records.open_file(context, drive_id, path) as file:
        return WholeFile(file, media_type="application/octet-stream", filename=path.rpartition("/")[2])


@router.delete("/files/{path:path}", status_code=204, summary="Delete a file")
@priced("cheap")
def delete_file(drive_id: DriveId, path: FilePath, context: ContextDep) -> None:
    """Remove a file of a drive that is not committed yet, or a map of a ready one that no job waits for or reads."""
    records.delete_file(context, drive_id, path)


_BATCH = {
    "type": "object",
    "properties": {
        "files": {
            "type": "array",
            "items": BINARY,
            "description": "Files, with their paths in the drive as file names.",
        }
    },
    "required": ["files"],
    "additionalProperties": False,
}


@router.post("/scans", openapi_extra=body_of({"multipart/form-data": _BATCH}), summary="Upload several files")
@priced("streaming")
async def post_scans(drive_id: DriveId, request: Request, context: ContextDep, client: ClientDep) -> FileList:
    """Upload several files at once, all or none of them: small ones cost a fraction of a request for each.

    A part may have a Content-Digest, as a single file. A repeated request replaces files of the same names.
    """
    length = declared_length(request, context.settings.max_batch_bytes, "A request with several files")
    boundary = boundary_of(request.headers.get("content-type"))
    await run_in_threadpool(check_upload, context, drive_id, [], length or 0, client)
    reader = BatchReader(context, boundary)

    def finish() -> list[UploadedFile]:
        arrivals = reader.finish()
        keep(context, drive_id, arrivals, client)
        return [UploadedFile(path=each.path, size_bytes=each.size_bytes, sha256=each.sha256) for each in arrivals]

    return FileList(files=await receive(request, length, reader.take, finish, reader.discard))


@router.post(
    "/archive",
    responses={202: {"model": UnpackedArchive, "description": "It is still being unpacked."}},
    openapi_extra=body_of({"application/octet-stream": BINARY}),
    summary="Upload an archive",
)
@priced("streaming")
async def post_archive(
    drive_id: DriveId, request: Request, response: Response, context: ContextDep, client: ClientDep, wait_s: WaitSeconds
) -> UnpackedArchive:
    """Upload the files of a drive as .zip, .tar, .tar.gz or .tar.zst, and wait until it is unpacked.

    Its first bytes tell what it is, whatever the Content-Type. A leading folder is stripped. Links, devices, encrypted
    files, paths that lead out of the archive and archives of two drives are refused; nothing is kept of them.
    """
    limit = context.settings.max_drive_bytes
    length = declared_length(request, limit, "An archive")
    await run_in_threadpool(check_upload, context, drive_id, ["archive"], length or 0, client, is_packed=True)
    intake = Intake(context, "archive", limit)

    def take(data: bytes) -> None:
        if not intake.size_bytes:
            check_magic(data)
        intake.write(data)

    def finish() -> Job:
        return queue_archive(context, drive_id, client, intake.finish())

    job = await receive(request, length, take, finish, intake.discard)
    job = await wait_for_job(context, job.id, wait_s)
    if job.state not in FINAL:
        response.status_code = 202
        response.headers["Location"] = f"{context.settings.root_path}/api/v1/jobs/{job.id}"
    return unpacked(job)
