"""`interloc batch`: drives of a batch, each a unit of work of its own, `interloc run` in a process of its own.

A unit is the command line of one drive, so its result is that of the command by itself. It can be repeated at will: a
result folder appears whole or not at all. Units are done on this machine, or by the workers of a Dask cluster. The
same command does those again that failed, or whose options are others.
"""

import csv
import io
import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, ThreadPoolExecutor, wait
from contextlib import contextmanager, redirect_stderr
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import click

from interloc import storage
from interloc.cli import console, options
from interloc.cli.console import not_right
from interloc.cli.run import run
from interloc.errors import ConfigError, IncompleteError, InterLocError, OutputError, in_words, is_interruption
from interloc.files import reason_of, write_file
from interloc.processes import cores, dask_client, in_own_process, stop_processes
from interloc.wording import counted

TABLE = "batch.csv"
_OF_MAP = ("osm", "overpass", "policy", "tolerance_m")
_TRUE, _FALSE = ("true", "yes", "1"), ("false", "no", "0")


@click.command(cls=options.Command, short_help="Work on many drives: one result folder each, and a table of all.")
@click.argument("drives", nargs=-1, required=True)
@click.option("-o", "--out", required=True, metavar="PATH", help="Folder of the batch: result folders and table.")
@options.together(*options.RUN)
@click.option(
    "--workers", type=click.IntRange(1, 256), show_default="one per core", help="Number of drives worked on at once."
)
@click.option("--dask", metavar="ADDRESS", help="Dask scheduler whose workers do it instead, as tcp://host:8786.")
@click.option("--fresh", is_flag=True, help="Do drives again that are done already.")
@options.OUTPUT
@click.pass_context
def batch(
    context: click.Context,
    /,
    drives: tuple[str, ...],
    out: str,
    workers: int | None,
    dask: str | None,
    fresh: bool,
    **given: Any,
) -> None:
    """Work on many DRIVES as `interloc run` does on one.

    A drive that fails stops nothing. The same command does what is left, or failed; drives that are done are done
    again only where their options have changed, or all with --fresh. Instead of drives, a LIST.csv names them: its
    column drive says where each is, name what to call it, and any other column is an option of `interloc run` for that
    drive alone, such as osm, near or labels. At the end DIR/batch.csv has a row per drive.

    \b
    Examples:
      interloc batch drives/* -o results --osm region.osm.pbf
      interloc batch drives.csv -o results --osm region.osm.pbf --dask tcp://cluster:8786
      interloc batch s3://bucket/drives -o s3://bucket/results --osm s3://bucket/region.osm.pbf --dask tcp://cluster:8786
    """
    options.configure(given["preset"], given["settings"])  # a mistake in it would fail every drive
    out = out.rstrip("/") or out
    not_given = {None, click.core.ParameterSource.DEFAULT}
    common = {name: value for name, value in given.items() if context.get_parameter_source(name) not in not_given}
    units = _units(drives, common)
    records = Records(out)
    if fresh:
        records.forget()
    done = {unit.name: row for unit in units if (row := records.done(unit)) is not None}
    if done:
        console.note(f"{counted(len(done), 'drive')} of {len(units)} done already (--fresh does them again)")
    missing = [unit for unit in units if unit.name not in done]
    kept = len(done)
    try:
        with console.progress("batch", "drive") as bar:
            processes = min(workers or cores(), len(missing) or 1)
            if missing:
                done |= do_all(missing, records, processes, dask, lambda count: bar(kept + count, len(units)))
    except BaseException as error:
        if not is_interruption(error):
            raise
        raise InterLocError("interrupted; the drives that are done are kept: the same command does the rest") from error
    rows = [done[unit.name] for unit in units]
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(asdict, rows))
    write_file(records.place / TABLE, text.getvalue())
    storage.send_results()  # now: the table of a batch in which a drive failed is one too
    failed = [row for row in rows if row.error is not None]
    record = {"out": out, "drives": [asdict(row) for row in rows], "failed": len(failed)}
    console.say(record, _facts(rows, f"{out}/{TABLE}"))
    if failed:
        first = failed[0]
        raise InterLocError(
            f"{len(failed)} of {counted(len(rows), 'drive')} failed, the first one {first.name}: {first.error}"
        )


