"""Sending a drive: checked here, reduced on the way, complete on the server; an interruption costs nothing."""

import hashlib
import json
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from http import HTTPStatus
from pathlib import Path

from pydantic import BaseModel, Field

from interloc.arrays import JsonObject
from interloc.client.connection import Connection, Refusal
from interloc.client.upload import OnProgress, UploadFile, files_of, upload
from interloc.config import DEFAULT, KeyframeConfig
from interloc.drives.findings import Findings
from interloc.drives.open import read_drive
from interloc.drives.options import DriveOptions, LabelFolder, ReadingOptions
from interloc.drives.scans.raw import RawScans
from interloc.drives.scans.reduced_format import MANIFEST, ReducedManifest, ground_path, is_reduced, read_manifest
from interloc.errors import ConfigError, DriveError, NetworkError
from interloc.osm.untrusted import MAP_ENDINGS, is_map
from interloc.reduction.reduce import Reduction, prepare_reduction, reduce_scan, small_files_of

OnStage = Callable[[str], None]
"""Called with what begins, in words."""

_COMMIT_WAIT_S = 30


class DriveAnswer(BaseModel):
    """A drive on the server."""

    id: str = Field(pattern=r"^[\w-]{1,64}$")
    name: str
    state: str
    report: JsonObject | None = None


@dataclass(frozen=True)
class PushOptions:
    """How a drive is read and sent."""

    name: str | None = None
    """Name of the drive on the server; that of its folder by default."""
    label_folders: tuple[LabelFolder, ...] = ()
    """"labels", "predictions", "geometry"; empty: all that are there."""
    reading: ReadingOptions = field(default_factory=ReadingOptions)
    keyframes: KeyframeConfig | None = DEFAULT.keyframes
    """Which scans to send; None: all of them."""
    maps: tuple[Path, ...] = ()
    """OpenStreetMap files that go along."""
    model: Path | None = None
    """Folder of a network that labels the scans here; label files do not count."""
    provider: str = "cpu"
    """What the network runs on."""

    def __post_init__(self) -> None:
        if self.model is not None and self.label_folders:
            raise ConfigError("--model labels the scans here: it does not go with --labels.")
        name = "drive" if self.name is None else self.name
        if not name.strip() or len(name) > 200 or not name.isprintable() or "/" in name:
            raise ConfigError(f"--name {self.name!r}: expected 1 to 200 characters without slashes and line breaks.")
        for path in self.maps:
            if not is_map(path.name) or path.name.startswith("."):
                endings = ", ".join(MAP_ENDINGS)
                raise ConfigError(f"{path}: is not an OpenStreetMap file by its name. Expected one of {endings}.")


@dataclass(frozen=True)
class PreparedDrive:
    """A drive that is ready to be sent."""

    manifest: ReducedManifest
    scans_sent: int
    is_georeferenced: bool
    files: list[UploadFile]
    """The drive itself."""
    maps: list[UploadFile] = field(default_factory=list)
    """OpenStreetMap files that go along."""

    @property
    def source_bytes(self) -> int | None:
        """Size of scans and labels of the drive."""
        if self.manifest.source is None:
            return None
        return self.manifest.source.scan_bytes + sum(labels.label_bytes or 0 for labels in self.manifest.labels)


def prepare(root: Path, options: PushOptions) -> PreparedDrive:
    """Check a drive as `interloc info` does, and get it ready; the first error is raised."""
    for path in options.maps:
        if not path.is_file():
            raise DriveError(f"{path}: no such file. Expected an OpenStreetMap file.")
    if is_reduced(root):
        prepared = _as_reduced(root, options)
    else:
        folders, by = options.label_folders or None, options.keyframes
        read = DriveOptions.of(options.reading, name=options.name, model=options.model, provider=options.provider)
        prepared = _reduced_on_the_way(prepare_reduction(root, read, label_folders=folders, keyframes=by))
    return replace(prepared, maps=[UploadFile(path.name, path) for path in options.maps])


def _reduced_on_the_way(reduction: Reduction) -> PreparedDrive:
    plan = reduction.plan
    marks = {labels: _mark_of(source) for labels, source in reduction.scans.items()}
    scans = [
        UploadFile(
            ground_path(labels, int(frame)),
            partial(reduce_scan, source, int(frame)),
            made_from=source.files(int(frame)),
            made_by=marks[labels],
        )
        for frame in plan.kept
        for labels, source in reduction.scans.items()
    ]
    small = [
        UploadFile(name, source) if isinstance(source, Path) else _file_of(name, source)
        for name, source in plan.copies.sources.items()
    ]
    files = [*small, *scans, _file_of(MANIFEST, reduction.manifest.to_bytes())]
    return PreparedDrive(reduction.manifest, len(plan.kept), reduction.is_georeferenced, files)


