"""Output for the user: progress bars, log lines, tables of facts."""

import json
import logging
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import click

_QUIET, _JSON = "interloc.quiet", "interloc.json"  # of what click keeps beside the command that runs


def set_quiet(context: click.Context, _: click.Parameter, value: bool) -> None:
    """Take the option --quiet: only warnings are logged, and neither progress nor the outcome is told."""
    context.meta[_QUIET] = value
    set_up_log()


def set_json(context: click.Context, _: click.Parameter, value: bool) -> None:
    """Take the option --json: the outcome is told as JSON."""
    context.meta[_JSON] = value


def is_quiet() -> bool:
    """Return whether the command that runs has the option --quiet."""
    return _has(_QUIET)


def wants_json() -> bool:
    """Return whether the command that runs has the option --json."""
    return _has(_JSON)


def _has(option: str) -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(option))


def set_up_log() -> None:
    """Show what the library logs on stderr, one line per message, warnings marked; only warnings with --quiet."""
    logger = logging.getLogger("interloc")
    for handler in list(logger.handlers):
        logger.removeHandler(handler)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter("%(message)s"))
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING if is_quiet() else logging.INFO)
    logger.propagate = False


class _Formatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        text = shown(super().format(record))
        return f"{record.levelname.lower()}: {text}" if record.levelno >= logging.WARNING else text


def shown(text: str) -> str:
    """Return a text that names what lies in object storage by its address, not by where it is laid out here."""
    storage = sys.modules.get("interloc.storage")
    return text if storage is None else str(storage.shown(text))


def _ignore(_: object) -> None:
    pass


class Interruption:
    """Ctrl-C or SIGTERM, recorded because an exception raised within a callback of a library may be lost."""

    asked = False

    @classmethod
    def ask(cls, signum: int, frame: FrameType | None) -> None:  # noqa: ARG003 - the signature of a signal handler
        """Handle the signal: stop here, or else at the next report of progress."""
        cls.asked = True
        sys.unraisablehook = _ignore  # objects that are half made raise errors when they are deleted
        raise KeyboardInterrupt


class Bar:
    """A progress bar on stderr: shown on a terminal only, created when there is something to count."""

    def __init__(self, label: str, unit: str) -> None:
        self._label, self._unit = label, unit
        self._is_shown = sys.stderr.isatty() and not is_quiet()
        self._bar: Any = None

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show how much of the total is done, followed by a note."""
        if Interruption.asked:
            raise KeyboardInterrupt
        if not self._is_shown:
            return
        if self._bar is None or self._bar.n == 0 < done:  # what it took until the first tells nothing of the others
            from tqdm import tqdm

            self.close()
            self._bar = tqdm(
                initial=done,
                total=total,
                desc=self._label,
                unit=self._unit,
                unit_scale=self._unit == "B",
                leave=False,
                file=sys.stderr,
            )
        if note:
            self._bar.set_postfix_str(note, refresh=False)
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()


@contextmanager
def progress(label: str, unit: str) -> Iterator[Bar]:
    """Give a progress bar that is gone at the end."""
    bar = Bar(label, unit)
    try:
        yield bar
    finally:
        bar.close()


def say_on_terminal(text: str) -> None:
    """Print a line on stderr for somebody who waits; nothing where stderr is a file or another program."""
    if sys.stderr.isatty():
        click.echo(text, err=True)


def note(text: str) -> None:
    """Print a line on stderr, unless with --quiet."""
    if not is_quiet():
        click.echo(text, err=True)


def say(record: dict[str, Any], facts: Iterable[tuple[str, str]]) -> None:
    """Print the outcome of a command: as JSON for programs (--json), else as facts for people, unless with --quiet."""
    if wants_json():
        say_json(record)
    elif not is_quiet():
        say_facts(facts)


def say_facts(facts: Iterable[tuple[str, str]]) -> None:
    """Print names and values in two columns."""
    rows = list(facts)
    width = max((len(name) for name, _ in rows), default=0)
    for name, value in rows:
        click.echo(shown(f"{name:<{width}}  {value}"))


def say_json(value: dict[str, Any]) -> None:
    """Print one JSON object."""
    click.echo(shown(json.dumps(value, indent=2, allow_nan=False)))


def size(count: int) -> str:
    """Write a number of bytes: "634 kB", "1.2 GB"."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            value = count / factor
            return f"{value:.1f} {unit}" if value < 100 else f"{value:.0f} {unit}"
    return f"{count} bytes"
