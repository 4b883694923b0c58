"""When is a kept result still the result? When settings, inputs and program are the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

MEASURING = (
    *("detection", "drives", "evaluation", "kernels", "mapping", "osm", "pipeline.py", "geometry.py"),
    *("benchmark/measure.py", "benchmark/failures.py", "benchmark/row.py"),
)
"""Parts of this package that figures depend on, beside the settings."""

SIMULATING = ("simulate", "kernels/raycast.py", "geometry.py")
"""Parts of this package that simulated drives depend on."""


def fingerprint(facts: dict[str, Any]) -> str:
    """Return a short text that differs where the facts (plain values) differ."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]


@cache
def code_fingerprint(parts: tuple[str, ...]) -> str:
    """Return a short text that differs where the source of some parts of this package differs."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for part in parts:
        path = package / part
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.relative_to(package).as_posix().encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:20]


def file_facts(paths: Iterable[Path]) -> list[tuple[str, int, int]]:
    """Return name, size and time of change of files, and of the files in folders, in a fixed order."""
    facts = []
    for path in paths:
        files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
        for file in files:
            status = file.stat()
            name = file.relative_to(path).as_posix() if path.is_dir() else file.name
            facts.append((name, status.st_size, status.st_mtime_ns))
    return facts
