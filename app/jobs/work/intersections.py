"""Find the intersections of a drive and score them against a map: `interloc run`, cut into ranges of keyframes."""

import hashlib
import pickle
import time
from contextlib import nullcontext
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from app.paths import without_folder
from app.work.requests import IntersectionsJob, IntersectionsOutcome, MapPlace, MapScores
from app.work.task import REDUCED, DriveGoneError, Part, Plan, ProgressFiles, Report, Task, no_georeference
from interloc.arrays import IntArray
from interloc.config import DetectorConfig
from interloc.detection.keyframes import select_keyframes
from interloc.detection.warm import are_cold, warm_up
from interloc.drive import Drive
from interloc.drives.folder import FolderDrive
from interloc.drives.open import open_drive
from interloc.drives.options import LabelChoice
from interloc.drives.scans.reduced_format import MANIFEST
from interloc.errors import Beside, DriveError, MapError
from interloc.evaluation.coverage import map_bounds, track_bounds
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.files import write_file
from interloc.localization.apply import place_run, write_places
from interloc.osm.graph import Bounds, RoadGraph
from interloc.osm.overpass import download_roads
from interloc.osm.reader import read_osm
from interloc.osm.untrusted import MAX_UNPACKED_BYTES
from interloc.output.layout import result_folder
from interloc.output.write import write_results
from interloc.pipeline import RangeResult, assemble, detect_range
from interloc.results import DriveResult, versions
from interloc.roadmap.network import RoadNetwork

_RANGE = 240
"""Keyframes per part with images of `_CELLS` cells per side: one or two seconds of work, 5 % of it for the halo."""

_MAP_RATIO = 60
"""Real maps unpack to 10 to 30 times their size; a higher ratio indicates a decompression bomb."""

_MAP_FREE_BYTES = 64 * 1024**2  # small maps may unpack to this much, whatever their ratio

_MIN_RANGE = 40
_CELLS = 750


def prepare(task: Task[IntersectionsJob]) -> Plan:
    """Open the drive and the map, so that what is wrong with them is reported before the long work."""
    progress = ProgressFiles.of(task)
    if are_cold():  # the service has just been installed and started
        progress.report_stage("preparing", "Compiling the kernels, once")
        warm_up(task.request.config)
    progress.report_stage("preparing")
    drive, keyframes = _open(task)
    if not len(keyframes):
        raise DriveError(f"{task.drive_name}: the drive holds no scans")
    if task.request.osm is not None:
        if drive.georeference is None and task.request.georeference != "map":
            raise no_georeference(task.drive_name)
        _read_map(task, _map_bounds(task, drive, keyframes))
    return Plan(_cut(len(keyframes), task.request.config), len(keyframes))


def run(task: Task[IntersectionsJob], part: Part, report: Report) -> None:
    """Find the intersections around the keyframes of a range."""
    path = _checkpoint(task, part)
    if read_checkpoint(path) is not None:
        report(part.stop - part.start)
        return
    drive, keyframes = _open(task)
    found = detect_range(drive, keyframes, part.start, part.stop, task.request.config, lambda done, _: report(done))
    write_checkpoint(path, found)


def finish(task: Task[IntersectionsJob], plan: Plan) -> IntersectionsOutcome:
    """Join the ranges, write the result folder, and score it where a map was given."""
    progress = ProgressFiles.of(task)
    progress.report_stage("mapping")
    drive, keyframes = _open(task)
    result = assemble(
        drive,
        keyframes,
        [_found(task, part) for part in plan.parts],
        task.request.config,
        workers=min(task.workers, len(plan.parts)),
        seconds=max(0.0, time.time() - plan.began),
    )
    result.run["job"] = task.job_id
    scored, graph, beside = result, None, Beside()
    if task.request.osm is not None:
        with beside.part("the score") if task.request.georeference != "map" else nullcontext():
            graph = _read_map(task, _map_bounds(task, drive, keyframes))
    scores = None
    with result_folder(task.result) as folder:
        if graph is not None and task.request.georeference == "map":
            result, scored = _place(task, drive, result, graph, folder)
        network = write_results(result, folder, beside=beside)
        if graph is not None:
            progress.report_stage("evaluating")
            with beside.part("the score"):
                scores = _evaluate(task.request, result, scored, graph, network, folder, beside)
        progress.check()
    placed = result.run.get("location")
    return IntersectionsOutcome(
        keyframes=len(result.keyframes),
        detections=len(result.detections),
        intersections=len(result.intersections),
        georeferenced=result.is_georeferenced,
        seconds=result.run["seconds"],
        stage_seconds=result.run["stage_seconds"],
        peak_memory_bytes=result.run["peak_memory_bytes"],
        location=None if placed is None else MapPlace.model_validate(placed | placed["places"][0]),
        report=scores,
        has_roads=True,
        doubtful_labels_m=result.run["doubtful_labels_m"],
        **({"dropped": result.run["dropped"]} if "dropped" in result.run else {}),
        **({"missing": beside.missing} if beside.missing else {}),
    )


def _open(task: Task[IntersectionsJob]) -> tuple[Drive, IntArray]:
    return open_input(task.drive, task.drive_name, task.request)


def open_input(folder: Path, name: str, request: IntersectionsJob) -> tuple[Drive, IntArray]:
    """Return the drive of a job, and the positions of its keyframes; folder and name as in a `Task`.

    A `DriveGoneError` says that its files are not where the commit has put them.
    """
    root = folder / REDUCED
    if not (root / MANIFEST).is_file():
        raise DriveGoneError(
            f"The files of drive {name} are no longer on the disk of the service, though it was committed. "
            "Upload it again, and tell the operator."
        )
    drive, keyframes = _open_once(root, name, request.labels or "auto", request.config)
    return drive.without_georeference() if request.georeference == "map" else drive, keyframes


