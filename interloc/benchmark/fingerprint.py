"""Fingerprints of settings, inputs and program: a kept result is valid as long as all of them are the same."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[1]
_WITHOUT_INFLUENCE = ("cli", "client", "explain")
"""Parts of this package that no figure depends on."""


def fingerprint(facts: dict[str, Any]) -> str:
    """Return a short text that differs where the facts (plain values) differ."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]


@cache
def measuring_program() -> str:
    """Return a fingerprint of the program that measures: the whole package without what no figure depends on."""
    files = (path for path in _PACKAGE.rglob("*.py") if path.relative_to(_PACKAGE).parts[0] not in _WITHOUT_INFLUENCE)
    return _contents(files)


@cache
def simulating_program() -> str:
    """Return a fingerprint of the program that simulates drives: the simulator and all that it imports."""
    return _contents(imported_by(_PACKAGE / "simulate"))


def imported_by(folder: Path) -> set[Path]:
    """Return the modules of a folder of this package, and those of the package that they import, directly or not."""
    found: set[Path] = set()
    waiting = set(folder.glob("*.py"))
    while waiting:
        path = waiting.pop()
        found.add(path)
        waiting |= set(_imports(path)) - found
    return found


def _imports(path: Path) -> Iterator[Path]:
    """Yield the modules of this package that a module imports, and the packages that they are in."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] == _PACKAGE.name:
            module = _PACKAGE.joinpath(*node.module.split(".")[1:])
            for name in (module, *(module / alias.name for alias in node.names)):
                places = [name.with_suffix(".py"), *(each / "__init__.py" for each in (name, *name.parents))]
                yield from (place for place in places if place.is_relative_to(_PACKAGE) and place.is_file())


def _contents(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.relative_to(_PACKAGE).as_posix().encode())
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
