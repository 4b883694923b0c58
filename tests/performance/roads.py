"""How good the map of roads is: centrelines, widths, completeness and topology against the map of the drive.

    python -m tests.performance.roads RESULT[=MAP.osm]...

RESULT is a result folder; beside it, in ``drive/``, lies the drive where it was simulated: its `simulation.json` and
map tell the true widths. Of real ground only what OpenStreetMap knows is measured. All figures are of the part that was
seen: a point of the truth, one per metre, whose cell of road.tif was seen twice.

- driven: within 4 m of the track; side: the rest, in seen runs of 20 m or more.
- centre: distance across the true line, more than 12 m from a junction, matched within 4 m and 37 degrees.
- width: median of an edge against the median of the truth along it.
- complete, correct: share of the truth (of the network) within 3 m of the other (Heipke et al. 1997).
- topology: pairs of neighbouring junctions, among those that the result found (within 15 m); those that it did not
  find are no nodes. A pair counts as missing where 90 % or more of its street was seen.
"""

# ruff: noqa: ANN001, ANN201
import argparse
import json
import resource
import time
from collections import defaultdict
from pathlib import Path

import click
import numpy as np
import shapely
from pyproj import Transformer
from scipy.spatial import cKDTree

import interloc
from interloc.lab.config import StreetConfig
from interloc.lab.streets import find_crossings, read_map, street_map_of, street_profiles, visible_lines
from interloc.lab.tracks import LocalFrame
from interloc.osm.intersections import DRIVABLE
from interloc.output.road import read_road
from interloc.roadmap.extract import extract_roads

DRIVEN_M, SIDE_RUN_M, FAR_M, MATCH_M, BUFFER_M, JUNCTION_M = 4, 20, 12, 4, 3, 15


