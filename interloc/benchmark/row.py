"""One measured drive: all that tables and figures need of it, kept in a file so that nothing is measured twice."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from interloc.errors import OutputError
from interloc.files import atomic_write, reason_of

Point = tuple[float, float]
Segment = tuple[float, float, float, float]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Cell(_Record):
    """Which measurement a row is."""

    drive: str
    """Name in the tables."""
    preset: str
    """Name of the settings."""
    noise: str
    """Label errors, r-FPR / r-FNR in percent: "20/20"."""
    seed: int
    """Of the label errors and, where it is simulated, of the drive."""

    @property
    def file_name(self) -> str:
        """Name of its files, without an ending."""
        parts = (self.drive, self.preset, self.noise, f"seed{self.seed}")
        return "_".join(re.sub(r"[^\w.+-]+", "-", part).strip("-") for part in parts)


class Place(_Record):
    """What was found of a node of the map, over all keyframes of a drive.

    Attributes
    ----------
    node : int
        Of OpenStreetMap; -1 for detections without any node in their region of interest.
    detections, right : int
        Matched to the node; within 5 m of it.
    missed : int
        Keyframes that had it in their relevant zone and no detection of it.
    error_m : float
        Sum of the distances of the detections from the node.
    axes_error_m : float or None
        Sum of their distances from where the axes of the roads meet; None where that is not known.
    """

    node: int
    detections: int
    right: int
    missed: int
    error_m: float
    axes_error_m: float | None


class MapPicture(_Record):
    """What the map of a drive shows, in metres east and north of the middle of its track."""

    roads: tuple[Segment, ...]
    """tuple of (x, y, x, y): pieces of the roads of the policy around the track."""
    track: tuple[Point, ...]
    """tuple of (x, y)."""
    true: tuple[Point, ...]
    false: tuple[Point, ...]
    """tuple of (x, y): detections within 5 m of their node, and all others."""
    found: tuple[Point, ...]
    missed: tuple[Point, ...]
    beyond: tuple[Point, ...]
    """tuple of (x, y): nodes of the map: in the zone and found, in the zone and not found, around but never in the
    zone."""
    is_made_up: bool = False
    """A simulator made the map up: it is not of OpenStreetMap."""


class Row(_Record):
    """A drive measured once."""

    cell: Cell
    fingerprint: str
    """Of everything that the figures depend on: settings, inputs, program."""
    policy: str
    keyframes: int
    errors_m: tuple[float, ...]
    """Center errors of all matched detections, metres."""
    places: tuple[Place, ...]
    """The same by the nodes of the map."""
    unmatched: int
    """Detections without any node in their ROI."""
    fn: int
    """Nodes in the relevant zone without a detection, summed over the keyframes."""
    nodes_found: int
    nodes_in_zone: int
    map_true: int
    map_false: int
    map_missed: int
    map_nodes: int
    """Fused intersections in the zone with and without a node; nodes in the zone without one; nodes in the zone."""
    map_errors_m: tuple[float, ...]
    """Of the assigned pairs, metres."""
    map_axes_errors_m: tuple[tuple[float, float], ...]
    """Of those pairs at whose node somebody read where the axes of the roads meet: from the node, and from there."""
    map_squared: tuple[float, ...]
    """Of the assigned pairs: errors in units of their covariances, squared (`evaluation.reliability`)."""
    map_confidence: tuple[float, ...]
    """Of the fused intersections in the zone."""
    map_right: tuple[bool, ...]
    """Whether these have a node."""
    compute_s: float
    """Processor time from files to intersections."""
    warnings: tuple[str, ...]
    picture: MapPicture
    failures: dict[str, Any]
    """See `interloc.benchmark.failures`."""


def write_row(row: Row, folder: Path) -> None:
    """Keep a row in a folder.

    Raises
    ------
    OutputError
        It could not be written.
    """
    with atomic_write(folder / f"{row.cell.file_name}.json") as handle:
        handle.write(row.model_dump_json(exclude_none=False).encode() + b"\n")


def read_row(cell: Cell, fingerprint: str, folder: Path) -> Row | None:
    """Read the row of a cell, if one is kept that was measured with the same settings, inputs and program.

    Raises
    ------
    OutputError
        The file cannot be read.
    """
    path = folder / f"{cell.file_name}.json"
    try:
        row = Row.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except ValidationError:  # of another version of this program
        return None
    except OSError as error:
        raise OutputError(f"{path} could not be read: {reason_of(error)}.") from error
    return row if row.cell == cell and row.fingerprint == fingerprint else None
