"""Made-up towns, and the exact truth about them."""

from __future__ import annotations

import heapq
import tempfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import ConfigError
from interloc.files import atomic_write
from interloc.geometry import bearing_deg
from interloc.osm.container import SIMULATOR
from interloc.osm.intersections import DRIVABLE
from interloc.processes import Progress
from interloc.simulate.config import DEFAULT_OPTIONS, SceneConfig, SimulationOptions, TrackConfig
from interloc.simulate.drive import simulate_map
from interloc.simulate.local_frame import LocalFrame
from interloc.simulate.obstacles import Yard, made_up_houses
from interloc.simulate.osm_map import STREET_CLASSES, MapWay, StreetMap, is_oneway, street_map_of
from interloc.simulate.profiles import find_crossings, street_profiles, visible_lines
from interloc.simulate.quarter_plan import QUARTER
from interloc.simulate.town_plan import FULL, ORIGIN_LAT_DEG, ORIGIN_LON_DEG, PLAIN, PlannedStreet, TownPlan
from interloc.simulate.tracks import Track, track_from_line

Part = Literal["plain", "full", "quarter"]
PLANS: dict[Part, TownPlan] = {"plain": PLAIN, "full": FULL, "quarter": QUARTER}

MAP_FILE = "map.osm"
DRIVING_OFFSET_M = 1.6
_TURN_RADIUS_M = 4.0


@dataclass(frozen=True)
class Junction:
    """The truth about a junction of the town.

    Attributes
    ----------
    name, kind : str
        Name in the plan; T, X, Y, staggered, roundabout, dual or compound.
    node_id : int
        Id in the .osm file.
    lon_deg, lat_deg : float
        As written to the .osm file.
    x_m, y_m : float
        Metres east and north in `Town.frame`.
    bearings_deg : tuple of float
        Directions of its arms, clockwise from north, ascending.
    """

    name: str
    kind: str
    node_id: int
    lon_deg: float
    lat_deg: float
    x_m: float
    y_m: float
    bearings_deg: tuple[float, ...]


