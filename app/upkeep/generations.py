"""Generations of backups: each a backup of its own, in a folder that is named by when it was begun.

What did not change from one to the next is there once, by hard links, where the file system has them: nothing in a
backup is changed in place but its database, which is copied.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from app.context import Context
from app.upkeep.backup import DATABASE, LOCK, RECORD, BackupRecord, BackupReport, back_up, refuse_unless_empty
from app.upkeep.transfer import PARTIAL, Advance, no_progress, writing
from app.work.places import link
from interloc.errors import ConfigError

_NAME = "%Y-%m-%dT%H%M%SZ"
_CLONING = ".cloning"


@dataclass(frozen=True)
class Retention:
    """Which generations stay: the newest of each of the last days, weeks and months that have one."""

    daily: int = 0
    weekly: int = 0
    monthly: int = 0
    """How many of each; the newest generation of all always stays."""

    def kept(self, times: list[datetime]) -> set[datetime]:
        """Return which of some times stay."""
        kept = {max(times)} if times else set()
        periods: tuple[tuple[int, Callable[[datetime], tuple[int, ...]]], ...] = (
            (self.daily, lambda time: (time.year, time.timetuple().tm_yday)),
            (self.weekly, lambda time: time.isocalendar()[:2]),
            (self.monthly, lambda time: (time.year, time.month)),
        )
        for count, period_of in periods:
            newest = {period_of(time): time for time in sorted(times)}
            kept |= set(sorted(newest.values())[len(newest) - min(count, len(newest)) :])
        return kept


def generations(out: Path) -> dict[datetime, Path]:
    """Return the generations in a folder, complete or not, the oldest first."""
    found = {}
    for path in sorted(out.iterdir()) if out.is_dir() else []:
        try:
            found[datetime.strptime(path.name, _NAME).replace(tzinfo=UTC)] = path
        except ValueError:  # something else
            continue
    return found


def back_up_generation(
    context: Context, out: Path, keep: Retention, advance: Advance = no_progress
) -> tuple[Path, BackupReport, list[str]]:
    """Make a generation, or go on with one that was stopped, then remove those that need not stay.

    Returns
    -------
    Path
        Folder of the generation.
    BackupReport
    list of str
        Names of those that were removed.

    Raises
    ------
    ConfigError
        `out` holds something else; or as of `back_up`, as all others.
    """
    if (out / RECORD).exists():
        raise ConfigError(
            f"{out} is a single backup. Generations need a folder of their own: give a new one, or move the backup "
            f"into it under the name of its time, such as {datetime.now(UTC):{_NAME}}."
        )
    there = generations(out)
    if out.is_dir() and not there:
        refuse_unless_empty(out, "and no generation of a backup", but=_CLONING)
    complete = {time: path for time, path in there.items() if _is_complete(path)}
    newest = max(complete, default=None)
    unfinished = [path for time, path in there.items() if newest is None or time > newest]
    target = unfinished[-1] if unfinished else out / f"{datetime.now(UTC):{_NAME}}"
    if newest is not None and not target.exists():
        with writing(target):
            _clone(complete[newest], target)
    report = back_up(context, target, advance)
    there = generations(out)
    kept = keep.kept([time for time, path in there.items() if _is_complete(path)])
    removed = [path for time, path in there.items() if time not in kept]
    for path in removed:
        with writing(path):
            (path / RECORD).unlink(missing_ok=True)  # half removed it is no backup
            shutil.rmtree(path)
    return target, report, [path.name for path in removed]


def find_generation(backup: Path, name: str | None) -> Path:
    """Return the generation to restore: the newest, or the newest whose name begins so; a single backup as it is.

    Raises
    ------
    ConfigError
        There is none such.
    """
    there = generations(backup)
    if not there and name is None:
        return backup
    fitting = [path for path in there.values() if path.name.startswith(name or "") and _is_complete(path)]
    if not fitting:
        raise ConfigError(
            f"{backup} holds no complete generation {name or ''!r}. It has: "
            f"{', '.join(path.name for path in there.values()) or 'none'}."
        )
    return fitting[-1]


def _is_complete(path: Path) -> bool:
    record = BackupRecord.read(path)
    return record is not None and record.complete


def _clone(source: Path, target: Path) -> None:
    """Make a copy of a backup of links; it has its name once it is whole."""
    temporary = target.with_name(_CLONING)
    shutil.rmtree(temporary, ignore_errors=True)
    for folder, folders, names in os.walk(source):
        here = Path(folder)
        if here == source:
            folders[:] = [name for name in folders if name != PARTIAL]
            names = [name for name in names if name != LOCK]  # noqa: PLW2901 - of this folder
        (temporary / here.relative_to(source)).mkdir(parents=True)
        for name in names:
            copy = shutil.copyfile if name.startswith(DATABASE) else link
            copy(here / name, temporary / here.relative_to(source) / name)
    temporary.rename(target)
