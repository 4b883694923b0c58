"""Drives of a batch, each a unit of work of its own: `interloc run` or `detect` in a worker process.

A unit is the command line of one drive, so its result is that of the command by itself. It can be repeated at will: a
result folder appears whole or not at all. Workers are those of the service: processes of this machine, one of which
may die without the others, or those of a Dask cluster.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import tarfile
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import redirect_stderr
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc import storage
from interloc.errors import ConfigError, InterLocError
from interloc.files import write_file

if TYPE_CHECKING:
    from app.jobs.executors import WorkExecutor

RECORDS = ".batch"
"""Folder of what is known of each unit: the same batch goes on where it was stopped."""

_TRIES = 3  # of a unit whose workers died
_NO_WORKERS_S = 600.0  # how long a cluster may be without workers, or without its scheduler


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


class Records:
    """What is known of the units of a batch, one file each, in the folder of the batch."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self._folder = out / RECORDS
        if out.exists() and not self._folder.is_dir() and (not out.is_dir() or any(out.iterdir())):
            raise ConfigError(
                f"{out} exists and is not the folder of a batch. It was not touched. Give a new or empty folder (-o)."
            )
        self._folder.mkdir(parents=True, exist_ok=True)
        self._there = storage.take_result(out)

    def send(self, *names: str) -> None:
        """Bring files and folders of the batch to where it belongs, if that is object storage."""
        for name in names if self._there is not None else ():
            assert self._there is not None
            if (place := self.out / name).exists():
                storage.send(place, self._there[0], f"{self._there[1]}/{name}")

    def done(self, unit: Unit) -> Ended | None:
        """Return how a unit ended that need not be done again."""
        try:
            record = json.loads(storage.present(self._folder / f"{unit.name}.json").read_bytes())
            is_there = (self.out / unit.name / "run.json").is_file() and record["unit"] == unit.identity
            ended = Ended(**{**record["ended"], "warnings": tuple(record["ended"]["warnings"])})
        except (OSError, ValueError, TypeError, KeyError):
            return None
        return ended if is_there and ended.error is None else None

    def write(self, unit: Unit, identity: dict[str, Any], ended: Ended) -> Ended:
        """Record how a unit ended; what it brings goes to its folder first."""
        if ended.content is not None:
            _unpack(ended.content, self.out / unit.name)
            ended = replace(ended, content=None)
        write_file(self._folder / f"{unit.name}.json", json.dumps({"unit": identity, "ended": asdict(ended)}, indent=1))
        self.send(unit.name, f"{RECORDS}/{unit.name}.json")
        return ended


def do_all(
    units: Sequence[Unit],
    records: Records,
    executor: WorkExecutor,
    *,
    shares_folder: bool,
    progress: Callable[[int], None],
) -> dict[str, Ended]:
    """Do units; one that fails stops nothing, one whose worker dies is tried again.

    Parameters
    ----------
    units
    records
    executor
    shares_folder
        Whether workers write to the folder of the batch themselves.
    progress
        Called several times per second with how many are done; whatever it raises ends the batch.
    """
    waiting = deque(units)
    running: dict[Future[Ended], tuple[Unit, dict[str, Any]]] = {}
    tries: Counter[str] = Counter()
    ended: dict[str, Ended] = {}
    seen = time.monotonic()
    while waiting or running:
        if executor.alive:
            seen = time.monotonic()
            while waiting and len(running) < 2 * executor.slots:
                unit = waiting.popleft()
                out = str(records.out / unit.name) if shares_folder else None
                identity = unit.identity
                running[executor.submit(work, unit, out)] = unit, identity
        elif time.monotonic() - seen > _NO_WORKERS_S:
            raise InterLocError("there are no workers any more. The same command does what is left.")
        if not running:
            time.sleep(0.2)
        for future in wait(running, timeout=0.2, return_when=FIRST_COMPLETED).done:
            unit, identity = running.pop(future)
            outcome = _outcome(future)
            tries[unit.name] += executor.alive > 0
            if outcome is None and tries[unit.name] < _TRIES:
                waiting.append(unit)
                continue
            lost = Ended(0.0, f"{unit.drive}: its worker died {_TRIES} times. Usual cause: too little memory.")
            ended[unit.name] = records.write(unit, identity, outcome or lost)
        progress(len(ended))
    return ended


def _outcome(future: Future[Ended]) -> Ended | None:
    """Return what became of a unit; None where its worker is lost."""
    from app.jobs.processes import WorkerLimitError, WorkerLostError

    try:
        return future.result()
    except WorkerLostError:
        return None
    except WorkerLimitError as error:
        return Ended(0.0, f"it was ended for its {error.limit}: {error}. Fewer --workers leave each of them more.")


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


def _unpack(content: bytes, out: Path) -> None:
    from interloc.output.layout import result_folder

    with result_folder(out) as folder, tarfile.open(fileobj=io.BytesIO(content)) as archive:
        archive.extractall(folder, filter="data")


def remove_records(out: Path) -> None:
    """Forget what was done: every unit is done again."""
    shutil.rmtree(out / RECORDS, ignore_errors=True)
    (out / RECORDS).mkdir(parents=True, exist_ok=True)
