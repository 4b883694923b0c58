"""Which lines of the skeleton are roads, and where they meet: the fused intersections are the nodes of the map.

The skeleton alone gives a node of its own (a fork) only where three lines of the road that was seen meet far from every
fused intersection.
"""

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import shapely

from interloc.arrays import FloatArray
from interloc.roadmap.graph import Edge, Graph, Node, directions

_SPUR_M = 8.0  # a dead end that is no more than this beyond the edge of the road is no street
_REACH_M, _REACH_HALVES = 12.0, 1.2  # of a fused intersection, metres and half widths
_LOOP_M = 60.0  # a line that leaves an intersection and returns is part of it
_FORK_M = 20.0  # the skeleton of a fork meets that far from where the streets do
_SHORT_M = 8.0
_BRIDGED_M = 25.0
_BRIDGED_COS = float(np.cos(np.radians(25.0)))
_ONWARD_COS = float(np.cos(np.radians(35.0)))
_STRAIGHT_COS = float(np.cos(np.radians(20.0)))
_NEAR_M, _FAR_M = 8.0, 25.0  # where the direction of an arm is measured
_MOUTH_M = 6.0


def connect(graph: Graph, fused_xy: FloatArray, places: Sequence[shapely.Polygon]) -> None:
    """Turn the graph of a skeleton into that of the roads, in place; fused intersections, (M, 2), and places help."""
    _enter_places(graph, fused_xy, places)
    _prune(graph)
    _attach(graph, fused_xy)
    _contract(graph)
    for node in list(graph.nodes):
        _drop_loops(graph, node)
    _part_levels(graph)
    _bridge_gaps(graph)
    _prune(graph)
    graph.smooth_all()
    graph.drop_lonely()


def _enter_places(graph: Graph, fused_xy: FloatArray, places: Sequence[shapely.Polygon]) -> None:
    """Make each open place one node, at which the lines end that lead into it."""
    for number, place in enumerate(places):
        inside = np.flatnonzero(shapely.contains_xy(place.buffer(_MOUTH_M), fused_xy)).tolist()
        middle = place.centroid if place.contains(place.centroid) else place.representative_point()
        xy = np.array([middle.x, middle.y]) if len(inside) != 1 else fused_xy[inside[0]]
        node = graph.add_node(Node(xy, 0.0, inside, number))
        for other in [n for n, each in graph.nodes.items() if each.is_free and graph.degree(n) != 2]:
            arms = graph.arms(other)
            reach = _MOUTH_M + min((float(np.median(edge.half_m)) for _, edge in arms), default=0.0)
            if place.distance(shapely.Point(graph.nodes[other].xy)) < reach:
                for arm, edge in arms:
                    if arm in graph.edges and edge.length_m < _FORK_M and graph.degree(edge.end) == 1:
                        graph.remove_edge(arm)  # a corner of the place, no street
                graph.merge(other, node)
        near = place.buffer(_FORK_M)
        for arm, edge in graph.arms(node):
            if arm in graph.edges and edge.start == edge.end and near.covers(shapely.LineString(edge.xy)):
                graph.remove_edge(arm)
    graph.drop_lonely()


def _prune(graph: Graph) -> None:
    """Remove dead ends that do not lead out of the road they begin on, the shortest first."""
    while True:
        spurs = []
        for number, edge in graph.edges.items():
            for tip, root in ((edge.start, edge.end), (edge.end, edge.start)):
                if graph.degree(tip) == 1 and graph.degree(root) > 2 and graph.nodes[tip].is_free:
                    beyond = edge.length_m - float(edge.from_node(root).half_m[0])
                    if beyond < _SPUR_M:
                        spurs.append((beyond, number, root))
        removed = 0
        for _, number, root in sorted(spurs):
            if graph.degree(root) > 2:
                graph.remove_edge(number)
                removed += 1
        graph.drop_lonely()
        graph.smooth_all()
        if not removed:
            return


