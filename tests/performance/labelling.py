"""What labels by a network cost per scan, step by step, on one core: `python tests/performance/labelling.py`.

From the project's folder, with PYTHONPATH=. there. Without --model, a network of a few operations stands in: its time
says nothing about real ones, but the steps around it cost the same. Best and median over all scans and rounds are
shown, time by the clock unless it says processor time. The target, 25 ms for projection and neighbours together, is
meant for a scan of 120,000 points on 64 x 2048 pixels. "No two pixels alike" is the worst case of the vote: labels by
chance.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import click
import numpy as np
from bench import Row, facts

from interloc.arrays import Float32Array
from interloc.labelling.rangenet.graph import Network
from interloc.labelling.rangenet.labeller import Labeller, normalise, project, range_image, vote
from interloc.labelling.rangenet.model import KnnSettings, Model, read_model
from interloc.processes import peak_memory_bytes
from tests.networks import write_model

Times = dict[str, list[tuple[float, float]]]

TARGET_MS = 25.0
REAL_SCANS = Path(__file__).parents[3] / "shared" / "data" / "kitti360_0009" / "velodyne"


def scans(folder: Path | None, count: int) -> list[Float32Array]:
    """Read scans; without a folder, make them up: a street between walls, as 64 beams see it."""
    if folder is not None:
        files = sorted(folder.glob("*.bin"))
        return [np.fromfile(file, np.float32).reshape(-1, 4) for file in files[:: max(len(files) // count, 1)][:count]]
    generator = np.random.default_rng(0)
    pitch, azimuth = np.meshgrid(np.radians(np.linspace(2, -24.8, 64)), np.linspace(np.pi, -np.pi, 1875), indexing="ij")
    wall = generator.uniform(6, 30, 60).repeat(40)[:1875] / np.maximum(np.abs(np.sin(azimuth)), 0.2)
    level = np.minimum(np.where(pitch < 0, 1.73 / np.tan(np.maximum(-pitch, 1e-3)), np.inf), wall)
    level = level + generator.normal(0, 0.02, level.shape)
    xyz = [level * np.cos(azimuth), level * np.sin(azimuth), level * np.tan(pitch)]
    points = np.stack([*xyz, generator.uniform(0, 1, level.shape)], axis=-1).reshape(-1, 4)
    return [points.astype(np.float32)] * count


def timed(times: Times, name: str, step: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
    """Do a step and note its time by the clock and of the processor, milliseconds."""
    clock, processor = time.perf_counter(), time.thread_time()
    result = step(*arguments, **more)
    times.setdefault(name, []).append((1e3 * (time.perf_counter() - clock), 1e3 * (time.thread_time() - processor)))
    return result


def measure(model: Model, points: list[Float32Array], rounds: int) -> Times:
    """Time every step on every scan; what compiles or loads is called once before."""
    network = Network(
        model.graph,
        model.form,
        height=model.height,
        width=model.width,
        classes=len(model.class_ids),
        provider="cpu",
        threads=1,
    )
    base = model.knn or KnnSettings()
    generator = np.random.default_rng(0)
    times: Times = {}
    for number in range(rounds + 1):
        if number == 1:
            times.clear()
        for scan in points:
            place = model.height, model.width, model.fov_up_rad, model.fov_down_rad
            seen = timed(times, "projection", project, scan, *place)
            image = timed(times, "range image", range_image, scan, seen)
            given = timed(times, "normalisation", normalise, image, seen, model.form.channels, model.means, model.stds)
            classes = timed(times, "network", network.run, given, seen.filled)
            chance = generator.integers(1, len(model.class_ids), classes.shape).astype(np.uint8)
            for side in (5, 7):
                settings, name = replace(base, search=side), f"neighbours, {side} x {side}"
                timed(times, name, vote, classes, seen, settings)
                timed(times, f"{name}, no two pixels alike", vote, chance, seen, settings)
    return times


def rows_of(times: Times) -> list[Row]:
    """Return the lines of the table."""
    rows = []
    for name, each in times.items():
        rows.append(Row(name, "ms per scan", [clock for clock, _ in each]))
    for side in (5, 7):
        both = zip(times["projection"], times[f"neighbours, {side} x {side}"], strict=True)
        sums = [(a[0] + b[0], a[1] + b[1]) for a, b in both]
        name = f"projection and neighbours, {side} x {side}"
        rows.append(Row(name, "ms per scan", [clock for clock, _ in sums], at_most=TARGET_MS))
        rows.append(Row("  processor time", "ms per scan", [processor for _, processor in sums], at_most=TARGET_MS))
    return rows


def memory_rows(model: Model, points: list[Float32Array], times: int) -> list[Row]:
    """Label scans again and again: the peak of memory after the first ones, and how much it grows after that."""
    labeller = Labeller(model, threads=1)
    for scan in points:
        labeller.label(scan)
    before = peak_memory_bytes()
    began = time.perf_counter()
    for number in range(times):
        labeller.label(points[number % len(points)])
    per_scan = 1e3 * (time.perf_counter() - began) / times
    return [
        Row("all steps", "ms per scan", [per_scan]),
        Row("memory", "MB", [before / 1e6]),
        Row(f"  growth over {times} scans", "MB", [(peak_memory_bytes() - before) / 1e6], at_most=5.0),
    ]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, help="a folder with model.onnx, arch_cfg.yaml and data_cfg.yaml")
    parser.add_argument("--scans", type=Path, help="a folder of .bin files instead of the real or made-up ones")
    parser.add_argument("--count", type=int, default=10, help="how many scans (10)")
    parser.add_argument("--rounds", type=int, default=5, help="how often each is measured (5)")
    options = parser.parse_args()
    folder = options.scans or (REAL_SCANS if REAL_SCANS.is_dir() else None)
    points = scans(folder, options.count)
    with tempfile.TemporaryDirectory() as temporary:
        path = options.model or write_model(Path(temporary) / "model", width=2048, road_half_width_m=5.0)
        model = read_model(path)
        rows = rows_of(measure(model, points, options.rounds)) + memory_rows(model, points, 100)
    counts = [len(scan) for scan in points]
    about = facts() | {"scans": folder or "made up", "points": f"{min(counts):,} to {max(counts):,}"}
    about |= {"image": f"{model.height} x {model.width}", "load_now": os.getloadavg()[0]}
    click.echo(", ".join(f"{name} {value}" for name, value in about.items()))
    click.echo(f"{'':<50} {'best':>8} {'median':>8}  {'':<14} target of the best")
    for row in rows:
        click.echo(f"{row.name:<50} {row.best:8.2f} {median(row.values):8.2f}  {row.unit:<14} {row.verdict}")


if __name__ == "__main__":
    main()
