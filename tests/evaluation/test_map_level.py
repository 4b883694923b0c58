from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.evaluation.metrics import MapLevel, assign_intersections
from tests.evaluation.made import at, run


def assign(intersections: list[Any], nodes: list[Any], in_zone: list[bool]) -> MapLevel:
    made = run([(0, 0)], (), intersections)
    return assign_intersections(
        made.keyframes, made.intersections, at(nodes), np.array(in_zone, dtype=np.bool_), relevant_zone_m=40
    )


def test_one_node_is_claimed_once() -> None:
    level = assign([(1, 0), (2, 0)], [(0, 0)], [True])
    assert level.node.tolist() == [0, -1]
    assert (level.precision, level.recall) == (0.5, 1.0)
    assert level.errors_m == pytest.approx([1.0], abs=1e-3)


def test_outside_the_zones_nothing_is_punished() -> None:
    level = assign([(0, 0), (60, 0)], [(1, 0), (-60, 0)], [True, False])
    assert level.counts.tolist() == [True, False]
    assert (level.precision, level.recall) == (1.0, 1.0)


def test_an_intersection_in_the_zone_may_be_a_node_just_outside() -> None:
    level = assign([(19, 0)], [(21, 0)], [False])
    assert (level.precision, level.recall) == (1.0, None)


def test_an_empty_map_has_no_precision() -> None:
    level = assign([], [(0, 0)], [True])
    assert (level.precision, level.recall) == (None, 0.0)


spots = st.lists(st.tuples(st.floats(-12, 12), st.floats(-12, 12)), max_size=4)


@given(intersections=spots, nodes=spots)
def test_no_assignment_is_cheaper(intersections: list[Any], nodes: list[Any]) -> None:
    level = assign(intersections, nodes, [True] * len(nodes))
    taken = level.node[level.node >= 0]
    assert len(set(taken.tolist())) == len(taken)
    mine = float(level.errors_m.sum()) + 10.0 * int((level.node < 0).sum())
    # Every way to give each intersection another node, or none (the places past the end).
    places = np.full((len(intersections), len(nodes) + len(intersections)), 10.0)
    for i, a in enumerate(intersections):
        for j, b in enumerate(nodes):
            places[i, j] = min(10.0, float(np.hypot(a[0] - b[0], a[1] - b[1])))
    rows = range(len(intersections))
    best = min(sum(places[i, c[i]] for i in rows) for c in permutations(range(places.shape[1]), len(intersections)))
    assert mine == pytest.approx(best, abs=1e-3)
