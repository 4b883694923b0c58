"""How wide a street is and what belongs to it, by class and tags."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from interloc.simulate.config import StreetConfig


class StreetClass(NamedTuple):
    """Defaults of a highway class.

    Attributes
    ----------
    width_m
        Road surface of a two-way street, kerb to kerb.
    oneway_lanes
        Lanes of a one-way carriageway without `lanes`.
    corner_radius_m
        Radius of the kerb where such a street joins a larger one.
    sidewalk, parking
        Whether sidewalks and cars at the kerb are usual in a town.
    marked
        Whether the lanes are marked.
    """

    width_m: float
    oneway_lanes: int
    corner_radius_m: float
    sidewalk: bool
    parking: bool
    marked: bool


STREET_CLASSES: dict[str, StreetClass] = {
    "motorway": StreetClass(15.0, 3, 12.0, False, False, True),
    "trunk": StreetClass(11.0, 2, 12.0, False, False, True),
    "primary": StreetClass(10.0, 2, 9.0, True, False, True),
    "secondary": StreetClass(8.5, 2, 8.0, True, False, True),
    "tertiary": StreetClass(7.5, 1, 7.0, True, True, True),
    "motorway_link": StreetClass(7.0, 1, 12.0, False, False, True),
    "trunk_link": StreetClass(7.0, 1, 10.0, False, False, True),
    "primary_link": StreetClass(6.5, 1, 8.0, True, False, False),
    "secondary_link": StreetClass(6.5, 1, 8.0, True, False, False),
    "tertiary_link": StreetClass(6.5, 1, 7.0, True, False, False),
    "unclassified": StreetClass(6.5, 1, 6.0, True, False, False),
    "residential": StreetClass(6.5, 1, 5.5, True, True, False),
    "living_street": StreetClass(5.5, 1, 4.0, False, True, False),
    "road": StreetClass(6.5, 1, 6.0, True, False, False),
    "service": StreetClass(4.0, 1, 3.0, False, False, False),
}
"""Highways that a car drives on. Footways, paths and tracks are none."""

YARD_SERVICES = {"driveway", "parking_aisle", "drive-through"}
"""`service=` ways that count as parking: SemanticKITTI labels private drives and the lanes of car parks so."""

_LANE_M = 3.25
_ONEWAY_LANE_M = 3.5


def road_width_m(tags: Mapping[str, str], config: StreetConfig) -> float:
    """Return the width of the road surface of a driven way, kerb to kerb.

    `width` counts if plausible; then `lanes`; then the class. A one-way carriageway has 3.5 m a lane and, with a
    single lane, room to pass a stopped car (5 m in all).
    """
    kind = tags["highway"]
    street = STREET_CLASSES[kind]
    oneway = is_oneway(tags)
    tagged = _number(tags.get("width")) if config.use_width_tags else None
    lanes = _number(tags.get("lanes")) if config.use_width_tags else None
    if tagged is not None and 2.5 <= tagged <= 30:
        return tagged
    if kind == "service":
        return config.width_factor * (3.5 if tags.get("service") in YARD_SERVICES else street.width_m)
    if oneway:
        count = lanes if lanes is not None and 1 <= lanes <= 6 else street.oneway_lanes
        return config.width_factor * max(count * _ONEWAY_LANE_M, 5.0)
    if lanes is not None and 1 <= lanes <= 8:
        if lanes <= 2:
            return config.width_factor * (street.width_m if lanes == 2 else min(street.width_m, 4.5))
        return config.width_factor * max(lanes * _LANE_M, street.width_m)
    return config.width_factor * street.width_m


def is_oneway(tags: Mapping[str, str]) -> bool:
    """Tell whether a way is one carriageway for one direction."""
    value = tags.get("oneway")
    if value is None:
        return tags.get("junction") in {"roundabout", "circular"} or tags.get("highway") == "motorway"
    return value in {"yes", "true", "1", "-1"}


def level_of(tags: Mapping[str, str]) -> int:
    """Return the vertical order of a way: `layer`, else 1 for a bridge and -1 for a tunnel."""
    layer = _number(tags.get("layer"))
    if layer is not None:
        return int(layer)
    if tags.get("bridge", "no") != "no":
        return 1
    return -1 if tags.get("tunnel", "no") not in {"no", "building_passage"} else 0


def sidewalk_sides(tags: Mapping[str, str]) -> tuple[bool, bool]:
    """Return whether a street has a sidewalk to the left and to the right of its direction."""
    value = tags.get("sidewalk")
    if value is None:
        usual = STREET_CLASSES[tags["highway"]].sidewalk
        return usual, usual
    return value in {"left", "both", "yes"}, value in {"right", "both", "yes"}


def _number(text: str | None) -> float | None:
    match = re.match(r"\s*(-?\d+(?:\.\d+)?)\s*(?:m|$)", text or "")
    return float(match.group(1)) if match else None
