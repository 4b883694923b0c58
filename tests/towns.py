"""The beginning of the plain part of the made-up town, simulated once for all tests."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from interloc.lab.config import LidarConfig, SimulationOptions
from interloc.lab.drive import simulate
from interloc.lab.town import Town
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
