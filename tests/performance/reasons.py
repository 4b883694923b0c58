"""How many reasons of wrong intersections and missed nodes are right: `tests/performance/reasons.py --kitti DIR`.

From the project's folder, with PYTHONPATH=. there. The reasons come from positions on the map alone; what is true is
asked of the simulated world: which streets' surfaces lie under the branches of an intersection, whether these streets
meet at a node, and which road surface the scans saw around a missed node. Each twin is simulated as the benchmark does
it, and once more with its service roads labelled as road, so that `left_out` occurs. Drives in --twins are used again.
"""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import shapely

from interloc.arrays import FloatArray
from interloc.cli.main import run
from interloc.drives.open import open_drive
from interloc.evaluation.published import SEQUENCES
from interloc.lab.config import LidarConfig, SceneConfig, SimulationOptions, StreetConfig
from interloc.lab.drive import simulate
from interloc.lab.scene import Scene
from interloc.lab.twins import twin_files, twin_track, twin_trip
from interloc.osm.intersections import DRIVABLE
from tests.twins import twin_scene

STARTS = {
    "left_out": "junction with",
    "slip_road": "mouth of a slip road",
    "fork": "roads part",
    "second": "second one",
    "off": "off by",
    "bend": "bend of",
    "road_end": "end of a road",
    "nothing": "nothing in",
    "merged": "merged with",
    "misplaced": "intersection ",
    "too_few": "detected at",
    "not_driven": "not driven",
    "short": "branches too short",
    "not_seen": "passed at",
}
BRANCH_M = np.arange(8.0, 23.0, 1.0)
"""Where along a branch the surface is asked for."""
ASIDE_M = 3.0
"""A branch of an intersection that is some metres off runs beside the street that it shows."""
COVERED_M = 5
REACH_M = 30.0
"""A junction this near can be what an intersection shows."""
ACUTE_DEG = 55.0
ARM_M = np.arange(6.0, 19.0, 1.0)
"""Where along the arms of a missed node road must have been seen."""
SEEN_M = 1.0
SEEN_SHARE = 0.6


