"""The files of a benchmark: benchmark.json, benchmark.txt, benchmark.html and failures."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from interloc.evaluation.map_level import bins_of
from interloc.evaluation.published import AVERAGE, COMPARISON, LABEL_ERRORS, PERFORMANCE
from interloc.evaluation.reasons import KINDS
from interloc.evaluation.report import make_folder, template
from interloc.files import write_file
from interloc.lab.measure import Row
from interloc.lab.run import Benchmark
from interloc.lab.tables import (
    ALL,
    NO_NOISE,
    Measured,
    figures,
    ours,
    outcomes,
    performance_table,
    tables,
)
from interloc.output.credits import joint_credit, map_credit
from interloc.output.geojson import encode, rounded, write_record
from interloc.pipeline import versions

PAGE = "benchmark.html"
_MEANINGS = {str(kind): meaning for kind, meaning in KINDS.items()}
_WORST = 40  # places of each preset on the page
_SHOWN = ("off_m", "osm_id", "lon", "lat", "frames", "see")


def benchmark_record(benchmark: Benchmark, measured: Measured) -> dict[str, Any]:
    """Return the figures of a benchmark as plain values for JSON; what is undefined is None.

    `results`: by preset, level of label errors and drive ("all": pooled), each figure with `mean`, `spread` (sample
    standard deviation over the seeds, None for one seed) and `seeds`; `rows`: the same per seed, with the counts behind
    them; `reliability`: by preset and level, with bootstrap intervals and the bins of the diagram; `published`: the
    paper's.
    """
    results = []
    for (preset, noise, drive), line in measured.estimates.iterrows():
        estimates = {
            name: {"mean": _plain(mean), "spread": _plain(spread), "seeds": int(seeds)}
            for name, (mean, spread, seeds) in line.unstack().iterrows()  # noqa: PD010 - back to one row per figure
        }
        results.append({"preset": preset, "noise": noise, "drive": drive, **estimates})
    reliability = [
        {
            "preset": preset,
            "noise": noise,
            **{name: asdict(each) for name, each in intervals.items()},
            "bins": [asdict(each) for each in bins_of(*outcomes(measured.of(preset=preset, noise=noise)))],
        }
        for (preset, noise), intervals in measured.reliability.items()
    ]
    return {
        "benchmark": benchmark.title,
        "policy": benchmark.truth.policy,
        "labels": measured.labels,
        "drives": list(measured.drives),
        "presets": list(measured.presets),
        "noises": list(measured.noises),
        "results": results,
        "reliability": reliability,
        "rows": [_row(row) for row in measured.rows],
        "published": {
            "performance": {name: asdict(value) for name, value in {**PERFORMANCE, ALL: AVERAGE}.items()},
            "comparison": {name: asdict(value) for name, value in COMPARISON.items()},
            "noise": {name: asdict(value) for name, value in LABEL_ERRORS.items()},
        },
        "config": {each.name: each.config.model_dump(mode="json") for each in benchmark.configs},
        **joint_credit(map_credit(is_made_up=row.made_up_map) for row in measured.rows).members,
        "versions": versions(),
    }


def _plain(value: float) -> float | None:
    return None if np.isnan(value) else rounded(value, 5)


def _row(row: Row) -> dict[str, Any]:
    return {
        **row.cell.model_dump(),
        "keyframes": row.keyframes,
        "detections": len(row.errors_m) + row.unmatched,
        "matched": len(row.errors_m),
        "fn": row.fn,
        **{name: _plain(value) for name, value in figures([row]).items()},
        "map_true": row.map_true,
        "map_false": row.map_false,
        "map_missed": row.map_missed,
        "compute_s": row.compute_s,
        "warnings": list(row.warnings),
        "failures": f"failures/{row.cell.file_name}.json",
    }


def write_benchmark(benchmark: Benchmark, measured: Measured, out: Path) -> None:
    """Write the outcome of a benchmark into its folder, each file whole or not at all."""
    make_folder(out / "failures")
    for row in measured.rows:
        record = {**row.cell.model_dump(), "policy": row.policy}
        if row.cell.noise != NO_NOISE:
            record["note"] = "`see` draws the frame without the label errors"
        record |= {"failures": row.failures, **map_credit(is_made_up=row.made_up_map).members}
        write_file(out / "failures" / f"{row.cell.file_name}.json", encode(record, indent=1) + "\n")
    record, failures = benchmark_record(benchmark, measured), failures_of(measured)
    shown = tables(measured)
    page = template("benchmark.html", "interloc.lab").render(
        title=benchmark.title,
        about=benchmark.about,
        policy=benchmark.truth.policy,
        warnings=dict.fromkeys(f"{row.cell.drive}: {warning}" for row in measured.rows for warning in row.warnings),
        tables=[*shown, *(performance_table(measured, level) for level in measured.noises[1:])],
        kinds=kinds_table(failures),
        places=[(ours(preset), worst_places(failures, preset, measured.noises[0])) for preset in measured.presets],
        made_up_maps=sorted({row.made_up_map for row in measured.rows}),
        configs=[(name, json.dumps(config, indent=2)) for name, config in record["config"].items()],
        versions=", ".join(f"{name} {version}" for name, version in record["versions"].items()),
    )
    write_file(out / PAGE, page)
    write_file(out / "benchmark.txt", "\n\n".join(table.text() for table in shown) + "\n")
    write_record(out / "benchmark.json", record)  # last: whoever waits for it finds the rest


def failures_of(measured: Measured) -> pd.DataFrame:
    """Return every failure with the cell that it is of."""
    found = [{**row.cell.model_dump(), **failure} for row in measured.rows for failure in row.failures]
    frame = pd.DataFrame(found, columns=["drive", "preset", "noise", "seed", "what", "kind", "times", *_SHOWN])
    frame["kind"] = [_MEANINGS.get(kind, str(kind).replace("_", " ")) for kind in frame["kind"]]
    return frame


def kinds_table(failures: pd.DataFrame) -> pd.DataFrame:
    """Count the failures by kind: places, and in brackets the detections or keyframes there."""
    keys = ["what", "kind", "preset", "noise"]
    counts = failures.groupby(keys)["times"].agg(["size", "sum"]).astype(str)
    return (counts["size"] + " (" + counts["sum"] + ")").rename("places").reset_index()


def worst_places(failures: pd.DataFrame, preset: str, noise: str) -> pd.DataFrame:
    """Return the failures of a preset at a level of label errors that cost most, worst first."""
    chosen = failures[(failures["preset"] == preset) & (failures["noise"] == noise)]
    shown = chosen.sort_values("times", ascending=False, kind="stable").head(_WORST).drop(columns=["preset", "noise"])
    shown["frames"] = [f"{frames[0]}..{frames[-1]}" for frames in shown["frames"]]
    shown["see"] = [" && ".join(lines) for lines in shown["see"]]
    return shown
