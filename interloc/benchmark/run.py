"""Running a benchmark: every drive with every preset, level of label errors and seed; finished rows are kept."""

from __future__ import annotations

import logging
import queue
import shutil
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from interloc.benchmark.cases import Case
from interloc.benchmark.fingerprint import MEASURING, code_fingerprint, fingerprint
from interloc.benchmark.measure import GroundTruth, measure
from interloc.benchmark.row import Cell, Row, read_row, write_row
from interloc.config import DetectorConfig
from interloc.errors import InterLocError, OutputError
from interloc.mapping.files import reason_of
from interloc.osm.reader import read_osm
from interloc.pipeline import versions

logger = logging.getLogger(__name__)

Report = Callable[[str, str, int, int], None]
"""Called with a task, what it is doing, and how much of how much is done; with 0 of 0 at its end."""

ROWS = "rows"
NO_NOISE = "0/0"
_DRIVE_POLICY = GroundTruth()


@dataclass(frozen=True)
class Settings:
    """Settings of the method under a name.

    Attributes
    ----------
    name : str
        In the tables.
    config : DetectorConfig
    arguments : tuple of str
        The same for the command line.
    """

    name: str
    config: DetectorConfig
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """What is to be measured.

    Attributes
    ----------
    cases : tuple of Case
        Simulated drives once for each seed, recorded ones once.
    settings : tuple of Settings
    noises : tuple of str
        Label errors, r-FPR / r-FNR in percent; "0/0" for none.
    seeds : int
        Of the label errors, for recorded drives; a simulated drive brings its own.
    truth : GroundTruth
    """

    cases: tuple[Case, ...]
    settings: tuple[Settings, ...]
    noises: tuple[str, ...] = (NO_NOISE,)
    seeds: int = 1
    truth: GroundTruth = _DRIVE_POLICY

    @property
    def drives(self) -> list[str]:
        """Names of the drives, each once, in order."""
        return list(dict.fromkeys(case.name for case in self.cases))

    def cells(self, case: Case) -> list[tuple[Cell, Settings]]:
        """Return what is to be measured on a drive."""
        found = []
        for settings in self.settings:
            for noise in self.noises:
                # Without label errors chance has no say in a recorded drive.
                seeds = [case.seed] if case.seed is not None else range(self.seeds if noise != NO_NOISE else 1)
                found += [(Cell(drive=case.name, preset=settings.name, noise=noise, seed=s), settings) for s in seeds]
        return found


@dataclass(frozen=True)
class _Task:
    """The cells of one drive that are not measured yet: the unit of parallel work."""

    case: Case
    cells: tuple[tuple[Cell, Settings, str], ...]
    truth: GroundTruth
    out: Path
    workers: int

    @property
    def name(self) -> str:
        return self.case.name if self.case.seed is None else f"{self.case.name} seed {self.case.seed}"


