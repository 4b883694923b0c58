"""One drive, one preset, one level of label errors: detect, evaluate, and keep in a file what the tables need of it."""

import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from interloc.arrays import FloatArray
from interloc.config import DetectorConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drive import Drive
from interloc.drives.label_errors import MislabelledDrive, parse_level
from interloc.errors import OutputError
from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.evaluation.map_level import squared_errors
from interloc.evaluation.matching import UNMATCHED
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M
from interloc.files import atomic_write, reason_of
from interloc.geometry import enu_from_lonlat, middle_of
from interloc.osm.graph import RoadGraph
from interloc.osm.policies import Policy
from interloc.output.geojson import DEGREE_DECIMALS, rounded
from interloc.pipeline import detect, detect_range
from interloc.processes import Progress

GROUP_M = 6.0
"""False detections nearer than this to each other are one group."""

Explain = Callable[[int], list[str]]
"""Returns the command lines that show a frame."""


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
    """Of the assigned pairs: errors in units of their covariances, squared (`evaluation.map_level`)."""
    map_confidence: tuple[float, ...]
    """Of the fused intersections in the zone."""
    map_right: tuple[bool, ...]
    """Whether these have a node."""
    compute_s: float
    """Processor time from files to intersections."""
    warnings: tuple[str, ...]
    made_up_map: bool
    """A simulator made the map up: it is not of OpenStreetMap."""
    failures: tuple[dict[str, Any], ...]
    """See `find_failures`."""


def write_row(row: Row, folder: Path) -> None:
    """Keep a row in a folder."""
    with atomic_write(folder / f"{row.cell.file_name}.json") as handle:
        handle.write(row.model_dump_json(exclude_none=False).encode() + b"\n")


def read_row(cell: Cell, fingerprint: str, folder: Path) -> Row | None:
    """Read the row of a cell, if one is kept that was measured with the same settings, inputs and program."""
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


@dataclass(frozen=True)
class Scoring:
    """How detections are scored."""

    policy: Policy = "drive"
    tolerance_m: float = 15.0
    """Of policy `consolidated`."""


def measure(
    cell: Cell,
    fingerprint: str,
    drive: Drive,
    graph: RoadGraph,
    config: DetectorConfig,
    truth: Scoring,
    explain: Explain,
    *,
    axes: Mapping[int, tuple[float, float]] | None = None,
    progress: Progress | None = None,
) -> Row:
    """Measure a cell of the benchmark, by a drive without label errors and its map.

    `explain` gives the command lines that show a frame; `axes` longitude and latitude of where the axes of the roads
    meet, by node (None: at the nodes).
    """
    r_fpr, r_fnr = parse_level(cell.noise)
    source = MislabelledDrive(drive, r_fpr, r_fnr, cell.seed) if r_fpr or r_fnr else drive
    _warm_up(source, config)
    began = time.process_time()
    result = detect(source, config, progress=progress)
    used_s = time.process_time() - began  # of this process: what else runs on the machine does not count
    evaluation = evaluate(result, graph, policy=truth.policy, tolerance_m=truth.tolerance_m)
    matching, level = evaluation.matching, evaluation.map_level
    squared = squared_errors(evaluation.intersections, level, evaluation.nodes.lonlat)
    return Row(
        cell=cell,
        fingerprint=fingerprint,
        policy=truth.policy,
        keyframes=len(evaluation.keyframes),
        errors_m=_rounded(matching.error_m[matching.is_matched]),
        places=_places(evaluation, axes),
        unmatched=int(np.count_nonzero(~matching.is_matched)),
        fn=evaluation.scores.fn,
        nodes_found=evaluation.nodes_found,
        nodes_in_zone=evaluation.nodes_in_zone,
        map_true=int(level.right.sum()),
        map_false=int(level.wrong.sum()),
        map_missed=int(level.missed.sum()),
        map_nodes=int(level.node_in_zone.sum()),
        map_errors_m=_rounded(level.errors_m),
        map_axes_errors_m=_from_axes(evaluation, axes or {}),
        map_squared=_rounded(squared[np.isfinite(squared)]),
        map_confidence=_rounded(evaluation.intersections.confidence[level.counts]),
        map_right=tuple(level.right[level.counts].tolist()),
        compute_s=round(used_s, 4),
        warnings=evaluation.warnings,
        made_up_map=graph.is_made_up,
        failures=tuple(find_failures(evaluation, explain)),
    )


