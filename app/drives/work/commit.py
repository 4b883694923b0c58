"""The commit of a drive: all of its files are checked, then its scans are reduced to what the method needs.

A drive that was reduced already, by the client that sent it, is checked scan by scan and taken over unchanged.
What is wrong with the files is listed in the report, each finding with its path; the outcome then has no result.
"""

import json
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from app.networks import work as models
from app.paths import without_folder
from app.work.requests import CommitJob, CommitOutcome, UploadOptions
from app.work.task import REDUCED, TRAJECTORY, Part, Plan, Report, Task, WorkSettings, link
from interloc.config import DEFAULT
from interloc.drives.findings import DriveFileError, Finding, Findings, by_severity
from interloc.drives.inspect import DriveReport, report_of
from interloc.drives.layouts import is_recording
from interloc.drives.open import DriveReading, open_drive, read_drive
from interloc.drives.options import ODOMETRY, DriveArguments, DriveOptions, LabelFolder
from interloc.drives.scans.reduced_format import MANIFEST, ground_path, is_reduced, read_ground, read_manifest
from interloc.errors import DriveError, InterLocError, OutputError
from interloc.output.geojson import write_collection
from interloc.output.write import trajectory_feature
from interloc.reduction.listing import fetch_drive
from interloc.reduction.reduce import Reduction, label_folders_in, prepare_reduction, reduction_of, small_files_of

PART_SCANS = 200
PART_LABELLED_SCANS = 20
"""A scan that a network labels takes a hundred times as long."""

MAX_PROBLEMS = 500
"""Maximum number of problems in a report: some of 9,000 bad scans are enough."""

_PROBLEMS = "problems.json"
_SOURCE = "source"
_MB = 1024**2


@dataclass(frozen=True)
class CommitPlan(Plan):
    """How the scans of a drive are cut: no parts where its check found errors."""

    report: DriveReport


def prepare(task: Task[CommitJob]) -> CommitPlan:
    """Check the files as `interloc info` does; cut the scans into parts if they are valid."""
    (task.drive / "files").mkdir(parents=True, exist_ok=True)
    files = _files(task)
    report = check(task)
    if not report.ok:
        return CommitPlan([], 0, report)
    try:
        frames = _frames(task)
    except InterLocError as error:  # not covered by the check: files that cannot be gathered
        findings = Findings(stop_at_first=False)
        findings.error(error)
        return CommitPlan([], 0, _with_errors(report, findings.found, task))
    size = PART_SCANS if _model(task) is None else PART_LABELLED_SCANS
    sources = [] if is_reduced(files) else list(_reduction(task).scans.values())
    starts = np.arange(0, len(frames), size)
    for source in sources:  # labels by geometry are made window by window: each in one part
        windows = source.windows_of(frames)
        starts = np.unique(np.searchsorted(windows, windows[starts]))
    ends = [*starts[1:].tolist(), len(frames)]
    parts = [Part(number, *edges) for number, edges in enumerate(zip(starts.tolist(), ends, strict=True))]
    return CommitPlan(parts, len(frames), report, stage="labelling" if any(each.is_slow for each in sources) else None)


def run(task: Task[CommitJob], part: Part, report: Report) -> None:
    """Reduce some scans, or check them if they are reduced already; faults of scans are recorded, not raised."""
    target = task.scratch / f"part-{part.number}"
    if target.is_dir():
        return
    folder = task.scratch / f"part-{part.number}-{task.attempt}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    do = _scan_check(task) if is_reduced(_files(task)) else _scan_reduction(task, folder)
    frames = _frames(task)[part.start : part.stop]
    problems: list[list[str]] = []
    for done, frame in enumerate(frames, start=1):
        try:
            do(frame)
        except DriveFileError as error:
            problems.append([error.path, error.message])
        report(done)
    (folder / _PROBLEMS).write_text(json.dumps(problems[:MAX_PROBLEMS]))
    os.sync()  # the scans themselves will be removed: one wait per part is better than one per file
    with suppress(OSError):  # another attempt was faster
        folder.rename(target)