class Town:
    """A made-up town.

    Parameters
    ----------
    part
        "full": every shape of junction that matters, a route of some 5 km. "plain": its X, T and Y junctions of 45 to
        120 degrees, some 670 m. "quarter": a town as one knows them, with curved streets, market square and park,
        some 2 km.
    seed
        Decides the houses.
    houses
        False leaves the plots empty.
    """

    def __init__(self, part: Part = "full", *, seed: int = 0, houses: bool = True) -> None:
        if part not in PLANS:
            raise ConfigError(f"Part of the town: {part!r}. Expected one of {', '.join(PLANS)}.")
        self.plan = PLANS[part]
        self.frame = LocalFrame(ORIGIN_LAT_DEG, ORIGIN_LON_DEG)
        names = [name for street in self.plan.streets for name in street.nodes.split()]
        self.node_ids = {name: 1000 + i for i, name in enumerate(dict.fromkeys(names))}
        xy = np.array([self.plan.nodes[name] for name in self.node_ids], dtype=np.float64)
        # OSM has seven decimals, about a centimetre: the truth is what the file says.
        self._lonlat = dict(zip(self.node_ids, np.round(self.frame.lonlat(xy), 7), strict=True))
        self._xy = {name: self.frame.xy(place) for name, place in self._lonlat.items()}
        self.junctions = self._find_junctions()
        self._houses = self._build(seed) if houses else []

    def write_osm(self, path: Path) -> None:
        """Write the town as an OSM file.

        Raises
        ------
        OutputError
            It could not be written.
        """
        with atomic_write(Path(path)) as file:
            file.write(self.osm().encode())

    def osm(self) -> str:
        """Return the town as OSM XML: streets with their tags, houses, areas; the same text for the same seed."""
        nodes = [(self.node_ids[n], self._lonlat[n], n in self.plan.turning_circles) for n in self.node_ids]
        ways = [(way.nodes, way.tags) for way in self._ways()]
        outlines = [(xy, {"building": "yes"}) for xy in self._houses]
        outlines += [(np.array(area.outline, dtype=np.float64), area.tags) for area in self.plan.areas]
        next_id = 100_000
        for xy, tags in outlines:
            ids = list(range(next_id, next_id + len(xy)))
            nodes += [(i, p, False) for i, p in zip(ids, self.frame.lonlat(xy), strict=True)]
            ways.append(([*ids, ids[0]], tags))
            next_id += len(ids)
        low, high = np.min([p for _, p, _ in nodes], axis=0), np.max([p for _, p, _ in nodes], axis=0)
        lines = [
            "<?xml version='1.0' encoding='UTF-8'?>",
            f'<osm version="0.6" generator="{SIMULATOR}">',
            f' <bounds minlat="{low[1]:.7f}" minlon="{low[0]:.7f}" maxlat="{high[1]:.7f}" maxlon="{high[0]:.7f}"/>',
        ]
        for node_id, (lon, lat), circle in nodes:
            start = f' <node id="{node_id}" version="1" lat="{lat:.7f}" lon="{lon:.7f}"'
            lines.append(f'{start}><tag k="highway" v="turning_circle"/></node>' if circle else f"{start}/>")
        for number, (ids, tags) in enumerate(ways):
            lines.append(f' <way id="{10 + number}" version="1">')
            lines += [f'  <nd ref="{i}"/>' for i in ids]
            lines += [f"  <tag k={quoteattr(k)} v={quoteattr(v)}/>" for k, v in tags.items()]
            lines.append(" </way>")
        return "\n".join([*lines, "</osm>", ""])

    def route_names(self) -> list[str]:
        """Return the names of the nodes along the route, every node that it passes."""
        stops = self.plan.route.split()
        route = [stops[0]]
        for goal in stops[1:]:
            before = route[-2] if len(route) > 1 else None
            route += self._shortest(route[-1], goal, before)[1:]
        return route

    def track(self, config: TrackConfig | None = None) -> Track:
        """Return the drive through the town, on the right-hand side of its streets.

        Parameters
        ----------
        config
            Speed and so on; where it gives no offset, 1.6 m to the right of the centre line.
        """
        config = config or TrackConfig()
        if not config.offset_m:
            config = config.model_copy(update={"offset_m": DRIVING_OFFSET_M})
        points: list[FloatArray] = []
        names = self.route_names()
        for i, name in enumerate(names):
            if 0 < i < len(names) - 1 and names[i - 1] == names[i + 1]:
                points += self._turn(names[i - 1], name)
            else:
                points.append(np.array([*self._xy[name], self.plan.heights_above_ground.get(name, 0.0)]))
        line = np.array(points)
        fine = np.concatenate(
            [np.linspace(a, b, max(int(np.hypot(*(b - a)[:2]) / 5), 1), endpoint=False) for a, b in pairwise(line)]
            + [line[-1:]]
        )
        alt = 110.0 + hills_m(fine[:, :2]) + fine[:, 2]
        return track_from_line(self.frame.lonlat(fine[:, :2]), alt, config)

    def _ways(self) -> list[MapWay]:
        return [
            MapWay(
                10 + i,
                [self.node_ids[n] for n in street.nodes.split()],
                np.array([self._lonlat[n] for n in street.nodes.split()]),
                dict(street.tags),
            )
            for i, street in enumerate(self.plan.streets)
        ]

    def _find_junctions(self) -> list[Junction]:
        arms: dict[str, set[str]] = {}
        for street in self.plan.streets:
            if street.tags["highway"] not in DRIVABLE:
                continue
            names = street.nodes.split()
            for a, b in pairwise(names):
                arms.setdefault(a, set()).add(b)
                arms.setdefault(b, set()).add(a)
        result = []
        for name, others in arms.items():
            if len(others) < 3:
                continue
            towards = [self._xy[other] - self._xy[name] for other in others]
            bearings = sorted(float(bearing_deg(np.arctan2(d[1], d[0]))) for d in towards)
            lon, lat = self._lonlat[name]
            x, y = self._xy[name]
            result.append(
                Junction(
                    name,
                    self.plan.kinds[name],
                    self.node_ids[name],
                    float(lon),
                    float(lat),
                    float(x),
                    float(y),
                    tuple(bearings),
                )
            )
        return result

    def _build(self, seed: int) -> list[FloatArray]:
        """Return the outlines of made-up houses in the frame of the town."""
        street_map: StreetMap = street_map_of(self._ways(), self.frame)
        config = SceneConfig()
        profiles = street_profiles(street_map, config.streets, towns=True, seed=seed)
        lines = visible_lines(profiles, find_crossings(profiles), from_hidden=False)
        lots = [np.array(area.outline, dtype=np.float64) for area in self.plan.areas]
        yard = Yard(profiles, lines, np.concatenate(list(self._xy.values())).reshape(-1, 2), lots)
        return [xy[:-1] for xy, _ in made_up_houses(profiles, lines, config.roadside, yard, seed)]

    def _turn(self, before: str, name: str) -> list[FloatArray]:
        """Return a round about the end of a cul-de-sac, counter-clockwise."""
        centre = self._xy[name]
        back = self._xy[before] - centre
        start = np.arctan2(back[1], back[0]) + 0.9
        angles = start + np.linspace(0.0, 2 * np.pi - 1.8, 12)
        ring = centre + _TURN_RADIUS_M * np.column_stack([np.cos(angles), np.sin(angles)])
        return [np.array([*p, 0.0]) for p in ring]

    def _shortest(self, start: str, goal: str, before: str | None) -> list[str]:
        """Return the shortest path along the streets, one-way streets in their direction, without turning at once."""
        roads: dict[str, list[tuple[str, float]]] = {}
        for street in self.plan.streets:
            if street.tags["highway"] not in STREET_CLASSES:
                continue
            for a, b in _directed(street):
                roads.setdefault(a, []).append((b, float(np.hypot(*(self._xy[b] - self._xy[a])))))
        queue: list[tuple[float, list[str]]] = [(0.0, [start])]
        done: set[str] = set()
        while queue:
            length, path = heapq.heappop(queue)
            here = path[-1]
            if here == goal:
                return path
            if here in done:
                continue
            done.add(here)
            for there, step in roads.get(here, []):
                if not (here == start and there == before and here not in self.plan.turning_circles):
                    heapq.heappush(queue, (length + step, [*path, there]))
        raise ConfigError(f"The town has no path from {start} to {goal}.")


