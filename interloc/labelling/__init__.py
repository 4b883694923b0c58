"""Labels of scans: by a segmentation network (RangeNet++ and its family), or by geometry and the driven track."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelDescription:
    """A network in a list, named as its folder: what can be told of it without loading it."""

    name: str
    problem: str | None = None
    """Why it cannot be used; everything else is then as far as it is known."""
    bytes: int | None = None
    height: int | None = None
    width: int | None = None
    classes: int | None = None
    identity: str | None = None
    """The same for the same files, whatever their names and places."""
