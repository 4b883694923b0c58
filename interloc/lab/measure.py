"""One drive, one preset, one level of label errors: detect, evaluate, and keep in a file what the tables need of it.

Label errors are made on purpose: what the result does when the segmentation errs (paper, section V-C).
"""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from interloc.arrays import FloatArray, JsonObject
from interloc.config import DetectorConfig
from interloc.drive import Drive, GroundPoints, is_slow
from interloc.errors import ConfigError, OutputError
from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M, UNMATCHED
from interloc.files import reason_of, write_file
from interloc.geometry import enu_from_lonlat
from interloc.osm.graph import RoadGraph
from interloc.osm.policies import Policy
from interloc.pipeline import detect
from interloc.processes import Progress
from interloc.results import versions


class MislabelledDrive:
    """A drive whose labels err: a `Drive`.

    Parameters
    ----------
    drive : Drive
        With the labels as they are.
    r_fpr : float
        Share of the confusable points (sidewalk, parking, other ground) that are taken for road, 0..1.
    r_fnr : float
        Share of the road points that are missed, 0..1.
    seed : int
        The same points err for the same seed and frame, whatever the process and the order of reading.

    Raises
    ------
    ConfigError
        For a share outside of 0..1, or a seed below 0.
    """

    def __init__(self, drive: Drive, r_fpr: float, r_fnr: float, seed: int = 0) -> None:
        for name, share in (("r_fpr", r_fpr), ("r_fnr", r_fnr)):
            if not 0 <= share <= 1:
                raise ConfigError(f"{name} is {share:g}; expected a share from 0 to 1 (5 % is 0.05).")
        if seed < 0:
            raise ConfigError(f"seed is {seed}; expected 0 or more.")
        self.drive, self.r_fpr, self.r_fnr, self.seed = drive, r_fpr, r_fnr, seed
        self.name, self.frames, self.times_s = drive.name, drive.frames, drive.times_s
        self.T_world_lidar, self.georeference = drive.T_world_lidar, drive.georeference
        self.is_slow = is_slow(drive)

    def ground_points(self, index: int) -> GroundPoints:
        """Read a scan, and let some of its labels err."""
        points = self.drive.ground_points(index)
        draw = np.random.default_rng([self.seed, int(self.drive.frames[index])]).random(
            len(points.xyz), dtype=np.float32
        )
        is_road = points.is_road
        return GroundPoints.split(points.xyz, np.where(is_road, draw >= self.r_fnr, draw < self.r_fpr))


