"""Fetching a result: the folder exactly as the service has it, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path, PurePosixPath
from urllib.parse import quote

from interloc.client.answers import Refusal, ResultFileAnswer, ResultFilesAnswer
from interloc.client.connection import Connection
from interloc.errors import NetworkError
from interloc.output.layout import RUN_FILE, result_folder

OnBytes = Callable[[int, int], None]
"""Called with the bytes fetched and the bytes in all; may raise an exception to stop."""

_ATTEMPTS = 4


def fetch(connection: Connection, job_id: str, out: Path, *, on_bytes: OnBytes | None = None) -> list[Path]:
    """Fetch the result folder of a successful job.

    Parameters
    ----------
    out
        The folder to write. It must not exist, be empty, or hold an older result, which is replaced.

    Returns
    -------
    list of Path
        The files, relative to the folder.

    Raises
    ------
    Refusal
        There is no such job, or it was not successful.
    NetworkError
        The service cannot be reached, or what it sends does not fit what it lists.
    OutputError
        The folder cannot be written.
    """
    address = f"/jobs/{quote(job_id, safe='')}/files"
    files = connection.ask("GET", address, ResultFilesAnswer).files
    names = [_checked(connection, file.name) for file in files]
    if Path(RUN_FILE) not in names:
        raise NetworkError(f"{connection.server}: job {job_id} has no {RUN_FILE}, so it is not the result of a drive.")
    total, done = sum(file.size_bytes for file in files), 0
    with result_folder(out) as folder:
        for file, name in zip(files, names, strict=True):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            _fetch_file(connection, f"{address}/{quote(file.name)}", file, folder / name)
            done += file.size_bytes
            if on_bytes is not None:
                on_bytes(done, total)
    return names


def _fetch_file(connection: Connection, address: str, file: ResultFileAnswer, path: Path) -> None:
    """Write one file; an answer that breaks off is asked for again."""
    for attempt in range(1, _ATTEMPTS + 1):
        try:
            written = _write(connection, address, path, file.size_bytes)
        except NetworkError as error:
            if attempt == _ATTEMPTS or (isinstance(error, Refusal) and error.status < HTTPStatus.INTERNAL_SERVER_ERROR):
                raise
            connection.check_server()  # waits for a server that is busy or restarts
            continue
        if written == file.size_bytes:
            return
    raise NetworkError(
        f"{connection.server}: {file.name} came with {written:,} bytes, but is listed with {file.size_bytes:,}. "
        "Usual cause: a proxy that changes answers."
    )


def _write(connection: Connection, address: str, path: Path, size: int) -> int:
    """Write an answer to a file, but not much more than expected; return the bytes written."""
    with connection.stream(address) as response, path.open("wb") as target:
        for piece in response.iter_bytes():
            target.write(piece)
            if target.tell() > size:
                break
        return target.tell()


def _checked(connection: Connection, name: str) -> Path:
    """Return the name of a file if it stays within the folder."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or not path.parts or any(c in name for c in "\\:\0"):
        raise NetworkError(f"{connection.server} lists a file of the result as {name!r}, which was not written.")
    return Path(path)
