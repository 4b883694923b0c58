"""Jobs of the service: submitting them, following them to their end, and fetching what they found."""

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal
from urllib.parse import quote

from pydantic import BaseModel, Field

from interloc.arrays import JsonObject
from interloc.client.connection import BUSY, Connection, ProblemAnswer, Refusal
from interloc.config import DetectorConfig, preset
from interloc.errors import InterLocError, NetworkError
from interloc.osm.policies import Policy
from interloc.output.layout import RUN_FILE, result_folder

OnBytes = Callable[[int, int], None]
"""Called with the bytes fetched and the bytes in all; may raise an exception to stop."""

_POLL_S, _PAUSE_S = 1.0, 3.0


class ProgressAnswer(BaseModel):
    """The progress of a job."""

    done: int = 0
    total: int | None = None


class JobAnswer(BaseModel):
    """A job."""

    id: str = Field(pattern=r"^[\w-]{1,64}$")
    drive_id: str
    drive_name: str = ""
    state: Literal["accepted", "running", "successful", "failed", "dismissed"]
    stage: str = ""
    message: str | None = None
    progress: ProgressAnswer = ProgressAnswer()
    error: ProblemAnswer | None = None
    summary: JsonObject | None = None


class ResultFileAnswer(BaseModel):
    """A file of a result."""

    name: str = Field(min_length=1, max_length=512)
    size_bytes: int = Field(ge=0)


class ResultFilesAnswer(BaseModel):
    """All files of a result."""

    files: list[ResultFileAnswer] = Field(max_length=100_000)


@dataclass(frozen=True)
class JobRequest:
    """What the service is to do with a drive: find its intersections, and score them where a map is given."""

    config: DetectorConfig
    labels: str | None = None
    """"labels", "predictions" or "geometry"; None: the one that the drive has."""
    osm: str | None = None
    """Name of a map among the files of the drive."""
    overpass: bool = False
    """Let the service fetch the present map from OpenStreetMap instead."""
    policy: Policy = "drive"
    tolerance_m: float = 15.0
    """Which OSM nodes count as intersections."""
    place: JsonObject | None = None
    """Place the drive on the map by its roads, and where to search: the result of `placing`."""


def submit(connection: Connection, drive_id: str, wanted: JobRequest) -> JobAnswer:
    """Let the service work on a drive that is ready or being checked; a `Refusal` says why it does not."""
    request: JsonObject = {"drive_id": drive_id, "policy": wanted.policy, "tolerance_m": wanted.tolerance_m}
    request |= {"preset": wanted.config.preset, **_differences(wanted.config)}
    if wanted.labels is not None:
        request["labels"] = wanted.labels
    if wanted.osm is not None or wanted.overpass:
        request["osm"] = {"overpass": True} if wanted.osm is None else {"file": wanted.osm}
    request |= wanted.place or {}
    # The key makes it safe to ask again when an answer is lost: there will be one job.
    return connection.ask("POST", "/jobs", JobAnswer, json=request, headers={"Idempotency-Key": secrets.token_hex(16)})


def placing(near: tuple[float, float] | None, radius_m: float | None = None) -> JsonObject:
    """Return what of a request says that a drive is to be placed on the map, and around which latitude, longitude."""
    there = None if near is None else {"lat_deg": near[0], "lon_deg": near[1], "radius_km": (radius_m or 3000.0) / 1e3}
    return {"georeference": "map", "near": there}


def follow(connection: Connection, job_id: str, on_change: Callable[[JobAnswer], None] | None = None) -> JobAnswer:
    """Wait for the end of a job, and return it; `on_change` is called with the job every second.

    An `InterLocError` with the service's text says that it failed or was cancelled.
    """
    while True:
        job = connection.ask("GET", f"/jobs/{quote(job_id, safe='')}", JobAnswer)
        if on_change is not None:
            on_change(job)
        if job.state == "successful":
            return job
        if job.state == "dismissed":
            raise InterLocError(f"job {job.id} was cancelled.")
        if job.state == "failed":
            raise InterLocError(f"job {job.id} failed: {job.error or 'the server does not say why'}")
        if connection.closing.wait(_POLL_S):
            raise NetworkError(f"{connection.server}: stopped waiting.")


def _differences(config: DetectorConfig) -> JsonObject:
    """Return the settings that differ from their preset, in its shape; a section of another kind whole."""
    ours, theirs = config.model_dump(mode="json"), preset(config.preset).model_dump(mode="json")
    changed: JsonObject = {}
    for section, values in ours.items():
        base = theirs[section]
        if values == base:
            continue
        if isinstance(values, dict) and isinstance(base, dict) and values.get("kind") == base.get("kind"):
            changed[section] = {name: value for name, value in values.items() if value != base[name]}
        else:
            changed[section] = values
    return {"config": changed} if changed else {}


def fetch(connection: Connection, job_id: str, out: Path, *, on_bytes: OnBytes | None = None) -> list[Path]:
    """Fetch the result folder of a successful job; return its files, relative to the folder.

    The folder to write must not exist, be empty, or hold an older result, which is replaced. A `NetworkError` also says
    that what the service sends does not fit what it lists.
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
            written = _write(connection, f"{address}/{quote(file.name)}", folder / name, file.size_bytes)
            if written != file.size_bytes:
                raise NetworkError(
                    f"{connection.server}: {file.name} came with {written:,} bytes, but is listed with "
                    f"{file.size_bytes:,}. Usual cause: a proxy that changes answers."
                )
            done += file.size_bytes
            if on_bytes is not None:
                on_bytes(done, total)
    return names


def _write(connection: Connection, address: str, path: Path, size: int, attempts: int = 4) -> int:
    """Write an answer to a file, but not much more than expected; return its bytes. What breaks off comes once more."""
    try:
        with connection.stream(address) as response, path.open("wb") as target:
            for piece in response.iter_bytes():
                target.write(piece)
                if target.tell() > size:
                    break
            return target.tell()
    except NetworkError as error:
        is_final = isinstance(error, Refusal) and error.status not in BUSY
        if is_final or attempts == 1 or connection.closing.wait(_PAUSE_S):
            raise
    return _write(connection, address, path, size, attempts - 1)


def _checked(connection: Connection, name: str) -> Path:
    """Return the name of a file if it stays within the folder."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or not path.parts or any(c in name for c in "\\:\0"):
        raise NetworkError(f"{connection.server} lists a file of the result as {name!r}, which was not written.")
    return Path(path)
