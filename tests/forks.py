"""Processes forked from one in which all is imported and compiled: they start at once."""

import gc
import logging
import os
import tempfile
import threading
import traceback
import warnings
from functools import cache
from importlib import import_module
from multiprocessing import forkserver, get_context, util
from pathlib import Path
from pkgutil import iter_modules

import interloc.processes
from app.main import create_app
from app.settings import Settings
from interloc import cli
from interloc.cli.main import run
from tests.app.street import write_street
from tests.networks import write_model

context = get_context("forkserver")
# A server within this process would say what its workers need, and that is less.
context.set_forkserver_preload = lambda _: None  # type: ignore[method-assign]
interloc.processes._context = lambda _: context  # type: ignore[assignment]


@cache
def warm_up() -> None:
    """Import, load and compile all that servers, workers and commands need sooner or later."""
    commands = [f"interloc.cli.{each.name}" for each in iter_modules(cli.__path__)]
    for name in ("app.server", "app.work.warm", "interloc.client.jobs", "rich.console", *commands):
        import_module(name)
    create_app(Settings()).openapi()  # FastAPI makes the routes when they are asked for
    with tempfile.TemporaryDirectory() as folder:
        street = write_street(Path(folder) / "street", 8)
        model = write_model(Path(folder) / "model", height=16, width=128, road_half_width_m=5.0)
        for words in (
            f"convert {street} --reduce --all-scans --quiet -o {folder}/reduced",
            f"run {street} --model {model} --workers 1 --quiet -o {folder}/labelled",
            f"run {folder}/reduced --preset paper --osm {street}/map.osm --workers 1 --quiet -o {folder}/scored",
        ):
            assert run(words.split()) == 0
    gc.collect()
    gc.freeze()  # no fork looks at all this again, which would copy it


def begin() -> None:
    """Make the process that forks all others, a fork of this one, and wait until it can."""
    before, start = _open_files(), util.spawnv_passfds  # type: ignore[attr-defined]

    def fork(_: object, arguments: list[str], passed: list[int]) -> int:
        with warnings.catch_warnings(action="ignore"):  # other threads only wait
            if pid := os.fork():
                return pid
        try:
            for file in _open_files() - before - set(passed):
                os.close(file)
            logging.getLogger().handlers.clear()
            warnings.simplefilter("ignore")
            forkserver._forkserver._lock = threading.Lock()  # type: ignore[attr-defined] # held by the one that forks
            if "forkserver" in arguments[-1] and not warm_up.cache_info().currsize:
                warm_up()
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what workers of servers in this process say is no result
            exec(arguments[-1])  # noqa: S102 - what it would run as `python -c`
        except Exception:  # noqa: BLE001 - nobody else would tell
            traceback.print_exc()
        finally:
            os._exit(0)

    util.spawnv_passfds = fork  # type: ignore[attr-defined]
    try:
        forkserver.ensure_running()
    finally:
        util.spawnv_passfds = start  # type: ignore[attr-defined]
    process = context.Process(target=int)  # no test has to be patient until all is ready
    process.start()
    process.join()


def _open_files() -> set[int]:
    return {int(path.name) for path in sorted(Path("/dev/fd").iterdir()) if path.exists()}


if __name__ == "__main__":
    warm_up()
    with tempfile.TemporaryDirectory() as town:  # what few tests need is compiled now, once
        run(["simulate", "town", "--max-scans", "3", "--columns", "90", "-o", f"{town}/drive"])
        run(["label", f"{town}/drive", "--by", "geometry", "-o", f"{town}/labels"])