@lru_cache(maxsize=4)  # a worker does many parts of few drives; their files do not change any more
def _open_once(root: Path, name: str, labels: LabelChoice, config: DetectorConfig) -> tuple[FolderDrive, IntArray]:
    drive = open_drive(root, name=name, labels=labels, check=False)  # the commit has checked it
    return drive, select_keyframes(drive.T_world_lidar, config.keyframes)


def _cut(keyframes: int, config: DetectorConfig) -> list[Part]:
    """Cut the keyframes into ranges; the same on every server, so that each finds the checkpoints of the others."""
    length = max(_MIN_RANGE, min(_RANGE, _RANGE * _CELLS**2 // config.bev.cells**2))
    count = max(1, round(keyframes / length))
    edges = [round(i * keyframes / count) for i in range(count + 1)]
    return [Part(number, start, stop) for number, (start, stop) in enumerate(pairwise(edges))]


def write_checkpoint(path: Path, part: RangeResult) -> None:
    """Keep what was found in a range, whole or not at all: a restart goes on from there, with identical results."""
    content = pickle.dumps(part)
    write_file(path, _head(content) + b"\n" + content)


def read_checkpoint(path: Path) -> RangeResult | None:
    """Read what `write_checkpoint` wrote; None if there is nothing, or nothing that this version has written."""
    try:
        head, _, content = path.read_bytes().partition(b"\n")
    except OSError:
        return None
    if head != _head(content):
        return None
    part: RangeResult = pickle.loads(content)  # noqa: S301 - of a worker of this service, and undamaged
    return part


def _head(content: bytes) -> bytes:
    """Return the versions that the numbers depend on, so that an updated service does not mix two, and a digest."""
    made_by = " ".join(f"{name} {version}" for name, version in versions().items())
    return f"{made_by} {hashlib.sha256(content).hexdigest()}".encode()


def _checkpoint(task: Task[IntersectionsJob], part: Part) -> Path:
    return task.scratch / f"range-{part.start}-{part.stop}"


def _found(task: Task[IntersectionsJob], part: Part) -> RangeResult:
    found = read_checkpoint(_checkpoint(task, part))
    if found is None:  # another server, of another version, wrote it
        run(task, part, lambda _: None)
        found = read_checkpoint(_checkpoint(task, part))
    assert found is not None
    return found


def _map_bounds(task: Task[IntersectionsJob], drive: Drive, keyframes: IntArray) -> Bounds | None:
    """Return the part of the map that the task needs; None: all of it."""
    near = task.request.near
    if task.request.georeference != "map":
        assert drive.georeference is not None
        lonlat = drive.georeference.lonlat[keyframes]
        return track_bounds(lonlat) if task.request.map_file is None else map_bounds(lonlat)
    if near is None:
        return None
    return track_bounds(np.array([[near.lon_deg, near.lat_deg]]), margin_m=1000.0 * near.radius_km)


def _read_map(task: Task[IntersectionsJob], bounds: Bounds | None) -> RoadGraph:
    if task.request.map_file is not None:
        path = task.drive / "files" / task.request.map_file
        try:
            max_bytes = max(_MAP_FREE_BYTES, _MAP_RATIO * path.stat().st_size)
            return read_osm(path, bounds, max_unpacked_bytes=min(MAX_UNPACKED_BYTES, max_bytes))
        except MapError as error:  # it is told in the result
            raise MapError(without_folder(str(error), path.parent, task.drive_name)) from error
        except FileNotFoundError as error:
            text = f"The map {path.name} of drive {task.drive_name} is no longer on the disk of the service."
            raise DriveGoneError(f"{text} Send it again, and tell the operator.") from error
    progress = ProgressFiles.of(task)

    def wait(reason: str, seconds: float) -> None:
        progress.report_stage("waiting for the map", f"{reason} ({seconds:.0f} s)")

    assert bounds is not None  # the request was checked
    return download_roads(bounds, cache_dir=task.cache / "overpass", on_wait=wait, url=task.settings.overpass_url)


def _place(
    task: Task[IntersectionsJob], drive: Drive, result: DriveResult, graph: RoadGraph, folder: Path
) -> tuple[DriveResult, DriveResult]:
    """Return the run on the earth, and the copy of it that is scored; see `interloc.localization.apply`."""
    progress = ProgressFiles.of(task)

    def report(done: int, total: int) -> None:
        progress.report_stage("locating", f"Comparing {done} of {total} places")

    near = task.request.near
    report(0, 1)
    placed = place_run(
        result,
        drive,
        graph,
        policy=task.request.policy,
        tolerance_m=task.request.tolerance_m,
        near=None if near is None else (near.lat_deg, near.lon_deg),
        radius_m=None if near is None else 1000.0 * near.radius_km,
        progress=report,
    )
    write_places(placed, graph, folder)
    return placed.result, placed.scored


def _evaluate(
    request: IntersectionsJob,
    result: DriveResult,
    scored: DriveResult,
    graph: RoadGraph,
    network: RoadNetwork | None,
    folder: Path,
    beside: Beside,
) -> MapScores:
    evaluation = evaluate(
        scored,
        graph,
        policy=request.policy,
        tolerance_m=request.tolerance_m,
        network=network if scored is result else None,
    )
    report = write_report(evaluation, folder, result=result, beside=beside)
    at_5 = {f"{name}_at_5": report[name]["5.0"] for name in ("precision", "recall", "f1")}
    level = report["map_level"]
    judged = 2 * level["true"] + level["false"] + level["missed"]
    map_f1 = 2 * level["true"] / judged if judged else None
    return MapScores.model_validate(report | at_5 | {"map_f1": map_f1})
