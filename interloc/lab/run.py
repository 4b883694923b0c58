"""Running a benchmark: every drive with every preset, level of label errors and seed. Finished rows are kept."""

import json
import logging
import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, JsonObject
from interloc.config import PAPER, DetectorConfig, flatten, with_settings
from interloc.errors import ConfigError, InterLocError, OutputError
from interloc.evaluation.metrics import UNMATCHED
from interloc.files import reason_of, write_file
from interloc.lab.cases import Case, folder_cases, twin_cases
from interloc.lab.measure import Cell, Row, Scoring, measure, read_row, settings_of, write_row
from interloc.lab.tables import MISSING, NO_NOISE, Measured, Table, metres, one_decimal, table_of, tables
from interloc.osm.reader import read_osm
from interloc.output.credits import map_credit
from interloc.output.geojson import rounded, write_record
from interloc.processes import Progress, run_in_processes, send_message
from interloc.results import versions
from interloc.wording import counted

logger = logging.getLogger(__name__)

ROWS = "rows"
_DRIVE_POLICY = Scoring()


@dataclass(frozen=True)
class NamedConfig:
    """A configuration of the method under a name."""

    name: str
    config: DetectorConfig


@dataclass(frozen=True)
class Benchmark:
    """What is to be measured."""

    cases: tuple[Case, ...]
    """Simulated drives once for each seed, recorded ones once."""
    configs: tuple[NamedConfig, ...]
    noises: tuple[str, ...] = (NO_NOISE,)
    """Levels of label errors, r-FPR / r-FNR in percent; "0/0": without."""
    seeds: int = 1
    """Number of seeds of the label errors on recorded drives; a simulated drive has its own seed."""
    truth: Scoring = _DRIVE_POLICY
    title: str = ""
    labels: str = "labels"
    """"labels" (by hand, or exact) or "predictions" (of a network)."""

    def measured(self, rows: list[Row]) -> Measured:
        """Return the rows of this benchmark for its tables."""
        names = tuple(dict.fromkeys(case.name for case in self.cases))
        return Measured(tuple(rows), names, tuple(each.name for each in self.configs), self.noises)

    def cells(self, case: Case) -> list[tuple[Cell, DetectorConfig]]:
        """Return what is to be measured on a drive."""
        found = []
        for each in self.configs:
            for noise in self.noises:
                # Without label errors nothing is random in a recorded drive.
                seeds = [case.seed] if case.seed is not None else range(self.seeds if noise != NO_NOISE else 1)
                cell = Cell(drive=case.name, preset=each.name, noise=noise, seed=0, inputs=case.inputs)
                found += [(cell.model_copy(update={"seed": seed}), each.config) for seed in seeds]
        return found


@dataclass(frozen=True)
class _Task:
    """The cells of one drive that are not measured yet: the unit of parallel work."""

    case: Case
    cells: tuple[tuple[Cell, DetectorConfig], ...]
    truth: Scoring
    out: Path


def run_benchmark(benchmark: Benchmark, out: Path, *, workers: int = 1, progress: Progress | None = None) -> list[Row]:
    """Measure everything that is planned, and keep each row in `out/rows` as soon as it is there.

    With several workers, so many drives at a time, each in a process; the rows do not depend on it. Rows that are there
    from before are taken where inputs, settings and versions are the same. `progress` is called with the number of rows
    that are there, and of all. Rows that were finished before anything fails are kept.
    """
    done, tasks = _plan(benchmark, out)
    finished, total = len(done), len(done) + sum(len(task.cells) for task in tasks)

    def tell(*_: int) -> None:
        if progress is not None:
            progress(finished, total)

    def count(line: str) -> None:
        nonlocal finished
        logger.info(line)
        finished += 1
        tell()

    try:
        if min(workers, len(tasks)) > 1:
            hint = "Finished rows are kept: the same command goes on from there."
            found = run_in_processes(_run_task, tasks, workers, on_message=count, hint=hint)
        else:
            found = [_run_task(task, count, tell) for task in tasks]
    finally:
        _remove_leftovers(out)
    done |= {row.cell: row for rows in found for row in rows}
    return [done[cell] for case in benchmark.cases for cell, _ in benchmark.cells(case)]


def _plan(benchmark: Benchmark, out: Path) -> tuple[dict[Cell, Row], list[_Task]]:
    """Return the rows that are kept from before, and what is to be measured; the drives of that are checked."""
    rows_dir = _make_folder(out)
    done: dict[Cell, Row] = {}
    tasks = []
    for case in benchmark.cases:
        missing = []
        for cell, config in benchmark.cells(case):
            row = read_row(cell, settings_of(config, benchmark.truth), rows_dir)
            if row is None:
                missing.append((cell, config))
            else:
                done[cell] = row
        if missing:
            tasks.append(_Task(case, tuple(missing), benchmark.truth, out))
    if done:
        logger.info("%s kept from before in %s", counted(len(done), "row"), out)
    try:
        for task in tasks:  # all of them before any long work
            task.case.check()
    except InterLocError:
        with suppress(OSError):  # it is not empty
            rows_dir.rmdir()
            out.rmdir()
        raise
    return done, tasks


