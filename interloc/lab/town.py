"""Made-up towns, whose maps are their truth."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import ConfigError
from interloc.lab.config import StreetConfig, TrackConfig
from interloc.lab.drive import Trip
from interloc.lab.scene import Yard, made_up_houses
from interloc.lab.streets import (
    STREET_CLASSES,
    MapData,
    MapWay,
    find_crossings,
    is_oneway,
    read_ways,
    shortest_path,
    street_map_of,
    street_profiles,
    visible_lines,
)
from interloc.lab.tracks import LidarTrack, LocalFrame, track_from_line
from interloc.osm.untrusted import SIMULATOR

Part = Literal["plain", "full", "quarter"]

ROUTES: dict[Part, str] = {
    "plain": "west X60 Y acute X62 X60 X60s",
    "full": (
        "west X60 Y acute X62 X60 X60s ring0 stagS round8 split dualS1 merge east3 T500 dualN2 split round0 round4 "
        "compW compE T430 dualN1 split round0 round12 sac round12 round8 stagS southwest ramp1 southeast dualS1 T430 "
        "compE compW curve1 acute Y stagN X70 ring0 X60s X60 X62 X62w"
    ),
    "quarter": (
        "mainW slip brook2 bridge marketS marketN churchN churchS ringW ring2 ringN garden parkE parkS school mill "
        "brook4 brookE ringE school marketS churchS"
    ),
}
"""Nodes by their `town:name`; the drive takes the shortest path from each to the next."""

ORIGIN_LAT_DEG, ORIGIN_LON_DEG = 49.02, 8.42
MAP_FILE = "map.osm"
DRIVING_OFFSET_M = 1.6
_TURN_RADIUS_M = 4.0
_OWN_TAGS = "town:"  # explained in town.osm


class Town:
    """A made-up town; the seed decides its houses.

    Part "full" has every shape of junction that matters, a route of some 5 km; "plain" its X, T and Y junctions of 45
    to 120 degrees, some 640 m; "quarter" is a town as one knows them, with curved streets, market square and park, some
    2 km.
    """

    def __init__(self, part: Part = "full", *, seed: int = 0) -> None:
        if part not in ROUTES:
            raise ConfigError(f"Part of the town: {part!r}. Expected one of {', '.join(ROUTES)}.")
        self.part = part
        self.frame = LocalFrame(ORIGIN_LAT_DEG, ORIGIN_LON_DEG)
        ways, self._node_tags = read_ways(Path(__file__).with_name("quarter.osm" if part == "quarter" else "town.osm"))
        self._streets = [
            way for way in ways if "highway" in way.tags and (part != "plain" or way.tags.get("town:part") == part)
        ]
        self._areas = [way for way in ways if "highway" not in way.tags and part != "plain"]
        self._lonlat = {node: place for way in self._streets for node, place in zip(way.nodes, way.lonlat, strict=True)}
        self._xy = {node: self.frame.xy(place) for node, place in self._lonlat.items()}
        street_map = street_map_of(MapData(Path(MAP_FILE), self._streets), self.frame)
        profiles = street_profiles(street_map, StreetConfig(), towns=True, seed=seed)
        lines = visible_lines(profiles, find_crossings(profiles), from_hidden=False)
        lots = [self.frame.xy(area.lonlat) for area in self._areas]
        yard = Yard(profiles, lines, np.concatenate(list(self._xy.values())).reshape(-1, 2), lots)
        self._houses = [xy[:-1] for xy, _ in made_up_houses(profiles, lines, yard, seed)]

    def map_data(self) -> MapData:
        """Return the streets with their tags, the houses and the areas."""
        outlines = [(self.frame.lonlat(xy), {"building": "yes"}) for xy in self._houses]
        outlines += [(area.lonlat[:-1], area.tags) for area in self._areas]
        ways = [replace(way, tags=_without_own(way.tags)) for way in self._streets]
        next_id = 100_000
        for lonlat, tags in outlines:
            ids = list(range(next_id, next_id + len(lonlat)))
            # OSM has seven decimals, about a centimetre: what is driven through is what the file says.
            ways.append(MapWay(10 + len(ways), [*ids, ids[0]], np.round(lonlat[[*range(len(ids)), 0]], 7), tags))
            next_id += len(ids)
        return MapData(Path(MAP_FILE), ways, node_tags={n: _without_own(tags) for n, tags in self._node_tags.items()})

    def osm(self) -> str:
        """Return the town as OSM XML: streets with their tags, houses, areas; the same text for the same seed."""
        data = self.map_data()
        nodes = {n: place for way in data.ways for n, place in zip(way.nodes, way.lonlat, strict=True)}
        low, high = np.min(list(nodes.values()), axis=0), np.max(list(nodes.values()), axis=0)
        lines = [
            "<?xml version='1.0' encoding='UTF-8'?>",
            f'<osm version="0.6" generator="{SIMULATOR}">',
            f' <bounds minlat="{low[1]:.7f}" minlon="{low[0]:.7f}" maxlat="{high[1]:.7f}" maxlon="{high[0]:.7f}"/>',
        ]
        for node, (lon, lat) in nodes.items():
            start = f' <node id="{node}" version="1" lat="{lat:.7f}" lon="{lon:.7f}"'
            tags = "".join(_tag_lines(data.node_tags.get(node, {})))
            lines.append(f"{start}>{tags}</node>" if tags else f"{start}/>")
        for way in data.ways:
            lines.append(f' <way id="{way.way_id}" version="1">')
            lines += [f'  <nd ref="{node}"/>' for node in way.nodes]
            lines += [f"  {line}" for line in _tag_lines(way.tags)]
            lines.append(" </way>")
        return "\n".join([*lines, "</osm>", ""])

    def trip(self, config: TrackConfig | None = None) -> Trip:
        """Return the drive through the town, to be simulated; its map will lie beside the scans as `map.osm`."""
        about: dict[str, object] = {"town": self.part}
        return Trip(self.track(config), self.map_data(), about, {MAP_FILE: self.osm().encode()})

    def route(self) -> list[int]:
        """Return the ids of the nodes along the route, every node that it passes."""
        named = {tags["town:name"]: node for node, tags in self._node_tags.items() if "town:name" in tags}
        stops = [named[name] for name in ROUTES[self.part].split()]
        route = [stops[0]]
        for goal in stops[1:]:
            before = route[-2] if len(route) > 1 else None
            route += self._shortest(route[-1], goal, before)[1:]
        return route

    def track(self, config: TrackConfig | None = None) -> LidarTrack:
        """Return the drive through the town, on the right-hand side of its streets.

        Where the configuration gives no offset, 1.6 m to the right of the centre line.
        """
        config = config or TrackConfig()
        if not config.offset_m:
            config = replace(config, offset_m=DRIVING_OFFSET_M)
        points: list[FloatArray] = []
        nodes = self.route()
        for i, node in enumerate(nodes):
            if 0 < i < len(nodes) - 1 and nodes[i - 1] == nodes[i + 1]:
                points += self._turn(nodes[i - 1], node)
            else:
                height_m = float(self._node_tags.get(node, {}).get("town:height", 0.0))
                points.append(np.array([*self._xy[node], height_m]))
        line = np.array(points)
        fine = np.concatenate(
            [np.linspace(a, b, max(int(np.hypot(*(b - a)[:2]) / 5), 1), endpoint=False) for a, b in pairwise(line)]
            + [line[-1:]]
        )
        x, y = fine[:, 0], fine[:, 1]
        hills = 2.0 * np.sin(x / 90.0) + 1.5 * np.cos(y / 110.0)  # slopes of up to 3 per cent
        alt = 110.0 + hills + fine[:, 2]
        return track_from_line(self.frame.lonlat(fine[:, :2]), alt, config)

    def _turn(self, before: int, node: int) -> list[FloatArray]:
        """Return a round about the end of a cul-de-sac, counter-clockwise."""
        centre = self._xy[node]
        back = self._xy[before] - centre
        start = np.arctan2(back[1], back[0]) + 0.9
        angles = start + np.linspace(0.0, 2 * np.pi - 1.8, 12)
        ring = centre + _TURN_RADIUS_M * np.column_stack([np.cos(angles), np.sin(angles)])
        return [np.array([*p, 0.0]) for p in ring]

    def _shortest(self, start: int, goal: int, before: int | None) -> list[int]:
        """Return the shortest path along the streets, one-way streets in their direction, without turning at once."""
        roads: dict[int, list[tuple[int, float]]] = {}
        for street in self._streets:
            if street.tags["highway"] not in STREET_CLASSES:
                continue
            forward = list(pairwise(street.nodes))
            for a, b in forward if is_oneway(street.tags) else forward + [(b, a) for a, b in forward]:
                roads.setdefault(a, []).append((b, float(np.hypot(*(self._xy[b] - self._xy[a])))))
        if before is not None and self._node_tags.get(start, {}).get("highway") != "turning_circle":
            roads[start] = [step for step in roads[start] if step[0] != before]
        path = shortest_path(roads, start, goal)
        if path is None:
            raise ConfigError(f"The town has no path from {start} to {goal}.")
        return path


def _without_own(tags: dict[str, str]) -> dict[str, str]:
    return {key: value for key, value in tags.items() if not key.startswith(_OWN_TAGS)}


def _tag_lines(tags: dict[str, str]) -> list[str]:
    return [f"<tag k={quoteattr(key)} v={quoteattr(value)}/>" for key, value in tags.items()]
