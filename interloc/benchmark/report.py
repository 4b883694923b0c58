"""The files of a benchmark: benchmark.json, benchmark.txt, benchmark.html, figures, failures."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from interloc.benchmark.figures import curves_figure, drive_boxes_figure, map_figure, noise_figure, reliability_figure
from interloc.benchmark.metrics import METRICS, Estimate, map_outcomes
from interloc.benchmark.row import Row
from interloc.benchmark.run import Benchmark
from interloc.benchmark.tables import ALL, NO_NOISE, Measured, Table, ours, performance_table, tables, text
from interloc.drawing import image
from interloc.evaluation.published import AVERAGE, COMPARISON, LABEL_ERRORS, PERFORMANCE
from interloc.evaluation.reasons import KINDS
from interloc.evaluation.reliability import bins_of
from interloc.evaluation.report import data_address, make_folder, template
from interloc.files import write_file
from interloc.output.credits import Credit, joint_credit, map_credit
from interloc.output.geojson import encode, rounded, write_record
from interloc.pipeline import versions

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
        `config`: settings of each preset; `attribution`, `license`: of the maps; `sensors`: the drives of each sensor,
        where several are compared.
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
    reliability = [
        {
            "preset": preset,
            "noise": noise,
            **{name: asdict(each) for name, each in measured.reliability[preset, noise].items()},
            "bins": [asdict(each) for each in bins_of(*map_outcomes(measured.of(preset=preset, noise=noise)))],
        }
        for preset in measured.presets
        for noise in measured.noises
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
        **_credit(measured.rows).members,
        **({"sensors": {name: list(drives) for name, drives in measured.sensors.items()}} if measured.sensors else {}),
        "versions": versions(),
    }


def _credit(rows: Iterable[Row]) -> Credit:
    return joint_credit(map_credit(is_made_up=row.picture.is_made_up) for row in rows)


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


PAGE = "benchmark.html"


def write_benchmark(benchmark: Benchmark, measured: Measured, out: Path) -> None:
    """Write the outcome of a benchmark into its folder, each file whole or not at all.

    Raises
    ------
    OutputError
        A file could not be written.
    """
    pictures, maps = _write_figures(measured, out / "figures")
    make_folder(out / "failures")
    for row in measured.rows:
        record = {**row.cell.model_dump(), "policy": row.policy}
        if row.cell.noise != NO_NOISE:
            record["note"] = "`see` draws the frame without the label errors"
        record |= {**row.failures, **map_credit(is_made_up=row.picture.is_made_up).members}
        write_file(out / "failures" / f"{row.cell.file_name}.json", encode(record, indent=1) + "\n")
    record = benchmark_record(benchmark, measured)
    *results, reliability = tables(measured)
    page = template("benchmark.html", "interloc.benchmark").render(
        title=benchmark.title,
        about=benchmark.about,
        policy=benchmark.truth.policy,
        warnings=_warnings(measured.rows),
        tables=results,
        reliability=reliability,
        noisy=[performance_table(measured, level) for level in measured.noises[1:]],
        kinds=kinds_table(measured),
        places=[(ours(preset), worst_places(measured, preset)) for preset in measured.presets],
        pictures=pictures,
        maps=maps,
        made_up_maps=sorted({row.picture.is_made_up for row in measured.rows}),
        configs=[(name, json.dumps(config, indent=2)) for name, config in record["config"].items()],
        versions=", ".join(f"{name} {version}" for name, version in record["versions"].items()),
    )
    write_file(out / PAGE, page)
    write_file(out / "benchmark.txt", "\n\n".join(map(text, tables(measured))) + "\n")
    write_record(out / "benchmark.json", record)  # last: whoever waits for it finds the rest


def kinds_table(measured: Measured) -> Table:
    """Count the failures by kind: groups of false detections with the detections in them, nodes with their misses."""
    header = ["", ""]
    counts = []
    for preset in measured.presets:
        for noise in measured.noises:
            header.append(ours(preset) if len(measured.noises) == 1 else f"{ours(preset)}, {noise}")
            counts.append(_kinds(measured.of(preset=preset, noise=noise)))
    groups = []
    for title, what in (("false detections", "groups (detections)"), ("missed nodes", "nodes (keyframes)")):
        kinds = sorted({kind for count in counts for group, kind in count if group == title})
        lines: list[tuple[str, ...]] = []
        for kind in kinds:
            cells = [f"{c[title, kind][0]} ({c[title, kind][1]})" if (title, kind) in c else "0" for c in counts]
            lines.append((f"{title}: {what}" if not lines else "", _meaning(kind), *cells))
        if lines:
            groups.append(tuple(lines))
    return Table(title="Failures by kind", header=tuple(header), groups=tuple(groups), labels=2)


def worst_places(measured: Measured, preset: str) -> list[dict[str, Any]]:
    """Return the failures of a preset without label errors that cost most, worst first."""
    places = []
    one_seed = len({row.cell.seed for row in measured.rows}) == 1
    for row in measured.of(preset=preset, noise=measured.noises[0]):
        for entry in row.failures["false_detections"]:
            off = entry["nearest_node"]["distance_m"] if entry["nearest_node"] else None
            places.append((entry["detections"], row.cell, f"false: {_meaning(entry['kind'])}", off, entry))
        for entry in row.failures["missed_nodes"]:
            cost = max(entry["keyframes_missed"], 0 if entry["found"] else 1)
            places.append((cost, row.cell, f"missed: {_meaning(entry['kind'])}", entry["best_error_m"], entry))
    places.sort(key=lambda place: -place[0])
    return [
        {
            "drive": cell.drive if one_seed else f"{cell.drive} seed {cell.seed}",
            "kind": kind,
            "times": cost,
            "off_m": off,
            "lonlat": f"{entry['lon']:.6f}, {entry['lat']:.6f}",
            "frames": f"{entry['frames'][0]}..{entry['frames'][-1]}",
            "see": entry["see"],
        }
        for cost, cell, kind, off, entry in places[:_WORST]
    ]


def _meaning(kind: str) -> str:
    return _MEANINGS.get(kind, kind.replace("_", " "))


def _kinds(rows: list[Row]) -> dict[tuple[str, str], tuple[int, int]]:
    places: Counter[tuple[str, str]] = Counter()
    times: Counter[tuple[str, str]] = Counter()
    for row in rows:
        for name, number in (("false_detections", "detections"), ("missed_nodes", "keyframes_missed")):
            for entry in row.failures[name]:
                key = (name.replace("_", " "), str(entry["kind"]))
                places[key] += 1
                times[key] += int(entry[number])
    return {key: (places[key], times[key]) for key in places}


def _warnings(rows: tuple[Row, ...]) -> list[str]:
    return list(dict.fromkeys(f"{row.cell.drive}: {warning}" for row in rows for warning in row.warnings))


def _write_figures(measured: Measured, folder: Path) -> tuple[dict[str, str], list[dict[str, Any]]]:
    make_folder(folder)
    pictures = {"noise": ""}
    figures = {"boxes": drive_boxes_figure(measured), "curves": curves_figure(measured)}
    figures["reliability"] = reliability_figure(measured)
    if len(measured.noises) > 1:
        figures["noise"] = noise_figure(measured)
    for name, figure in figures.items():
        svg = image(figure, "svg")
        write_file(folder / f"{name}.svg", svg)
        write_file(folder / f"{name}.png", image(figure, "png"))
        pictures[name] = data_address(svg, "image/svg+xml")
    maps = []
    for drive in measured.drives:
        shown = []
        for preset in measured.presets:
            row = measured.of(preset=preset, noise=measured.noises[0], drive=drive)[0]
            png = image(map_figure(row.picture), "png", dpi=120)
            write_file(folder / f"map_{row.cell.file_name}.png", png)
            shown.append({"preset": ours(preset), "picture": data_address(png, "image/png")})
        maps.append({"name": drive, "maps": shown})
    return pictures, maps
