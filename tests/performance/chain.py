"""From points and times alone to a map: `python -m tests.performance.chain --kitti DIR --twins DIR 07:os1-32 05`.

Each argument is SEQUENCE[:SENSOR[:SCANS]], a twin of KITTI with ten scans per second. Its poses, labels and fixes are
hidden; `interloc run --near` computes the poses, labels the points by geometry and places the drive on the map of the
whole city. Where it is placed, it is tried once more around a place `--away` km to the east, where it must be refused.
Shown are the intersections of the map in reach that were found within 10 m, the farthest of them, how far the track
lies from the true one, and processor time and memory of the whole process. Drives in --twins are used again.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import click
import numpy as np

import interloc
from interloc.arrays import FloatArray
from interloc.cli.main import run
from interloc.drives.open import open_drive
from interloc.geometry import enu_from_lonlat

EAST_DEG_PER_KM = 1 / 73.0
"""At the latitude of Karlsruhe."""


def twin(kitti: Path, twins: Path, sequence: str, sensor: str, scans: str) -> Path:
    """Return the folder of a twin at ten scans per second, simulated where it is not there yet."""
    folder = twins / "-".join(filter(None, (sequence, sensor, scans)))
    if not (folder / "simulation.json").is_file():
        limit = ["--max-scans", scans] if scans else []
        where = ["--kitti", str(kitti), "--sensor", sensor, "-o", str(folder)]
        run(["simulate", "twin", sequence, "--every-scan", "--quiet", *where, *limit])
    return folder


def bare(drive: Path) -> Path:
    """Return a folder with the points and times of a drive, and nothing else of it."""
    folder = drive.with_name(f"{drive.name}-bare")
    folder.mkdir(exist_ok=True)
    for name in ("velodyne", "times.txt"):
        if not (folder / name).exists():
            (folder / name).symlink_to(drive.resolve() / name)
    return folder


def mapped(drive: Path, out: Path, osm: Path, near: FloatArray) -> tuple[str, float, float]:
    """Run the whole chain as a process of its own; return what it said at last, seconds and megabytes."""
    place = f"{near[1]:.2f},{near[0]:.2f}"
    arguments = [str(drive), "-o", str(out), "--osm", str(osm), "--near", place, "--quiet"]
    child = subprocess.Popen(
        [sys.executable, "-m", "interloc", "run", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    assert child.stderr is not None
    words = child.stderr.read().decode().strip()
    _, status, used = os.wait4(child.pid, 0)
    said = words.splitlines()[-1] if status and words else ""
    return said, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def outcome(out: Path, truth: FloatArray) -> str:
    """Tell what was found: `truth` is the (N, 2) longitude and latitude of every scan."""
    keyframes = interloc.read_results(out).keyframes
    assert keyframes.lonlat is not None
    origin = truth[0, 1], truth[0, 0]
    off = enu_from_lonlat(*origin, keyframes.lonlat) - enu_from_lonlat(*origin, truth[keyframes.frame])
    scores = json.loads((out / "report.json").read_text())["map_level"]
    distances = np.hypot(*off.T)
    return (
        f"{scores['true']} of {scores['nodes_in_zone']} intersections, {scores['false']} wrong, at most "
        f"{scores['max_m']:.2f} m off; track {np.median(distances):.2f} m off (median), {distances.max():.2f} m at most"
    )


def main() -> None:
    """Simulate, run and print one line per drive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", nargs="+", metavar="SEQUENCE[:SENSOR[:SCANS]]")
    parser.add_argument("--kitti", type=Path, required=True, help="as of interloc simulate twin, with karlsruhe.osm.gz")
    parser.add_argument("--twins", type=Path, required=True, help="where the drives are kept: 1 to 7 GB each")
    parser.add_argument("--away", type=float, default=7.0, help="how far away the other place is, km (7)")
    options = parser.parse_args()
    osm = options.kitti / "karlsruhe.osm.gz"
    for each in options.drives:
        sequence, sensor, scans, *_ = [*each.split(":"), "", ""]
        drive = twin(options.kitti, options.twins, sequence, sensor or "hdl-64e", scans)
        placed = open_drive(drive).georeference
        assert placed is not None
        truth = np.column_stack([placed.lon_deg, placed.lat_deg])
        out, middle = options.twins / f"{drive.name}-result", truth.mean(axis=0)
        refused, seconds, megabytes = mapped(bare(drive), out, osm, middle)
        click.echo(f"{drive.name}: {refused or outcome(out, truth)} ({seconds:.0f} s of CPU time, {megabytes:.0f} MB)")
        if not refused:
            elsewhere = middle + np.array([options.away * EAST_DEG_PER_KM, 0.0])
            refused, *_ = mapped(bare(drive), out, osm, elsewhere)
            click.echo(f"{drive.name}, {options.away:g} km away: {refused or outcome(out, truth)}")


if __name__ == "__main__":
    main()
