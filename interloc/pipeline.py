"""A whole drive through the detector, on one process or several, to the tables of a result."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, pairwise

from interloc.arrays import IntArray
from interloc.config import DEFAULT, DetectorConfig
from interloc.detection.detector import Detector, KeyframeDetections, Window, locate
from interloc.detection.keyframes import select_keyframes
from interloc.detection.occupancy import PATCH_STEP_M, road_patch
from interloc.detection.scan import ScanLike
from interloc.detection.warm import warm_up
from interloc.drive import Drive, DriveScan, check_columns, is_slow, read_ahead, scans_of
from interloc.drives.folder import FolderDrive
from interloc.errors import DriveError, expect
from interloc.geometry import thin
from interloc.mapping.fusion import fuse
from interloc.mapping.georeferencing import build_tables, check_fixes, doubtful_stretches
from interloc.processes import Progress, Stopwatch, cores, peak_memory_bytes, run_in_processes
from interloc.results import DriveResult, RoadPatch, RunRecord, versions

_MIN_RANGE_KEYFRAMES = 100  # keyframes: a shorter range might read mostly its halo
_RANGES_PER_PROCESS = 8
_MIN_KEYFRAMES_PER_PROCESS = 400  # keyframes for each process: fewer are done before it has started


@dataclass(frozen=True)
class RangeResult:
    """What one process found in its range of keyframes."""

    start: int
    """Number of the first keyframe of the range."""
    detections: list[KeyframeDetections]
    """One for each keyframe of the range."""
    seconds: dict[str, float]
    """Seconds spent in each step."""
    peak_memory_bytes: int
    """Of the process so far."""
    road: tuple[RoadPatch, ...] = ()
    """The road around the keyframes of the range, every few metres."""


def detect_range(
    drive: Drive,
    keyframes: IntArray,
    start: int,
    stop: int,
    config: DetectorConfig,
    progress: Progress | None = None,
    left: dict[int, tuple[Detector, Iterator[Window]]] | None = None,
) -> RangeResult:
    """Find the intersections around the keyframes of a range: a pure function, the unit of parallel work.

    The keyframes, (K,) positions in the drive, before and behind the range that reach into its windows (its halo) are
    read too, so the result is exactly that of a run over the whole drive. A range that begins where the last one ended
    goes on with what that has `left`.
    """
    left = {} if left is None else left
    if start not in left:
        left.clear()
        first = max(0, start - config.keyframes.window)
        detector = Detector(config, first=first)
        left[start] = detector, islice(detector.completed(_read(drive, keyframes[first:])), start - first, None)
    detector, windows = left[stop] = left.pop(start)
    kept = set(thin(drive.T_world_lidar[keyframes, :2, 3], PATCH_STEP_M).tolist())
    found: list[KeyframeDetections] = []
    road: list[RoadPatch] = []
    for row, window in enumerate(islice(windows, stop - start), start):
        steps = window.steps()
        found.append(locate(steps, window.keyframe, config))
        if row in kept:
            road.append(road_patch(row, steps.occupancy, steps.roi, window.bev.against))
            detector.stopwatch.lap("road")
        if progress is not None:
            progress(len(found), stop - start)
    seconds, detector.stopwatch.seconds = detector.stopwatch.seconds, {}
    return RangeResult(start, found, seconds, peak_memory_bytes(), tuple(road))


def _read(drive: Drive, keyframes: IntArray) -> Iterator[DriveScan]:
    """Yield the scans at some positions of a drive, read ahead where that takes long."""
    scans = scans_of(drive, keyframes)
    return read_ahead(scans, cores()) if is_slow(drive) else scans


def stream(scans: Drive | Iterable[ScanLike], config: DetectorConfig = DEFAULT) -> Iterator[KeyframeDetections]:
    """Yield the detections of each keyframe as soon as they are known, the last ones too: `Detector`, in a loop.

    Parameters
    ----------
    scans : Drive or iterable of Scan
        A drive, or scans with their poses as they arrive, in their order.
    config
        ``keyframes.lookahead`` keyframes (20, about 40 m, unless set) pass before the detections of one come;
        0 is causal, and finds fewer intersections ahead of the vehicle.

    Yields
    ------
    KeyframeDetections
        One for each keyframe, in order, whether anything was found or not.

    Raises
    ------
    DriveError
        A scan of the drive is damaged, or the pose or the points of a scan are not valid.
    ConfigError
        The settings are not a `DetectorConfig`.
    """
    detector = Detector(config)
    if isinstance(scans, Drive):
        check_columns(scans)
        scans = _read(scans, select_keyframes(scans.T_world_lidar, config.keyframes))
    for window in detector.completed(scans):
        yield window.detect()


def detect(
    drive: Drive,
    config: DetectorConfig = DEFAULT,
    *,
    workers: int | None = 1,
    progress: Progress | None = None,
    meanwhile: Callable[[], None] = lambda: None,
) -> DriveResult:
    """Find the intersections along a drive and fuse them into a map.

    Parameters
    ----------
    drive
    config
        Settings of the method, those of the fusion too; see `interloc.config.preset`.
    workers : int or None
        Processes; None: as many as pay off. The result does not depend on it.
    progress
        Called with the keyframes done and the keyframes in all.
    meanwhile
        Called once the processes have begun, or before the first keyframe; what it raises ends the run.

    Returns
    -------
    DriveResult

    Raises
    ------
    DriveError
        The drive has no scans, or a scan is damaged.
    ConfigError
        The drive is not one, or the settings are not.
    """
    expect(drive, Drive)
    check_columns(drive)
    expect(config, DetectorConfig)
    warm_up(config)  # once per process, and no part of the time that the run takes
    began = time.perf_counter()
    keyframes = select_keyframes(drive.T_world_lidar, config.keyframes)
    if drive.georeference is not None:
        check_fixes(drive.georeference, keyframes)
    if not len(keyframes):
        raise DriveError(f"{drive.name}: the drive holds no scans")
    if workers is None:
        # Scans that are slow to read are read by threads: every process would read its halo once more.
        pay_off = 1 if is_slow(drive) else max(1, len(keyframes) // _MIN_KEYFRAMES_PER_PROCESS)
        workers = min(cores(), pay_off)
    ranges = split(len(keyframes), workers)
    if len(ranges) == 1:
        meanwhile()
        began = time.perf_counter()
        results = [detect_range(drive, keyframes, 0, len(keyframes), config, progress)]
    else:
        done = 0

        def count(part: RangeResult) -> None:
            nonlocal done
            done += len(part.detections)
            if progress is not None:
                progress(done, len(keyframes))

        work, stretch = partial(_detect_between, drive, keyframes, config), len(keyframes) / min(workers, len(ranges))
        ranges.sort(key=lambda part: (part[0] + 0.5) % stretch)  # in this order a process gets those that follow
        results = run_in_processes(work, ranges, workers, on_result=count, meanwhile=meanwhile)
        results.sort(key=lambda part: part.start)
    return assemble(
        drive, keyframes, results, config, workers=min(workers, len(ranges)), seconds=time.perf_counter() - began
    )


def assemble(
    drive: Drive,
    keyframes: IntArray,
    parts: Sequence[RangeResult],
    config: DetectorConfig,
    *,
    workers: int,
    seconds: float,
) -> DriveResult:
    """Join what was found in the ranges of a drive, in their order, to the tables of its result.

    The number of processes, and the seconds that this took so far, are recorded in run.json.
    """
    began = time.perf_counter()
    stopwatch = Stopwatch()
    for part in parts:
        stopwatch.add(part.seconds)
    stopwatch.start()
    found = [detections for part in parts for detections in part.detections]
    keyframe_table, detection_table = build_tables(found, keyframes, drive.georeference)
    stopwatch.lap("georeference")
    intersections, intersection = fuse(keyframe_table, detection_table, config.fusion, config.calibration)
    detection_table = replace(detection_table, intersection=intersection)
    stopwatch.lap("fusion")
    run: RunRecord = {
        "drive": drive.name,
        "config": config.model_dump(mode="json"),
        "fusion": config.fusion.model_dump(mode="json"),  # part of config too; kept for older readers
        "versions": versions(),
        "scans": len(drive.frames),
        "keyframes": len(keyframes),
        "labels": drive.label_source if isinstance(drive, FolderDrive) else None,
        "doubtful_labels_m": doubtful_stretches(keyframe_table),
        "georeference": None if drive.georeference is None else drive.georeference.source,
        "workers": workers,
        "seconds": seconds + time.perf_counter() - began,
        "stage_seconds": stopwatch.seconds,  # summed over the processes
        "peak_memory_bytes": max([part.peak_memory_bytes for part in parts] + [peak_memory_bytes()]),
    }
    if isinstance(drive, FolderDrive):
        run["road_ids"], run["frames"] = sorted(drive.scheme.road), drive.frames[[0, -1]].tolist()
        run["poses"] = drive.pose_file
        if (dropped := drive.dropped) is not None:
            run["dropped"] = dropped
    if intersections.bends:
        run["bends"] = intersections.bends
    road = tuple(patch for part in parts for patch in part.road)
    track = drive.T_world_lidar[:, :2, 3].astype(float)
    lonlat = None if drive.georeference is None else drive.georeference.lonlat
    return DriveResult(drive.name, keyframe_table, detection_table, intersections, track, lonlat, run, road)


def split(count: int, workers: int) -> list[tuple[int, int]]:
    """Cut the keyframes 0..count into ranges: several per process, so that they end together, but none too short.

    The first ranges of the stretches of the processes differ in length, so that they end one by one.
    """
    workers = max(1, min(workers, count // _MIN_RANGE_KEYFRAMES))
    each = 1 if workers == 1 else min(_RANGES_PER_PROCESS, count // workers // _MIN_RANGE_KEYFRAMES)
    firsts = [1.0] if each == 1 else [(i + 1) / workers for i in range(workers)]
    inner = (i + (j + first) / each for i, first in enumerate(firsts) for j in range(each))
    edges = {round(at * count / workers) for at in (*range(workers + 1), *inner)}
    return list(pairwise(sorted(edges)))


_left: dict[int, tuple[Detector, Iterator[Window]]] = {}
"""In a worker: what its last range has left."""


def _detect_between(drive: Drive, keyframes: IntArray, config: DetectorConfig, bounds: tuple[int, int]) -> RangeResult:
    return detect_range(drive, keyframes, *bounds, config, left=_left)