def finish(task: Task[CommitJob], plan: CommitPlan) -> CommitOutcome:
    """Put the reduced drive together."""
    if not plan.parts:
        return CommitOutcome(ok=plan.report.ok, report=plan.report)
    folders = [task.scratch / f"part-{part.number}" for part in plan.parts]
    problems = [
        Finding("error", path, message)
        for folder in folders
        for path, message in json.loads((folder / _PROBLEMS).read_text())
    ]
    if problems:
        return CommitOutcome(ok=False, report=_with_errors(plan.report, problems, task))
    shutil.rmtree(task.result, ignore_errors=True)
    reduced = task.result / REDUCED
    reduced.mkdir(parents=True)
    if is_reduced(_files(task)):
        _take_over(_files(task), reduced)
    else:
        reduction = _reduction(task)
        for labels in reduction.scans:
            (reduced / ground_path(labels, 0)).parent.mkdir(parents=True)
        for folder in folders:
            for file in (folder / "ground").glob("*/*"):
                link(file, reduced / "ground" / file.parent.name / file.name)
        reduction.write_rest(reduced)
    drive = open_drive(reduced, labels=read_manifest(reduced).labels[0].folder, check=False)
    lonlat = None if drive.georeference is None else drive.georeference.lonlat
    track = trajectory_feature(drive.T_world_lidar[:, :2, 3], lonlat)
    write_collection(task.result / TRAJECTORY[lonlat is None], [track], local=lonlat is None)
    os.sync()
    return CommitOutcome(
        ok=True,
        scans=len(drive.frames),
        kept_scans=plan.total,
        reduced_bytes=sum(file.stat().st_size for file in reduced.rglob("*") if file.is_file()),
        seconds=round(time.time() - plan.began, 3),
        report=plan.report,
    )


def _files(task: Task[CommitJob]) -> Path:
    """Return the folder of the files: as they were sent, or as they were fetched from object storage."""
    source = task.request.source
    return task.drive / "files" if source is None else _fetched(source, task.scratch, task.settings)


def _fetched(source: str, scratch: Path, settings: WorkSettings) -> Path:
    """Fetch a drive of object storage into the scratch folder, once for all attempts of the job."""
    folder, incomplete = scratch / _SOURCE, scratch / f"{_SOURCE}-incomplete"

    def check_sizes(sizes: Mapping[str, int]) -> None:
        total = sum(sizes.values())
        for name, size in sizes.items():
            limit = settings.max_recording_bytes if is_recording(name) else settings.max_file_bytes
            if size > limit:
                raise DriveError(f"{source}: {name} is larger than {limit / _MB:,.0f} MB, the limit of a file.")
        if total > settings.max_drive_bytes:
            raise DriveError(f"{source} is larger than {settings.max_drive_bytes / _MB:,.0f} MB, the limit of a drive.")
        here = sum(file.stat().st_size for file in incomplete.rglob("*") if file.is_file())
        if shutil.disk_usage(scratch).free + here - total < settings.min_free_bytes:
            raise OutputError("the disk of the service has no room for the drive. Nothing was read.")

    if not folder.is_dir():
        within, limit = settings.sources, settings.max_drive_files
        fetch_drive(source, incomplete, within=within, limit=limit, check_sizes=check_sizes)
        incomplete.rename(folder)
    (place,) = folder.iterdir()
    return place if place.is_dir() else folder


def check(task: Task[CommitJob]) -> DriveReport:
    """Check a drive by all of its label folders; return one report with the problems of all."""
    root = _files(task)
    readings, findings = _read_once(root, _options(task), task.job_id)
    report = report_of(root, _options(task), next(iter(readings.values())), findings)
    name = report.name if report.layout else task.drive_name
    return report.model_copy(
        update={"path": name, "name": name, "problems": _tidied(report.problems, root, task.drive_name)}
    )


def _tidied(problems: list[Finding], root: Path, name: str) -> list[Finding]:
    """Sort problems, keep some of very many, and name the files as their owner does."""
    problems = by_severity(problems)
    kept = [
        Finding(each.severity, without_folder(each.path, root, name), without_folder(each.message, root, name))
        for each in problems[:MAX_PROBLEMS]
    ]
    if len(problems) > MAX_PROBLEMS:
        kept.append(Finding("note", "", f"And {len(problems) - MAX_PROBLEMS:,} more problems."))
    return kept


