"""Output for the user: progress bars, log lines, tables of facts."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from interloc.wording import counted, metres, percent

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


class Interruption:
    """Ctrl-C or SIGTERM, recorded because an exception raised within a callback of a library may be lost."""

    asked = False

    @classmethod
    def ask(cls, signum: int, frame: FrameType | None) -> None:  # noqa: ARG003 - the signature of a signal handler
        """Handle the signal: stop here, or else at the next report of progress."""
        cls.asked = True
        sys.unraisablehook = lambda _: None  # objects that are half made raise errors when they are deleted
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


def progress(label: str, unit: str) -> closing[Bar]:
    """Give a progress bar that is gone at the end."""
    return closing(Bar(label, unit))


def note(text: str) -> None:
    """Print a line on stderr, unless with --quiet."""
    if not is_quiet():
        click.echo(text, err=True)


def say(record: Mapping[str, Any], outcome: Iterable[tuple[str, str]] | str) -> None:
    """Print the outcome of a command: as JSON for programs (--json), else as facts or a text for people."""
    if wants_json():
        say_json(record)
    elif not isinstance(outcome, str):
        say_facts(outcome)
    elif not is_quiet():
        click.echo(shown(outcome))


def say_facts(facts: Iterable[tuple[str, str]]) -> None:
    """Print names and values in two columns, unless with --quiet."""
    rows = [] if is_quiet() else list(facts)
    width = max((len(name) for name, _ in rows), default=0)
    for name, value in rows:
        click.echo(shown(f"{name:<{width}}  {value}"))


def say_json(value: Mapping[str, Any]) -> None:
    """Print one JSON object."""
    text = shown(json.dumps(value, ensure_ascii=False, allow_nan=False))  # addresses are found as they are written
    click.echo(json.dumps(json.loads(text), indent=2))


def size(count: int) -> str:
    """Write a number of bytes: "634 kB", "1.2 GB"."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            value = count / factor
            return f"{value:.1f} {unit}" if value < 100 else f"{value:.0f} {unit}"
    return f"{count} bytes"


if TYPE_CHECKING:
    from interloc.arrays import JsonObject
    from interloc.evaluation.record import Report
    from interloc.results import DriveResult, RunRecord


def run_facts(result: DriveResult, out: Path) -> list[tuple[str, str]]:
    """Return names and values for a person."""
    run = result.run
    seconds, workers = run["seconds"], counted(run["workers"], "worker")
    bends = (
        "of which all detections together saw two branches only: a bend of a road, or a side street that was not seen"
    )
    return [
        (
            "drive",
            f"{result.drive}: {run['scans']} scans, {run['keyframes']} keyframes, preset {run['config']['preset']}",
        ),
        ("detections", f"{len(result.detections)}"),
        ("intersections", f"{len(result.intersections)} on the map"),
        *([("left out", f"{counted(run['bends'], 'place')} {bends}")] if "bends" in run else []),
        georeference_fact(run),
        ("time", f"{seconds:.1f} s, {1e3 * seconds / run['keyframes']:.1f} ms per keyframe, {workers}"),
        ("written to", str(out)),
    ]


def doubt_facts(result: DriveResult) -> list[tuple[str, str]]:
    """Return the warnings of doubtful labels and of lost scans, where there are any; a report holds them anyway."""
    from interloc.drives.folder import dropped_in_words
    from interloc.labelling.track import doubts_in_words

    stretches, dropped = result.run["doubtful_labels_m"], result.run.get("dropped")
    found = [doubts_in_words(stretches)] if stretches else []
    return [("warning", each) for each in (*found, *([dropped_in_words(dropped)] if dropped else []))]


def georeference_fact(run: RunRecord) -> tuple[str, str]:
    """Return where longitude and latitude of a run come from, for a person."""
    return "georeference", run["georeference"] or "none: positions are metres in the frame of the first scan"


def run_summary(result: DriveResult, out: Path) -> JsonObject:
    """Return the same for a program."""
    return {
        "out": str(out),
        "drive": result.drive,
        "detections": len(result.detections),
        "intersections": len(result.intersections),
        "georeferenced": result.is_georeferenced,
        **{key: result.run[key] for key in ("scans", "keyframes", "seconds", "peak_memory_bytes")},
    }


def not_right(report: Report) -> str:
    """Return of which kinds the intersections are that are not right, with numbers; "" where all are."""
    from interloc.evaluation.reasons import KINDS

    kinds = {kind: count for kind, count in report["reasons"]["intersections"].items() if count}
    meanings: dict[str, str] = dict(KINDS)  # type: ignore[arg-type]
    listed = sorted(kinds.items(), key=lambda row: -row[1])
    return "; ".join(f"{count} x {meanings.get(kind, kind)}" for kind, count in listed)


def report_facts(report: Report, out: Path) -> list[tuple[str, str]]:
    """Return the main figures of report.json for a person, the map first."""
    kinds = not_right(report)
    return [
        ("map", report["map_line"]),
        ("policy", f"{report['policy']}: {counted(report['nodes_in_zone'], 'OSM node')} in the relevant zone"),
        *([("not right", f"{kinds} (in intersections)")] if kinds else []),
        (
            "detection level",
            f"ACE {metres(report['ace_m'])}, precision {percent(report['precision']['5.0'])}, "
            f"recall {percent(report['recall']['5.0'])} at D = 5 m: the paper's measure, of single keyframes"
            if report["ace_m"] is not None
            else "no detection was matched",
        ),
        *(("warning", text) for text in report["warnings"]),
        ("report", str(out / "report.html")),
    ]
