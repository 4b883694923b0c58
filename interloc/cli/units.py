"""Drives of a batch, each a unit of work of its own: `interloc run` or `detect` in a process of its own.

A unit is the command line of one drive, so its result is that of the command by itself. It can be repeated at will: a
result folder appears whole or not at all. Units are done on this machine, or by the workers of a Dask cluster.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import shutil
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import click

from interloc import storage
from interloc.errors import ConfigError, InterLocError, install
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


@dataclass(frozen=True)
class Ended:
    """What became of a unit."""

    seconds: float
    error: str | None = None
    """Why it failed; None if it did not."""
    warnings: tuple[str, ...] = ()
    content: bytes | None = None
    """The result folder as a tar, where the worker shares no folder with whoever asked."""


def work(unit: Unit, out: str | None) -> Ended:
    """Do a unit, in a worker process.

    Parameters
    ----------
    unit
    out
        Result folder to write; None gives it back.
    """
    if out is None:
        with tempfile.TemporaryDirectory(prefix="interloc-batch-") as folder:
            ended = work(unit, f"{folder}/{unit.name}")
            return ended if ended.error is not None else replace(ended, content=_packed(Path(folder) / unit.name))
    from interloc.cli.main import cli

    command = cli.get_command(click.Context(cli), unit.command)
    assert command is not None
    began = time.monotonic()
    notes = io.StringIO()
    error: str | None = None
    arguments = [unit.drive, "-o", out, *unit.arguments, "--workers", "1", "--quiet"]
    with redirect_stderr(notes):
        try:
            with command.make_context(unit.command, arguments) as context:
                command.invoke(context)
        except click.ClickException as failure:
            error = failure.format_message()
        except InterLocError as failure:
            error = storage.shown(str(failure))
        except Exception as failure:  # noqa: BLE001 - the other drives go on, whatever it is
            error = f"a fault of InterLoc itself: {type(failure).__name__}: {failure}"
    storage.clear()
    warnings = tuple(line.removeprefix("warning: ") for line in notes.getvalue().splitlines() if line)
    return Ended(time.monotonic() - began, error, warnings)


Submit = Callable[[Unit, Path], "Future[Ended]"]
"""Has a unit of the batch in a folder done."""


class Records:
    """What is known of the units of a batch, one file each, in the folder of the batch.

    Parameters
    ----------
    out
        Folder of the batch.
    whole
        Whether what is in object storage already is needed whole: else the records and the figures of the table.
    """

    def __init__(self, out: Path, *, whole: bool = False) -> None:
        self.out = out
        self._folder = out / RECORDS
        if out.exists() and not self._folder.is_dir() and (not out.is_dir() or any(out.iterdir())):
            raise ConfigError(
                f"{out} exists and is not the folder of a batch. It was not touched. Give a new or empty folder (-o)."
            )
        self._folder.mkdir(parents=True, exist_ok=True)
        needed = re.compile(rf"{re.escape(RECORDS)}/|.*/(run\.json|report\.json|intersections\.[a-z.]*json)$")
        storage.fetch_older(out, lambda name: whole or needed.match(name) is not None)
        self._place = storage.take_result(out)

    def send(self, *names: str) -> None:
        """Bring files and folders of the batch to where it belongs, if that is object storage."""
        for name in names:
            if self._place is not None and (self.out / name).exists():
                self._place.send(name)

    def forget(self) -> None:
        """Forget what was done: every unit is done again."""
        shutil.rmtree(self._folder)
        self._folder.mkdir()

    def done(self, unit: Unit) -> Ended | None:
        """Return how a unit ended that need not be done again."""
        try:
            record = json.loads((self._folder / f"{unit.name}.json").read_bytes())
            is_there = (self.out / unit.name / "run.json").is_file() and record["unit"] == unit.identity
            ended = Ended(**{**record["ended"], "warnings": tuple(record["ended"]["warnings"])})
        except (OSError, ValueError, TypeError, KeyError):
            return None
        return ended if is_there and ended.error is None else None

    def write(self, unit: Unit, identity: dict[str, Any], ended: Ended) -> Ended:
        """Record how a unit ended; what it brings goes to its folder first."""
        if ended.content is not None:
            from interloc.output.layout import result_folder

            content = io.BytesIO(ended.content)
            with result_folder(self.out / unit.name) as folder, tarfile.open(fileobj=content) as archive:
                archive.extractall(folder, filter="data")
            ended = replace(ended, content=None)
        write_file(self._folder / f"{unit.name}.json", json.dumps({"unit": identity, "ended": asdict(ended)}, indent=1))
        self.send(unit.name, f"{RECORDS}/{unit.name}.json")
        return ended


def do_all(
    units: Sequence[Unit], records: Records, workers: int, dask: str | None, progress: Callable[[int], None]
) -> dict[str, Ended]:
    """Do units; one that fails stops nothing, one whose process dies is tried again.

    Parameters
    ----------
    units
    records
    workers
        Processes of this machine.
    dask
        Address of a Dask scheduler whose workers do it instead.
    progress
        Called several times per second with how many are done; whatever it raises ends the batch.
    """
    ended: dict[str, Ended] = {}
    with _dask(dask) if dask is not None else _processes(workers) as submit:
        running = {submit(unit, records.out): (unit, unit.identity) for unit in units}
        while running:
            for future in wait(running, timeout=0.2, return_when=FIRST_COMPLETED).done:
                unit, identity = running.pop(future)
                try:
                    outcome = future.result()
                except Exception as error:  # noqa: BLE001 - of Dask, whose workers or scheduler died
                    why = f"the Dask cluster gave it up ({type(error).__name__}: {error})"
                    outcome = Ended(0.0, f"{unit.drive}: {why}. Usual cause: workers with too little memory.")
                ended[unit.name] = records.write(unit, identity, outcome)
            progress(len(ended))
    return ended


@contextmanager
def _processes(workers: int) -> Iterator[Submit]:
    """Do units in a process each, again where that dies; what runs is stopped where the batch ends early."""
    stopping = Event()

    def do(unit: Unit, out: Path) -> Ended:
        for _ in range(_TRIES):
            with suppress(InterLocError):  # it died: what is wrong with the drive is an outcome
                if not stopping.is_set():
                    return in_own_process(partial(work, out=str(out / unit.name)), unit)
        return Ended(0.0, f"{unit.drive}: its worker died {_TRIES} times. Usual cause: too little memory.")

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
    """Have units done by the workers of a cluster, which give the results back."""
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
            "Start one (`dask scheduler`), and workers (`dask worker ADDRESS`)."
        ) from error
    try:
        executor = client.get_executor(pure=False)  # a repeated call must be executed again
        yield lambda unit, _: executor.submit(work, unit, None)
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


def _packed(folder: Path) -> bytes:
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w:gz", compresslevel=1) as archive:
        for entry in sorted(folder.iterdir()):
            archive.add(entry, entry.name)
    return content.getvalue()
