"""How true the widths of branches are: `tests/performance/widths.py DRIVE... --kitti DIR`, on simulated drives.

From the project's folder, with PYTHONPATH=. there. A drive is what `interloc simulate town`, `interloc benchmark twins
--keep` or `tests/performance/reasons.py` (folders like 06_service) wrote; `simulation.json` in it tells its world. The
width of a branch is compared with that of the road surface of the simulated street under it. Only branches count that
run on exactly one street where widths are measured: with two, neither is the width.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import click
import numpy as np
from reasons import COVERED_M, Truth, places_along

from interloc.arrays import FloatArray
from interloc.detection.widths import FAR_M, NEAR_M
from interloc.drives.open import open_drive
from interloc.lab.config import SceneConfig
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import read_map
from interloc.lab.town import MAP_FILE, Town
from interloc.lab.twins import twin_track
from interloc.pipeline import detect
from interloc.results import DetectionTable, IntersectionTable
from tests.twins import twin_scene

ALONG_M = np.arange(NEAR_M, FAR_M + 0.5, 1.0)
"""Where along a branch the street is asked for."""
NEAR_DETECTION_M, FAR_DETECTION_M = 15.0, 30.0


def scene_of(folder: Path, kitti: Path | None) -> Scene:
    """Return the world that a drive was simulated in."""
    facts = json.loads((folder / "simulation.json").read_text())
    config, seed = SceneConfig.model_validate(facts["scene"]), facts["seed"]
    if "town" in facts:
        return build_scene(
            Town(facts["town"], seed=seed).track(), read_map(folder / MAP_FILE), config=config, seed=seed
        )
    if kitti is None or "twin" not in facts:
        raise click.UsageError(f"{folder}: neither a town nor, with --kitti, a twin.")
    return twin_scene(kitti, facts["twin"], twin_track(kitti, facts["twin"]), config=config, seed=seed)


def the_street_under(truth: Truth, xy: FloatArray, bearing_deg: float) -> int | None:
    """Return the street on which a branch runs; None for none and for several."""
    places = places_along(xy, bearing_deg, ALONG_M)
    streets, count = np.unique(truth.tree.query(places, "intersects")[1], return_counts=True)
    streets = streets[count >= COVERED_M]
    return int(streets[0]) if len(streets) == 1 else None


def errors_of(truth: Truth, table: DetectionTable | IntersectionTable) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the widths of all branches that count, metres, and the row of the table of each."""
    assert table.lonlat is not None
    errors, rows = [], []
    for row, xy in enumerate(truth.scene.frame.xy(table.lonlat)):
        for bearing_deg, width_m in zip(table.bearings_deg[row].tolist(), table.widths_m[row].tolist(), strict=True):
            street = the_street_under(truth, xy, bearing_deg)
            if street is not None and np.isfinite(width_m):
                errors.append(width_m - 2.0 * truth.scene.profiles[street].half_m)
                rows.append(row)
    return np.array(errors), np.array(rows, dtype=np.int64)


def say(name: str, errors: FloatArray) -> None:
    """Print the figures of some branches."""
    if len(errors):
        size = np.abs(errors)
        figures = f"{np.median(size):10.2f} {np.percentile(size, 90):14.2f} {np.median(errors):8.2f}"
        click.echo(f"{name:44s} {len(errors):8d} {figures}")


def main() -> None:
    """Detect on each drive, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drives", nargs="+", type=Path, metavar="DRIVE", help="Simulated drives.")
    parser.add_argument("--kitti", type=Path, help="Folder with oxts/, poses_suma/, osm/, ... of the twins.")
    given = parser.parse_args()
    click.echo(f"{'':44s} {'branches':>8s} {'median [m]':>10s} {'90 % below [m]':>14s} {'bias [m]':>8s}")
    for folder in given.drives:
        truth = Truth(scene_of(folder, given.kitti))
        result = detect(open_drive(folder))
        say(f"{folder.name}, intersections", errors_of(truth, result.intersections)[0])
        errors, rows = errors_of(truth, result.detections)
        away_m = np.hypot(*result.detections.lidar_xy.T)[rows]
        say(f"{folder.name}, detections", errors)
        say(f"  up to {NEAR_DETECTION_M:g} m away", errors[away_m <= NEAR_DETECTION_M])
        say(f"  beyond {FAR_DETECTION_M:g} m", errors[away_m > FAR_DETECTION_M])


if __name__ == "__main__":
    main()
