"""The cross-section of every street: road surface, bays, sidewalks, and where streets pass over each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from interloc.arrays import FloatArray
from interloc.simulate.config import StreetConfig
from interloc.simulate.osm_map import (
    STREET_CLASSES,
    YARD_SERVICES,
    Street,
    StreetClass,
    StreetMap,
    is_oneway,
    road_width_m,
    sidewalk_sides,
)

URBAN_DISTANCE_M = 45.0
TWIN_DISTANCE_M = 25.0
CLEARANCE_M = 25.0


@dataclass(frozen=True)
class Profile:
    """Cross-section of a street, metres; left and right of the direction of its way."""

    street: Street
    line: LineString
    """Centre line in M."""
    half_m: float
    """Half the width of the road surface."""
    bay_left_m: float
    bay_right_m: float
    """Marked parking at the kerb; 0 where there is none."""
    walk_left_m: float
    walk_right_m: float
    """Sidewalks beyond; 0 where there is none."""
    median_left: bool
    """The left side belongs to the other carriageway or to the island of a roundabout."""
    oneway: bool
    urban: bool

    @property
    def kind(self) -> StreetClass:
        """Its class."""
        return STREET_CLASSES[self.street.tags["highway"]]

    @property
    def is_yard(self) -> bool:
        """True for private drives and lanes of car parks (label parking)."""
        return self.street.tags.get("service") in YARD_SERVICES

    @property
    def is_service(self) -> bool:
        """True for service ways of any kind."""
        return self.street.tags["highway"] == "service"

    def edge_m(self, *, left: bool) -> float:
        """Distance of the back edge of the sidewalk from the centre line."""
        if left:
            return self.half_m + self.bay_left_m + self.walk_left_m
        return self.half_m + self.bay_right_m + self.walk_right_m


@dataclass(frozen=True)
class Crossing:
    """A place where one street passes over another."""

    x_m: float
    y_m: float
    shown: int
    hidden: int
    """Indices of the streets; a vehicle on the ground sees `shown`: the lower of two, unless that is a tunnel."""

    @property
    def clearing(self) -> BaseGeometry:
        """The neighbourhood in which only one of the two exists."""
        return Point(self.x_m, self.y_m).buffer(CLEARANCE_M)


def street_profiles(street_map: StreetMap, config: StreetConfig, *, towns: bool, seed: int) -> list[Profile]:
    """Decide the cross-section of every street.

    Parameters
    ----------
    street_map, config
    towns
        True: every street runs through a town (no buildings are known, or they are made up along the streets).
        False: those near buildings of the map.
    seed
        Chooses the streets with marked bays.
    """
    lines = [LineString(s.xy) for s in street_map.streets]
    tree = shapely.STRtree(lines)
    centres = shapely.STRtree([Point(xy.mean(axis=0)) for _, xy in street_map.buildings])
    return [
        _profile(
            street,
            line,
            config,
            urban=towns or len(centres.query(line, predicate="dwithin", distance=URBAN_DISTANCE_M)) >= 2,
            median_left=_median_left(street, line, street_map.streets, tree),
            draw=np.random.default_rng([seed, street.way_id & 0x7FFFFFFF, 1]).random(2),
        )
        for street, line in zip(street_map.streets, lines, strict=True)
    ]


def _profile(
    street: Street,
    line: LineString,
    config: StreetConfig,
    *,
    urban: bool,
    median_left: bool,
    draw: FloatArray,
) -> Profile:
    kind = STREET_CLASSES[street.tags["highway"]]
    half = road_width_m(street.tags, config) / 2
    left, right = sidewalk_sides(street.tags) if config.sidewalks else (False, False)
    if "sidewalk" not in street.tags and not urban:
        left = right = False
    bays = urban and kind.parking and kind.sidewalk and not kind.marked and draw[0] < config.parking_bay_share
    bay_left = config.parking_bay_width_m if bays and draw[1] < 0.6 else 0.0
    bay_right = config.parking_bay_width_m if bays and draw[1] > 0.3 else 0.0
    walk = config.sidewalk_width_m
    return Profile(
        street=street,
        line=line,
        half_m=min(half, 2.75) if bays else half,
        bay_left_m=bay_left,
        bay_right_m=bay_right,
        walk_left_m=walk if left and not median_left else 0.0,
        walk_right_m=walk if right else 0.0,
        median_left=median_left,
        oneway=is_oneway(street.tags),
        urban=urban,
    )


def _median_left(street: Street, line: LineString, streets: Sequence[Street], tree: shapely.STRtree) -> bool:
    """Tell whether the other carriageway of the same road, or the island of a roundabout, lies to the left."""
    if street.tags.get("junction") in {"roundabout", "circular"}:
        return True
    if not is_oneway(street.tags) or street.tags["highway"] in {"residential", "service", "living_street"}:
        return False
    middle = np.array(line.interpolate(0.5, normalized=True).coords[0])
    ahead = np.array(line.interpolate(min(0.5 + 1.0 / line.length, 1.0), normalized=True).coords[0])
    direction = (ahead - middle) / max(float(np.linalg.norm(ahead - middle)), 1e-9)
    probe = LineString([middle, middle + TWIN_DISTANCE_M * np.array([-direction[1], direction[0]])])
    for i in tree.query(probe, predicate="intersects"):
        other = streets[int(i)]
        if other is street or not is_oneway(other.tags) or other.tags["highway"] != street.tags["highway"]:
            continue
        along = other.xy[-1] - other.xy[0]
        if along @ direction < -0.7 * float(np.linalg.norm(along)):
            return True
    return False


def find_crossings(profiles: Sequence[Profile]) -> list[Crossing]:
    """Find the streets that pass over or under another one, without a node in common."""
    tree = shapely.STRtree([p.line for p in profiles])
    crossings = []
    for i, profile in enumerate(profiles):
        for j in map(int, tree.query(profile.line, predicate="intersects")):
            other = profiles[j]
            low, high = profile.street.level, other.street.level
            if low >= high or set(profile.street.nodes) & set(other.street.nodes):
                continue
            place = shapely.centroid(profile.line.intersection(other.line))
            shown, hidden = (i, j) if low >= 0 else (j, i)
            crossings.append(Crossing(place.x, place.y, shown, hidden))
    return crossings


def visible_lines(
    profiles: Sequence[Profile], crossings: Sequence[Crossing], *, from_hidden: bool
) -> list[BaseGeometry]:
    """Return the part of each centre line that exists for a vehicle on the usual level, or on the hidden one.

    Where streets cross on two levels, the other street and those that it continues into end before the crossing.
    """
    lines: list[BaseGeometry] = [p.line for p in profiles]
    for crossing in crossings:
        kept, gone = crossing.shown, crossing.hidden
        if from_hidden:
            kept, gone = gone, kept
        ends = {profiles[gone].street.nodes[0], profiles[gone].street.nodes[-1]}
        stays = {profiles[kept].street.nodes[0], profiles[kept].street.nodes[-1]}
        for i, profile in enumerate(profiles):
            own = {profile.street.nodes[0], profile.street.nodes[-1]}
            if i == gone or (own & ends and not own & stays and i != kept):
                lines[i] = lines[i].difference(crossing.clearing)
    return lines
