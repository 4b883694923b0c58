"""How much of a map that was changed on purpose an audit finds, and what it claims of the map as it is.

    python tests/performance/audit.py OUT_A OUT_B --osm map.osm.gz --draws 10 --first 200

Of the junctions that two drives or more came by, 20 % lose a side road and 20 % are moved by 8 to 20 m. A finding is
right if a change that fits its kind lies within 25 m, of a side road also at its other end.
"""

import argparse
import sys
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from interloc.arrays import FloatArray
from interloc.city.audit import audit
from interloc.city.citymap import CityMap, merge
from interloc.city.drives import Pass
from interloc.city.osm_plane import OsmPlane
from interloc.evaluation.coverage import map_bounds
from interloc.osm.graph import RoadGraph
from interloc.osm.reader import read_osm
from interloc.output.read import read_results

_NEAR_M, _TRACK_M, _APART_M, _SHARE = 25.0, 15.0, 40.0, 0.2
Change = tuple[str, FloatArray, FloatArray]  # removed or moved, the junction, the other end of what was removed


def changed(city: CityMap, graph: RoadGraph, rng: np.random.Generator) -> tuple[RoadGraph, list[Change]]:
    osm = OsmPlane.of(city, graph)
    tracks = [cKDTree(drive.track_xy - drive.knots.mean(axis=0)) for drive in city.drives.values()]
    nodes = osm.open_junctions
    came = [np.asarray(each.query_ball_point(osm.xy[nodes], _TRACK_M, return_length=True)) >= 3 for each in tracks]
    passed = rng.permutation(nodes[np.sum(came, axis=0) >= 2]).tolist()
    count = round(_SHARE * len(passed))
    changes: list[Change] = []
    gone: set[tuple[int, int]] = set()
    lonlat = graph.lonlat.copy()
    for kind in ("removed", "moved"):
        for node in passed:
            here = osm.xy[node]
            if sum(each[0] == kind for each in changes) >= count:
                break
            if any(np.hypot(*(here - each[1])) < _APART_M for each in changes):
                continue
            if kind == "moved":
                angle = rng.uniform(0, 2 * np.pi)
                to = here + osm.offset_m + rng.uniform(8, 20) * np.array([np.sin(angle), np.cos(angle)])
                lonlat[node] = city.lonlat(to[None])[0]
                changes.append((kind, here, here))
                continue
            roads = [osm.along(node, each, np.inf)[0] for each in osm.neighbours.get(node, [])]
            sides = [road for road in roads if _leaves(osm.road_from(node, road[1], 60.0), tracks)]
            if sides:
                gone.update((min(pair), max(pair)) for pair in zip(sides[0][:-1], sides[0][1:], strict=True))
                changes.append((kind, here, osm.xy[sides[0][-1]]))
    kept = np.array([(min(pair), max(pair)) not in gone for pair in graph.edges.tolist()])
    return replace(graph, lonlat=lonlat, edges=graph.edges[kept], edge_way=graph.edge_way[kept]), changes


def _leaves(road: FloatArray, tracks: list[cKDTree]) -> bool:
    return len(road) >= 25 and all(each.query(road[15:])[0].min() > 12.0 for each in tracks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", nargs="+")
    parser.add_argument("--osm", required=True)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    passes = [Pass.of(read_results(each)) for each in options.results]  # of one drive, too: some centimetres apart
    drives = [replace(p, name=str(n), track_lonlat=p.track_lonlat + 1e-7 * n) for n, p in enumerate(passes)]
    city = merge(drives)
    graph = read_osm(options.osm, map_bounds(np.concatenate([each.track_lonlat for each in drives])))
    clean = audit(city, graph)
    shown = city.places.xy[city.places.is_shown & (city.places.passes >= 2)]
    right = wrong = total = found = detected = 0
    for draw in range(options.first, options.first + options.draws):
        after, changes = changed(city, graph, np.random.default_rng(draw))
        hits: set[int] = set()
        for finding in audit(city, after).findings:
            fits = [
                number
                for number, (kind, *ends) in enumerate(changes)
                if (kind == "moved" or finding.kind != "moved")
                and min(np.hypot(*(finding.xy - each)) for each in ends) < _NEAR_M
            ]
            right, wrong = right + bool(fits), wrong + (not fits)
            hits.update(fits)
        total, found = total + len(changes), found + len(hits)
        detected += sum(bool((np.hypot(*(shown - xy).T) < _TRACK_M).any()) for _, xy, _ in changes)
    sys.stdout.write(
        f"right {right} of {right + wrong}, found {found} of {total}, {detected} of them detected; unchanged map: "
        f"{len(clean.findings)} findings on {clean.junctions} junctions\n"
    )


if __name__ == "__main__":
    main()
