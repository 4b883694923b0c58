"""The evaluation as plain values: what `report.json` holds, by the contract of the result folder."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.map_level import MapLevel
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M
from interloc.output.geojson import DEGREE_DECIMALS, rounded

_METRE_DECIMALS = 4
_RATIO_DECIMALS = 6


def report_record(evaluation: Evaluation) -> dict[str, Any]:
    """Return the figures of an evaluation as values that JSON can say; what is undefined is None."""
    scores, errors, table = evaluation.scores, evaluation.errors, evaluation.node_table
    names = [threshold_name(d) for d in scores.threshold_m]
    return {
        "drive": evaluation.drive,
        "policy": evaluation.nodes.policy,
        "tolerance_m": evaluation.nodes.tolerance_m,
        "osm": {
            "source": evaluation.graph.source,
            "date": evaluation.graph.date,
            "nodes": len(evaluation.nodes),
            "bounds": evaluation.graph.bounds,
            "highways": len(evaluation.graph.ways),
            "clipped_highways": evaluation.graph.clipped_ways,
        },
        "keyframes": len(evaluation.keyframes),
        "detections": len(evaluation.detections),
        "detections_outside_map": evaluation.detections_outside_map,
        "matched": int(evaluation.matching.is_matched.sum()),
        "ace_m": _metres(errors.ace_m),
        "ace_tp_m": _metres(errors.ace_tp_m),
        "ace_tp_threshold_m": STANDARD_THRESHOLD_M,
        "ace_under_10_m": _metres(errors.ace_under_10_m),
        "ace_under_threshold_m": NEAR_PAIR_M,
        "median_m": _metres(errors.median_m),
        "p95_m": _metres(errors.p95_m),
        "rmse_m": _metres(errors.rmse_m),
        "tp": dict(zip(names, scores.tp.tolist(), strict=True)),
        "fp": dict(zip(names, scores.fp.tolist(), strict=True)),
        "fn": dict.fromkeys(names, scores.fn),  # the same for every D: no distance is asked of a match
        "precision": dict(zip(names, _ratios(scores.precision), strict=True)),
        "recall": dict(zip(names, _ratios(scores.recall), strict=True)),
        "f1": dict(zip(names, _ratios(scores.f1), strict=True)),
        "roi_m": evaluation.roi_m,
        "relevant_zone_m": evaluation.relevant_zone_m,
        "nodes_in_zone": int(table.in_zone.sum()),
        "nodes_found": int((table.in_zone & table.found).sum()),
        "map_level": _map_level(evaluation.map_level),
        "track_to_road_m": _metres(evaluation.track_to_road_m),
        "warnings": list(evaluation.warnings),
        "nodes": node_rows(evaluation),
    }


def threshold_name(threshold_m: float) -> str:
    """Return the key of a threshold in the maps of the report: "5.0"."""
    return f"{threshold_m:.1f}"


def node_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Return the nodes that mattered: in the zone of some keyframe, or matched by some detection."""
    nodes, table, level = evaluation.nodes, evaluation.node_table, evaluation.map_level
    on_map = dict(zip(level.node.tolist(), level.error_m.tolist(), strict=True))
    return [
        {
            "osm_id": int(nodes.osm_id[row]),
            "lon": rounded(nodes.lonlat[row, 0], DEGREE_DECIMALS),
            "lat": rounded(nodes.lonlat[row, 1], DEGREE_DECIMALS),
            "degree": int(nodes.degree[row]),
            "in_zone": bool(table.in_zone[row]),
            "found": bool(table.found[row]),
            "keyframes_in_zone": int(table.zone_keyframes[row]),
            "keyframes_missed": int(table.missed_keyframes[row]),
            "detections": int(table.detections[row]),
            "best_error_m": _metres(table.best_error_m[row]),
            "median_error_m": _metres(table.median_error_m[row]),
            "map_error_m": _metres(on_map.get(row)),
        }
        for row in np.flatnonzero(table.in_zone | (table.detections > 0)).tolist()
    ]


def _map_level(level: MapLevel) -> dict[str, Any]:
    errors = level.errors_m
    return {
        "gate_m": level.gate_m,
        "intersections": len(level.node),
        "intersections_in_zone": int(level.counts.sum()),
        "nodes_in_zone": int(level.node_in_zone.sum()),
        "assigned": len(errors),
        "true": int((level.counts & np.isfinite(level.error_m)).sum()),
        "false": int((level.counts & np.isinf(level.error_m)).sum()),
        "missed": int((level.node_in_zone & ~level.node_found).sum()),
        "precision": _ratio(level.precision),
        "recall": _ratio(level.recall),
        "mean_m": _metres(errors.mean() if len(errors) else None),
        "median_m": _metres(np.median(errors) if len(errors) else None),
        "p95_m": _metres(np.percentile(errors, 95.0) if len(errors) else None),
        "max_m": _metres(errors.max() if len(errors) else None),
    }


def _metres(value: float | np.floating[Any] | None) -> float | None:
    return None if value is None else rounded(float(value), _METRE_DECIMALS)


def _ratio(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else round(value, _RATIO_DECIMALS)


def _ratios(values: FloatArray | IntArray) -> list[float | None]:
    return [_ratio(float(value)) for value in values]
