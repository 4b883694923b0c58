"""Plans of made-up towns, and one with every shape of junction that matters. Metres east and north of the origin."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

ORIGIN_LAT_DEG = 49.02
ORIGIN_LON_DEG = 8.42

Place = tuple[float, float]


class PlannedStreet(NamedTuple):
    """A street of a plan: names of nodes, separated by blanks, and OSM tags."""

    nodes: str
    tags: dict[str, str]


class PlannedArea(NamedTuple):
    """An outline without streets and made-up houses (car park, park, church), and its OSM tags."""

    outline: list[Place]
    tags: dict[str, str]


@dataclass(frozen=True)
class TownPlan:
    """Where the streets of a town run, and the way through it.

    Attributes
    ----------
    nodes : dict
        Place of every node of a street, by name.
    streets : list of PlannedStreet
    kinds : dict
        What every junction is, by name: T, X, Y, staggered, roundabout, dual or compound.
    route : str
        Names of nodes, separated by blanks; the drive takes the shortest path from each to the next.
    areas : list of PlannedArea
    turning_circles : tuple of str
        Dead ends at which the vehicle can turn.
    heights_above_ground : dict
        Height of nodes on bridges and ramps, metres.
    """

    nodes: dict[str, Place]
    streets: list[PlannedStreet]
    kinds: dict[str, str]
    route: str
    areas: list[PlannedArea] = field(default_factory=list)
    turning_circles: tuple[str, ...] = ()
    heights_above_ground: dict[str, float] = field(default_factory=dict)


_RESIDENTIAL = {"highway": "residential"}
_TERTIARY = {"highway": "tertiary"}
_SECONDARY = {"highway": "secondary"}
_DUAL = {"highway": "primary", "oneway": "yes", "lanes": "2"}

_NODES: dict[str, Place] = {
    # The plain part: a 45-degree T, a 60-degree X, a Y, an acute T, another oblique X.
    "west": (-130, 0),
    "T45": (-65, 0),
    "T45s": (-140, -75),
    "X60": (0, 0),
    "Y": (100, 0),
    "acute": (155, 86),
    "X62": (52, 90),
    "X62n": (97, 168),
    "X62w": (-58, 100),
    "X60s": (-52, -90),
    # A curve leads south and becomes the ring.
    "bend1": (-66, -120),
    "bend2": (-64, -148),
    "bend3": (-44, -170),
    "ring0": (-5, -180),
    "X70": (75, -180),
    "X70n": (98, -117),
    "X70s": (48, -254),
    "close1": (-30, -250),
    "drive1": (15, -180),
    "drive1n": (15, -160),
    "drive2": (40, -180),
    "drive2s": (40, -199),
    # A staggered pair, 20 m apart.
    "stagN": (150, -180),
    "stagN1": (150, -85),
    "stagS": (170, -180),
    "carpark": (170, -232),
    "southwest": (170, -290),
    # The dual carriageway: one full crossing, one T with an opening in the median.
    "split": (352, -180),
    "dualN0": (385, -173),
    "dualS0": (385, -187),
    "dualN1": (430, -173),
    "dualS1": (430, -187),
    "dualN2": (510, -173),
    "dualS2": (510, -187),
    "dualN3": (565, -173),
    "dualS3": (565, -187),
    "merge": (598, -180),
    "east1": (640, -172),
    "east2": (662, -140),
    "east3": (650, -70),
    "east4": (600, -32),
    "T500": (508, -20),
    "T430": (428, -14),
    "southeast": (430, -290),
    # The compound junction: two nodes 19 m apart with five more arms.
    "compE": (318, -8),
    "compW": (300, -15),
    "compN": (342, 92),
    "curve1": (205, 117),
    "curve2": (258, 108),
    "curve3": (288, 60),
    # The bridge over the road to the cul-de-sac.
    "ramp1": (240, -290),
    "bridgeW": (284, -290),
    "bridgeE": (316, -290),
    "ramp2": (360, -290),
    "sac": (300, -392),
    # The car park.
    "lot1": (142, -232),
    "lot1n": (142, -212),
    "lot1s": (142, -262),
    "lot2": (118, -232),
    "lot2n": (118, -212),
    "lot2s": (118, -262),
}

_ROUNDABOUT_CENTRE = (300.0, -180.0)
_ROUNDABOUT_RADIUS_M = 15.0
_NODES |= {
    f"round{k}": (
        _ROUNDABOUT_CENTRE[0] + _ROUNDABOUT_RADIUS_M * math.cos(k * math.pi / 8),
        _ROUNDABOUT_CENTRE[1] + _ROUNDABOUT_RADIUS_M * math.sin(k * math.pi / 8),
    )
    for k in range(16)
}

_PLAIN_STREETS = [
    PlannedStreet("west T45 X60 Y", _RESIDENTIAL),
    PlannedStreet("T45 T45s", _RESIDENTIAL),
    PlannedStreet("X60s X60 X62 X62n", _RESIDENTIAL),
    PlannedStreet("Y acute", _RESIDENTIAL),
    PlannedStreet("Y stagN1", _RESIDENTIAL),
    PlannedStreet("X62w X62 acute", _RESIDENTIAL),
    PlannedStreet("acute curve1", _RESIDENTIAL),
]
_STREETS = [
    *_PLAIN_STREETS,
    PlannedStreet("X60s bend1 bend2 bend3 ring0", _RESIDENTIAL),
    PlannedStreet("ring0 drive1 drive2 X70 stagN stagS round8", _TERTIARY),
    PlannedStreet("X70n X70 X70s close1", _RESIDENTIAL),
    PlannedStreet("drive1 drive1n", {"highway": "service", "service": "driveway"}),
    PlannedStreet("drive2 drive2s", {"highway": "service", "service": "driveway"}),
    PlannedStreet("stagN1 stagN", _RESIDENTIAL),
    PlannedStreet("stagS carpark southwest", _RESIDENTIAL),
    PlannedStreet(" ".join(f"round{k % 16}" for k in range(17)), {"highway": "tertiary", "junction": "roundabout"}),
    PlannedStreet("round0 split", {"highway": "primary"}),
    PlannedStreet("split dualS0 dualS1 dualS2 dualS3 merge", _DUAL),
    PlannedStreet("merge dualN3 dualN2 dualN1 dualN0 split", _DUAL),
    PlannedStreet("merge east1 east2 east3 east4 T500 T430 compE", _SECONDARY),
    PlannedStreet("T430 dualN1 dualS1 southeast", _RESIDENTIAL),
    PlannedStreet("T500 dualN2 dualS2", _RESIDENTIAL),
    PlannedStreet("compE compW", _SECONDARY),
    PlannedStreet("compE compN", _RESIDENTIAL),
    PlannedStreet("round4 compW", _TERTIARY),
    PlannedStreet("curve1 curve2 curve3 compW", _RESIDENTIAL),
    PlannedStreet("round12 sac", _RESIDENTIAL),
    PlannedStreet("southwest ramp1 bridgeW", _RESIDENTIAL),
    PlannedStreet("bridgeW bridgeE", {**_RESIDENTIAL, "bridge": "yes", "layer": "1"}),
    PlannedStreet("bridgeE ramp2 southeast", _RESIDENTIAL),
    PlannedStreet("carpark lot1 lot2", {"highway": "service"}),
    PlannedStreet("lot1n lot1 lot1s", {"highway": "service", "service": "parking_aisle"}),
    PlannedStreet("lot2n lot2 lot2s", {"highway": "service", "service": "parking_aisle"}),
]

_CAR_PARK: list[Place] = [(104, -266), (156, -266), (156, -208), (104, -208)]
_BRIDGE_M = 6.0

_KINDS: dict[str, str] = {
    "T45": "T",
    "X60": "X",
    "Y": "Y",
    "acute": "T",
    "X62": "X",
    "X70": "X",
    "stagN": "staggered",
    "stagS": "staggered",
    "split": "dual",
    "merge": "dual",
    "dualN1": "dual",
    "dualS1": "dual",
    "dualN2": "dual",
    "dualS2": "dual",
    "compE": "compound",
    "compW": "compound",
    "T430": "T",
    "T500": "T",
    "round0": "roundabout",
    "round4": "roundabout",
    "round8": "roundabout",
    "round12": "roundabout",
}

PLAIN = TownPlan(_NODES, _PLAIN_STREETS, _KINDS, route="west X60 Y acute X62 X60 X60s")

FULL = TownPlan(
    _NODES,
    _STREETS,
    _KINDS,
    route=(
        "west X60 Y acute X62 X60 X60s ring0 stagS round8 split dualS1 merge east3 T500 dualN2 split round0 round4 "
        "compW compE T430 dualN1 split round0 round12 sac round12 round8 stagS southwest ramp1 southeast dualS1 T430 "
        "compE compW curve1 acute Y stagN X70 ring0 X60s X60 X62 X62w"
    ),
    areas=[PlannedArea(_CAR_PARK, {"amenity": "parking"})],
    turning_circles=("sac", "close1"),
    heights_above_ground={"bridgeW": _BRIDGE_M, "bridgeE": _BRIDGE_M, "ramp1": 2.7, "ramp2": 2.7},
)