def _with_errors(report: DriveReport, problems: list[Finding], task: Task[CommitJob]) -> DriveReport:
    every = list(dict.fromkeys([*problems, *report.problems]))
    return report.model_copy(update={"problems": _tidied(every, _files(task), task.drive_name)})


def reading_options(options: UploadOptions, root: Path, name: str, model: Path | None = None) -> DriveOptions:
    """Return how the uploaded files in `root` are read, by the options, the name and the network of the drive."""
    changed: DriveArguments = {"name": name.replace("/", "_"), "model": model}
    if options.oxts is not None:
        changed["oxts"] = root / options.oxts
    if options.poses is not None and options.poses != ODOMETRY:
        if options.poses.startswith("/"):  # a topic: nothing but a bag may look at it, or it would be a path of ours
            changed["layout"] = "rosbag"
        else:
            changed["poses"] = str(root / options.poses)
    return DriveOptions.of(options, **changed)


def _options(task: Task[CommitJob]) -> DriveOptions:
    return reading_options(task.request.options, _files(task), task.drive_name, _model(task))


def _model(task: Task[CommitJob]) -> Path | None:
    name = task.request.options.model
    if name is None or is_reduced(_files(task)):
        return None
    return models.find(task.settings.models, name)


def _frames(task: Task[CommitJob]) -> list[int]:
    """Return the numbers of the scans that are to be reduced, or are reduced already."""
    root = _files(task)
    if is_reduced(root):
        return [int(frame) for frame in read_manifest(root).kept_frames]
    return [int(frame) for frame in _reduction(task).plan.kept]


@lru_cache(maxsize=2)
def _read_once(
    root: Path,
    options: DriveOptions,
    job_id: str,  # noqa: ARG001 - files may differ for another job
) -> tuple[dict[LabelFolder, DriveReading], Findings]:
    """Read a drive by its label folders, once for all steps and parts of a job in this process."""
    findings = Findings(stop_at_first=False)
    folders: Sequence[LabelFolder] = label_folders_in(root, options)
    if is_reduced(root):
        with suppress(DriveFileError):  # of a manifest that cannot be read, which reading lists
            folders = [labels.folder for labels in read_manifest(root).labels]
    return read_drive(root, options, findings, label_folders=folders), findings


def _reduction(task: Task[CommitJob]) -> Reduction:
    return _reduction_once(_files(task), _options(task), task.job_id)


@lru_cache(maxsize=2)
def _reduction_once(root: Path, options: DriveOptions, job_id: str) -> Reduction:
    readings, findings = _read_once(root, options, job_id)
    # Labels that are made are made of the keyframes only; label files are cheap enough to keep every scan.
    are_made = any(each.scans is not None and each.scans.is_slow for each in readings.values())
    keyframes = DEFAULT.keyframes if are_made else None
    if not findings.ok:  # files that changed since they were checked
        return prepare_reduction(root, options, keyframes=keyframes)
    return reduction_of(readings, options, Findings(stop_at_first=True), keyframes)


def _scan_reduction(task: Task[CommitJob], folder: Path) -> Callable[[int], None]:
    reduction = _reduction(task)
    for labels in reduction.scans:
        (folder / ground_path(labels, 0)).parent.mkdir(parents=True)
    return lambda frame: reduction.write_ground(frame, folder)


def _scan_check(task: Task[CommitJob]) -> Callable[[int], None]:
    root = _files(task)
    manifest = read_manifest(root)

    def check_scan(frame: int) -> None:
        for labels in manifest.labels:
            read_ground(root, labels.folder, frame)

    return check_scan


def _take_over(files: Path, reduced: Path) -> None:
    """Link the files of an upload that was reduced by the client."""
    manifest = read_manifest(files)
    for labels in manifest.labels:
        (reduced / ground_path(labels.folder, 0)).parent.mkdir(parents=True)
        for frame in manifest.kept_frames:
            name = ground_path(labels.folder, int(frame))
            link(files / name, reduced / name)
    for name in (MANIFEST, *small_files_of(files, manifest)):
        (reduced / name).parent.mkdir(parents=True, exist_ok=True)
        link(files / name, reduced / name)