def _places(evaluation: Evaluation, axes: Mapping[int, tuple[float, float]] | None) -> tuple[Place, ...]:
    matching, lonlat, ids = evaluation.matching, evaluation.detections.lonlat, evaluation.nodes.osm_id
    assert lonlat is not None
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
    level, lonlat, nodes = evaluation.map_level, evaluation.intersections.lonlat, evaluation.nodes
    assert lonlat is not None
    found = []
    for row in np.flatnonzero(level.node != UNMATCHED).tolist():
        node = level.node[row]
        if (place := axes.get(int(nodes.osm_id[node]))) is not None:
            origins = np.array([nodes.lonlat[node], place])
            errors = np.hypot(*enu_from_lonlat(origins[:, 1], origins[:, 0], np.broadcast_to(lonlat[row], (2, 2))).T)
            found.append((round(float(errors[0]), 4), round(float(errors[1]), 4)))
    return tuple(found)


def _warm_up(drive: Drive, config: DetectorConfig) -> None:
    """Detect around a keyframe in the middle, so that no compiling is timed."""
    keyframes = select_keyframes(drive.T_world_lidar, config.keyframes)
    middle = len(keyframes) // 2
    detect_range(drive, keyframes, middle, min(middle + 1, len(keyframes)), config)


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple(np.round(values, 4).tolist())


def find_failures(evaluation: Evaluation, explain: Explain) -> list[dict[str, Any]]:
    """List what went wrong on a drive, place by place: what cost most first.

    `what`: "false" for a group of false detections, "missed" for a node that was missed at keyframes. `kind`: one of
    `interloc.evaluation.reasons.KINDS`, of a group the most frequent one, or of a node "part_of_the_time" (found, but
    not at every keyframe) and "on_the_map" (only by an intersection of the map within 10 m). `times`: detections, or
    keyframes. `off_m`: of the group from the nearest node, or the smallest error at the node. `see`: the command lines
    that draw the frame in the middle.
    """
    found = [*_false_detections(evaluation), *_missed_nodes(evaluation)]
    for failure in found:
        node, (lon, lat), frames = failure.pop("node"), failure.pop("lonlat"), failure["frames"]
        nodes = evaluation.nodes
        failure |= {
            "osm_id": None if node is None else int(nodes.osm_id[node]),
            "degree": None if node is None else int(nodes.degree[node]),
            "lon": rounded(lon, DEGREE_DECIMALS),
            "lat": rounded(lat, DEGREE_DECIMALS),
            "off_m": rounded(failure["off_m"], 2),
            "see": explain(sorted(frames)[len(frames) // 2]),
        }
        failure["frames"] = sorted(set(frames))
    return sorted(found, key=lambda failure: -failure["times"])


def _false_detections(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    """Yield the false detections in groups, which steps of at most `GROUP_M` join."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415
    from scipy.spatial import cKDTree  # noqa: PLC0415

    detections, kinds = evaluation.detections, evaluation.verdicts.false_kind
    assert detections.lonlat is not None
    false = np.flatnonzero(~(evaluation.matching.error_m < STANDARD_THRESHOLD_M))
    if len(false) == 0:
        return
    lon, lat = middle_of(detections.lonlat)
    xy = enu_from_lonlat(lat, lon, detections.lonlat[false])
    nodes_xy = enu_from_lonlat(lat, lon, evaluation.nodes.lonlat)
    pairs = cKDTree(xy).query_pairs(GROUP_M, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(xy), len(xy)))
    count, group = connected_components(links, directed=False)
    for number in range(count):
        members = false[group == number]
        away = np.hypot(*(nodes_xy - np.median(xy[group == number], axis=0)).T)
        yield {
            "what": "false",
            "kind": Counter(kinds[row] for row in members.tolist()).most_common(1)[0][0],
            "times": len(members),
            "off_m": away.min() if len(away) else np.nan,
            "node": int(away.argmin()) if len(away) else None,
            "lonlat": np.median(detections.lonlat[members], axis=0),
            "frames": evaluation.keyframes.frame[detections.keyframe[members]].tolist(),
        }


def _missed_nodes(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    table, matching = evaluation.node_table, evaluation.matching
    for node in np.flatnonzero(table.in_zone & (~table.found | (table.missed_keyframes > 0))).tolist():
        at_node = matching.zone_node == node
        misses = matching.zone_keyframe[at_node & ~matching.zone_found]
        yield {
            "what": "missed",
            "kind": "part_of_the_time" if table.found[node] else evaluation.verdicts.miss_kind[node] or "on_the_map",
            "times": max(int(table.missed_keyframes[node]), 0 if table.found[node] else 1),
            "off_m": table.best_error_m[node],
            "node": node,
            "lonlat": evaluation.nodes.lonlat[node],
            "frames": evaluation.keyframes.frame[misses if len(misses) else matching.zone_keyframe[at_node]].tolist(),
        }
