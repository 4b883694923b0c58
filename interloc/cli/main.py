"""The entry point: finds the command, and turns every failure into one readable line and an exit code."""

import errno
import gc
import os
import signal
import sys
from importlib import import_module
from traceback import walk_tb

import click

from interloc.cli.console import Interruption, shown
from interloc.errors import ConfigError, IncompleteError, InterLocError, in_words, is_interruption
from interloc.processes import GARBAGE_THRESHOLD

COMMANDS = {
    "info": "info",
    "run": "run",
    "evaluate": "results",
    "compare": "results",
    "explain": "results",
    "locate": "locate",
    "export": "results",
    "merge": "maps",
    "audit": "maps",
    "batch": "batch",
    "live": "live",
    "ros": "live",
    "label": "convert",
    "odometry": "convert",
    "convert": "convert",
    "simulate": "lab",
    "benchmark": "lab",
    "push": "push",
    "serve": "service",
    "admin": "service",
}
"""Name -> module of this package, in which the command has the same name."""

MOVED = {
    "detect": "`interloc run` without a map does that",
    "reduce": "`interloc convert --reduce` does that",
    "fetch": "`interloc push --fetch JOB` does that",
    "config": "`interloc info --settings` does that",
    **{name: f"it is `interloc admin {name}` now" for name in ("token", "check", "trash", "backup", "restore")},
}
"""Commands of before -> where they are."""


LIBRARIES = {
    "OPENBLAS_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
    "PYDANTIC_DISABLE_PLUGINS": "__all__",
    "PYTHONSAFEPATH": "1",
}
"""How libraries are set up, unless it is said otherwise: threads would only wait here, for small matrices and pictures,
and would keep worker processes from being forked; a look for plugins takes a tenth of the start. No process that is
started imports what lies in the working folder."""


class _Commands(click.Group):
    """Imports the module of a command when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name in MOVED:
            raise ConfigError(f"there is no command {cmd_name}: {MOVED[cmd_name]}")
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = getattr(import_module(f"interloc.cli.{COMMANDS[cmd_name]}"), cmd_name)
        return command


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True},
)
@click.version_option(package_name="interloc", message="InterLoc %(version)s")
def cli() -> None:
    """Find road intersections in LiDAR drives, map them, and score them against OpenStreetMap.

    \b
    Start with:
      interloc info DRIVE                          what is in a drive, and what is wrong with it
      interloc run DRIVE -o OUT --osm map.osm.gz   find, map, evaluate: open OUT/report.html
    """


def main() -> None:
    """Run the command line."""
    gc.set_threshold(GARBAGE_THRESHOLD)
    for name, value in LIBRARIES.items():  # before any of them is imported
        os.environ.setdefault(name, value)
    sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")  # which some daemons close
    for stop in (signal.SIGINT, signal.SIGTERM):  # SIGTERM is treated as Ctrl-C: half-written results are removed
        signal.signal(stop, Interruption.ask)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:  # nohup ignores it
        signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))
    code = run()
    gc.freeze()  # the end of the process need not look for circles in what numba and others have made: 0.1 s
    sys.exit(code)


def run(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 1 (failed) or 2 (usage)."""
    try:
        code = _invoke(arguments)
    except click.UsageError as error:
        error.show()
        return 2
    except click.ClickException as error:
        return _fail(error.format_message(), error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted; nothing was written", 1)
    except InterLocError as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:  # the reader of our output has gone, as with `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError:
        return _fail("out of memory; try fewer --workers or a coarser bev.resolution_m", 1)
    except OSError as error:
        if error.errno in {errno.ENOSPC, errno.EIO, errno.EFBIG} and error.filename is None:  # of writing to stdout
            return _fail(f"the output could not be written: {os.strerror(error.errno or 0).lower()}", 1)
        return _fault(error)
    except Exception as error:  # noqa: BLE001 - whatever it is, the user gets a line
        return _fault(error)
    return code if isinstance(code, int) else 0  # click returns what `Exit` asked for


def _invoke(arguments: list[str] | None) -> object:
    """Run a command; what it has written for object storage comes there, also where something beside it is missing."""
    code: object = 0
    missing = None
    try:
        code = cli.main(args=arguments, prog_name="interloc", standalone_mode=False)
    except IncompleteError as error:
        missing = error
    if not code and (storage := sys.modules.get("interloc.storage")) is not None:
        storage.send_results()
    if missing is not None:
        raise missing
    return code


def _fault(error: Exception) -> int:
    """Report an unexpected error, or raise it if INTERLOC_DEBUG is set."""
    if is_interruption(error):
        return _fail("interrupted; nothing was written", 1)
    if isinstance(error, ModuleNotFoundError) and any(
        frame.f_globals["__name__"].startswith("app.") for frame, _ in walk_tb(error.__traceback__)
    ):
        missing = f"the service needs {error.name}, which is not installed"
        return _fail(f"{missing}: pip install '.[service]' in the clone of InterLoc", 1)
    if os.environ.get("INTERLOC_DEBUG"):
        raise error
    return _fail(f"{in_words(error)}. Run again with INTERLOC_DEBUG=1 for the details, and please report them.", 1)


def _fail(message: str, exit_code: int) -> int:
    click.echo(f"interloc: {shown(message)}", err=True)
    return exit_code
