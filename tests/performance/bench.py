"""How fast InterLoc is and what memory it takes: `make bench`.

Every figure comes from a fresh process, so that peaks of memory are honest, over files that are in the page cache, with
byte code and kernels that are compiled; loading the kernels is timed by itself. What a drive costs once and what a
keyframe costs are told apart by a drive six times as long; commands are measured in processor time. Best and median of
several runs are shown. Targets are held against the best: other work on the machine only ever adds, to processor time
the least. Without --drive, drives through the made-up town are simulated once (281 keyframes, 25 % road, 1.1 GB) and
kept in the folder for temporary files: one core is measured by scans of 125,000 points, as those of KITTI, and two by
scans of 80,000, driven six times.
"""

import argparse
import gc
import importlib
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import click
import numpy as np

from interloc.arrays import FloatArray
from interloc.cli.main import LIBRARIES
from interloc.config import PAPER, preset
from interloc.detection.detector import Detector
from interloc.detection.keyframes import select_keyframes
from interloc.drive import scans_of
from interloc.drives.folder import FolderDrive
from interloc.drives.open import open_drive
from interloc.geometry import yaw_of
from interloc.lab.config import LidarConfig, SimulationOptions
from interloc.lab.drive import simulate
from interloc.lab.town import Town
from interloc.output.layout import RUN_FILE
from interloc.output.write import write_results
from interloc.pipeline import detect
from interloc.processes import GARBAGE_THRESHOLD
from tests.reference import find_range
from tests.small_drives import level_poses

Measure = Callable[[Path], dict[str, float]]
LONG = 6  # times as many scans
FEW = 50  # scans
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | LIBRARIES
"""As for users, and as the command line sets up libraries."""


@dataclass(frozen=True)
class Row:
    """A line of the table; the target is an upper or a lower bound of the best value."""

    name: str
    unit: str
    values: list[float]
    at_most: float | None = None
    at_least: float | None = None

    @property
    def best(self) -> float:
        return max(self.values) if self.at_least is not None else min(self.values)

    @property
    def verdict(self) -> str:
        if self.at_most is not None:
            return f"<= {self.at_most:g}  {'ok' if self.best <= self.at_most else 'MISSED'}"
        if self.at_least is not None:
            return f">= {self.at_least:g}  {'ok' if self.best >= self.at_least else 'MISSED'}"
        return ""


def pipeline(root: Path, name: str, workers: int) -> dict[str, float]:
    """From files to GeoJSON: seconds and peak memory, and milliseconds per keyframe of each step of the method."""
    config, loading = preset(name), time.process_time()
    drive = open_drive(root)
    detector = Detector(config)
    for scan in scans_of(drive, range(5)):
        detector.push(scan)
    list(detector.finish())
    gc.set_threshold(GARBAGE_THRESHOLD)  # as in commands and workers
    began, worked = time.perf_counter(), time.process_time()
    drive = open_drive(root)
    opened = time.process_time()
    result = detect(drive, config, workers=workers)
    detected = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        write_results(result, Path(folder))
    end, ended = time.perf_counter(), time.process_time()
    count = result.run["keyframes"]
    return {
        "load_seconds": worked - loading,
        "keyframes": count,
        "seconds": end - began,
        "open_seconds": opened - worked,
        "write_seconds": ended - detected,
        "cpu_seconds": ended - worked,
        "peak_mb": result.run["peak_memory_bytes"] / 1e6,
        **{f"stage {stage}": 1e3 * seconds / count for stage, seconds in result.run["stage_seconds"].items()},
    }


def masking(root: Path) -> dict[str, float]:
    """Merely read the scans and their labels and mask the road, in plain numpy."""
    began, worked = time.perf_counter(), time.process_time()
    scans = sorted((root / "velodyne").glob("*.bin"))
    for scan in scans:
        points = np.fromfile(scan, np.float32).reshape(-1, 4)
        labels = np.fromfile(root / "labels" / f"{scan.stem}.label", np.uint32) & 0xFFFF
        assert len(points[(labels == 40) | (labels == 60)])
    seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - worked
    return {"ms": 1e3 * seconds / len(scans), "cpu_ms": 1e3 * cpu_seconds / len(scans)}


