"""The beginning of the plain part of the made-up town, simulated once for all tests; junctions of any part."""

import os
import shutil
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import interloc.lab.town
from interloc.arrays import FloatArray
from interloc.geometry import bearing_deg
from interloc.lab.config import LidarConfig, SimulationOptions
from interloc.lab.drive import simulate
from interloc.lab.streets import read_ways
from interloc.lab.town import Town
from interloc.osm.intersections import DRIVABLE
from tests.once import once

SCANS = 60
"""Keyframes, 130 m: as far as behind the first two junctions, after 45 of them."""


def write_town(root: Path) -> None:
    """Write the drive and its map, ground only."""
    sensor = LidarConfig(columns=512)
    options = SimulationOptions(keyframes_only=True, ground_only=True, max_scans=SCANS, sensor=sensor)
    simulate(Town("plain").trip(), root, options)


def town_drive(factory: pytest.TempPathFactory, scans: int = SCANS) -> Path:
    """Return the drive, or its first scans. Shared: do not change it."""
    whole = once(factory, "town", write_town)

    def shorten(root: Path) -> None:
        shutil.copytree(whole, root, copy_function=os.link)
        for frame in range(scans, SCANS):
            (root / f"velodyne/{frame:06d}.bin").unlink()
            (root / f"labels/{frame:06d}.label").unlink()

    return whole if scans == SCANS else once(factory, f"town-{scans}", shorten)


class Junction(NamedTuple):
    """The truth about a junction of the town."""

    kind: str
    node_id: int
    lonlat: FloatArray
    xy: FloatArray
    """In the frame of the town."""
    bearings_deg: FloatArray
    """Directions of its arms, clockwise from north."""


def junctions_of(town: Town) -> dict[str, Junction]:
    """Return the junctions of a town by their `town:name`, as town.osm and quarter.osm have them."""
    _, tags = read_ways(
        Path(interloc.lab.town.__file__).with_name("quarter.osm" if town.part == "quarter" else "town.osm")
    )
    arms: dict[int, list[FloatArray]] = {}
    lonlat: dict[int, FloatArray] = {}
    for way in town.map_data().ways:
        if way.tags.get("highway") in DRIVABLE:
            lonlat |= dict(zip(way.nodes, way.lonlat, strict=True))
            xy = town.frame.xy(way.lonlat)
            for a, b in pairwise(range(len(way.nodes))):
                arms.setdefault(way.nodes[a], []).append(xy[b] - xy[a])
                arms.setdefault(way.nodes[b], []).append(xy[a] - xy[b])
    return {
        tags[node]["town:name"]: Junction(
            tags[node]["town:junction"],
            node,
            lonlat[node],
            town.frame.xy(lonlat[node]),
            np.sort(bearing_deg(np.arctan2(*np.array(away).T[::-1]))),
        )
        for node, away in arms.items()
        if len(away) > 2
    }