def _as_reduced(root: Path, options: PushOptions) -> PreparedDrive:
    manifest = read_manifest(root)
    thins_otherwise = options.keyframes is None and manifest.keyframes is not None
    is_other = options.reading.oxts is not None or options.reading.frames is not None
    if is_other or options.model is not None or thins_otherwise:
        raise ConfigError(
            f"{root} is a reduced drive: --oxts, --frames, --model and --all-scans belong to the drive that it was "
            "made from. Give that drive, or leave these options out."
        )
    chosen = options.label_folders or tuple(labels.folder for labels in manifest.labels)
    opened = read_drive(root, DriveOptions.of(options.reading), Findings(stop_at_first=True), label_folders=chosen)
    kept = [labels for labels in manifest.labels if labels.folder in chosen]
    sent = ReducedManifest.model_validate({**dict(manifest), "name": options.name or manifest.name, "labels": kept})
    names = small_files_of(root, manifest)
    names += [ground_path(labels, int(frame)) for frame in manifest.kept_frames for labels in chosen]
    files = [*(UploadFile(name, root / name) for name in names), _file_of(MANIFEST, sent.to_bytes())]
    is_georeferenced = next(iter(opened.values())).trajectory.georeference is not None
    return PreparedDrive(sent, len(manifest.kept_frames), is_georeferenced, files)


def _file_of(name: str, data: bytes) -> UploadFile:
    return UploadFile(name, lambda: data, made_by=hashlib.sha256(data).hexdigest())


def _mark_of(source: RawScans) -> str:
    """Tell label schemes, and networks, apart."""
    ids = (sorted(source.scheme.road), sorted(source.scheme.confusable), *source.sources[1].identity)
    return hashlib.sha256(repr(ids).encode()).hexdigest()[:12]


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
    report: JsonObject | None
    """What the server found in it (`DriveReport.to_dict`)."""

    def to_dict(self) -> JsonObject:
        """Return the fields as plain values, for JSON."""
        return asdict(self)


def push(
    connection: Connection,
    root: Path,
    prepared: PreparedDrive,
    *,
    threads: int = 8,
    on_stage: OnStage | None = None,
    on_progress: OnProgress | None = None,
) -> Pushed:
    """Send a drive to the server as it was prepared with the same options, and have it checked there.

    So many bundles of files as there are threads are read, reduced and sent at once. A `DriveError` says that a scan
    cannot be read, or why the server finds the drive unusable; after a `NetworkError` the next push goes on where this
    one stopped.
    """
    report_stage = on_stage or (lambda _: None)
    files = [*prepared.files, *prepared.maps]
    report_stage("making the drive")
    drive = _drive_for(connection, root, prepared)
    started = time.monotonic()
    if drive.state == "ready":  # its files are these; maps may be new
        progress = upload(connection, drive.id, prepared.maps, threads=threads, on_progress=on_progress)
        progress = replace(progress, total=len(files), done=len(files))
    else:
        progress = upload(connection, drive.id, files, threads=threads, on_progress=on_progress)
    seconds = time.monotonic() - started
    report_stage("the server checks the drive")
    drive = commit(connection, drive.id)
    there = files_of(connection, drive.id)
    return Pushed(
        drive_id=drive.id,
        name=drive.name,
        server=connection.server,
        scans=len(prepared.manifest.frames),
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
    """Have the server check a drive, and wait until it is ready for jobs."""
    headers = {"Prefer": f"wait={_COMMIT_WAIT_S}"}
    while True:
        drive = connection.ask("POST", f"/drives/{drive_id}/commit", DriveAnswer, json={}, headers=headers)
        if drive.state == "ready":
            return drive
        if connection.closing.wait(0.5):
            raise NetworkError(f"{connection.server}: stopped waiting.")


def _drive_for(connection: Connection, root: Path, prepared: PreparedDrive) -> DriveAnswer:
    """Make a drive, or return the one that an earlier push of the same files by the same options has made.

    The key of the request says which: the service makes one drive per key.
    """
    new = {"name": prepared.manifest.name}
    files = [(file.path, file.signature) for file in prepared.files]
    key = hashlib.sha256(json.dumps([os.path.realpath(root), new, files], default=str).encode()).hexdigest()
    drive = connection.ask("POST", "/drives", DriveAnswer, json=new, headers={"Idempotency-Key": key})
    if drive.state == "checking":
        try:
            drive = commit(connection, drive.id)
        except Refusal as error:
            if error.status != HTTPStatus.UNPROCESSABLE_ENTITY:
                raise
            drive = connection.ask("GET", f"/drives/{drive.id}", DriveAnswer)
    return drive
