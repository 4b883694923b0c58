"""Rows with literal figures, and one small simulated drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from interloc.benchmark.row import Cell, MapPicture, Place, Row
from tests.towns import town_drive

NOTHING = MapPicture(roads=(), track=((0.0, 0.0), (9.0, 0.0)), true=(), false=(), found=(), missed=(), beyond=())


def make_row(
    drive: str = "00",
    errors_m: Sequence[float] = (1.0,),
    *,
    preset: str = "default",
    noise: str = "0/0",
    seed: int = 0,
    places: Sequence[Place] = (),
    unmatched: int = 0,
    fn: int = 0,
    nodes: tuple[int, int] = (1, 1),
    fused: tuple[int, int, int, int] = (1, 0, 0, 1),
    map_errors_m: Sequence[float] = (0.5,),
    map_axes_errors_m: Sequence[tuple[float, float]] = (),
    map_squared: Sequence[float] = (1.0,),
    outcomes: Sequence[tuple[float, bool]] = ((0.9, True),),
    keyframes: int = 100,
    compute_s: float = 0.5,
) -> Row:
    """Make a row; `nodes`: found, in zone; `fused`: true, false, missed, nodes; `outcomes`: confidence, right."""
    return Row(
        cell=Cell(drive=drive, preset=preset, noise=noise, seed=seed),
        fingerprint="f",
        policy="drive",
        keyframes=keyframes,
        errors_m=tuple(errors_m),
        places=tuple(places),
        unmatched=unmatched,
        fn=fn,
        nodes_found=nodes[0],
        nodes_in_zone=nodes[1],
        map_true=fused[0],
        map_false=fused[1],
        map_missed=fused[2],
        map_nodes=fused[3],
        map_errors_m=tuple(map_errors_m),
        map_axes_errors_m=tuple(map_axes_errors_m),
        map_squared=tuple(map_squared),
        map_confidence=tuple(confidence for confidence, _ in outcomes),
        map_right=tuple(right for _, right in outcomes),
        compute_s=compute_s,
        warnings=(),
        picture=NOTHING,
        failures={"false_detections": [], "missed_nodes": []},
    )


@pytest.fixture(scope="session")
def row() -> Callable[..., Row]:
    return make_row


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 130 m of the plain part of the made-up town, with map.osm. Shared: do not change it."""
    return town_drive(tmp_path_factory)


@pytest.fixture
def kitti(data: Callable[[str], Path]) -> Path:
    """The tracks and maps of KITTI."""
    return data("kitti")