def literal(root: Path, keyframes: int) -> dict[str, float]:
    """Time `tests.reference` around the middle of a drive, once its first window is read: one scan per keyframe."""
    drive = open_drive(root)
    every = select_keyframes(drive.T_world_lidar, PAPER.keyframes)
    first = max(0, len(every) // 2 - keyframes // 2)
    marks: list[tuple[float, float]] = []
    part = find_range(
        drive,
        every,
        first,
        first + keyframes + 1,
        progress=lambda *_: marks.append((time.perf_counter(), time.process_time())),
    )
    seconds, cpu_seconds = (end - began for began, end in zip(marks[0], marks[-1], strict=True))
    found = sum(len(detections.world_xy) for detections in part.detections[1:])
    return {"ms": 1e3 * seconds / keyframes, "cpu_ms": 1e3 * cpu_seconds / keyframes, "detections": found}


def command(root: Path) -> dict[str, float]:
    """Run `interloc run` with two processes on a drive, from its start to its end."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        run_command("run", str(root), "-o", str(Path(folder) / "out"), "--workers", "2", "--quiet")
        seconds = time.perf_counter() - began
        run = json.loads((Path(folder) / "out" / RUN_FILE).read_bytes())
    return {"seconds": seconds, "keyframes": run["keyframes"], "peak_mb": run["peak_memory_bytes"] / 1e6}


def run_command(*words: str) -> None:
    """Run a command of the command line."""
    code = "from interloc.cli.main import main; main()"
    subprocess.run([sys.executable, "-c", code, *words], stdout=subprocess.DEVNULL, check=True, env=ENVIRONMENT)


MEASURES: dict[str, Measure] = {
    "default": lambda root: pipeline(root, "default", 1),
    "paper": lambda root: pipeline(root, "paper", 1),
    "default2": lambda root: pipeline(root, "default", 2),
    "paper2": lambda root: pipeline(root, "paper", 2),
    "command": command,
    "masking": masking,
    "literal": lambda root: literal(root, 40),
}


def measured(name: str, root: Path, times: int) -> list[dict[str, float]]:
    """Measure something several times, each in a fresh process."""
    command = [sys.executable, str(Path(__file__).resolve()), "--measure", name, "--drive", str(root)]
    runs = []
    for number in range(times):
        if sys.stderr.isatty():
            click.echo(f"\r{name} {number + 1} of {times} ...".ljust(40) + "\r", err=True, nl=False)
        answer = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=ENVIRONMENT)
        runs.append(json.loads(answer.stdout))
    return runs


def command_seconds(times: int, *words: str) -> list[float]:
    """Return the processor time of a command as a whole process."""
    seconds = []
    for _ in range(times):
        began = processor_s()
        run_command(*words)
        seconds.append(processor_s() - began)
    return seconds


def processor_s() -> float:
    """Return what all processes that have ended took of the processor."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def start_up(root: Path, times: int) -> Iterator[Row]:
    """Measure commands as whole processes: of the first scans of a drive, and of none."""
    with tempfile.TemporaryDirectory() as folder:
        drive, out = open_drive(root), str(Path(folder) / "out")
        short = Path(folder) / "drive"
        short.mkdir()
        link_scans(drive, short, range(FEW))
        write_poses(short, drive.T_world_lidar[:FEW])
        yield Row("interloc --help", "s", command_seconds(2 * times, "--help"), at_most=0.5)
        yield Row(f"interloc info, {FEW} scans", "s", command_seconds(times, "info", str(short)), at_most=0.5)
        detecting = command_seconds(times, "run", str(short), "-o", out, "--workers", "1", "--quiet")
        yield Row(f"interloc run, {FEW} scans", "s", detecting, at_most=1.0)


def made_up_drive(name: str, shots: int) -> Path:
    """Simulate the drive through the town, with so many shots per turn of a laser, where it is not there yet."""
    root = Path(tempfile.gettempdir()) / "interloc-bench" / name
    if not root.exists():
        click.echo(f"simulating a drive to {root} (some 100 MB, half a minute) ...", err=True)
        sensor = LidarConfig(columns=shots)
        simulate(Town("plain").trip(), root, SimulationOptions(keyframes_only=True, sensor=sensor))
    return root


def write_long(drive: FolderDrive, root: Path) -> None:
    """Drive the same scans again and again, each time from where the last time ended; links, no copies."""
    poses, start = [], np.eye(4)
    for _ in range(LONG):
        poses.append(start @ drive.T_world_lidar)
        last = poses[-1][-1]
        start = level_poses(*last[:2, 3], yaw_of(last[:3, :3])) @ level_poses(2.2)
        start[2, 3] = last[2, 3]
    link_scans(drive, root, [number % len(drive.frames) for number in range(LONG * len(drive.frames))])
    write_poses(root, np.concatenate(poses))


def link_scans(drive: FolderDrive, root: Path, positions: Sequence[int]) -> None:
    """Make a folder of links to scans of a drive and to their labels."""
    folders = ("velodyne", "labels")
    for folder in folders:
        (root / folder).mkdir()
    for number, position in enumerate(positions):
        for folder, source in zip(folders, drive.scans.files(int(drive.frames[position])), strict=True):
            (root / folder / f"{number:06d}{source.suffix}").symlink_to(source.resolve())


def write_poses(root: Path, T_world_lidar: FloatArray) -> None:
    """Write the poses of a drive."""
    np.savetxt(root / "poses.txt", T_world_lidar[:, :3].reshape(-1, 12))


def rows_of(root: Path, sparse: Path, times: int) -> list[Row]:
    """Measure everything: the last rows by a drive whose scans have fewer points."""
    for name, drive in (("default", root), ("paper", sparse)):
        measured(name, drive, 1)  # compiles the kernels and fills the page cache
    masking_runs, literal_runs = measured("masking", root, times), measured("literal", sparse, times)
    masked, plain = [run["cpu_ms"] for run in masking_runs], [run["ms"] for run in literal_runs]
    rows = [
        Row("read and mask the scans in numpy, by the clock", "ms per keyframe", [run["ms"] for run in masking_runs]),
        Row("  processor time", "ms per keyframe", masked),
        Row("the plain reference, by the clock (80,000 points)", "ms per keyframe", plain),
        Row("  processor time", "ms per keyframe", [run["cpu_ms"] for run in literal_runs]),
    ]
    for name in ("default", "paper"):
        runs = measured(name, root, times)
        wall, cpu = ([1e3 * run[key] / run["keyframes"] for run in runs] for key in ("seconds", "cpu_seconds"))
        rows.append(Row(f"{name}, one core, by the clock", "ms per keyframe", wall, at_most=6.0))
        rows.append(Row("  processor time", "ms per keyframe", cpu, at_most=6.0))
        rows += [
            Row(f"  {stage[6:]}", "ms per keyframe", [run[stage] for run in runs])
            for stage in runs[0]
            if stage.startswith("stage ")
        ]
        rows += [
            Row(f"  {name}", "s per drive", [run[key] for run in runs])
            for name, key in (
                ("opening and checks, in a warm process: processor time", "open_seconds"),
                ("writing: processor time", "write_seconds"),
            )
        ]
        rows.append(Row("  times reading and masking", "x", [ms / min(masked) for ms in cpu], at_most=3.0))
        rows.append(Row("  memory", "MB", [run["peak_mb"] for run in runs], at_most=600.0))
    with tempfile.TemporaryDirectory() as folder:
        write_long(open_drive(sparse), Path(folder))
        for name, title in (
            ("command", f"interloc run, two processes, {LONG}x as long"),
            ("default2", "  the same without its start"),
            ("paper2", "  the same by preset paper"),
        ):
            doubles = measured(name, Path(folder), times)
            rate = [run["keyframes"] / run["seconds"] for run in doubles]
            rows.append(Row(title, "keyframes/s", rate, at_least=500.0))
            rows.append(Row("  times the plain reference", "x", [r * min(plain) / 1e3 for r in rate], at_least=40.0))
            rows.append(Row("  memory", "MB", [run["peak_mb"] for run in doubles], at_most=300.0))
        (long,), shorts = measured("default", Path(folder), 1), measured("default", sparse, times)
        short = min(shorts, key=lambda run: run["cpu_seconds"])
        each = (long["cpu_seconds"] - short["cpu_seconds"]) / (long["keyframes"] - short["keyframes"])
        fixed = short["cpu_seconds"] - each * short["keyframes"]
        rows += [
            Row(f"default, {LONG}x as long less once: processor time", "ms per keyframe", [1e3 * each]),
            Row("  what is left: fixed", "s per drive", [fixed]),
            Row("  memory", "MB", [long["peak_mb"]], at_most=300.0),
        ]
    rows.append(
        Row("loading of the kernels, once per process: processor time", "s", [run["load_seconds"] for run in runs])
    )
    return [*rows, *start_up(root, times)]


def facts() -> dict[str, Any]:
    """Return what the figures depend on."""
    versions = {name: importlib.import_module(name).__version__ for name in ("numpy", "numba")}
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {"python": platform.python_version(), "cores": os.cpu_count(), "load_before": load, **versions}


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drive", type=Path, help="a drive of 100 keyframes or more instead of the made-up one")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the table there too")
    parser.add_argument("--quick", action="store_true", help="measure everything once instead of five times")
    parser.add_argument("--measure", choices=MEASURES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        click.echo(json.dumps(MEASURES[options.measure](options.drive)))
        return
    about = facts()
    drives = [options.drive or made_up_drive(name, shots) for name, shots in (("town", 2083), ("town-80", 1343))]
    rows = rows_of(*drives, 1 if options.quick else 5)
    click.echo(", ".join(f"{name} {value}" for name, value in about.items()))
    click.echo(f"{'':<56} {'best':>8} {'median':>8}  {'':<14} target of the best")
    for row in rows:
        click.echo(f"{row.name:<56} {row.best:8.2f} {median(row.values):8.2f}  {row.unit:<14} {row.verdict}")
    missed = [row.name.strip() for row in rows if row.verdict.endswith("MISSED")]
    click.echo(f"missed: {', '.join(missed)}" if missed else "every target is met")
    if options.json:
        table = [asdict(row) | {"best": row.best, "median": median(row.values)} for row in rows]
        options.json.write_text(json.dumps({"about": about, "rows": table}, indent=1) + "\n")


if __name__ == "__main__":
    main()
