"""Sending a drive: checked here, reduced on the way, complete on the server; an interruption costs nothing."""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

from interloc.client.answers import DriveAnswer, FileAnswer, Refusal, parse
from interloc.client.connection import Connection
from interloc.client.prepare import PreparedDrive, PushOptions
from interloc.client.upload import OnProgress, UploadFile, file_address, files_of, upload
from interloc.client.upload_log import Sent, UploadLog, log_folder
from interloc.errors import NetworkError
from interloc.osm.container import is_map

OnStage = Callable[[str], None]
"""Called with what begins, in words."""

_COMMIT_WAIT_S = 30


@dataclass(frozen=True)
class Pushed:
    """A drive on the server."""

    drive_id: str
    name: str
    server: str
    scans: int
    scans_sent: int
    """Scans of the drive, and how many of them the server has."""
    files: int
    """Files that the server has."""
    files_sent: int
    bytes_sent: int
    """What this push has sent, not an earlier one."""
    bytes_there: int
    """Size of all files on the server, as sent."""
    source_bytes: int | None
    """Size of the scans and labels that they were made from."""
    seconds: float
    """Duration of the upload."""
    maps: tuple[str, ...]
    """Names of the maps that were sent too."""
    report: dict[str, Any] | None
    """What the server found in it (`DriveReport.to_dict`)."""

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, for JSON."""
        return asdict(self)


def push(
    connection: Connection,
    root: Path,
    prepared: PreparedDrive,
    options: PushOptions,
    *,
    threads: int = 8,
    logs: Path | None = None,
    on_stage: OnStage | None = None,
    on_progress: OnProgress | None = None,
) -> Pushed:
    """Send a drive to the server, and have it checked there.

    Parameters
    ----------
    root
        Folder of the drive.
    prepared
        The result of `prepare` with the same `options`.
    threads
        Number of files that are read, reduced and sent at once.
    logs
        Folder of the logs of what was sent; in the user's cache by default.
    on_stage, on_progress
        Called when a stage begins, and with the progress of the upload.

    Raises
    ------
    DriveError
        A scan cannot be read, or the server finds the drive unusable and says why.
    NetworkError
        The server cannot be reached, or refuses. The next push goes on where this one stopped.
    OutputError
        The log of what was sent cannot be written, or another process pushes the same drive.
    """
    report_stage = on_stage or (lambda _: None)
    with UploadLog(logs or log_folder(), _identity(connection, root, options)) as log:
        drive = _find_drive(connection, log, prepared)
        files = [*prepared.files, *prepared.maps]
        if drive is None:
            report_stage("making the drive")
            drive = _make_drive(connection, prepared, options)
            log.begin(drive.id)
        started = time.monotonic()
        if drive.state == "ready":  # its files are these; maps may be new
            progress = upload(connection, drive.id, prepared.maps, log, threads=threads, on_progress=on_progress)
            progress = replace(progress, total=len(files), done=len(files))
        else:
            _remove_others(connection, drive.id, files)
            progress = upload(connection, drive.id, files, log, threads=threads, on_progress=on_progress)
        seconds = time.monotonic() - started
        report_stage("the server checks the drive")
        drive = commit(connection, drive.id)
        there = files_of(connection, drive.id)
    return Pushed(
        drive_id=drive.id,
        name=drive.name,
        server=connection.server,
        scans=prepared.scans,
        scans_sent=prepared.scans_sent,
        files=len(there),
        files_sent=progress.sent,
        bytes_sent=progress.bytes_sent,
        bytes_there=sum(file.size_bytes for file in there.values()),
        source_bytes=prepared.source_bytes,
        seconds=seconds,
        maps=tuple(file.path for file in prepared.maps),
        report=drive.report,
    )


def commit(connection: Connection, drive_id: str) -> DriveAnswer:
    """Have the server check a drive, and wait until it is ready for jobs.

    Raises
    ------
    Refusal
        The drive cannot be used; the text names every problem.
    NetworkError
        The server cannot be reached.
    """
    headers = {"Prefer": f"wait={_COMMIT_WAIT_S}"}
    while True:
        response = connection.request("POST", f"/drives/{drive_id}/commit", json={}, headers=headers)
        drive = parse(response, DriveAnswer, connection.server)
        if drive.state == "ready":
            return drive
        if connection.closing.wait(0.5):
            raise NetworkError(f"{connection.server}: stopped waiting.")


def _identity(connection: Connection, root: Path, options: PushOptions) -> dict[str, Any]:
    """Return what identifies a push: with the same values it continues an earlier one."""
    chosen = {**vars(options), **dict(options.reading)}
    chosen = {name: str(value) for name, value in chosen.items() if name not in {"maps", "keyframes", "reading"}}
    by = options.keyframes
    thinning = None if by is None or options.raw else [by.distance_m, by.angle_deg]
    return {"format": 1, "server": connection.server, "drive": os.path.realpath(root), "thinning": thinning, **chosen}


def _find_drive(connection: Connection, log: UploadLog, prepared: PreparedDrive) -> DriveAnswer | None:
    """Return the drive of an earlier push, if this one can continue it."""
    if log.drive_id is None:
        return None
    try:
        drive = connection.ask("GET", f"/drives/{log.drive_id}", DriveAnswer)
        if drive.state == "checking":
            try:
                drive = commit(connection, drive.id)
            except Refusal as error:
                if error.status != HTTPStatus.UNPROCESSABLE_ENTITY:
                    raise
                drive = connection.ask("GET", f"/drives/{log.drive_id}", DriveAnswer)
        if drive.state == "ready" and not _is_whole(prepared.files, log, files_of(connection, drive.id)):
            return None  # it has changed here since then, and a ready drive accepts no other files
    except Refusal as error:
        if error.status == HTTPStatus.NOT_FOUND:
            return None  # deleted, or removed because nothing came for too long
        raise
    return drive


def _is_whole(files: list[UploadFile], log: UploadLog, there: dict[str, FileAnswer]) -> bool:
    """Tell whether the server has exactly these files, as far as that shows without reading them."""
    drive_files = {path for path in there if not is_map(path)}
    return drive_files == {file.path for file in files} and all(
        log.sent(file.path) == Sent(file.signature, there[file.path].sha256) for file in files
    )


def _make_drive(connection: Connection, prepared: PreparedDrive, options: PushOptions) -> DriveAnswer:
    """Make a new drive; the key makes it safe to ask again when an answer is lost: there will be one."""
    new = {"name": prepared.name, "keep_raw": options.keep_raw, "options": prepared.options}
    key = {"Idempotency-Key": secrets.token_hex(16)}
    return connection.ask("POST", "/drives", DriveAnswer, json=new, headers=key)


def _remove_others(connection: Connection, drive_id: str, files: list[UploadFile]) -> None:
    """Remove files that no longer belong to the drive; maps may have been added by others."""
    wanted = {file.path for file in files}
    for path in files_of(connection, drive_id):
        if path not in wanted and not is_map(path):
            connection.request("DELETE", file_address(drive_id, path))
