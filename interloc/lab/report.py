"""The files of a benchmark: benchmark.json, benchmark.txt, benchmark.html, failures, and the paper's Fig. 8."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from interloc.drawing import entitle, image, new_figure, quiet, series_style
from interloc.evaluation.published import AVERAGE, COMPARISON, LABEL_ERRORS, PERFORMANCE
from interloc.evaluation.reasons import KINDS
from interloc.evaluation.reliability import bins_of
from interloc.evaluation.report import data_address, make_folder, template
from interloc.files import write_file
from interloc.lab.measure import Row
from interloc.lab.run import Benchmark
from interloc.lab.tables import (
    ALL,
    NO_NOISE,
    Measured,
    Table,
    figures,
    ours,
    outcomes,
    performance_table,
    pooled,
    pools,
    scores,
    table_of,
    tables,
)
from interloc.output.credits import joint_credit, map_credit
from interloc.output.geojson import encode, rounded, write_record
from interloc.pipeline import versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "benchmark.html"
F1_THRESHOLDS_M = np.arange(0.5, 10.1, 0.5)
_MEANINGS = {str(kind): meaning for kind, meaning in KINDS.items()}
_WORST = 40  # places of each preset on the page


def benchmark_record(benchmark: Benchmark, measured: Measured) -> dict[str, Any]:
    """Return the figures of a benchmark as plain values for JSON; what is undefined is None.

    Returns
    -------
    dict
        `results`: one entry per preset, level of label errors and drive ("all": pooled), each figure with `mean`,
        `spread` (sample standard deviation over the seeds, None for one seed) and `seeds`; `rows`: the same per
        seed, with the counts behind them; `reliability`: whether uncertainty and confidence are true, one entry per
        preset and level, with bootstrap intervals and the bins of the diagram; `published`: the paper's figures;
        `config`: settings of each preset; `attribution`, `license`: of the maps.
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
    """Write the outcome of a benchmark into its folder, each file whole or not at all.

    Raises
    ------
    OutputError
        A file could not be written.
    """
    make_folder(out / "failures")
    for row in measured.rows:
        record = {**row.cell.model_dump(), "policy": row.policy}
        if row.cell.noise != NO_NOISE:
            record["note"] = "`see` draws the frame without the label errors"
        record |= {**row.failures, **map_credit(is_made_up=row.made_up_map).members}
        write_file(out / "failures" / f"{row.cell.file_name}.json", encode(record, indent=1) + "\n")
    picture = ""
    if len(measured.noises) > 1:
        make_folder(out / "figures")
        figure = label_errors_figure(measured)
        svg = image(figure, "svg")
        write_file(out / "figures" / "label_errors.svg", svg)
        write_file(out / "figures" / "label_errors.png", image(figure, "png"))
        picture = data_address(svg, "image/svg+xml")
    record = benchmark_record(benchmark, measured)
    shown = tables(measured)
    page = template("benchmark.html", "interloc.lab").render(
        title=benchmark.title,
        about=benchmark.about,
        policy=benchmark.truth.policy,
        warnings=dict.fromkeys(f"{row.cell.drive}: {warning}" for row in measured.rows for warning in row.warnings),
        tables=[*shown, *(performance_table(measured, level) for level in measured.noises[1:])],
        picture=picture,
        kinds=kinds_table(measured),
        places=[(ours(preset), worst_places(measured, preset)) for preset in measured.presets],
        made_up_maps=sorted({row.made_up_map for row in measured.rows}),
        configs=[(name, json.dumps(config, indent=2)) for name, config in record["config"].items()],
        versions=", ".join(f"{name} {version}" for name, version in record["versions"].items()),
    )
    write_file(out / PAGE, page)
    write_file(out / "benchmark.txt", "\n\n".join(table.text() for table in shown) + "\n")
    write_record(out / "benchmark.json", record)  # last: whoever waits for it finds the rest


