"""What went wrong, place by place: false detections in groups, and nodes that were missed, with the kind of reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M
from interloc.geometry import enu_from_lonlat, middle_of
from interloc.output.geojson import DEGREE_DECIMALS, rounded

GROUP_M = 6.0
"""False detections nearer than this to each other are one group."""

Explain = Callable[[int], list[str]]
"""Returns the command lines that show a frame."""


def find_failures(evaluation: Evaluation, explain: Explain) -> dict[str, Any]:
    """Gather the false detections and the missed nodes of a drive.

    Parameters
    ----------
    evaluation
    explain
        Gives the command lines that show the steps of the method at a frame.

    Returns
    -------
    dict
        `false_detections`: groups, largest first: `lon`, `lat`, `detections`, `frames`, `error_m` (median),
        `nearest_node` (`osm_id`, `degree`, `distance_m`), `kind`, `see`.
        Kinds: those of a wrong detection in `interloc.evaluation.reasons.KINDS`, the most frequent one of a group.
        `missed_nodes`: those with most missed keyframes first: `osm_id`, `lon`, `lat`, `degree`, `found`,
        `keyframes_in_zone`, `keyframes_missed`, `frames`, `best_error_m`, `kind`, `see`.
        Kinds: those of a missed node; "part_of_the_time" (found, but not at every keyframe); "on_the_map" (by no
        detection within 5 m, but by an intersection of the map within 10 m).
    """
    return {
        "false_detections": _false_detections(evaluation, explain),
        "missed_nodes": _missed_nodes(evaluation, explain),
    }


def _false_detections(evaluation: Evaluation, explain: Explain) -> list[dict[str, Any]]:
    detections, matching = evaluation.detections, evaluation.matching
    assert detections.lonlat is not None
    false = np.flatnonzero(~(matching.error_m < STANDARD_THRESHOLD_M))
    if len(false) == 0:
        return []
    lon, lat = middle_of(detections.lonlat)
    xy = enu_from_lonlat(lat, lon, detections.lonlat[false])
    nodes_xy = enu_from_lonlat(lat, lon, evaluation.nodes.lonlat)
    kinds = evaluation.verdicts.false_kind
    groups = []
    for rows in _groups(xy):
        place = np.median(xy[rows], axis=0)
        node, distance = _nearest(nodes_xy, place)
        members = false[rows]
        frames = evaluation.keyframes.frame[detections.keyframe[members]]
        ((kind, _),) = Counter(kinds[row] for row in members.tolist()).most_common(1)
        lonlat = np.median(detections.lonlat[members], axis=0)
        errors = matching.error_m[members]
        groups.append(
            {
                "lon": rounded(lonlat[0], DEGREE_DECIMALS),
                "lat": rounded(lonlat[1], DEGREE_DECIMALS),
                "detections": len(members),
                "frames": sorted(set(frames.tolist())),
                "error_m": rounded(np.median(errors), 2),
                "nearest_node": None if node < 0 else _node(evaluation, node) | {"distance_m": rounded(distance, 2)},
                "kind": kind,
                "see": explain(_middle(frames)),
            }
        )
    return sorted(groups, key=lambda group: -int(group["detections"]))


def _missed_nodes(evaluation: Evaluation, explain: Explain) -> list[dict[str, Any]]:
    table, matching, nodes = evaluation.node_table, evaluation.matching, evaluation.nodes
    if len(nodes) == 0:
        return []
    missed = []
    for node in np.flatnonzero(table.in_zone & (~table.found | (table.missed_keyframes > 0))).tolist():
        at_node = matching.zone_node == node
        misses = matching.zone_keyframe[at_node & ~matching.zone_found]
        frames = evaluation.keyframes.frame[misses if len(misses) else matching.zone_keyframe[at_node]]
        kind = "part_of_the_time" if table.found[node] else evaluation.verdicts.miss_kind[node] or "on_the_map"
        missed.append(
            {
                **_node(evaluation, node),
                "lon": rounded(nodes.lonlat[node, 0], DEGREE_DECIMALS),
                "lat": rounded(nodes.lonlat[node, 1], DEGREE_DECIMALS),
                "found": bool(table.found[node]),
                "keyframes_in_zone": int(table.zone_keyframes[node]),
                "keyframes_missed": int(table.missed_keyframes[node]),
                "frames": frames.tolist(),
                "best_error_m": rounded(table.best_error_m[node], 2),
                "kind": kind,
                "see": explain(_middle(frames)),
            }
        )
    return sorted(missed, key=lambda entry: (entry["found"], -entry["keyframes_missed"]))


def _node(evaluation: Evaluation, node: int) -> dict[str, Any]:
    return {"osm_id": int(evaluation.nodes.osm_id[node]), "degree": int(evaluation.nodes.degree[node])}


def _nearest(places: FloatArray, place: FloatArray) -> tuple[int, float]:
    if len(places) == 0:
        return -1, np.inf
    distance = np.hypot(*(places - place).T)
    nearest = int(np.argmin(distance))
    return nearest, float(distance[nearest])


def _middle(frames: IntArray) -> int:
    return int(np.sort(frames)[len(frames) // 2])


def _groups(xy: FloatArray) -> list[IntArray]:
    """Return the rows of each group of (N, 2) points that steps of at most `GROUP_M` join."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415
    from scipy.spatial import cKDTree  # noqa: PLC0415

    pairs = cKDTree(xy).query_pairs(GROUP_M, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(xy), len(xy)))
    count, group = connected_components(links, directed=False)
    return [np.flatnonzero(group == each) for each in range(count)]