def _attach(graph: Graph, fused_xy: FloatArray) -> None:
    """Let the junctions of the skeleton be the fused intersections that they lie at."""
    known = {row for node in graph.nodes.values() for row in node.intersections}
    rows = [row for row in range(len(fused_xy)) if row not in known]
    if not rows:
        return
    groups = {row: list[int]() for row in rows}
    for number, node in graph.nodes.items():
        if node.is_free and graph.degree(number) > 2:
            distance = np.linalg.norm(fused_xy[rows] - node.xy, axis=1)
            if distance.min() < max(_REACH_M, _REACH_HALVES * node.half_m):
                groups[rows[int(distance.argmin())]].append(number)
    for row, group in groups.items():
        if group:
            half_m = max(graph.nodes[number].half_m for number in group)
            into = graph.add_node(Node(fused_xy[row], half_m, [row]))
            for number in group:
                graph.merge(number, into)
            _drop_loops(graph, into)
        else:
            _split_nearest(graph, fused_xy[row], row)


def _split_nearest(graph: Graph, xy: FloatArray, row: int) -> None:
    best, where = _REACH_M, (-1, -1)
    for number, edge in graph.edges.items():
        low, high = edge.xy.min(axis=0), edge.xy.max(axis=0)
        if np.any(xy < low - best) or np.any(xy > high + best):
            continue
        distance = np.linalg.norm(edge.xy - xy, axis=1)
        nearest = int(np.argmin(distance))
        if distance[nearest] < best:
            best, where = float(distance[nearest]), (number, nearest)
    if where[0] < 0:
        return
    edge = graph.edges[where[0]]
    if 0 < where[1] < len(edge.xy) - 1:
        graph.split(*where, Node(xy, float(edge.half_m[where[1]]), [row]))
        return
    end = graph.nodes[edge.start if where[1] == 0 else edge.end]
    if end.is_free:
        end.intersections.append(row)


def _drop_loops(graph: Graph, node: int) -> None:
    for number, edge in graph.arms(node):
        if number in graph.edges and edge.start == edge.end and edge.length_m < _LOOP_M:
            graph.remove_edge(number)


def _contract(graph: Graph) -> None:
    """Merge forks into the intersection, or the fork, that they are parts of."""
    while True:
        for number, edge in sorted(graph.edges.items(), key=lambda item: item[1].length_m):
            free = [n for n in (edge.start, edge.end) if graph.nodes[n].is_free and graph.degree(n) > 2]
            if edge.start == edge.end or not free:
                continue
            into = edge.other(free[0])
            is_fork = graph.nodes[into].is_free
            if edge.length_m < (_SHORT_M if is_fork else _FORK_M) and (not is_fork or graph.degree(into) > 2):
                graph.remove_edge(number)
                graph.merge(free[0], into)
                _drop_loops(graph, into)
                break
        else:
            return


def _part_levels(graph: Graph) -> None:
    """Where two straight roads cross and the method saw no intersection, one passes over the other: no node."""
    for number in [n for n, node in graph.nodes.items() if node.is_free and graph.degree(n) == 4]:
        for arm, edge in dict(graph.arms(number)).items():
            if edge.start == edge.end and len(edge.xy) > 2:  # both ends of a loop are arms, each of another road
                half = len(edge.xy) // 2
                graph.split(arm, half, Node(edge.xy[half], float(edge.half_m[half])))
        arms = graph.arms(number)
        ways = list(directions(arms, _NEAR_M, _FAR_M))
        for mate in (1, 2, 3):
            pair, others = (0, mate), [k for k in (1, 2, 3) if k != mate]
            if all(ways[a] @ ways[b] < -_STRAIGHT_COS for a, b in (pair, others)):
                for a, b in (pair, others):
                    (one, first), (two, second) = arms[a], arms[b]
                    if one == two:
                        continue
                    graph.remove_edge(one)
                    graph.remove_edge(two)
                    graph.add_edge(first.turned().then(second))
                break
    graph.smooth_all()
    graph.drop_lonely()