def _units(drives: Sequence[str], common: Mapping[str, Any]) -> "list[Unit]":
    """Return what is to be done for each drive, or each row of a list."""
    params = run.get_params(click.Context(run))
    parameters = {str(param.name): param for param in params if isinstance(param, click.Option)}
    listed: list[_Listed] = []
    for drive in drives:
        is_list = drive.lower().endswith(".csv")
        listed += _listed(Path(drive), parameters) if is_list else map(_Listed, _drives_at(drive))
    if not listed:
        raise ConfigError(f"{drives[0]} names no drive. A list has a column drive, in its first line too.")
    names = _names([each.drive for each in listed], [each.name for each in listed])
    units = []
    for name, each in zip(names, listed, strict=True):
        own = {k: (*common.get(k, ()), v) if parameters[k].multiple else v for k, v in each.options.items()}
        values = {**common, **own}
        has_map = values.get("osm") is not None or values.get("overpass", False)
        used = {key: value for key, value in values.items() if has_map or key not in _OF_MAP}
        arguments = [text for key, value in used.items() for text in _written(parameters[key], value)]
        units.append(Unit(name, each.drive, tuple(arguments)))
    return units


@dataclass
class _Listed:
    """A drive of a list."""

    drive: str = ""
    name: str | None = None
    options: dict[str, str | bool] = field(default_factory=dict)
    """Of `interloc run`, for this drive alone."""


