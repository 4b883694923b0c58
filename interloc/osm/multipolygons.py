"""Areas of several ways: multipolygon relations put together to polygons with holes, for pictures only.

What somebody wrote into a map must not cost more than the map itself: every step is linear in the nodes, but for the
holes of a relation with several outlines, and both its ways and all nodes together are limited where they are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray

MAX_WAYS = 500
"""Ways of a relation; a building of more is left out. The largest have some dozens."""


@dataclass(frozen=True)
class Multipolygon:
    """A relation that is an area."""

    id: int
    """OSM relation id."""
    outer: tuple[int, ...]
    inner: tuple[int, ...]
    """OSM ids of the ways around it, and of those around its holes; each once."""

    @property
    def ways(self) -> tuple[int, ...]:
        """Ids of all its ways."""
        return (*self.outer, *self.inner)

    @classmethod
    def of(cls, relation_id: int, members: Iterable[tuple[int, str]]) -> Multipolygon | None:
        """Sort members, (way id, role); None where there is no outline, or more ways than `MAX_WAYS`."""
        roles = {way: role for way, role in members if role in {"outer", "inner", ""}}  # "" is outer, in old maps
        inner = tuple(way for way, role in roles.items() if role == "inner")
        outer = tuple(way for way, role in roles.items() if role != "inner")
        return cls(relation_id, outer, inner) if outer and len(roles) <= MAX_WAYS else None


def rings_of(ways: Sequence[Sequence[int]]) -> list[list[int]]:
    """Join ways, each its node ids in order, end to end to closed rings; empty where an end stays open."""
    at: dict[int, list[int]] = {}  # the ways that end at a node
    for number, way in enumerate(ways):
        if way[0] != way[-1]:
            for end in (way[0], way[-1]):
                at.setdefault(end, []).append(number)
    used: set[int] = set()
    rings = []
    for number, way in enumerate(ways):
        if number in used:
            continue
        used.add(number)
        ring = list(way)
        while ring[0] != ring[-1]:
            candidates = at[ring[-1]]
            while candidates and candidates[-1] in used:
                candidates.pop()
            if not candidates:
                return []
            used.add(candidates[-1])
            following = ways[candidates[-1]]
            ring.extend(following[1:] if following[0] == ring[-1] else following[-2::-1])
        if len(ring) >= 4:
            rings.append(ring)
    return rings


def holes_of(outer: Sequence[FloatArray], inner: Sequence[FloatArray]) -> list[tuple[FloatArray, ...]]:
    """Return the holes of each outline: the inner rings, (n, 2) float64, that lie in it."""
    if len(outer) == 1 or not inner:
        return [tuple(inner)] * len(outer)
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    areas = np.array([shapely.Polygon(ring) for ring in outer])
    shapely.prepare(areas)
    x, y = np.array([(ring[0] + ring[1]) / 2 for ring in inner]).T  # rings may share a corner, but no edge
    inside = shapely.contains_xy(areas[:, None], x, y)
    return [tuple(inner[number] for number in np.flatnonzero(row).tolist()) for row in inside]