def _make_folder(out: Path) -> Path:
    rows = out / ROWS
    try:
        if out.is_dir() and not rows.is_dir() and any(out.iterdir()):
            raise OutputError(
                f"{out} exists and is not a benchmark: it has no {ROWS}/. It was not touched. "
                "Give the name of a new or an empty folder."
            )
        rows.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    _remove_leftovers(out)
    return rows


def _remove_leftovers(out: Path) -> None:
    for leftover in out.glob(".twin-*"):  # of a run that was stopped or killed
        shutil.rmtree(leftover, ignore_errors=True)


def _run_task(task: _Task, count: Callable[[str], None] = send_message, tell: Progress | None = None) -> list[Row]:
    """Measure the cells of a drive; `count` is called with the name of each row, `tell` again and again."""
    rows = []
    graph, axes = read_osm(task.case.osm), task.case.axes()
    with task.case.opened(task.out, tell) as drive:
        for cell, config in task.cells:
            row = measure(cell, drive, graph, config, task.truth, axes=axes, progress=tell)
            write_row(row, task.out / ROWS)
            rows.append(row)
            count(row.cell.file_name)
    return rows


def write_benchmark(benchmark: Benchmark, rows: list[Row], out: Path) -> tuple[str, JsonObject]:
    """Write the tables, `benchmark.txt`, and the figures behind them, `benchmark.json`; return both.

    In the record, `results` are by preset, level of label errors and drive ("all": pooled), each figure with `mean`,
    `spread` (sample standard deviation over the seeds, None for one seed) and `seeds`; `rows/` has each measurement.
    """
    measured = benchmark.measured(rows)
    results = []
    for (preset, noise, drive), line in measured.estimates.iterrows():
        estimates = {
            name: {"mean": _plain(mean), "spread": _plain(spread), "seeds": int(seeds)}
            for name, (mean, spread, seeds) in line.unstack().iterrows()
        }
        results.append({"preset": preset, "noise": noise, "drive": drive, **estimates})
    record = {
        "benchmark": benchmark.title,
        "policy": benchmark.truth.policy,
        "labels": benchmark.labels,
        "drives": list(measured.drives),
        "presets": list(measured.presets),
        "noises": list(measured.noises),
        "results": results,
        "warnings": {row.cell.file_name: list(row.warnings) for row in rows if row.warnings},
        "config": {each.name: each.config.model_dump(mode="json") for each in benchmark.configs},
        **map_credit(is_made_up=all(row.made_up_map for row in rows)).members,
        "versions": versions(),
    }
    text = "\n\n".join(table.text() for table in tables(measured))
    write_file(out / "benchmark.txt", text + "\n")
    write_record(out / "benchmark.json", record)  # last: whoever waits for it finds the rest
    return text, record


def _plain(value: float) -> float | None:
    return None if np.isnan(value) else rounded(value, 5)


# What each rule and setting of the method gives: every one taken out alone, over drives that are split in two.
#
# A rule or setting stays if it gains on the mean of the choosing drives by more than the interval over places; nothing
# is chosen to reach a line. The reporting drives are measured once per candidate, and told whatever they say.

NOTHING = "nothing"
_RESAMPLES = 1000
_OF_THE_MAP = ("fusion.", "calibration")  # have no effect on a detection


@dataclass(frozen=True)
class DriveSet:
    """The drives of one part of the split, apart by place."""

    sequences: tuple[str, ...]
    seeds: tuple[int, ...]
    """Of the twins of KITTI."""
    recorded: tuple[str, ...]
    """Folders of recorded drives; their last two characters name the map, if none (`map.osm`) lies in them."""

    def cases(self, kitti: Path, recorded: Path | None, *, keep: Path | None, max_scans: int | None) -> list[Case]:
        """Return the twins, and those of the recorded drives that are there."""
        found: list[Case] = [*twin_cases(kitti, self.sequences, seeds=self.seeds, keep=keep, max_scans=max_scans)]
        for path in [] if recorded is None else [recorded / name for name in self.recorded]:
            if path.is_dir():
                own = path / "map.osm"
                (case,) = folder_cases([path], [own if own.is_file() else kitti / "osm" / f"{path.name[-2:]}.osm.gz"])
                found.append(replace(case, name=path.name))
        return found


SETS = {
    "choosing": DriveSet(("00", "05", "06", "09"), (0, 1, 2), ("real_00", "real_05", "real_06", "drawn_00", "town")),
    "reporting": DriveSet(("02", "07", "08", "10"), (3, 4, 5), ("real_02", "real_07", "drawn_02", "kitti360_00")),
}
"""Real ground of a sequence is `real_NN`, a drive over a map drawn by people `drawn_NN`, the made-up town
`town` (`interloc simulate town`)."""