class Truth:
    """The streets of a simulated world, to be asked what lies where."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.streets = [profile.street for profile in scene.profiles]
        self.tree = shapely.STRtree([profile.line.buffer(profile.half_m) for profile in scene.profiles])
        self.lines = [profile.line for profile in scene.profiles]
        self.at_node: dict[int, list[int]] = {}
        for row, street in enumerate(self.streets):
            for node in (street.nodes[0], street.nodes[-1]):
                self.at_node.setdefault(node, []).append(row)
        self.nodes = [node for node, rows in self.at_node.items() if len(rows) >= 3]
        self.node_xy = np.array([self.scene.street_map.node_xy[node] for node in self.nodes]).reshape(-1, 2)

    def is_drivable(self, row: int) -> bool:
        """Whether policy `drive` counts a street."""
        return self.streets[row].tags["highway"] in DRIVABLE

    def is_counted(self, node: int) -> bool:
        """Whether at least three drivable streets meet at a node."""
        return sum(self.is_drivable(row) for row in self.at_node[node]) >= 3

    def under_branches(self, xy: FloatArray, bearings_deg: list[float]) -> list[int]:
        """Return the street under most of each branch."""
        found = []
        for bearing_deg in bearings_deg:
            places = places_along(xy, bearing_deg, BRANCH_M)
            distances: dict[int, list[float]] = {}
            for place, row in self.tree.query(places, "dwithin", ASIDE_M).T.tolist():
                distances.setdefault(row, []).append(float(places[place].distance(self.lines[row])))
            covered = {row: each for row, each in distances.items() if len(each) >= COVERED_M}
            if covered:  # of several that cover it as far, the one along whose centre line it runs
                longest = max(len(each) for each in covered.values())
                rows = [row for row, each in covered.items() if len(each) >= 0.7 * longest]
                found.append(min(rows, key=lambda row: float(np.mean(covered[row]))))
        return found

    def at_junction(self, node: int) -> set[int]:
        """Return the streets at a node, and the next ones where those are short, as in a large junction."""
        rows = set(self.at_node.get(node, []))
        for row in list(rows):
            if self.lines[row].length < REACH_M:
                street = self.streets[row]
                rows |= {*self.at_node[street.nodes[0]], *self.at_node[street.nodes[-1]]}
        return rows

    def junctions(self, xy: FloatArray, streets: list[int], least: int) -> list[int]:
        """Return the nodes near a place at which so many of the streets meet."""
        near = np.flatnonzero(np.hypot(*(self.node_xy - xy).T) <= REACH_M)
        return [self.nodes[k] for k in near if len(set(streets) & self.at_junction(self.nodes[k])) >= least]

    def place(self, node: int) -> FloatArray:
        """Return where a node is, (2,)."""
        place: FloatArray = self.scene.street_map.node_xy[node]
        return place

    def acute(self, streets: list[int]) -> bool:
        """Whether two of the streets, or their neighbours at a node, leave it at an acute angle."""
        for node in {n for row in streets for n in (self.streets[row].nodes[0], self.streets[row].nodes[-1])}:
            rows = self.at_node[node]
            ways = [self._direction(row, node) for row in rows]
            for a in range(len(ways)):
                for b in range(a):
                    if np.degrees(np.arccos(np.clip(ways[a] @ ways[b], -1, 1))) <= ACUTE_DEG:
                        return True
        return False

    def _direction(self, row: int, node: int) -> FloatArray:
        line = self.lines[row]
        start = np.hypot(*(np.array(line.coords[0]) - self.place(node))) < np.hypot(
            *(np.array(line.coords[-1]) - self.place(node))
        )
        end = line.interpolate(min(20.0, line.length) if start else max(line.length - 20.0, 0.0))
        step = np.array([end.x, end.y]) - self.place(node)
        unit: FloatArray = step / max(np.hypot(*step), 1e-9)
        return unit

    def arms(self, node: int) -> list[FloatArray]:
        """Return places along each drivable street that leaves a node."""
        return [
            self.place(node) + ARM_M[:, None] * self._direction(row, node)
            for row in self.at_node.get(node, [])
            if self.is_drivable(row)
        ]


def places_along(xy: FloatArray, bearing_deg: float, along_m: FloatArray) -> Any:
    """Return the points at some distances along a branch."""
    bearing = np.radians(bearing_deg)
    return shapely.points(xy + along_m[:, None] * [np.sin(bearing), np.cos(bearing)])


def is_right(truth: Truth, kind: str, sentence: str, xy: FloatArray, bearings_deg: list[float]) -> bool:
    """Whether the reason of a wrong intersection is that of the simulated world."""
    streets = truth.under_branches(xy, bearings_deg)
    named = re.search(r"node (\d+)", sentence)
    meet_there = named is not None and int(named[1]) in truth.junctions(xy, streets, 2)
    if kind == "left_out":
        has_such = any(not truth.is_drivable(row) for row in streets)
        return any(not truth.is_counted(node) for node in truth.junctions(xy, streets, 2 if has_such else 3))
    if kind == "slip_road":
        return any(truth.streets[row].tags["highway"].endswith("_link") for row in streets)
    if kind == "fork":
        return meet_there and truth.acute(streets)
    if kind in {"second", "off"}:
        return meet_there
    three = truth.junctions(xy, streets, 3)
    if kind == "road_end":
        ends = {n for row in streets for n in (truth.streets[row].nodes[0], truth.streets[row].nodes[-1])}
        return not three and any(len(truth.at_node[n]) == 1 for n in ends)
    return not three  # a bend, a path, nothing: no streets meet


def is_missed_so(
    truth: Truth, kind: str, node: int, folder: Path, found: list[tuple[FloatArray, dict[str, Any]]]
) -> bool | None:
    """Whether the reason of a missed node is that of the simulated world; None where it only states what was found."""
    if node not in truth.at_node:
        return None
    if kind in {"merged", "misplaced"}:
        shown = [
            truth.under_branches(xy, properties["branch_bearings_deg"])
            for xy, properties in found
            if np.hypot(*(truth.place(node) - xy)) <= REACH_M
        ]
        return any(set(streets) & set(truth.at_node[node]) for streets in shown)
    if kind == "not_driven":
        return seen_arms(truth, node, open_drive(folder), folder) < 3
    return None


def seen_arms(truth: Truth, node: int, drive: Any, drive_folder: Path) -> int:
    """Return how many arms of a node the road points of all scans around it cover."""
    poses = truth.scene.T_map_lidar
    arms = truth.arms(node)
    hit = [np.zeros(len(ARM_M), dtype=bool) for _ in arms]
    track_frames = json.loads((drive_folder / "simulation.json").read_text())["track_frames"]
    for row, frame in enumerate(drive.frames):
        pose = poses[track_frames[frame]]
        if np.hypot(*(pose[:2, 3] - truth.place(node))) > 60.0:
            continue
        points = drive.ground_points(row).road
        world = (points @ pose[:3, :3].T + pose[:3, 3])[:, :2]
        tree = shapely.STRtree(shapely.points(world)) if len(world) else None
        if tree is None:
            continue
        for arm, seen in zip(arms, hit, strict=True):
            near = tree.query(shapely.points(arm), predicate="dwithin", distance=SEEN_M)[0]
            seen[np.unique(near)] = True
    return sum(seen.mean() >= SEEN_SHARE for seen in hit)


def answers(truth: Truth, folder: Path, out: Path) -> Iterator[tuple[str, bool | None, str]]:
    """Yield the kind of each reason of a result, whether it is right (None: cannot be asked), and its words."""
    for xy, properties in layer(truth, out, "intersections"):
        if properties["outcome"] == "wrong":
            reason = properties["reason"]
            kind = kind_of(reason)
            good = is_right(truth, kind, reason, xy, properties["branch_bearings_deg"])
            yield kind, good, f"{out.name} intersection {properties['id']}: {reason}"
    detections = layer(truth, out, "detections")
    for _, properties in layer(truth, out, "osm_nodes"):
        if properties["outcome"] == "missed" and properties["reason"]:
            kind = kind_of(properties["reason"])
            good = is_missed_so(truth, kind, properties["osm_id"], folder, detections)
            yield kind, good, f"{out.name} node {properties['osm_id']}: {properties['reason']}"


def twin_folder(kitti: Path, sequence: str, twins: Path, *, service_roads: bool, columns: int) -> Path:
    """Return the folder of a twin, which is simulated if it is not there."""
    folder = twins / (f"{sequence}_service" if service_roads else sequence)
    if not folder.is_dir():
        streets = StreetConfig(service_roads="road" if service_roads else "other_ground")
        scene, sensor = SceneConfig(streets=streets), LidarConfig(columns=columns)
        options = SimulationOptions(keyframes_only=True, ground_only=True, scene=scene, sensor=sensor)
        simulate(twin_trip(kitti, sequence), folder, options)
    return folder


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kitti", type=Path, required=True, help="Folder with oxts/, poses_suma/, osm/, ...")
    parser.add_argument("--twins", type=Path, required=True, help="Folder of the simulated drives.")
    parser.add_argument("--sequences", nargs="*", default=SEQUENCES)
    parser.add_argument("--service", nargs="*", default=["05", "06"], help="Sequences with service roads as road.")
    parser.add_argument("--presets", nargs="*", default=["default", "paper"])
    parser.add_argument("--columns", type=int, default=1024)
    given = parser.parse_args()
    right, asked, stated = Counter[str](), Counter[str](), Counter[str]()
    for sequence, service_roads in [(s, False) for s in given.sequences] + [(s, True) for s in given.service]:
        folder = twin_folder(given.kitti, sequence, given.twins, service_roads=service_roads, columns=given.columns)
        truth = Truth(twin_scene(given.kitti, sequence, twin_track(given.kitti, sequence)))
        osm = str(twin_files(given.kitti, sequence)["osm"])
        for preset in given.presets:
            out = given.twins / f"{folder.name}_{preset}"
            assert run(["run", str(folder), "-o", str(out), "--osm", osm, "--preset", preset, "--quiet"]) == 0
            for kind, good, words in answers(truth, folder, out):
                asked[kind] += good is not None
                right[kind] += bool(good)
                stated[kind] += good is None
                if good is not None and not good:
                    click.echo(f"not so: {words}")
    for kind in asked | stated:
        note = f", {stated[kind]} more say what was found: nothing to compare with" if stated[kind] else ""
        click.echo(f"{kind:12s} {right[kind]:4d} of {asked[kind]:4d} right{note}")
    total = asked.total()
    click.echo(f"{'all':12s} {right.total():4d} of {total:4d} right, {right.total() / max(total, 1):.1%}")


def layer(truth: Truth, out: Path, name: str) -> list[tuple[FloatArray, dict[str, Any]]]:
    """Return place, (2,) in the frame of the scene, and properties of each feature of a layer."""
    features = json.loads((out / f"{name}.geojson").read_text())["features"]
    return [(truth.scene.frame.xy(np.array(f["geometry"]["coordinates"])), f["properties"]) for f in features]


def kind_of(sentence: str) -> str:
    """Return the kind of a reason by how its sentence begins."""
    return next((kind for kind, start in STARTS.items() if sentence.startswith(start)), "path")


if __name__ == "__main__":
    main()