def parse_level(level: str) -> tuple[float, float]:
    """Return r-FPR and r-FNR as shares, 0..1, of a level in percent such as "5/20"; another text is a ConfigError."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*/\s*(\d+(?:\.\d+)?)\s*", level)
    shares = tuple(float(part) / 100.0 for part in match.groups()) if match else ()
    if len(shares) != 2 or max(shares) > 1.0:
        raise ConfigError(f"level {level!r} is not valid. Expected r-FPR/r-FNR in percent, such as 5/20.")
    return shares[0], shares[1]


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
    inputs: str = ""
    """What the drive is made of, and how it is read."""

    @property
    def file_name(self) -> str:
        """Name of its files, without an ending."""
        parts = (self.drive, self.preset, self.noise, f"seed{self.seed}")
        return "_".join(re.sub(r"[^\w.+-]+", "-", part).strip("-") for part in parts)


class Place(_Record):
    """What was found of a node of the map (-1: none is in the region of the detections), over all keyframes.

    `detections` are matched to it, `right` of them within 5 m; `missed` are keyframes that had it in their relevant
    zone and no detection of it. `error_m` is the sum of the distances from the node, `axes_error_m` from where the axes
    of the roads meet; None where that is not known.
    """

    node: int
    detections: int
    right: int
    missed: int
    error_m: float
    axes_error_m: float | None


class Row(_Record):
    """A drive measured once."""

    cell: Cell
    settings: JsonObject
    """Of the method and of the scoring, and the versions of the program and what it rests on."""
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
    """Fused intersections that are right and wrong; nodes in the zone without one; nodes in the zone."""
    map_errors_m: tuple[float, ...]
    """Of the assigned pairs, metres."""
    map_axes_errors_m: tuple[tuple[float, float], ...]
    """Of those pairs at whose node somebody read where the axes of the roads meet: from the node, and from there."""
    warnings: tuple[str, ...]
    made_up_map: bool
    """A simulator made the map up: it is not of OpenStreetMap."""


def write_row(row: Row, folder: Path) -> None:
    """Keep a row in a folder."""
    write_file(folder / f"{row.cell.file_name}.json", row.model_dump_json() + "\n")


def read_row(cell: Cell, settings: JsonObject, folder: Path) -> Row | None:
    """Read the row of a cell, if one is kept that was measured with these settings."""
    path = folder / f"{cell.file_name}.json"
    try:
        row = Row.model_validate_json(path.read_bytes())
    except (FileNotFoundError, ValidationError):  # or of another version of this program
        return None
    except OSError as error:
        raise OutputError(f"{path} could not be read: {reason_of(error)}.") from error
    return row if row.cell == cell and row.settings == settings else None


@dataclass(frozen=True)
class Scoring:
    """How detections are scored."""

    policy: Policy = "drive"
    tolerance_m: float = 15.0
    """Of policy `consolidated`."""


def settings_of(config: DetectorConfig, truth: Scoring) -> JsonObject:
    """Return what `Row.settings` keeps."""
    scoring = {"policy": truth.policy, "tolerance_m": truth.tolerance_m}
    return {"method": config.model_dump(mode="json"), "scoring": scoring, "versions": versions()}


def measure(
    cell: Cell,
    drive: Drive,
    graph: RoadGraph,
    config: DetectorConfig,
    truth: Scoring,
    *,
    axes: Mapping[int, tuple[float, float]] | None = None,
    progress: Progress | None = None,
) -> Row:
    """Measure a cell of the benchmark, by a drive without label errors and its map.

    `axes` are longitude and latitude of where the axes of the roads meet, by node (None: at the nodes).
    """
    r_fpr, r_fnr = parse_level(cell.noise)
    source = MislabelledDrive(drive, r_fpr, r_fnr, cell.seed) if r_fpr or r_fnr else drive
    result = detect(source, config, progress=progress)
    evaluation = evaluate(result, graph, policy=truth.policy, tolerance_m=truth.tolerance_m)
    matching, level = evaluation.matching, evaluation.map_level
    outcomes = Counter(evaluation.verdicts.intersections.outcome)
    return Row(
        cell=cell,
        settings=settings_of(config, truth),
        keyframes=len(evaluation.keyframes),
        errors_m=_rounded(matching.error_m[matching.is_matched]),
        places=_places(evaluation, axes),
        unmatched=int(np.count_nonzero(~matching.is_matched)),
        fn=evaluation.scores.fn,
        nodes_found=evaluation.nodes_found,
        nodes_in_zone=evaluation.nodes_in_zone,
        map_true=outcomes["right"],
        map_false=outcomes["wrong"],
        map_missed=int(level.missed.sum()),
        map_nodes=int(level.node_in_zone.sum()),
        map_errors_m=_rounded(level.errors_m),
        map_axes_errors_m=_from_axes(evaluation, axes or {}),
        warnings=evaluation.warnings,
        made_up_map=graph.is_made_up,
    )


def _places(evaluation: Evaluation, axes: Mapping[int, tuple[float, float]] | None) -> tuple[Place, ...]:
    matching, lonlat, ids = evaluation.matching, evaluation.detections.degrees, evaluation.nodes.osm_id
    missed = np.bincount(matching.zone_node[~matching.zone_found], minlength=len(ids))
    places = []
    for node in np.unique([*matching.node.tolist(), *np.flatnonzero(missed).tolist()]).tolist():
        rows = np.flatnonzero(matching.node == node)
        known = node != UNMATCHED
        errors = matching.error_m[rows] if known else np.zeros(0)
        number = int(ids[node]) if known else UNMATCHED
        off = float(errors.sum()) if known and axes is None else None
        if axes is not None and number in axes:
            off = float(np.hypot(*enu_from_lonlat(*axes[number][::-1], lonlat[rows]).T).sum())
        places.append(
            Place(
                node=number,
                detections=len(rows),
                right=int((errors < STANDARD_THRESHOLD_M).sum()),
                missed=int(missed[node]) if known else 0,
                error_m=round(float(errors.sum()), 4),
                axes_error_m=None if off is None else round(off, 4),
            )
        )
    return tuple(places)


def _from_axes(evaluation: Evaluation, axes: Mapping[int, tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    level, lonlat, nodes = evaluation.map_level, evaluation.intersections.degrees, evaluation.nodes
    found = []
    for row in np.flatnonzero(level.node != UNMATCHED).tolist():
        node = level.node[row]
        if (place := axes.get(int(nodes.osm_id[node]))) is not None:
            origins = np.array([nodes.lonlat[node], place])
            errors = np.hypot(*enu_from_lonlat(origins[:, 1], origins[:, 0], np.broadcast_to(lonlat[row], (2, 2))).T)
            found.append((round(float(errors[0]), 4), round(float(errors[1]), 4)))
    return tuple(found)


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple(np.round(values, 4).tolist())
