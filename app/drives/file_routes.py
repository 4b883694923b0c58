"""Endpoints: the files of a drive, one by one, several at once, or as an archive."""

import re
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.context import Context, ContextDep
from app.drives import records
from app.drives.models import FileList, UnpackedArchive, UploadedBatch, UploadedFile
from app.drives.routes import DriveId
from app.drives.upload import check_magic, check_upload, keep, queue_archive, unpacked
from app.http.delivery import WholeFile
from app.http.gate import ClientDep
from app.http.headers import WaitSeconds
from app.http.intake import Arrival, Intake, receive, receive_file
from app.http.limits import declared_length
from app.http.multipart import BatchReader, Place, bad_part, boundary_of
from app.http.openapi import BINARY, body_of, get_and_head
from app.http.parameters import answer_page
from app.http.patterns import TEXT
from app.http.prices import priced
from app.jobs.view import wait_for_job
from app.paths import MAX_PATH, PATH_PATTERN, check_path
from app.states import FINAL
from app.store.models import Job
from interloc.drives.layouts import POSE_FILES, SCAN_FOLDERS, is_recording

router = APIRouter(prefix="/drives/{drive_id}", tags=["Uploads"])

FilePath = Annotated[
    str,
    Path(
        description="Path in the folder of the drive.",
        openapi_examples={"scan": {"value": "velodyne/000000.bin"}},
        json_schema_extra={"pattern": PATH_PATTERN, "maxLength": MAX_PATH},
    ),
]


@get_and_head(router, "/files", response_model=FileList, summary="List the files of a drive")
@priced("cheap")
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


@router.get(
    "/files/{path:path}",
    response_class=WholeFile,
    responses={
        200: {"content": {"application/octet-stream": {}}, "description": "The bytes."},
        206: {"content": {"application/octet-stream": {}}, "description": "The range that was asked for."},
    },
    summary="Download a file",
)
@priced("streaming")
def get_file(drive_id: DriveId, path: FilePath, context: ContextDep, _client: ClientDep) -> WholeFile:
    """Return an uploaded file, as long as it is kept."""
    file, sha256 = records.open_file(context, drive_id, path)
    headers = {"ETag": f'"{sha256}"', "X-Content-Type-Options": "nosniff"}
    with file:
        name = path.rpartition("/")[2]
        return WholeFile(file, media_type="application/octet-stream", filename=name, headers=headers)


@router.delete("/files/{path:path}", status_code=204, summary="Delete a file")
@priced("cheap")
def delete_file(drive_id: DriveId, path: FilePath, context: ContextDep, _client: ClientDep) -> None:
    """Remove a file of a drive that is not committed yet, or a map of a ready one that no job waits for or reads."""
    records.delete_file(context, drive_id, path)


def _numbered(folder: str, suffix: str) -> Place:
    def place(filename: str | None) -> str:
        if re.fullmatch(rf"\d{{1,18}}\.{suffix}", filename or "", re.ASCII) is None:
            raise bad_part(f"filename {filename!r}; expected the number of the scan, as 000000.{suffix}.")
        return f"{folder}/{filename}"

    return place


def _relative(filename: str | None) -> str:
    if not filename:
        raise bad_part("a part `files` has no filename; expected its path in the drive.")
    return check_path(filename)


def _named(path: str) -> Place:
    return lambda _filename: path


def _several(description: str) -> dict[str, Any]:
    return {"type": "array", "items": BINARY, "description": description}


_PARTS: dict[str, tuple[Place, dict[str, Any]]] = {
    "scans": (_numbered(SCAN_FOLDERS[0], "bin"), _several("Scans, with file names such as 000000.bin.")),
    "labels": (_numbered("labels", "label"), _several("Their labels, with file names such as 000000.label.")),
    "predictions": (
        _numbered("predictions", "label"),
        _several("Labels predicted by a network, with the same file names."),
    ),
    **{
        part: (_named(name), {**BINARY, "description": name})
        for part, name in {"poses": POSE_FILES[0], "calib": "calib.txt", "times": "times.txt", "geo": "geo.csv"}.items()
    },
    "files": (_relative, _several("Any other files, with their paths in the drive as file names.")),
}
"""The parts of a batch: where each goes, and its schema."""

_BATCH = {
    "type": "object",
    "properties": {name: schema for name, (_, schema) in _PARTS.items()},
    "minProperties": 1,
    "additionalProperties": False,
}


@router.post(
    "/scans",
    openapi_extra=body_of({"multipart/form-data": _BATCH}),
    summary="Upload a batch of scans",
)
@priced("streaming")
async def post_scans(drive_id: DriveId, request: Request, context: ContextDep, client: ClientDep) -> UploadedBatch:
    """Upload several files at once, all or none of them: small ones cost a fraction of a request for each.

    A part may have a Content-Digest, as a single file. A repeated request replaces files of the same names.
    """
    limits = context.settings
    length = declared_length(request, limits.max_batch_bytes, "A request with several files")
    boundary = boundary_of(request.headers.get("content-type"))
    await run_in_threadpool(check_upload, context, drive_id, [], length or 0, client)
    reader = BatchReader(
        context,
        boundary,
        {name: place for name, (place, _) in _PARTS.items()},
        max_bytes=limits.max_batch_bytes,
        max_files=limits.max_batch_files,
        max_file_bytes=limits.max_file_bytes,
    )

    def finish() -> list[UploadedFile]:
        arrivals = reader.finish()
        keep(context, drive_id, arrivals, client)
        return [UploadedFile(path=each.path, size_bytes=each.size_bytes, sha256=each.sha256) for each in arrivals]

    return UploadedBatch(files=await receive(request, length, reader.take, finish, reader.discard))


_ARCHIVE = {
    "type": "object",
    "properties": {"archive": BINARY},
    "required": ["archive"],
    "additionalProperties": False,
}


@router.post(
    "/archive",
    responses={202: {"model": UnpackedArchive, "description": "It is still being unpacked."}},
    openapi_extra=body_of({"application/octet-stream": BINARY, "multipart/form-data": _ARCHIVE}),
    summary="Upload an archive",
)
@priced("streaming")
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
    limit = context.settings.max_archive_bytes
    length = declared_length(request, limit, "An archive")
    await run_in_threadpool(check_upload, context, drive_id, ["archive"], length or 0, client, is_packed=True)
    content_type = request.headers.get("content-type", "")
    if content_type.startswith("multipart/"):
        job = await _receive_form(context, request, drive_id, client, boundary_of(content_type), length)
    else:
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


async def _receive_form(
    context: Context, request: Request, drive_id: str, client: str, boundary: bytes, length: int | None
) -> Job:
    """Receive an archive in the part `archive` of a form."""
    limit = context.settings.max_archive_bytes
    fields = {"archive": _named("archive")}
    reader = BatchReader(context, boundary, fields, max_bytes=limit + (1 << 16), max_files=1, max_file_bytes=limit)

    def finish() -> Job:
        (arrival,) = reader.finish()
        with arrival.temporary.open("rb") as file:
            check_magic(file.read(512))
        return queue_archive(context, drive_id, client, arrival)

    return await receive(request, length, reader.take, finish, reader.discard)