def _bridge_gaps(graph: Graph) -> None:
    """Join dead ends that face each other, or a node, across ground that was not seen."""
    tips = [n for n in graph.nodes if graph.degree(n) == 1 and graph.nodes[n].place is None]
    if not tips:
        return
    way = {n: -next(directions(graph.arms(n), 0.0, _FAR_M)) for n in tips}
    half_m = {n: float(np.median(graph.arms(n)[0][1].half_m)) for n in tips}
    goals = [n for n, node in graph.nodes.items() if not node.is_free or graph.degree(n) == 1]
    goals_xy, found = np.stack([graph.nodes[n].xy for n in goals]), []
    for tip in tips:
        root = graph.arms(tip)[0][1].end
        near = np.linalg.norm(goals_xy - graph.nodes[tip].xy, axis=1) <= _BRIDGED_M
        for goal in (goals[k] for k in np.flatnonzero(near)):
            step = graph.nodes[goal].xy - graph.nodes[tip].xy
            length = float(np.linalg.norm(step))
            if goal in {tip, root} or length < 1e-6 or (goal in way and goal < tip):
                continue
            # Of a road of which one end shows another flank than the other does the lines lie side by side.
            beside_m = half_m[tip] + half_m[goal] if goal in way and way[tip] @ way[goal] < -_BRIDGED_COS else 0.0
            if _faces(way[tip], step, beside_m) and (goal not in way or _faces(way[goal], -step, beside_m)):
                found.append((length, tip, goal))
    for _, tip, goal in sorted(found):
        if graph.degree(tip) == 1 and (graph.degree(goal) == 1 or not graph.nodes[goal].is_free):
            ends = np.stack([graph.nodes[tip].xy, graph.nodes[goal].xy])
            graph.add_edge(Edge(tip, goal, ends, np.full(2, half_m[tip]), np.zeros(2, np.bool_)))
    graph.smooth_all()


def _faces(way: FloatArray, step: FloatArray, beside_m: float) -> bool:
    """Return whether a step leads on in a direction, or no farther beside it."""
    along, beside = float(step @ way), abs(float(step[0] * way[1] - step[1] * way[0]))
    return along >= _BRIDGED_COS * math.hypot(along, beside) or (along > 0.0 and beside <= beside_m)


def strokes(graph: Graph) -> list[list[tuple[int, Edge]]]:
    """Return number and edge in chains that go straight on at nodes, each edge once, in the direction of its chain."""
    onward = _straight_on(graph)
    chains, used = [], set[int]()
    for number in graph.edges:
        if number in used:
            continue
        first, node = number, graph.edges[number].start
        visited = {number}
        while (first, node) in onward and onward[first, node] not in visited:  # back to where the chain begins
            first = onward[first, node]
            visited.add(first)
            node = graph.edges[first].other(node)
        chain: list[tuple[int, Edge]] = []
        here: int | None = first
        while here is not None and here not in used:
            used.add(here)
            edge = graph.edges[here].from_node(node)
            chain.append((here, edge))
            node = edge.end
            here = onward.get((here, node))
        chains.append(chain)
    return chains


def _straight_on(graph: Graph) -> dict[tuple[int, int], int]:
    """Return the edge that goes straight on, by edge and node."""
    onward = {}
    for node, what in graph.nodes.items():
        if what.place is not None:
            continue
        arms = [arm for arm in graph.arms(node) if arm[1].start != arm[1].end]  # a loop would lead on twice
        ways = list(directions(arms, _NEAR_M, _FAR_M))
        taken: set[int] = set()
        for cosine, a, b in sorted((float(ways[a] @ ways[b]), a, b) for a, b in combinations(range(len(arms)), 2)):
            if cosine < -_ONWARD_COS and not taken & {a, b} and arms[a][0] != arms[b][0]:
                taken |= {a, b}
                onward[arms[a][0], node], onward[arms[b][0], node] = arms[b][0], arms[a][0]
    return onward