def _listed(path: Path, parameters: Mapping[str, click.Option]) -> list[_Listed]:
    """Return the rows of a list, values as text; paths are relative to the folder of the list."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path} cannot be read as a list of drives: {reason}.") from error
    by_column = {opt.lstrip("-").replace("-", "_"): param for param in parameters.values() for opt in param.opts}
    rows = []
    for number, line in enumerate(lines, 2):
        row = _Listed()
        for title, cell in line.items():
            column = (title or "").strip().lower().replace("-", "_")
            param = by_column.get(column)
            if not cell:
                continue
            if column == "drive":
                row.drive = _place(cell, path.parent)
            elif column == "name":
                row.name = cell
            elif param is None or param.name in {"out", "workers", "quiet", "as_json"}:
                raise ConfigError(f"{path} line {number}: {title or cell!r} is neither drive nor name nor an option.")
            elif param.is_flag and cell.lower() not in (*_TRUE, *_FALSE):
                raise ConfigError(f"{path} line {number}: {column} is {cell!r}; expected true or false.")
            else:
                is_path = isinstance(param.type, click.Path)
                row.options[str(param.name)] = (
                    cell.lower() in _TRUE if param.is_flag else _place(cell, path.parent) if is_path else cell
                )
        if not row.drive:
            raise ConfigError(f"{path} line {number} names no drive. A list has a column drive, in its first line too.")
        rows.append(row)
    return rows


def _drives_at(given: str) -> list[str]:
    """Return where a drive is, or all drives below a prefix in object storage."""
    if "://" not in given:
        return [_place(given)]
    from interloc.reduction.listing import find_stored

    _, _, drives = find_stored(given)
    found = ["/".join(filter(None, (given.rstrip("/"), drive.root))) for drive in drives]
    return found or [given]  # whose reading says what is wrong with it


def _place(given: str, base: Path = Path()) -> str:
    """Return a path that means the same to workers in other folders."""
    return given if "://" in given else str((base / given).absolute())


def _written(param: click.Option, value: Any) -> Iterator[str]:
    """Write the value of an option as on the command line."""
    name = max(param.opts, key=len)
    if param.is_flag:
        yield from [name] if value else []
    elif param.multiple:
        for each in value if isinstance(value, tuple) else [value]:
            yield from (name, str(each))
    elif isinstance(value, Path) or (isinstance(value, str) and "/" in value and Path(value).exists()):
        yield from (name, _place(console.shown(str(value))))
    else:
        yield from (name, ",".join(map(str, value)) if isinstance(value, tuple) else str(value))


def _names(drives: Sequence[str], given: Sequence[str | None]) -> list[str]:
    """Return a name for each drive: as given, else of its folder, with those above it where they are the same."""
    parts = [[part for part in drive.replace("://", "/").split("/") if part] for drive in drives]
    for depth in range(1, max(map(len, parts)) + 1):
        names = [name or "-".join(part[-depth:]) for name, part in zip(given, parts, strict=True)]
        if len(set(names)) == len(names):
            break
    else:
        twice = next(name for number, name in enumerate(names) if name in names[:number])
        raise ConfigError(
            f"{twice!r} names two drives of the batch. Give each drive once, or other names in a LIST.csv."
        )
    for name in names:
        if "/" in name or name.startswith("."):
            raise ConfigError(
                f"{name!r} cannot be the name of a drive: it is that of a folder. Give others in a LIST.csv."
            )
    return names


def _facts(rows: "Sequence[Row]", table: str) -> list[tuple[str, str]]:
    done = [row for row in rows if row.error is None]
    return [
        ("drives", f"{len(done)} of {len(rows)} successful"),
        ("intersections", str(sum(row.intersections or 0 for row in done))),
        ("time", f"{sum(row.seconds for row in rows):.1f} s of work"),
        ("table", table),
    ]


RECORDS = ".batch"
"""Folder of what is known of each unit: the same batch goes on where it was stopped."""


@dataclass(frozen=True)
class Unit:
    """A drive to work on."""

    name: str
    """Of the drive in the batch, and of its result folder."""
    drive: str
    """Where it is."""
    arguments: tuple[str, ...]
    """Of `interloc run`, without the result folder: what must be the same for an earlier result to count."""


@dataclass(kw_only=True)
class Row:
    """What became of a unit; its error is None where it was successful.

    Found of the OSM nodes, right of the judged intersections, and their median error are the score. Precision, recall,
    ace_m are those of the detections (D = 5 m); reasons say of which kinds the intersections are that are not right.
    """

    name: str
    state: str = "failed"
    verdict: str | None = None
    found: int | None = None
    nodes: int | None = None
    right: int | None = None
    judged: int | None = None
    median_m: float | None = None
    precision: float | None = None
    recall: float | None = None
    ace_m: float | None = None
    reasons: str | None = None
    intersections: int | None = None
    keyframes: int | None = None
    seconds: float = 0.0
    warnings: str = ""
    error: str | None = None
    drive: str


COLUMNS = tuple(each.name for each in fields(Row))


def work(unit: Unit, out: str) -> Row:
    """Do a unit, in a worker process, and write its result to its place in the batch."""
    began = time.monotonic()
    notes = io.StringIO()
    row, warnings = Row(name=unit.name, drive=unit.drive), list[str]()
    arguments = [unit.drive, "-o", f"{out}/{unit.name}", *unit.arguments, "--workers", "1", "--quiet"]
    with redirect_stderr(notes):
        try:
            with run.make_context("run", arguments) as context:
                try:
                    run.invoke(context)
                except IncompleteError as failure:  # what there is is written
                    row.error = storage.shown(in_words(failure))
                warnings = _take_figures(row, context.params["out"])
            storage.send_results()
        except click.ClickException as failure:
            row.error = failure.format_message()
        except Exception as failure:  # noqa: BLE001 - the other drives go on, whatever it is
            row.error = storage.shown(in_words(failure))
        finally:
            storage.clear()
    said = [line.removeprefix("warning: ") for line in notes.getvalue().splitlines() if line]
    row.warnings = "; ".join(dict.fromkeys([*warnings, *said]))
    row.seconds, row.state = round(time.monotonic() - began, 1), "failed" if row.error else "successful"
    return row


def _take_figures(row: Row, folder: Path) -> list[str]:
    """Take the figures of a result; return the warnings of its report."""
    from interloc.evaluation.record import REPORT_FILE, read_report
    from interloc.output.geojson import read_json
    from interloc.output.layout import file_names
    from interloc.output.read import read_run

    run = read_run(folder)
    intersections = read_json(folder / file_names(georeferenced=run["georeferenced"])["intersections"])
    row.keyframes, row.intersections = run["keyframes"], len(intersections["features"])
    if not (folder / REPORT_FILE).is_file():
        return []
    report = read_report(folder)
    level = report["map_level"]
    row.verdict, row.reasons, row.ace_m = report["map_line"], not_right(report), report["ace_m"]
    row.found, row.nodes = level["nodes_in_zone"] - level["missed"], level["nodes_in_zone"]
    row.right, row.judged, row.median_m = level["true"], level["true"] + level["false"], level["median_m"]
    row.precision, row.recall = report["precision"]["5.0"], report["recall"]["5.0"]
    return report["warnings"]


class Records:
    """What is known of the units of a batch, a file each, in its folder or at its address in object storage."""

    def __init__(self, out: str) -> None:
        self.out = out
        self.place = storage.result_place(out) if storage.is_url(out) else Path(out)
        self._folder = self.place / RECORDS
        if self.place.exists() and not self._folder.is_dir() and (not self.place.is_dir() or any(self.place.iterdir())):
            raise ConfigError(
                f"{out} exists and is not the folder of a batch. It was not touched. Give a new or empty folder (-o)."
            )
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
        if storage.is_url(out):  # where a folder needs a file
            write_file(self._folder / "begun", "")
            storage.send_part(self.place, f"{RECORDS}/begun")
        storage.fetch_older(self.place, lambda name: name.startswith(f"{RECORDS}/"))

    def forget(self) -> None:
        """Forget what was done: every unit is done again."""
        shutil.rmtree(self._folder)
        self._folder.mkdir()

    def done(self, unit: Unit) -> Row | None:
        """Return what became of a unit that need not be done again; a ConfigError: another drive has its name."""
        try:
            record = json.loads((self._folder / f"{unit.name}.json").read_bytes())
            row = Row(**record["row"])
            before = Unit(**record["unit"] | {"arguments": tuple(record["unit"]["arguments"])})
            is_there = (self.place / unit.name / "run.json").is_file()
        except (OSError, ValueError, TypeError, KeyError):
            return None
        if is_there and before.drive != unit.drive:
            what = f"{self.out}/{unit.name} is the result of {before.drive}, not of {unit.drive}"
            raise ConfigError(f"{what}. Give another folder (-o), or other names in a LIST.csv (column name).")
        return row if before == unit and is_there and row.error is None else None

    def write(self, unit: Unit, row: Row) -> Row:
        """Record what became of a unit."""
        name = f"{RECORDS}/{unit.name}.json"
        write_file(self.place / name, json.dumps({"unit": asdict(unit), "row": asdict(row)}, indent=1))
        if storage.is_url(self.out):
            storage.send_part(self.place, name)
        elif row.error is None and not (self.place / unit.name / "run.json").is_file():
            row.state, row.error = "failed", f"its worker wrote no result here: it must see {self.out} too."
        return row


def do_all(
    units: Sequence[Unit], records: Records, workers: int, dask: str | None, progress: Callable[[int], None]
) -> dict[str, Row]:
    """Do units, by `workers` processes of this machine, or by those of the Dask scheduler at an address.

    One that fails, or whose process dies, stops nothing. `progress` is called several times per second with how many
    are done; whatever it raises ends the batch.
    """
    rows: dict[str, Row] = {}
    with _processes(workers) if dask is None else _dask(dask) as (executor, do):
        running = {executor.submit(do, unit, records.out): unit for unit in units}
        while running:
            for future in wait(running, timeout=0.2, return_when=FIRST_COMPLETED).done:
                unit = running.pop(future)
                try:
                    row = future.result()
                except Exception as error:  # noqa: BLE001 - its process, or Dask's workers or scheduler, died
                    row = Row(name=unit.name, drive=unit.drive, error=f"{unit.drive}: {error or type(error).__name__}")
                rows[unit.name] = records.write(unit, row)
            progress(len(rows))
    return rows


Do = Callable[[Unit, str], Row]
"""Does a unit of the batch in a folder, or at an address."""


@contextmanager
def _processes(workers: int) -> Iterator[tuple[Executor, Do]]:
    """Do units in a process each; what runs is stopped where the batch ends early."""
    with ThreadPoolExecutor(workers, "batch") as threads:
        try:
            yield threads, lambda unit, out: in_own_process(partial(work, out=out), unit)
        except BaseException:
            threads.shutdown(wait=False, cancel_futures=True)
            stop_processes()
            raise


@contextmanager
def _dask(address: str) -> Iterator[tuple[Executor, Do]]:
    client = dask_client(address)
    try:
        yield client.get_executor(pure=False), work  # a repeated call must be executed again
    finally:
        client.close(timeout=5)
