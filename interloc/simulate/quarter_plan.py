"""A plan that looks like a town: curved streets, market square, park. Metres east and north of the origin."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from interloc.simulate.town_plan import Place, PlannedArea, PlannedStreet, TownPlan

_STEP_M = 9.0  # between the nodes of a curve

_NODES: dict[str, Place] = {
    # The main street, from the west to the east.
    "mainW": (-330, -72),
    "slip": (-243, -46),
    "ringW": (-176, -8),
    "churchS": (-92, 6),
    "marketS": (0, 0),
    "school": (98, -14),
    "ringE": (192, 4),
    "brookE": (252, 40),
    "mainE": (318, 92),
    # The ring, north of it.
    "ring1": (-192, 62),
    "ring2": (-158, 124),
    "ringN": (-84, 152),
    "ring3": (10, 152),
    "garden": (92, 144),
    "ring4": (150, 112),
    "parkE": (176, 62),
    # The market square, and the streets that lead away from it.
    "churchN": (-88, 74),
    "marketN": (2, 70),
    "parkS": (92, 56),
    # Along the brook, south of the main street.
    "brook1": (-190, -62),
    "brook2": (-140, -98),
    "brook3": (-72, -92),
    "bridge": (4, -98),
    "mill": (98, -112),
    "brook4": (180, -92),
    "brook5": (232, -34),
    # Streets around it that are not driven.
    "hillW": (-212, 206),
    "hill1": (-104, 232),
    "hill2": (110, 226),
    "hillE": (214, 178),
    "bankW": (-104, -172),
    "bank1": (10, -180),
    "bank2": (112, -190),
    "bankE": (236, -158),
    # Footpaths through the park and over the square.
    "path1": (30, 100),
    "path2": (72, 112),
    "path3": (120, 90),
    "square1": (-30, 52),
}


def _curve(*names: str) -> str:
    """Lead a street smoothly through nodes; more nodes are made in between, and all their names returned in order."""
    points = np.array([_NODES[name] for name in names], dtype=np.float64)
    padded = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    result = [names[0]]
    for i, (start, end) in enumerate(pairwise(names)):
        before, a, b, after = padded[i : i + 4]
        count = max(round(float(np.hypot(*(b - a))) / _STEP_M), 1)
        for k in range(1, count):
            t = k / count  # Catmull-Rom
            place = (
                (2 * t**3 - 3 * t**2 + 1) * a
                + (t**3 - 2 * t**2 + t) * (b - before) / 2
                + (3 * t**2 - 2 * t**3) * b
                + (t**3 - t**2) * (after - a) / 2
            )
            name = f"{start}-{end}{k}"
            _NODES[name] = (round(float(place[0]), 2), round(float(place[1]), 2))
            result.append(name)
        result.append(end)
    return " ".join(result)


def _street(name: str, highway: str = "residential") -> dict[str, str]:
    return {"highway": highway, "name": name}


_STREETS = [
    PlannedStreet(
        _curve("mainW", "slip", "ringW", "churchS", "marketS", "school", "ringE", "brookE", "mainE"),
        _street("Hauptstraße", "tertiary"),
    ),
    PlannedStreet(
        _curve("ringW", "ring1", "ring2", "ringN", "ring3", "garden", "ring4", "parkE", "ringE"), _street("Lindenring")
    ),
    PlannedStreet(_curve("churchS", "churchN", "ringN", "hill1"), _street("Kirchgasse")),
    PlannedStreet("marketS marketN", _street("Marktgasse")),
    PlannedStreet("churchN marketN", _street("Am Markt")),
    PlannedStreet(_curve("marketN", "parkS", "parkE"), _street("Parkstraße")),
    PlannedStreet("mill school parkS", _street("Schulstraße")),
    PlannedStreet(_curve("garden", "hill2"), _street("Gärtnerweg")),
    PlannedStreet(
        _curve("slip", "brook1", "brook2", "brook3", "bridge", "mill", "brook4", "brook5", "brookE"),
        _street("Am Mühlbach"),
    ),
    PlannedStreet(_curve("marketS", "bridge", "bank1"), _street("Brückenstraße")),
    PlannedStreet("mill bank2", _street("Mühlweg")),
    PlannedStreet(_curve("hillW", "hill1", "hill2", "hillE"), _street("Bergstraße")),
    PlannedStreet(_curve("bankW", "bank1", "bank2", "bankE"), _street("Uferweg")),
    PlannedStreet("marketN path1 path2 garden", {"highway": "footway"}),
    PlannedStreet("path2 path3 parkE", {"highway": "footway"}),
    PlannedStreet("churchN square1 marketS", {"highway": "footway"}),
]

_AREAS = [
    PlannedArea([(-80, 16), (-10, 11), (-8, 60), (-77, 63)], {"place": "square", "name": "Marktplatz"}),
    PlannedArea(
        [(-62, 30), (-36, 28), (-35, 42), (-61, 44)], {"building": "church", "name": "Johanniskirche", "height": "14"}
    ),
    PlannedArea(
        [(14, 82), (88, 68), (150, 66), (140, 100), (84, 130), (14, 138)], {"leisure": "park", "name": "Stadtpark"}
    ),
]

QUARTER = TownPlan(
    _NODES,
    _STREETS,
    kinds={
        "slip": "T",
        "ringW": "T",
        "churchS": "T",
        "marketS": "X",
        "school": "X",
        "ringE": "T",
        "brookE": "T",
        "ringN": "X",
        "garden": "T",
        "parkE": "T",
        "churchN": "T",
        "marketN": "T",
        "parkS": "T",
        "bridge": "X",
        "mill": "X",
        "hill1": "T",
        "hill2": "T",
        "bank1": "T",
        "bank2": "T",
    },
    route=(
        "mainW slip brook2 bridge marketS marketN churchN churchS ringW ring2 ringN garden parkE parkS school mill "
        "brook4 brookE ringE school marketS churchS"
    ),
    areas=_AREAS,
)