def label_errors_figure(measured: Measured) -> Figure:
    """Draw center errors and F1 curves of each level of label errors, one row of figures per preset (paper, Fig. 8)."""
    count = len(measured.presets)
    figure = new_figure(10.5, 4.1 * count)
    for (boxes, curves), preset in zip(figure.subplots(count, 2, squeeze=False), measured.presets, strict=True):
        levels = {noise: measured.of(preset=preset, noise=noise) for noise in measured.noises}
        errors = [pooled(rows, "errors_m") for rows in levels.values()]
        boxes.boxplot(errors, whis=(5, 95), showfliers=False, tick_labels=list(levels))
        boxes.set(xlabel="label errors r-FPR / r-FNR [%]", ylabel="center error [m]")
        boxes.set_ylim(bottom=0.0)
        entitle(boxes, f"{ours(preset)}: center error", 11.0)
        for number, (noise, rows) in enumerate(levels.items()):
            f1 = [np.nanmean([scores(pool, each)[2] for _, pool in pools(rows)]) for each in F1_THRESHOLDS_M]
            curves.plot(F1_THRESHOLDS_M, 100.0 * np.array(f1), label=noise, **series_style(number))
        curves.set(xlabel="threshold D [m]", ylabel="F1 [%]", ylim=(0.0, 102.0))
        curves.legend(loc="lower right", frameon=False, fontsize=9)
        entitle(curves, f"{ours(preset)}: F1 over the threshold", 11.0)
        quiet(boxes)
        quiet(curves)
    return figure


def kinds_table(measured: Measured) -> Table:
    """Count the failures by kind: groups of false detections with the detections in them, nodes with their misses."""
    places: Counter[tuple[str, ...]] = Counter()
    times: Counter[tuple[str, ...]] = Counter()
    for row in measured.rows:
        for name, number, words in (
            ("false_detections", "detections", "false detections: groups (detections)"),
            ("missed_nodes", "keyframes_missed", "missed nodes: nodes (keyframes)"),
        ):
            for entry in row.failures[name]:
                key = (words, _meaning(entry["kind"]), row.cell.preset, row.cell.noise)
                places[key] += 1
                times[key] += entry[number]
    columns = list(product(measured.presets, measured.noises))
    lines: dict[tuple[str, ...], list[str]] = {
        (words, kind): [f"{places[key]} ({times[key]})" for each in columns for key in [(words, kind, *each)]]
        for words, kind in sorted({key[:2] for key in places}) or [("nothing", "")]
    }
    return table_of("Failures by kind", lines, [f"{ours(preset)}, {noise}" for preset, noise in columns])


def worst_places(measured: Measured, preset: str) -> pd.DataFrame:
    """Return the failures of a preset without label errors that cost most, worst first."""
    places = []
    one_seed = len({row.cell.seed for row in measured.rows}) == 1
    for row in measured.of(preset=preset, noise=measured.noises[0]):
        drive = row.cell.drive if one_seed else f"{row.cell.drive} seed {row.cell.seed}"
        for what, entries in row.failures.items():
            for entry in entries:
                if what == "false_detections":
                    times, node = entry["detections"], entry["nearest_node"]
                    off_m = node["distance_m"] if node else None
                else:
                    times, off_m = max(entry["keyframes_missed"], 0 if entry["found"] else 1), entry["best_error_m"]
                places.append(
                    {
                        "drive": drive,
                        "kind": f"{'false' if what == 'false_detections' else 'missed'}: {_meaning(entry['kind'])}",
                        "times": times,
                        "off node": "-" if off_m is None else f"{off_m:.2f} m",
                        "lon, lat": f"{entry['lon']:.6f}, {entry['lat']:.6f}",
                        "frames": f"{entry['frames'][0]}..{entry['frames'][-1]}",
                        "see": " && ".join(entry["see"]),
                    }
                )
    found = pd.DataFrame(places)
    return found if found.empty else found.sort_values("times", ascending=False, kind="stable").head(_WORST)


def _meaning(kind: str) -> str:
    return _MEANINGS.get(kind, kind.replace("_", " "))
