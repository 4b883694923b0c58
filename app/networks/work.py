"""The networks of the service."""

from pathlib import Path

from interloc.errors import ModelError
from interloc.labelling.networks import describe_networks


def find(folder: Path | None, name: str) -> Path:
    """Return the folder of a network; a `ModelError` says that there is none of this name."""
    names = [] if folder is None else [each.name for each in describe_networks(folder)]
    if folder is None or name not in names:
        there = ", ".join(names) or "none; INTERLOC_MODELS names the folder that they are in"
        raise ModelError(f"model {name!r}: the service has no such network. There are: {there}.")
    return folder / name