def run_plan(
    plan: Plan, out: Path, *, workers: int = 1, fresh: bool = False, report: Report | None = None
) -> list[Row]:
    """Measure everything that is planned, and keep each row in `out/rows` as soon as it is there.

    Parameters
    ----------
    plan
    out
        Folder of the benchmark; is made where it is missing.
    workers : int
        Processes. The rows do not depend on it, except for their times.
    fresh : bool
        Measure anew what is kept from before.
    report
        Is told what is being done.

    Returns
    -------
    list of Row
        In the order of the plan.

    Raises
    ------
    InterLocError
        Whatever is wrong with a drive, its map, or the output; rows that were finished before are kept.
    """
    rows_dir = _make_folder(out)
    done: dict[Cell, Row] = {}
    tasks = []
    for case in plan.cases:
        facts: dict[str, Any] = {"drive": case.facts(), "program": [code_fingerprint(MEASURING), versions()]}
        facts |= {"truth": [plan.truth.policy, plan.truth.tolerance_m]}
        missing = []
        for cell, settings in plan.cells(case):
            mark = fingerprint({**facts, "cell": cell.model_dump(), "config": settings.config.model_dump(mode="json")})
            row = None if fresh else read_row(cell, mark, rows_dir)
            if row is None:
                missing.append((cell, settings, mark))
            else:
                done[cell] = row
        if missing:
            tasks.append((case, missing))
    if done:
        logger.info("%d of the rows are kept from before (%s); --fresh measures them anew", len(done), rows_dir)
    try:
        for case, _ in tasks:  # all of them before any long work
            case.check()
    except InterLocError:
        _remove_if_empty(rows_dir, out)
        raise
    at_once = max(1, min(workers, len(tasks)))
    full = [_Task(case, tuple(cells), plan.truth, out, max(1, workers // at_once)) for case, cells in tasks]
    try:
        for row in _run_here(full, report) if at_once == 1 else _run_in_processes(full, at_once, report):
            done[row.cell] = row
    finally:
        for leftover in out.glob(".twin-*"):
            shutil.rmtree(leftover, ignore_errors=True)
    return [done[cell] for case in plan.cases for cell, _ in plan.cells(case)]


def _make_folder(out: Path) -> Path:
    rows = out / ROWS
    try:
        if out.is_dir() and not rows.is_dir() and any(out.iterdir()):
            raise OutputError(
                f"{out} exists and is no benchmark: it has no {ROWS}/. It was not touched. "
                "Give the name of a new or an empty folder."
            )
        rows.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    for leftover in out.glob(".twin-*"):  # of a run that was killed
        shutil.rmtree(leftover, ignore_errors=True)
    return rows


def _remove_if_empty(*folders: Path) -> None:
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()


def _run_here(tasks: Sequence[_Task], report: Report | None) -> list[Row]:
    return [row for task in tasks for row in _run_task(task, report)]


def _run_in_processes(tasks: Sequence[_Task], workers: int, report: Report | None) -> list[Row]:
    """Run several drives at a time; what they report comes through a queue."""
    context = get_context("spawn")
    rows: list[Row] = []
    with context.Manager() as manager:
        messages: Any = manager.Queue()
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_obey_main_process)
        try:
            waiting: set[Future[list[Row]]] = {pool.submit(_run_task_reporting, task, messages) for task in tasks}
            while waiting:
                finished, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
                _pass_on(messages, report)
                for future in finished:
                    rows += future.result()
        except BrokenProcessPool:
            raise InterLocError(
                "a worker process was ended from outside. Usual cause: too little memory; try fewer --workers. "
                "Finished rows are kept: the same command goes on from there."
            ) from None
        except BaseException:
            _stop(pool)
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    return rows


def _stop(pool: ProcessPoolExecutor) -> None:
    """End the workers in the middle of their work: what they finished is on disk."""
    processes = list((pool._processes or {}).values())  # noqa: SLF001 - no public way before Python 3.14
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()


def _obey_main_process() -> None:
    """Leave Ctrl-C to the main process, which ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _pass_on(messages: Any, report: Report | None) -> None:  # noqa: ANN401 - a proxy
    while True:
        try:
            message = messages.get_nowait()
        except queue.Empty:
            return
        if isinstance(message, str):
            logger.info("%s", message)
        elif report is not None:
            report(*message)


def _run_task_reporting(task: _Task, messages: Any) -> list[Row]:  # noqa: ANN401 - a proxy
    def report(name: str, what: str, done: int, total: int) -> None:
        if done == total or done % 10 == 0:
            messages.put((name, what, done, total))

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # tidy up on the way out
    try:
        return _run_task(task, report, messages.put)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _run_task(
    task: _Task, report: Report | None, say: Callable[[str], object] = lambda text: logger.info("%s", text)
) -> list[Row]:
    """Measure what is missing of one drive."""

    def progress(what: str) -> Callable[[int, int], None]:
        return lambda done, total: report(task.name, what, done, total) if report is not None else None

    rows = []
    graph = read_osm(task.case.osm)
    with task.case.opened(task.out, progress("simulate")) as drive:
        for cell, settings, mark in task.cells:
            row = measure(
                cell,
                mark,
                drive,
                graph,
                settings.config,
                task.truth,
                partial(task.case.explain, settings=settings.arguments),
                workers=task.workers,
                progress=progress(f"{cell.preset} {cell.noise}"),
            )
            write_row(row, task.out / ROWS)
            rows.append(row)
            say(describe(row))
    if report is not None:
        report(task.name, "", 0, 0)
    return rows


def describe(row: Row) -> str:
    """Say the main figures of a row in a line."""
    from interloc.benchmark.score import ace_m, precision, recall  # noqa: PLC0415 - for the eye only

    cell = row.cell
    ace, pre, rec = ace_m([row]), precision([row]), recall([row])
    return (
        f"{cell.drive} seed {cell.seed}, {cell.preset}, label errors {cell.noise}: "
        f"ACE {'-' if ace is None else f'{ace:.2f} m'}, "
        f"Pre@5 {'-' if pre is None else f'{100 * pre:.1f} %'}, "
        f"Rec@5 {'-' if rec is None else f'{100 * rec:.1f} %'}, "
        f"nodes {row.nodes_found}/{row.nodes_in_zone}"
    )