def hills_m(xy: FloatArray) -> FloatArray:
    """Return the height of the ground of the town at (N, 2) places: slopes of up to 3 per cent."""
    return 2.0 * np.sin(xy[..., 0] / 90.0) + 1.5 * np.cos(xy[..., 1] / 110.0)


def _directed(street: PlannedStreet) -> list[tuple[str, str]]:
    names = street.nodes.split()
    forward = list(pairwise(names))
    return forward if is_oneway(street.tags) else forward + [(b, a) for a, b in forward]


def simulate_town(
    out: Path,
    options: SimulationOptions = DEFAULT_OPTIONS,
    *,
    part: Part = "plain",
    track: TrackConfig | None = None,
    progress: Progress | None = None,
) -> int:
    """Simulate the drive through a made-up town; its map is written beside the scans as `map.osm`.

    Parameters
    ----------
    out, options, progress
        See `simulate_drive`.
    part
        See `Town`.
    track
        How it is driven.

    Returns
    -------
    int
        Scans written.

    Raises
    ------
    OutputError
        `out` could not be written.
    """
    town = Town(part, seed=options.seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / MAP_FILE
        town.write_osm(path)
        return simulate_map(
            town.track(track),
            path,
            out,
            options,
            extra_files={MAP_FILE: path.read_bytes()},
            about={"town": part},
            progress=progress,
        )
