"""What a piece of work may use: time and memory, and the error where it uses more."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Literal

_GB = 1024**3
_SHARE = 0.75  # of the memory of the machine; the rest is for the server, the database and the page cache
_MIN_BYTES = 1 * _GB
_PROC, _CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")


class WorkerLimitError(Exception):
    """A piece of work used more than it may, and was ended; another try would end the same way.

    Attributes
    ----------
    limit : {"time", "memory"}
    bound, used : float
        Seconds or bytes.
    """

    def __init__(self, limit: Literal["time", "memory"], bound: float, used: float) -> None:
        unit = "s" if limit == "time" else "bytes"
        super().__init__(f"it used {used:.0f} {unit}, and may use {bound:.0f}")
        self.limit = limit
        self.bound = bound
        self.used = used


def memory_of(pid: int | None) -> int:
    """Return the resident memory of a process, bytes; 0 where the system does not tell (macOS, Windows)."""
    try:
        pages = int((_PROC / str(pid) / "statm").read_bytes().split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def memory_share(processes: int) -> int:
    """Return the memory that each of some worker processes may use, bytes: an equal share, but at least 1 GB."""
    return max(_MIN_BYTES, int(machine_memory() * _SHARE / processes))


def machine_memory() -> int:
    """Return the memory that this process and its children can use in all, bytes: that of the machine or container."""
    limits = [*_cgroup_limits(_PROC, _CGROUPS)]
    with suppress(ValueError, OSError, AttributeError):  # Windows
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return min(limits, default=0)


def _cgroup_limits(proc: Path, cgroups: Path) -> list[int]:
    """Return the limits of the control groups that this process is in, of version 2 and 1; "max" is none."""
    limits = []
    try:
        lines = (proc / "self/cgroup").read_text().splitlines()
    except OSError:
        return []
    for line in lines:
        _, controllers, place = line.split(":", 2)
        if controllers not in {"", "memory"}:
            continue
        root = cgroups / controllers
        name = "memory.limit_in_bytes" if controllers else "memory.max"
        group = root / place.lstrip("/")
        # The groups above bound it too; in a container the path may be that of the host: then only the root is there.
        for folder in (group, *group.parents):
            with suppress(OSError, ValueError):
                limits.append(int((folder / name).read_text()))
            if folder == root:
                break
    return limits
