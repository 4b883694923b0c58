"""From rows to figures: pooled over drives, mean and spread over seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from interloc.arrays import BoolArray, FloatArray
from interloc.benchmark.row import Row
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M
from interloc.evaluation.reliability import calibration_error, share_within, squared_per_dimension

PRECISION_THRESHOLD_M, RECALL_THRESHOLD_M = 6.9, 13.3
"""Of the comparison with MMInsectDet (paper, section V-B)."""

Metric = Callable[[Sequence[Row]], float | None]
"""Returns a figure of some rows, pooled as if they were one drive; None where it is undefined."""


@dataclass(frozen=True)
class Estimate:
    """A figure over several seeds."""

    mean: float | None
    """None where it is undefined for every seed."""
    spread: float | None = None
    """Sample standard deviation over the seeds; None for one seed."""
    seeds: int = 1
    """Number of seeds."""


def pooled(rows: Sequence[Row], column: str) -> FloatArray:
    """Return the values of all rows, one after the other, of a field of `Row` that holds several."""
    return np.array([each for row in rows for each in getattr(row, column)], dtype=np.float64)


def ace_m(rows: Sequence[Row]) -> float | None:
    """Return the average center error over all matched pairs (paper, eq. 14)."""
    return _mean(pooled(rows, "errors_m"))


def ace_under_10_m(rows: Sequence[Row]) -> float | None:
    """Return the average center error of the pairs under 10 m."""
    errors = pooled(rows, "errors_m")
    return _mean(errors[errors < NEAR_PAIR_M])


def precision(rows: Sequence[Row], threshold_m: float = STANDARD_THRESHOLD_M) -> float | None:
    """Return TP / (TP + FP) at a threshold (paper, eq. 18)."""
    detections = sum(len(row.errors_m) + row.unmatched for row in rows)
    return _ratio(_true(rows, threshold_m), detections)


def recall(rows: Sequence[Row], threshold_m: float = STANDARD_THRESHOLD_M) -> float | None:
    """Return TP / (TP + FN) at a threshold (paper, eq. 18)."""
    true = _true(rows, threshold_m)
    return _ratio(true, true + sum(row.fn for row in rows))


def f1(rows: Sequence[Row], threshold_m: float = STANDARD_THRESHOLD_M) -> float | None:
    """Return 2 TP / (2 TP + FP + FN) at a threshold."""
    true = _true(rows, threshold_m)
    detections = sum(len(row.errors_m) + row.unmatched for row in rows)
    return _ratio(2 * true, true + detections + sum(row.fn for row in rows))


def total(rows: Sequence[Row], column: str) -> float | None:
    """Return the sum of a field of `Row`."""
    return float(sum(getattr(row, column) for row in rows))


def map_precision(rows: Sequence[Row]) -> float | None:
    """Return the share of the fused intersections that are nodes, one-to-one."""
    true = sum(row.map_true for row in rows)
    return _ratio(true, true + sum(row.map_false for row in rows))


def map_recall(rows: Sequence[Row]) -> float | None:
    """Return the share of the nodes that have a fused intersection, one-to-one."""
    nodes = sum(row.map_nodes for row in rows)
    return _ratio(nodes - sum(row.map_missed for row in rows), nodes)


def map_median_m(rows: Sequence[Row]) -> float | None:
    """Return the median error of the fused intersections that have a node."""
    errors = pooled(rows, "map_errors_m")
    return None if len(errors) == 0 else float(np.median(errors))


def map_outcomes(rows: Sequence[Row]) -> tuple[FloatArray, BoolArray]:
    """Return the confidences of the fused intersections in the zone, and whether each has a node."""
    return pooled(rows, "map_confidence"), pooled(rows, "map_right").astype(np.bool_)


def map_within_95(rows: Sequence[Row]) -> float | None:
    """Return the share of the fused intersections with a node whose node lies in their ellipse of 95 %."""
    squared = pooled(rows, "map_squared")
    return share_within(squared) if len(squared) else None


def map_nees(rows: Sequence[Row]) -> float | None:
    """Return the normalised estimation error squared per degree of freedom: 1 where errors are as large as said."""
    squared = pooled(rows, "map_squared")
    return squared_per_dimension(squared) if len(squared) else None


def map_calibration_error(rows: Sequence[Row]) -> float | None:
    """Return the expected calibration error of the confidence."""
    confidence, right = map_outcomes(rows)
    return calibration_error(confidence, right) if len(confidence) else None


def ms_per_keyframe(rows: Sequence[Row]) -> float | None:
    """Return the processor time from files to intersections, milliseconds per keyframe."""
    keyframes = sum(row.keyframes for row in rows)
    return 1e3 * sum(row.compute_s for row in rows) / keyframes if keyframes else None


METRICS: dict[str, Metric] = {
    "ace_m": ace_m,
    "ace_under_10_m": ace_under_10_m,
    "precision_at_5": precision,
    "recall_at_5": recall,
    "f1_at_5": f1,
    "precision_at_6_9": partial(precision, threshold_m=PRECISION_THRESHOLD_M),
    "recall_at_13_3": partial(recall, threshold_m=RECALL_THRESHOLD_M),
    "nodes_found": partial(total, column="nodes_found"),
    "nodes_in_zone": partial(total, column="nodes_in_zone"),
    "map_precision": map_precision,
    "map_recall": map_recall,
    "map_median_m": map_median_m,
    "map_within_95": map_within_95,
    "map_nees": map_nees,
    "map_calibration_error": map_calibration_error,
    "ms_a_keyframe": ms_per_keyframe,
}
"""Every figure under the name that `benchmark.json` gives it."""


def estimate(rows: Sequence[Row], metric: Metric) -> Estimate:
    """Pool the drives of each seed, then take mean and spread over the seeds.

    Where only some drives have several seeds (without label errors, a recorded drive has but one), the drives with
    one seed take part in every pool.
    """
    seeds = sorted({row.cell.seed for row in rows})
    by_drive: dict[str, dict[int, Row]] = {}
    for row in rows:
        by_drive.setdefault(row.cell.drive, {})[row.cell.seed] = row
    values = []
    for seed in seeds:
        pool = [of_drive.get(seed) or of_drive[min(of_drive)] for of_drive in by_drive.values()]
        values.append(metric(pool))
    known = [value for value in values if value is not None]
    if not known:
        return Estimate(None, None, len(seeds))
    mean = math.fsum(known) / len(known)
    spread = float(np.std(known, ddof=1)) if len(known) > 1 else None
    return Estimate(mean, spread, len(known))


def _true(rows: Sequence[Row], threshold_m: float) -> int:
    return int(np.count_nonzero(pooled(rows, "errors_m") < threshold_m))


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _mean(values: FloatArray) -> float | None:
    return float(values.mean()) if len(values) else None
