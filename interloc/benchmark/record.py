"""A benchmark as plain values: what `benchmark.json` holds."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from interloc.benchmark.row import Row
from interloc.benchmark.score import METRICS, Estimate
from interloc.benchmark.tables import ALL, Measured
from interloc.config import DetectorConfig
from interloc.evaluation.published import AVERAGE, COMPARISON, LABEL_ERRORS, PERFORMANCE
from interloc.output.geojson import rounded
from interloc.pipeline import versions


def benchmark_record(title: str, measured: Measured, configs: dict[str, DetectorConfig], policy: str) -> dict[str, Any]:
    """Return the figures of a benchmark as values that JSON can say; what is undefined is None.

    Returns
    -------
    dict
        `results`: one entry a preset, level of label errors and drive ("all": pooled), each figure with `mean`,
        `spread` (sample standard deviation over the seeds, None for one seed) and `seeds`; `rows`: the same a seed,
        with the counts behind them; `published`: the paper's figures; `config`: settings of each preset.
    """
    results = [
        {
            "preset": preset,
            "noise": noise,
            "drive": drive,
            **{name: _estimate(measured.estimate(name, preset=preset, noise=noise, drive=drive)) for name in METRICS},
        }
        for preset in measured.presets
        for noise in measured.noises
        for drive in (*measured.drives, ALL)
    ]
    return {
        "benchmark": title,
        "policy": policy,
        "labels": measured.labels,
        "drives": list(measured.drives),
        "presets": list(measured.presets),
        "noises": list(measured.noises),
        "results": results,
        "rows": [_row(row) for row in measured.rows],
        "published": {
            "performance": {name: asdict(value) for name, value in {**PERFORMANCE, ALL: AVERAGE}.items()},
            "comparison": {name: asdict(value) for name, value in COMPARISON.items()},
            "noise": {name: asdict(value) for name, value in LABEL_ERRORS.items()},
        },
        "config": {name: config.model_dump(mode="json") for name, config in configs.items()},
        "versions": versions(),
    }


def _estimate(value: Estimate) -> dict[str, float | int | None]:
    return {
        "mean": None if value.mean is None else rounded(value.mean, 5),
        "spread": None if value.spread is None else rounded(value.spread, 5),
        "seeds": value.seeds,
    }


def _row(row: Row) -> dict[str, Any]:
    figures = {name: metric([row]) for name, metric in METRICS.items()}
    return {
        **row.cell.model_dump(),
        "keyframes": row.keyframes,
        "detections": len(row.errors_m) + row.unmatched,
        "matched": len(row.errors_m),
        "fn": row.fn,
        **{name: None if value is None else rounded(value, 5) for name, value in figures.items()},
        "map_true": row.map_true,
        "map_false": row.map_false,
        "map_missed": row.map_missed,
        "compute_s": row.compute_s,
        "warnings": list(row.warnings),
        "failures": f"failures/{row.cell.file_name}.json",
    }
