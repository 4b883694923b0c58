"""How much of a drive it takes to place it: the search repeated over its first metres, more and more of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Drive
from interloc.localization.locate import locate
from interloc.localization.track import track_of
from interloc.osm.graph import RoadGraph
from interloc.processes import Progress
from interloc.results import DriveResult

LENGTHS_M = (100.0, 150.0, 200.0, 300.0, 400.0, 500.0, 700.0, 1000.0, 1500.0, 2000.0, 3000.0)


@dataclass(frozen=True)
class _Beginning:
    """The first scans of a drive, of which only the poses are needed."""

    name: str
    frames: IntArray
    T_world_lidar: FloatArray
    times_s: None = None
    georeference: None = None

    def ground_points(self, index: int) -> Any:  # noqa: ANN401 - never called: a search needs poses only
        """Not available."""
        raise NotImplementedError(f"scan {index} of {self.name}: only poses are here")


def growth_of(
    drive: Drive,
    graph: RoadGraph,
    *,
    result: DriveResult | None = None,
    near: tuple[float, float] | None = None,
    radius_m: float | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Place the first 100, 150, 200, ... metres of a drive, and at last all of it.

    Returns
    -------
    list of dict
        `length_m`, `outcome`, `score`, `runner_up`, `chance` for each length.
    """
    at_m = track_of(drive.T_world_lidar).at_m
    lengths = [length for length in LENGTHS_M if length < at_m[-1]] + [float(at_m[-1])]
    rows: list[dict[str, Any]] = []
    for number, length_m in enumerate(lengths):
        count = int(np.searchsorted(at_m, length_m)) + 1
        part = _Beginning(drive.name, drive.frames[:count], drive.T_world_lidar[:count])
        seen = None if result is None else _before(result, int(part.frames[-1]))
        location = locate(part, graph, result=seen, near=near, radius_m=radius_m)
        scores = [place.score for place in location.places[:2]]
        rows.append(
            {
                "length_m": round(length_m, 1),
                "outcome": location.decision.outcome,
                "score": round(scores[0], 3) if scores else None,
                "runner_up": round(scores[1], 3) if len(scores) > 1 else None,
                "chance": round(location.chance, 3),
            }
        )
        if progress is not None:
            progress(number + 1, len(lengths))
    return rows


def growth_text(rows: list[dict[str, Any]]) -> str:
    """Say from which length on a drive is found, and stays found."""
    unique = len(rows)
    while unique and rows[unique - 1]["outcome"] == "found":
        unique -= 1
    steps = ", ".join(f"{row['length_m']:.0f} m {row['outcome'].replace('_', ' ')}" for row in rows)
    where = f"unique from {rows[unique]['length_m']:.0f} m on" if unique < len(rows) else "never unique"
    return f"{where} ({steps})"


def _before(result: DriveResult, frame: int) -> DriveResult:
    """Return a run up to a scan."""
    keyframes, table = result.keyframes, result.detections
    count = int(np.searchsorted(keyframes.frame, frame, side="right"))
    return replace(
        result,
        keyframes=replace(keyframes.select(np.arange(count)), lonlat=None, enu_yaw_rad=None),
        detections=replace(table.select(np.flatnonzero(table.keyframe < count)), lonlat=None),
    )