class Truth:
    """The streets of a map in metres of the mosaic, as points one per metre."""

    def __init__(self, folder: Path, osm: Path, epsg: int, box: tuple[float, float, float, float]) -> None:
        facts_file = folder.parent / "drive" / "simulation.json"
        facts = json.loads(facts_file.read_text()) if facts_file.exists() else None
        to_lonlat, to_mosaic = (Transformer.from_crs(a, b, always_xy=True) for a, b in ((epsg, 4326), (4326, epsg)))
        lon, lat = to_lonlat.transform((box[0] + box[2]) / 2, (box[1] + box[3]) / 2)
        frame = LocalFrame(lat, lon)
        low, high = (frame.xy(np.stack(to_lonlat.transform(*at), axis=-1)) for at in (box[:2], box[2:]))
        buildings = osm.parent.parent / "osm_buildings" / osm.name
        data = read_map(osm, buildings if facts and buildings.is_file() and "osm" in osm.parts else None)
        streets = street_map_of(data, frame, (*(low - 100), *(high + 100)))
        config = StreetConfig(**facts["scene"]["streets"]) if facts else StreetConfig()
        profiles = street_profiles(streets, config, towns=not streets.buildings, seed=facts["seed"] if facts else 0)
        lines = visible_lines(profiles, find_crossings(profiles), from_hidden=False)
        self.is_exact = facts is not None
        pieces, ways, self.width, self.is_road, self.street, self.edges = [], [], [], [], [], []
        for number, (profile, line) in enumerate(zip(profiles, lines, strict=True)):
            is_road = profile.street.tags["highway"] in DRIVABLE
            for part in shapely.get_parts(line):
                if part.length < 1:
                    continue
                at = np.linspace(0, part.length, max(2, round(part.length) + 1))
                xy = shapely.get_coordinates(shapely.line_interpolate_point(part, at))
                xy = np.stack(to_mosaic.transform(*frame.lonlat(xy).T), axis=-1)
                begin = sum(map(len, pieces))
                self.edges.append((begin, begin + len(xy), profile.street.nodes[0], profile.street.nodes[-1], is_road))
                pieces.append(xy)
                step = np.gradient(xy, axis=0)
                ways.append(step / np.linalg.norm(step, axis=1)[:, None])
                self.width += [2 * profile.half_m] * len(xy)
                self.is_road += [is_road] * len(xy)
                self.street += [number] * len(xy)
        self.xy, self.way = np.concatenate(pieces), np.concatenate(ways)
        self.width, self.is_road, self.street = map(np.array, (self.width, self.is_road, self.street))
        degree = defaultdict(set)
        for begin, _, first, last, is_road in self.edges:
            if is_road:
                degree[first].add((begin, 0))
                degree[last].add((begin, 1))
        places = {}
        for begin, end, first, last, _ in self.edges:
            places.setdefault(first, self.xy[begin])
            places.setdefault(last, self.xy[end - 1])
        self.junctions = {node: places[node] for node, arms in degree.items() if len(arms) > 2}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("results", nargs="+")
    options = parser.parse_args()
    pool = defaultdict(list)
    for each in options.results:
        folder, _, osm = each.partition("=")
        row = measure(Path(folder), Path(osm or f"{folder}/../drive/map.osm"), pool)
        click.echo(" ".join(f"{k}={v}" for k, v in row.items()))
    if len(options.results) > 1:
        click.echo(f"pooled: {pooled(pool)}")
    click.echo(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def pooled(pool) -> dict[str, object]:
    row = {
        name: spread(pool[name])
        for name in ("centre driven", "centre side", "width driven", "width side")
        if pool[name]
    }
    right, wrong, missing = (sum(pool[name]) for name in ("right", "wrong", "missing"))
    return row | {"topology": (right, wrong, missing), "F1": round(2 * right / max(2 * right + wrong + missing, 1), 3)}


def spread(errors) -> str:
    errors = np.asarray(errors)
    if not len(errors):
        return "-"
    size = np.abs(errors)
    return f"{np.median(size):.3f}/{np.percentile(size, 95):.2f}({np.median(errors):+.2f},n{len(errors)})"


def measure(folder: Path, osm: Path, pool) -> dict[str, object]:
    result, mosaic = interloc.read_results(folder), read_road(folder / "road.tif")
    began = time.process_time()
    network = extract_roads(result, mosaic)
    seconds = time.process_time() - began
    km = np.linalg.norm(np.diff(result.keyframes.world_xy, axis=0), axis=1).sum() / 1000
    track = np.stack(
        Transformer.from_crs(4326, mosaic.epsg, always_xy=True).transform(*result.keyframes.lonlat.T), axis=-1
    )
    box = (*(track.min(axis=0) - 100), *(track.max(axis=0) + 100))
    truth = Truth(folder, osm, mosaic.epsg, box)
    seen = is_seen(mosaic.raster, truth.xy)
    on_track = cKDTree(track).query(truth.xy)[0] < DRIVEN_M
    junctions = np.array(list(truth.junctions.values())).reshape(-1, 2)
    apart = cKDTree(junctions).query(truth.xy)[0] > FAR_M if len(junctions) else np.ones(len(seen), bool)
    at, way, owner, gap = stations(network)
    tree = cKDTree(at)
    row = {"drive": folder.resolve().parent.name, "km": round(km, 1), "s/km": round(seconds / km, 2)}

    roads = truth.is_road & seen
    runs = long_runs(roads & ~on_track, truth.street)
    distance, _ = tree.query(truth.xy)
    row["complete driven"] = round(float((distance[roads & on_track] < BUFFER_M).mean()), 3)
    row["side"] = round(float((distance[runs] < BUFFER_M).mean()), 3) if runs.any() else None
    own = ~gap
    row["correct"] = round(float((cKDTree(truth.xy).query(at[own])[0] < BUFFER_M).mean()), 3)
    matched, error, edge = matches(truth, tree, at, way, owner, roads & apart)
    for name, chosen in (("driven", on_track), ("side", runs)):
        errors = error[chosen[matched]]
        row[f"centre {name}"] = spread(errors)
        pool[f"centre {name}"] += errors.tolist()
    if truth.is_exact:
        errors = {True: [], False: []}
        for number, each in enumerate(network.edges):
            mine = edge == number
            if np.isfinite(each.width_m) and mine.sum() > 5:
                errors[each.is_driven].append(each.width_m - np.median(truth.width[matched[mine]]))
        for name, driven in (("driven", True), ("side", False)):
            row[f"width {name}"] = spread(errors[driven])
            pool[f"width {name}"] += errors[driven]
    right, wrong, missing = topology(network, truth, seen)
    for name, value in (("right", right), ("wrong", wrong), ("missing", missing)):
        pool[name].append(len(value))
    row["topology"] = (len(right), len(wrong), len(missing))
    row["where"] = [np.round((a + b) / 2).astype(int).tolist() for a, b in (*wrong, *missing)][:8]
    return row


def is_seen(raster, xy):
    cells = np.floor(xy * [1, -1] / raster.cell_m).astype(int)
    tiles = cells // 256
    seen = np.zeros(len(xy), bool)
    for tile in set(map(tuple, tiles)):
        rows = np.flatnonzero((tiles == tile).all(axis=1))
        counts = raster.tiles.get((tile[1], tile[0]))
        if counts is not None:
            seen[rows] = counts[cells[rows, 1] % 256, cells[rows, 0] % 256] >= 2
    return seen


def long_runs(chosen, street):
    result = np.zeros_like(chosen)
    breaks = np.flatnonzero((np.diff(chosen.astype(int)) != 0) | (np.diff(street) != 0)) + 1
    for run in np.split(np.arange(len(chosen)), breaks):
        result[run] = chosen[run[0]] and len(run) >= SIDE_RUN_M
    return result


def stations(network):
    at, way, owner, gap = [], [], [], []
    for number, edge in enumerate(network.edges):
        line = shapely.LineString(edge.xy)
        where = np.linspace(0, line.length, max(2, round(line.length / 0.5)))
        xy = shapely.get_coordinates(shapely.line_interpolate_point(line, where))
        step = np.gradient(xy, axis=0)
        at.append(xy)
        way.append(step / np.maximum(np.linalg.norm(step, axis=1), 1e-9)[:, None])
        owner += [number] * len(xy)
        gap += [edge.seen < 0.5] * len(xy)
    return np.concatenate(at), np.concatenate(way), np.array(owner), np.array(gap)


def matches(truth, tree, at, way, owner, chosen):
    """Return rows of the truth that have a line beside them, the distance across, and the edge."""
    rows, errors, edges = [], [], []
    for row in np.flatnonzero(chosen):
        near = tree.query_ball_point(truth.xy[row], MATCH_M)
        near = [k for k in near if abs(way[k] @ truth.way[row]) > 0.8]
        if near:
            best = min(near, key=lambda k: np.sum((at[k] - truth.xy[row]) ** 2))
            normal = np.array([-truth.way[row][1], truth.way[row][0]])
            rows.append(row)
            errors.append(normal @ (at[best] - truth.xy[row]))
            edges.append(owner[best])
    return np.array(rows, int), np.array(errors), np.array(edges)


def topology(network, truth, seen):
    names, places = list(truth.junctions), np.array(list(truth.junctions.values())).reshape(-1, 2)
    nodes = [node for node in network.nodes if node.kind == "intersection"]
    pairs = sorted(
        (float(d), i, j)
        for i, node in enumerate(nodes)
        for j in range(len(places))
        if (d := np.linalg.norm(node.xy - places[j])) < JUNCTION_M
    )
    name_of, taken = {}, set()
    for _, i, j in pairs:  # one to one; other junctions near a compound node are the same
        if nodes[i].id not in name_of and j not in taken:
            name_of[nodes[i].id] = names[j]
            taken.add(j)
    also = {}
    for _, i, j in pairs:
        if j not in taken and nodes[i].id in name_of:
            also.setdefault(names[j], name_of[nodes[i].id])
    found = set(name_of.values())
    mine = joined([(edge.start, edge.end) for edge in network.edges], set(name_of))
    mine = {frozenset((name_of[a], name_of[b])) for a, b in map(tuple, mine)}
    links = []
    for begin, end, first, last, is_road in truth.edges:
        if is_road:
            links.append((also.get(first, first), also.get(last, last), int(seen[begin:end].sum()), end - begin))
    whole = joined([link[:2] for link in links], found)
    clear = joined([link[:2] for link in links if link[2] >= 0.9 * link[3] or link[3] - link[2] < 3], found)
    # what joins two junctions of the result by ways that are no roads of the policy is not wrong either
    service = joined([(first, last) for _, _, first, last, _ in truth.edges], found)
    right, wrong, missing = mine & whole, mine - whole - service, clear - mine
    where = truth.junctions
    return tuple([[where[node] for node in pair] for pair in map(tuple, group)] for group in (right, wrong, missing))


def joined(links, chosen):
    """Return the pairs of chosen nodes that links join without another chosen one between."""
    onward = defaultdict(list)
    for first, last in links:
        onward[first].append(last)
        onward[last].append(first)
    pairs = set()
    for start in chosen:
        seen, stack = {start}, [start]
        while stack:
            for node in onward[stack.pop()]:
                if node in chosen and node != start:
                    pairs.add(frozenset((start, node)))
                elif node not in seen:
                    seen.add(node)
                    stack.append(node)
    return pairs


if __name__ == "__main__":
    main()
