"""Jobs of the service: submitting them, and following them to their end."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from pydantic import ValidationError

from interloc.client.answers import JobAnswer, JobsAnswer, media_type
from interloc.client.connection import Connection
from interloc.config import DetectorConfig, preset
from interloc.errors import InterLocError, NetworkError
from interloc.osm.policies import Policy

OnChange = Callable[[JobAnswer], None]

_POLL_S = 1.0
_MAX_EVENT_BYTES = 4 * 1024**2
_SILENCE_S = 45.0  # a stream of events is never silent for so long: the service sends comments in between


@dataclass(frozen=True)
class JobRequest:
    """What the service is to do with a drive: find its intersections, and score them where a map is given."""

    config: DetectorConfig
    """Settings of the method."""
    labels: str | None = None
    """"labels" or "predictions"; None: the one that the drive has."""
    osm: str | None = None
    """Name of a map among the files of the drive."""
    overpass: bool = False
    """Let the service fetch the present map from OpenStreetMap instead."""
    policy: Policy = "drive"
    tolerance_m: float = 15.0
    """Which OSM nodes count as intersections."""
    place: dict[str, Any] | None = None
    """Place the drive on the map by its roads, and where to search: the result of `placing`."""


def submit(
    connection: Connection, drive_id: str, wanted: JobRequest, *, subscriber: dict[str, str] | None = None
) -> JobAnswer:
    """Let the service work on a drive that is ready or being checked.

    Parameters
    ----------
    subscriber
        Addresses that the service calls when the job begins or ends, if it may.

    Raises
    ------
    Refusal
        The service refuses and says why: no such drive, an invalid setting, a full queue.
    NetworkError
        The service cannot be reached.
    """
    request: dict[str, Any] = {"drive_id": drive_id, "policy": wanted.policy, "tolerance_m": wanted.tolerance_m}
    request |= {"preset": wanted.config.preset, **_differences(wanted.config)}
    if wanted.labels is not None:
        request["labels"] = wanted.labels
    if wanted.osm is not None or wanted.overpass:
        request["osm"] = {"overpass": True} if wanted.osm is None else {"file": wanted.osm}
    request |= wanted.place or {}
    if subscriber is not None:
        request["subscriber"] = subscriber
    # The key makes it safe to ask again when an answer is lost: there will be one job.
    return connection.ask("POST", "/jobs", JobAnswer, json=request, headers={"Idempotency-Key": secrets.token_hex(16)})


def placing(near: tuple[float, float] | None, radius_m: float | None = None) -> dict[str, Any]:
    """Return what of a request says that a drive is to be placed on the map, and around which latitude, longitude."""
    there = None if near is None else {"lat_deg": near[0], "lon_deg": near[1], "radius_km": (radius_m or 3000.0) / 1e3}
    return {"georeference": "map", "near": there}


def finished(connection: Connection, drive_id: str, wanted: JobRequest) -> JobAnswer | None:
    """Return the newest job of a drive that has done what is wanted; None where there is none.

    It counts only if the files of the drive have not changed since; a map of Overpass is another one every day.
    """
    done = {
        "config": wanted.config.model_dump(mode="json"),
        "labels": wanted.labels,
        "osm": None if wanted.osm is None else {"file": wanted.osm},
        "policy": wanted.policy,
        "tolerance_m": wanted.tolerance_m,
        **(placing(None) | {"georeference": "drive"} if wanted.place is None else wanted.place),
    }
    address = f"/jobs?drive={quote(drive_id, safe='')}&state=successful&limit=1000"
    jobs = connection.ask("GET", address, JobsAnswer).jobs
    return next((job for job in jobs if {name: job.request.get(name) for name in done} == done), None)


def follow(connection: Connection, job_id: str, on_change: OnChange | None = None) -> JobAnswer:
    """Wait for the end of a job.

    Parameters
    ----------
    on_change
        Called with the job at every change.

    Returns
    -------
    JobAnswer
        The successful job.

    Raises
    ------
    InterLocError
        The job failed or was cancelled; the text is the service's.
    Refusal, NetworkError
        There is no such job, or the service does not answer.
    """
    for job in _changes(connection, job_id):
        if on_change is not None:
            on_change(job)
        if job.is_final:
            return _successful(job)
    raise AssertionError  # changes come until the end


def _changes(connection: Connection, job_id: str) -> Iterator[JobAnswer]:
    """Yield the job, and again at each change: by events, and by asking wherever those fail."""
    address = f"/jobs/{quote(job_id, safe='')}"
    while True:
        job = connection.ask("GET", address, JobAnswer)
        yield job
        if job.is_final:
            return
        try:
            for changed in _events(connection, f"{address}/events", job.version):
                yield changed
                if changed.is_final:
                    return
        except NetworkError:
            pass  # the next request shows what is wrong
        if connection.closing.wait(_POLL_S):
            raise NetworkError(f"{connection.server}: stopped waiting.")


def _events(connection: Connection, address: str, version: int) -> Iterator[JobAnswer]:
    headers = {"Accept": "text/event-stream", "Last-Event-ID": str(version)}
    with connection.stream(address, headers=headers, timeout_s=_SILENCE_S) as response:
        if media_type(response) != "text/event-stream":
            raise NetworkError(f"{connection.server}: {address} does not send events.")
        for data in read_events(response.iter_raw()):
            if not data:  # nothing new for a while, or an event was lost: the next request shows which
                return
            try:
                yield JobAnswer.model_validate_json(data)
            except ValidationError as error:
                raise NetworkError(f"{connection.server}: {address} sends events that are not jobs.") from error


def read_events(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the data of each server-sent event of a stream, and ``b""`` for each comment (a sign of life).

    An event cut off at the end is dropped.

    Raises
    ------
    NetworkError
        An event is longer than 4 MB.
    """
    pending, data = b"", []
    for piece in pieces:
        *lines, pending = (pending + piece).replace(b"\r\n", b"\n").split(b"\n")
        for line in lines:
            name, _, value = line.partition(b":")
            if name == b"data":
                data.append(value.removeprefix(b" "))
            elif line.startswith(b":"):
                yield b""
            elif not line and data:
                yield b"\n".join(data)
                data = []
        if len(pending) + sum(map(len, data)) > _MAX_EVENT_BYTES:
            raise NetworkError("the server sent an event without an end")


def _successful(job: JobAnswer) -> JobAnswer:
    if job.state == "successful":
        return job
    if job.state == "dismissed":
        raise InterLocError(f"job {job.id} was cancelled.")
    raise InterLocError(f"job {job.id} failed: {job.error or 'the server does not say why'}")


def _differences(config: DetectorConfig) -> dict[str, Any]:
    """Return the settings that differ from their preset, in its shape; a section of another kind whole."""
    ours, theirs = config.model_dump(mode="json"), preset(config.preset).model_dump(mode="json")
    changed: dict[str, Any] = {}
    for section, values in ours.items():
        base = theirs[section]
        if values == base:
            continue
        if isinstance(values, dict) and isinstance(base, dict) and values.get("kind") == base.get("kind"):
            changed[section] = {name: value for name, value in values.items() if value != base[name]}
        else:
            changed[section] = values
    return {"config": changed} if changed else {}
