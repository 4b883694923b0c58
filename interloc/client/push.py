"""Pushing of a drive: checked here, reduced on the way, complete on the server; an interruption costs nothing."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

from interloc.client.answers import DriveAnswer, FileAnswer, Refusal, parse
from interloc.client.connection import Connection
from interloc.client.consignment import Consignment, PushOptions, is_map
from interloc.client.journal import Journal, Sent, journal_folder
from interloc.client.parcels import Parcel
from interloc.client.upload import OnProgress, file_address, files_of, upload
from interloc.errors import NetworkError

OnStage = Callable[[str], None]
"""Told what begins, in words."""

_COMMIT_WAIT_S = 30


@dataclass(frozen=True)
class Pushed:
    """A drive on the server.

    Attributes
    ----------
    drive_id, name : str
    server : str
    scans, scans_sent : int
        In the drive, and how many of them the server has.
    files : int
        That the server has.
    files_sent, bytes_sent : int
        By this push, not by one before.
    bytes_there : int
        Size of all files on the server, as sent.
    source_bytes : int or None
        Size of the scans and labels that it was made of.
    seconds : float
        For the upload.
    maps : tuple of str
        Names of the maps that went along.
    report : dict or None
        What the server found in it (`DriveReport.to_dict`).
    """

    drive_id: str
    name: str
    server: str
    scans: int
    scans_sent: int
    files: int
    files_sent: int
    bytes_sent: int
    bytes_there: int
    source_bytes: int | None
    seconds: float
    maps: tuple[str, ...]
    report: dict[str, Any] | None

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON can hold."""
        return asdict(self)


def push(
    connection: Connection,
    root: Path,
    consignment: Consignment,
    options: PushOptions,
    *,
    threads: int = 8,
    journals: Path | None = None,
    on_stage: OnStage | None = None,
    on_progress: OnProgress | None = None,
) -> Pushed:
    """Bring a drive to the server, and have it checked there.

    Parameters
    ----------
    root
        Folder of the drive.
    consignment
        Of `consign`, by the same `options`.
    threads
        Files read, reduced and sent at once.
    journals
        Folder in which is remembered what was sent; in the cache of the user by default.
    on_stage, on_progress
        Told what happens.

    Raises
    ------
    DriveError
        A scan cannot be read, or the server finds the drive unusable and says why.
    NetworkError
        The server cannot be reached, or refuses. The next push goes on where this one stopped.
    OutputError
        What was sent cannot be remembered, or another process pushes the same drive.
    """
    tell = on_stage or (lambda _: None)
    with Journal(journals or journal_folder(), _identity(connection, root, options)) as journal:
        drive = _find_drive(connection, journal, consignment)
        parcels = [*consignment.parcels, *consignment.maps]
        if drive is None:
            tell("making the drive")
            drive = _make_drive(connection, consignment, options)
            journal.begin(drive.id)
        started = time.monotonic()
        if drive.state == "ready":  # its files are these; maps may be new
            tally = upload(connection, drive.id, consignment.maps, journal, threads=threads, on_progress=on_progress)
            tally = replace(tally, total=len(parcels), done=len(parcels))
        else:
            _remove_others(connection, drive.id, parcels)
            tally = upload(connection, drive.id, parcels, journal, threads=threads, on_progress=on_progress)
        seconds = time.monotonic() - started
        tell("the server checks the drive")
        drive = commit(connection, drive.id)
        there = files_of(connection, drive.id)
    return Pushed(
        drive_id=drive.id,
        name=drive.name,
        server=connection.server,
        scans=consignment.scans,
        scans_sent=consignment.scans_sent,
        files=len(there),
        files_sent=tally.sent,
        bytes_sent=tally.bytes_sent,
        bytes_there=sum(file.size_bytes for file in there.values()),
        source_bytes=consignment.source_bytes,
        seconds=seconds,
        maps=tuple(parcel.path for parcel in consignment.maps),
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
            raise NetworkError(f"{connection.server}: given up.")


def _identity(connection: Connection, root: Path, options: PushOptions) -> dict[str, Any]:
    """Return what makes a push the same as an earlier one."""
    chosen = {name: str(value) for name, value in vars(options).items() if name not in {"maps", "keyframes"}}
    by = options.keyframes
    thinning = None if by is None or options.raw else [by.distance_m, by.angle_deg]
    return {"format": 1, "server": connection.server, "drive": os.path.realpath(root), "thinning": thinning, **chosen}


def _find_drive(connection: Connection, journal: Journal, consignment: Consignment) -> DriveAnswer | None:
    """Return the drive of an earlier push that this one can go on with."""
    if journal.drive_id is None:
        return None
    try:
        drive = connection.ask("GET", f"/drives/{journal.drive_id}", DriveAnswer)
        if drive.state == "checking":
            try:
                drive = commit(connection, drive.id)
            except Refusal as error:
                if error.status != HTTPStatus.UNPROCESSABLE_ENTITY:
                    raise
                drive = connection.ask("GET", f"/drives/{journal.drive_id}", DriveAnswer)
        if drive.state == "ready" and not _is_whole(consignment.parcels, journal, files_of(connection, drive.id)):
            return None  # it changed here since then: a ready drive takes no other files
    except Refusal as error:
        if error.status == HTTPStatus.NOT_FOUND:
            return None  # deleted, or left alone for too long
        raise
    return drive


def _is_whole(parcels: list[Parcel], journal: Journal, there: dict[str, FileAnswer]) -> bool:
    """Tell whether the server has just these files, as far as can be told without reading them."""
    drive_files = {path for path in there if not is_map(path)}
    return drive_files == {parcel.path for parcel in parcels} and all(
        journal.sent(parcel.path) == Sent(parcel.signature, there[parcel.path].sha256) for parcel in parcels
    )


def _make_drive(connection: Connection, consignment: Consignment, options: PushOptions) -> DriveAnswer:
    """Make a new drive. An answer that is lost leaves an empty one behind, which the server sweeps up."""
    new = {"name": consignment.name, "keep_raw": options.keep_raw, "options": consignment.options}
    return connection.ask("POST", "/drives", DriveAnswer, json=new)


def _remove_others(connection: Connection, drive_id: str, parcels: list[Parcel]) -> None:
    """Take away what does not belong to the drive any more; maps may have been added by others."""
    wanted = {parcel.path for parcel in parcels}
    for path in files_of(connection, drive_id):
        if path not in wanted and not is_map(path):
            connection.request("DELETE", file_address(drive_id, path))
