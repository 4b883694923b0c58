"""Commands in processes of their own, forked from one in which all is imported and compiled: they start at once."""

import gc
import logging
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from multiprocessing import forkserver, get_context, util
from pathlib import Path
from pkgutil import iter_modules

import interloc.processes
from app.main import create_app
from app.settings import Settings
from interloc import cli, detect, evaluate, open_drive, read_osm, write_report, write_results
from interloc.cli.main import main
from interloc.config import PRESETS
from interloc.reduction.reduce import reduce_drive
from tests.app.street import write_street
from tests.networks import write_model

context = get_context("forkserver")
# A server within this process would say what its workers need, and that is less.
context.set_forkserver_preload = lambda _: None  # type: ignore[method-assign]


@cache
def warm_up() -> None:
    """Import, load and compile all that servers, workers and commands need sooner or later."""
    commands = [f"interloc.cli.{each.name}" for each in iter_modules(cli.__path__)]
    for name in ("app.server", "app.work.warm", "interloc.client.jobs", "rich.console", *commands):
        import_module(name)
    create_app(Settings()).openapi()  # FastAPI makes the routes when they are asked for
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        street, model = write_street(root / "street", 8), root / "model"
        write_model(model, height=16, width=128, road_half_width_m=5.0)
        reduce_drive(street, root / "reduced", keyframes=None)
        for drive in (open_drive(street, model=model), open_drive(street), open_drive(root / "reduced")):
            for config in PRESETS.values():
                result = detect(drive, config)
        write_results(result, root / "result")
        write_report(evaluate(result, read_osm(street / "map.osm")), root / "result")
    gc.collect()
    gc.freeze()  # no fork looks at all this again, which would copy it


def begin() -> None:
    """Make the process that forks all others, a fork of this one, and wait until it can."""
    before = _open_files()

    def fork(_: object, arguments: Sequence[str], passed: Sequence[int]) -> int:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # other threads only wait
            if pid := os.fork():
                return pid
        try:
            for file in _open_files() - before - set(passed):
                os.close(file)
            logging.getLogger().handlers.clear()
            warnings.resetwarnings()  # to what Python begins with
            for category in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
                warnings.simplefilter("ignore", category)
            forkserver._forkserver._lock = threading.Lock()  # type: ignore[attr-defined] # held by the one that forks
            if "resource_tracker" in arguments[-1]:
                warnings.simplefilter("ignore")  # processes that were killed have left some
            elif not warm_up.cache_info().currsize:
                warm_up()
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what workers of servers in this process say is no result
            exec(arguments[-1])  # noqa: S102 - what it would run as `python -c`
        except Exception:  # noqa: BLE001 - nobody else would tell
            traceback.print_exc()
        finally:
            os._exit(0)

    start, util.spawnv_passfds = util.spawnv_passfds, fork  # type: ignore[attr-defined]
    try:
        forkserver.ensure_running()
    finally:
        util.spawnv_passfds = start  # type: ignore[attr-defined]
    process = context.Process(target=int)  # no test has to be patient until all is ready
    process.start()
    process.join()


def _open_files() -> set[int]:
    return {int(path.name) for path in sorted(Path("/dev/fd").iterdir()) if path.exists()}


interloc.processes._context = lambda _: context  # type: ignore[assignment]


class Command(context.Process):  # type: ignore[name-defined, misc]
    """A program, `interloc` or another, in a process of its own, with the methods of `subprocess.Popen` too.

    It writes into files, of which none gets larger than `max_file_bytes`, if that is given.
    """

    def __init__(
        self,
        arguments: Sequence[object],
        environment: Mapping[str, str],
        out: Path,
        err: Path,
        cwd: Path | None = None,
        *,
        max_file_bytes: int | None = None,
        program: Callable[[], object] = main,
    ) -> None:
        super().__init__()
        self.out, self.err = out, err
        self._words, self._environment = [str(each) for each in arguments], dict(environment)
        self._cwd, self._max_file_bytes, self._program = cwd, max_file_bytes, program
        self.start()

    def poll(self) -> int | None:
        code: int | None = self.exitcode
        return code

    returncode = property(poll)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; returns the exit code."""
        self.join(timeout)
        if self.exitcode is None:
            raise subprocess.TimeoutExpired("interloc", timeout or 0)
        return int(self.exitcode)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for the end; returns what was written."""
        self.wait(timeout)
        return self.out.read_text(), self.err.read_text()

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal, unless the process has ended."""
        if self.exitcode is None:
            os.kill(self.pid, number)

    def run(self) -> None:
        """Become the command: its variables, its folder, its streams, its limit."""
        os.environ.clear()
        os.environ.update(self._environment)
        if self._cwd is not None:
            os.chdir(self._cwd)
        for path, stream in ((self.out, 1), (self.err, 2)):
            target = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            os.dup2(target, stream)
            os.close(target)
        sys.argv = ["interloc", *self._words]
        if self._environment.get("PYTHONWARNINGS") == "error":
            warnings.simplefilter("error")
        if self._max_file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (self._max_file_bytes, self._max_file_bytes))
        if {"serve", "batch", "worker"} & set(self._words):
            begin()  # else the first of its workers would import everything again
        self._program()


if __name__ == "__main__":
    warm_up()