def taken_out(config: DetectorConfig, names: Sequence[str] = ()) -> list[NamedConfig]:
    """Return the preset, and the preset with each setting in which it differs from `paper` set back to that, alone.

    A section that `paper` leaves out counts as one setting, and so does `candidates`; `names` chooses among them.
    """
    plain = dict(flatten(PAPER.model_dump(mode="json")))
    back: dict[str, str] = {}
    for name, value in flatten(config.model_dump(mode="json", exclude={"preset"})):
        section = name.split(".", maxsplit=1)[0]
        if name.startswith(_OF_THE_MAP) or (name in plain and plain[name] == value):
            continue
        if section == "candidates":
            back[section] = f"candidates.kind={PAPER.candidates.kind}"
        elif name in plain:
            back[name] = f"{name}={json.dumps(plain[name])}"
        else:
            back[section] = f"{section}=null"
    if unknown := [name for name in names if name not in back]:
        raise ConfigError(f"--take-out {unknown[0]}: expected one of {', '.join(back)}")
    without = [
        NamedConfig(name, with_settings(config, [setting]))
        for name, setting in back.items()
        if not names or name in names
    ]
    return [NamedConfig(NOTHING, config), *without]


_ACE, _AXES, _F1 = range(3)


def _by_place(rows: Iterable[Row]) -> dict[tuple[str, int], FloatArray]:
    """Return detections, right, missed, error, detections near known axes and their error, by node of the map.

    A node is one place on all drives that pass it. Detections without a node are one place for each drive.
    """
    places: dict[tuple[str, int], FloatArray] = {}
    for row in rows:
        for place in row.places:
            key = (row.cell.drive if place.node == UNMATCHED else "", place.node)
            axes = (0.0, 0.0) if place.axes_error_m is None else (place.detections, place.axes_error_m)
            matched = 0 if place.node == UNMATCHED else place.detections
            counts = (place.detections, matched, place.right, place.missed, place.error_m, *axes)
            places[key] = places.get(key, np.zeros(len(counts))) + np.array(counts, np.float64)
    return places


def _figures(counts: FloatArray) -> FloatArray:
    """Return ACE, the same against the axes, and F1 at 5 m in percent, of (..., places, 7) counts; NaN for none."""
    detections, matched, right, missed, error, known, off = np.moveaxis(counts.sum(axis=-2), -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack([error / matched, off / known, 200.0 * right / (right + detections + missed)], axis=-1)


def ablation_table(rows: Sequence[Row], configs: Sequence[NamedConfig], title: str) -> Table:
    """Return what changes without each setting, with the interval of a bootstrap over places."""
    base = _by_place(row for row in rows if row.cell.preset == configs[0].name)
    lines: dict[tuple[str, ...], Iterable[str]] = {}
    for config in configs:
        other = _by_place(row for row in rows if row.cell.preset == config.name)
        keys, nothing = sorted({*base, *other}), np.zeros(7)
        counts = np.array([[of.get(key, nothing) for key in keys] for of in (base, other)]).reshape(2, -1, 7)
        here = _figures(counts)
        drawn = np.random.default_rng(0).integers(0, max(len(keys), 1), (_RESAMPLES, len(keys)))
        spread = np.diff(_figures(counts[:, drawn]), axis=0)[0]
        cells = []
        for which, write in ((_ACE, metres), (_AXES, metres), (_F1, one_decimal)):
            cells.append(write(here[1, which]) if np.isfinite(here[1, which]) else MISSING)
            if config is not configs[0]:
                cells[-1] += _change(here[1, which] - here[0, which], spread[:, which], write)
        lines[config.name,] = cells
    drives = len({(row.cell.drive, row.cell.seed) for row in rows})
    return table_of(
        f"{title}: each setting in which the preset differs from paper set back to that, alone",
        lines,
        ["ACE [m]", "error from the axes [m]", "F1@5 [%]"],
        (
            f"{counted(drives, 'drive')}, {counted(len(base), 'place')}. In brackets: change and its interval",
            "(bootstrap over places, 95 %), * where that does not hold 0. ACE: from the nodes of OpenStreetMap. Axes:",
            "from where the axes of roads meet, where that is known: in simulated drives, and in those with axes.csv.",
        ),
        names=["taken out"],
    )


def _change(change: float, drawn: FloatArray, write: Callable[[float], str]) -> str:
    if not np.isfinite(change):
        return ""
    low, high = map(write, np.nanpercentile(drawn, (2.5, 97.5)))
    sign = "*" if float(low) > 0 or float(high) < 0 else " "
    return f" ({'+' if change >= 0 else ''}{write(change)}; {low} to {high}){sign}"
