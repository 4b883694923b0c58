"""Commands in processes of their own, forked from one that has imported everything: they start at once."""

import os
import resource
import signal
import subprocess
import sys
import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from multiprocessing import forkserver, get_context, util
from pathlib import Path
from typing import Any

import interloc.processes
from interloc.cli.main import main

context = get_context("forkserver")
context.set_forkserver_preload(["pytest", "tests.preloaded"])
# A server within this process would say that its workers need less: then every command and server had to import all.
context.set_forkserver_preload = lambda _: None  # type: ignore[method-assign]


@cache
def ready() -> None:
    """Wait, once, until all is imported: no test has to be patient with that."""
    process = context.Process(target=int)
    process.start()
    process.join()


def _ready_context(_: object) -> Any:
    """Return how processes for some work are started here: from the one process whose imports all tests share."""
    ready()  # now: later it would inherit that Ctrl-C is held back, and so would the commands
    return context


interloc.processes._context = _ready_context  # type: ignore[assignment]


class Command(context.Process):  # type: ignore[name-defined, misc]
    """`interloc ...` in a process of its own, with the methods of `subprocess.Popen` too; it writes into files.

    No file can get larger than `max_file_bytes`, if that is given.
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
    ) -> None:
        super().__init__()
        self.out, self.err = out, err
        self._words, self._environment = [str(each) for each in arguments], dict(environment)
        self._cwd, self._max_file_bytes = cwd, max_file_bytes
        self.start()

    @property
    def returncode(self) -> int | None:
        return self.poll()

    def poll(self) -> int | None:
        code: int | None = self.exitcode
        return code

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; returns the exit code."""
        self.join(timeout)
        if (code := self.poll()) is None:
            raise subprocess.TimeoutExpired("interloc", timeout or 0)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for the end; returns what was written."""
        self.wait(timeout)
        return self.out.read_text(), self.err.read_text()

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal, unless the process has ended."""
        if self.poll() is None:
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
        if {"serve", "batch"} & set(self._words):
            _prepare_workers()
        main()


def _prepare_workers() -> None:
    """Fork the process from which a command forks its workers, too: a new one would import everything again."""
    before = _open_files()

    def fork(_: object, arguments: Sequence[str], passed: Sequence[int]) -> int:
        if pid := os.fork():
            return pid
        for file in _open_files() - before - set(passed):
            os.close(file)
        try:
            exec(arguments[-1])  # noqa: S102 - what it would run as `python -c`
        finally:
            os._exit(0)

    start, util.spawnv_passfds = util.spawnv_passfds, fork  # type: ignore[attr-defined]
    try:
        forkserver.ensure_running()
    finally:
        util.spawnv_passfds = start  # type: ignore[attr-defined]


def _open_files() -> set[int]:
    return {int(path.name) for path in sorted(Path("/dev/fd").iterdir()) if path.exists()}
