"""The networks of the service: where they lie, and how long each takes per scan on this machine."""

import json
from contextlib import suppress
from pathlib import Path

from interloc.errors import ModelError
from interloc.files import atomic_write
from interloc.labelling import ModelDescription
from interloc.labelling.networks import describe_networks

_FOLDER = "models"
_MAX_SCAN_S = 3600.0


def available(folder: Path | None) -> list[ModelDescription]:
    """List the networks of the service; those that cannot be used with the reason."""
    return [] if folder is None else describe_networks(folder)


def find(folder: Path | None, name: str) -> Path:
    """Return the folder of a network; a `ModelError` says that there is none of this name."""
    names = [] if folder is None else [each.name for each in describe_networks(folder)]
    if folder is None or name not in names:
        there = ", ".join(names) or "none; INTERLOC_MODELS names the folder that they are in"
        raise ModelError(f"model {name!r}: the service has no such network. There are: {there}.")
    return folder / name


def note_time(cache: Path, model: Path, seconds: float) -> None:
    """Remember how long a network takes per scan; without it nothing is lost but a promise to the next client."""
    with suppress(OSError):
        (cache / _FOLDER).mkdir(parents=True, exist_ok=True)
        with atomic_write(cache / _FOLDER / f"{model.name}.json") as file:
            file.write(json.dumps({"seconds_per_scan": round(seconds, 4)}).encode())


def seconds_per_scan(cache: Path, name: str) -> float | None:
    """Return how long a network took per scan the last time; None where it was not used here yet."""
    try:
        seconds = json.loads((cache / _FOLDER / f"{name}.json").read_text())["seconds_per_scan"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return seconds if isinstance(seconds, float) and 0 <= seconds < _MAX_SCAN_S else None
