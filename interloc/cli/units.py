"""Drives of a batch, each a unit of work of its own: `interloc run` or `detect` in a process of its own.

A unit is the command line of one drive, so its result is that of the command by itself. It can be repeated at will: a
result folder appears whole or not at all. Units are done on this machine, or by the workers of a Dask cluster. The same
command does those again that failed, or whose options are others.
"""

import io
import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, ThreadPoolExecutor, wait
from contextlib import contextmanager, redirect_stderr
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click

from interloc import storage
from interloc.cli.summary import not_right
from interloc.errors import ConfigError, IncompleteError, InterLocError
from interloc.files import write_file
from interloc.processes import dask_client, in_own_process, stop_processes

RECORDS = ".batch"
"""Folder of what is known of each unit: the same batch goes on where it was stopped."""


@dataclass(frozen=True)
class Unit:
    """A drive to work on."""

    name: str
    """Of the drive in the batch, and of its result folder."""
    drive: str
    """Where it is."""
    command: str
    """run or detect."""
    arguments: tuple[str, ...]
    """Of the command, without the result folder: what must be the same for an earlier result to count."""


COLUMNS = (
    "name",
    "state",
    "verdict",
    "found",
    "nodes",
    "right",
    "judged",
    "median_m",
    "precision",
    "recall",
    "ace_m",
    "reasons",
    "intersections",
    "keyframes",
    "seconds",
    "warnings",
    "error",
    "drive",
)
"""Found of the OSM nodes, right of the judged intersections, and their median error are the score. Precision, recall,
ace_m are those of the detections (D = 5 m); reasons say of which kinds the intersections are that are not right."""

Row = dict[str, Any]
"""What became of a unit: a value for each of the `COLUMNS`; its error is None where it was successful."""


def work(unit: Unit, out: str) -> Row:
    """Do a unit, in a worker process, and write its result to its place in the batch."""
    from interloc.cli.main import cli

    command = cli.get_command(click.Context(cli), unit.command)
    assert command is not None
    began = time.monotonic()
    notes = io.StringIO()
    row: Row = {**dict.fromkeys(COLUMNS), "name": unit.name, "drive": unit.drive}
    arguments = [unit.drive, "-o", f"{out}/{unit.name}", *unit.arguments, "--workers", "1", "--quiet"]
    with redirect_stderr(notes):
        try:
            with command.make_context(unit.command, arguments) as context:
                command.invoke(context)
                row |= _figures(context.params["out"])
            storage.send_results()
        except click.ClickException as failure:
            row["error"] = failure.format_message()
        except IncompleteError as failure:
            row |= _figures(Path(f"{out}/{unit.name}")) if not storage.is_url(out) else {}
            row["error"] = storage.shown(str(failure))
        except InterLocError as failure:
            row["error"] = storage.shown(str(failure))
        except Exception as failure:  # noqa: BLE001 - the other drives go on, whatever it is
            row["error"] = f"a fault of InterLoc itself: {type(failure).__name__}: {failure}"
    storage.clear()
    said = [line.removeprefix("warning: ") for line in notes.getvalue().splitlines() if line]
    row["warnings"] = "; ".join(dict.fromkeys([*(row["warnings"] or []), *said]))
    return row | {"seconds": round(time.monotonic() - began, 1), "state": "failed" if row["error"] else "successful"}


def _figures(folder: Path) -> Row:
    """Return the figures of a result."""
    run, report, *intersections = (
        json.loads(path.read_bytes()) if (path := folder / name).is_file() else {}
        for name in ("run.json", "report.json", "intersections.geojson", "intersections.local.json")
    )
    row = {"keyframes": run["keyframes"], "intersections": sum(len(each.get("features", [])) for each in intersections)}
    if report:
        level = report["map_level"]
        row |= {"verdict": report["map_line"], "ace_m": report["ace_m"], "reasons": not_right(report)}
        row |= {"found": level["nodes_in_zone"] - level["missed"], "nodes": level["nodes_in_zone"]}
        row |= {"right": level["true"], "judged": level["true"] + level["false"], "median_m": level["median_m"]}
        row |= {name: report[name]["5.0"] for name in ("precision", "recall")}
        row["warnings"] = report["warnings"]
    return row


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
        self._folder.mkdir(parents=True, exist_ok=True)
        storage.fetch_older(self.place, lambda name: name.startswith(f"{RECORDS}/"))

    def forget(self) -> None:
        """Forget what was done: every unit is done again."""
        shutil.rmtree(self._folder)
        self._folder.mkdir()

    def done(self, unit: Unit) -> Row | None:
        """Return what became of a unit that need not be done again."""
        try:
            record = json.loads((self._folder / f"{unit.name}.json").read_bytes())
            row: Row = record["row"]
            is_same = Unit(**record["unit"] | {"arguments": tuple(record["unit"]["arguments"])}) == unit
            is_there = (self.place / unit.name / "run.json").is_file()
        except (OSError, ValueError, TypeError, KeyError):
            return None
        return row if is_same and is_there and row["error"] is None else None

    def write(self, unit: Unit, row: Row) -> Row:
        """Record what became of a unit."""
        name = f"{RECORDS}/{unit.name}.json"
        write_file(self.place / name, json.dumps({"unit": asdict(unit), "row": row}, indent=1))
        if storage.is_url(self.out):
            storage.send_part(self.place, name)
        elif row["error"] is None and not (self.place / unit.name / "run.json").is_file():
            row = row | {"state": "failed", "error": f"its worker wrote no result here: it must see {self.out} too."}
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
                    row = {**dict.fromkeys(COLUMNS), "name": unit.name, "drive": unit.drive, "state": "failed"}
                    row |= {"seconds": 0.0, "warnings": "", "error": f"{unit.drive}: {error or type(error).__name__}"}
                rows[unit.name] = records.write(unit, row)
            progress(len(rows))
    return rows


Do = Callable[[Unit, str], Row]
"""Does a unit of the batch in a folder, or at an address."""


def _in_process(unit: Unit, out: str) -> Row:
    return in_own_process(partial(work, out=out), unit)


@contextmanager
def _processes(workers: int) -> Iterator[tuple[Executor, Do]]:
    """Do units in a process each; what runs is stopped where the batch ends early."""
    with ThreadPoolExecutor(workers, "batch") as threads:
        try:
            yield threads, _in_process
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
