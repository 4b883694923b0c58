"""Drives of a batch, each a unit of work of its own: `interloc run` or `detect` in a process of its own.

A unit is the command line of one drive, so its result is that of the command by itself. It can be repeated at will: a
result folder appears whole or not at all. Units are done on this machine, or by the workers of a Dask cluster.
"""

import hashlib
import io
import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import click

from interloc import storage
from interloc.cli.summary import not_right
from interloc.errors import ConfigError, IncompleteError, InterLocError, install
from interloc.files import write_file
from interloc.processes import in_own_process, stop_processes

RECORDS = ".batch"
"""Folder of what is known of each unit: the same batch goes on where it was stopped."""

_TRIES = 3  # of a unit whose process died
_PATIENCE_S = 10.0  # with a scheduler that does not answer


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
    """Of the command, without the result folder."""

    @property
    def identity(self) -> dict[str, Any]:
        """What must be the same for an earlier result to count: the command, and size and time of what it reads."""
        named = {self.drive, *self.arguments}
        files = {name: _stamps(name) for name in sorted(named) if not name.startswith("-")}
        return {"command": self.command, "arguments": list(self.arguments), "files": files}


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

Submit = Callable[[Unit, str], "Future[Row]"]
"""Has a unit of the batch in a folder, or at an address, done."""


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
            is_there = (self.place / unit.name / "run.json").is_file() and record["unit"] == unit.identity
        except (OSError, ValueError, TypeError, KeyError):
            return None
        return row if is_there and row["error"] is None else None

    def write(self, unit: Unit, identity: dict[str, Any], row: Row) -> Row:
        """Record what became of a unit."""
        name = f"{RECORDS}/{unit.name}.json"
        write_file(self.place / name, json.dumps({"unit": identity, "row": row}, indent=1))
        if storage.is_url(self.out):
            storage.send_part(self.place, name)
        elif row["error"] is None and not (self.place / unit.name / "run.json").is_file():
            row = row | {"state": "failed", "error": f"its worker wrote no result here: it must see {self.out} too."}
        return row


def do_all(
    units: Sequence[Unit], records: Records, workers: int, dask: str | None, progress: Callable[[int], None]
) -> dict[str, Row]:
    """Do units; one that fails stops nothing, one whose process dies is tried again.

    By `workers` processes of this machine, or by those of the Dask scheduler at an address. `progress` is called
    several times per second with how many are done; whatever it raises ends the batch.
    """
    rows: dict[str, Row] = {}
    with _dask(dask) if dask is not None else _processes(workers) as submit:
        running = {submit(unit, records.out): (unit, unit.identity) for unit in units}
        while running:
            for future in wait(running, timeout=0.2, return_when=FIRST_COMPLETED).done:
                unit, identity = running.pop(future)
                try:
                    row = future.result()
                except Exception as error:  # noqa: BLE001 - of Dask, whose workers or scheduler died
                    row = _lost(unit, f"the Dask cluster gave it up ({type(error).__name__}: {error})")
                rows[unit.name] = records.write(unit, identity, row)
            progress(len(rows))
    return rows


def _lost(unit: Unit, why: str) -> Row:
    error = f"{unit.drive}: {why}. Usual cause: too little memory."
    lost = {"name": unit.name, "drive": unit.drive, "state": "failed", "seconds": 0.0, "warnings": "", "error": error}
    return {**dict.fromkeys(COLUMNS), **lost}


@contextmanager
def _processes(workers: int) -> Iterator[Submit]:
    """Do units in a process each, again where that dies; what runs is stopped where the batch ends early."""
    stopping = Event()

    def do(unit: Unit, out: str) -> Row:
        for _ in range(_TRIES):
            with suppress(InterLocError):  # it died: what is wrong with the drive is an outcome
                if not stopping.is_set():
                    return in_own_process(partial(work, out=out), unit)
        return _lost(unit, f"its worker died {_TRIES} times")

    with ThreadPoolExecutor(workers, "batch") as threads:
        try:
            yield lambda unit, out: threads.submit(do, unit, out)
        except BaseException:
            stopping.set()
            threads.shutdown(wait=False, cancel_futures=True)
            stop_processes()
            raise


@contextmanager
def _dask(address: str) -> Iterator[Submit]:
    try:
        from distributed import Client

        connect: Any = Client
        client = connect(address, timeout=_PATIENCE_S, name="interloc", set_as_default=False)
    except ImportError as error:
        raise ConfigError(
            f"a Dask scheduler is named ({address}), but Dask is not installed. Install it: {install('dask')}"
        ) from error
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigError(
            f"no Dask scheduler answers at {address} ({error or type(error).__name__}). "
            "Start one (`dask scheduler`), and workers (`dask worker ADDRESS`) that see the same files."
        ) from error
    try:
        executor = client.get_executor(pure=False)  # a repeated call must be executed again
        yield lambda unit, out: executor.submit(work, unit, out)
    finally:
        client.close(timeout=5)


def _stamps(name: str) -> list[list[Any]]:
    """Return name, size and time of a file, or of what is directly in a folder; of all objects below a prefix."""
    path = Path(name)
    try:
        if storage.is_url(name):
            bucket, key = storage.Bucket.of(name)
            found = bucket.below(key) or [each for each in [bucket.head(key)] if each is not None]
            told = "\n".join(f"{each.key} {each.size} {each.etag} {each.modified_s}" for each in found)
            return [[len(found), hashlib.sha256(told.encode()).hexdigest()]]
        entries = sorted(path.iterdir()) if path.is_dir() else [path]
        return [[entry.name, entry.stat().st_size, entry.stat().st_mtime_ns] for entry in entries]
    except (OSError, InterLocError):
        return []
