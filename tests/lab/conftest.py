"""A street, a house and a track, drawn in metres about a point; rows of a benchmark with literal figures."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from interloc.lab.config import LidarConfig, RoadsideConfig, SceneConfig, StreetConfig, TrackConfig
from interloc.lab.measure import Cell, Place, Row
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import read_map
from interloc.lab.tracks import LidarTrack, LocalFrame, track_from_line
from tests.small_drives import sequence  # noqa: F401 - a fixture
from tests.towns import town_drive

FRAME = LocalFrame(49.0, 8.4)
BARE = RoadsideConfig(parked_car_density=0, hedge_share=0, buildings="map")
PLAIN_STREETS = StreetConfig(parking_bay_share=0)
SMALL_LIDAR = LidarConfig(columns=360)


def osm_text(ways: list[tuple[list[tuple[float, float]], dict[str, str]]]) -> str:
    """Ways by their points in metres; points at the same place are one node."""
    places: dict[tuple[float, float], int] = {}
    body = []
    for number, (points, tags) in enumerate(ways):
        ids = [places.setdefault(p, len(places) + 1) for p in points]
        nodes = "".join(f'<nd ref="{i}"/>' for i in ids)
        body.append(
            f'<way id="{number + 1}" version="1">{nodes}'
            + "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
            + "</way>"
        )
    nodes = []
    for p, i in places.items():
        lon, lat = FRAME.lonlat(p)
        nodes.append(f'<node id="{i}" version="1" lat="{lat:.7f}" lon="{lon:.7f}"/>')
    return f'<?xml version="1.0"?><osm version="0.6">{"".join(nodes)}{"".join(body)}</osm>'


STREET = ([(-150.0, 0.0), (150.0, 0.0)], {"highway": "residential"})
HOUSE = ([(10.0, 8.0), (20.0, 8.0), (20.0, 16.0), (10.0, 16.0), (10.0, 8.0)], {"building": "yes"})
SHED = ([(30.0, 40.0), (34.0, 40.0), (34.0, 44.0), (30.0, 40.0)], {"building": "yes"})


@pytest.fixture
def write_map(tmp_path: Path) -> Callable[..., Path]:
    def write(*ways: tuple[list[tuple[float, float]], dict[str, str]]) -> Path:
        path = tmp_path / "map.osm"
        path.write_text(osm_text(list(ways)))
        return path

    return write


@pytest.fixture(scope="session")
def straight_track() -> LidarTrack:
    line = FRAME.lonlat([[-60.0, 0.0], [60.0, 0.0]])
    return track_from_line(line, None, TrackConfig(rate_hz=4))


@pytest.fixture(scope="session")
def street_scene(straight_track: LidarTrack, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A straight residential street along x with one house to the north, flat."""
    path = tmp_path_factory.mktemp("map") / "map.osm"
    path.write_text(osm_text([STREET, HOUSE, SHED]))
    return build_scene(
        straight_track, read_map(path), config=SceneConfig(roadside=BARE, streets=PLAIN_STREETS, flat=True)
    )


def row(
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
    keyframes: int = 100,
) -> Row:
    """Make a row; `nodes`: found, in zone; `fused`: true, false, missed, nodes."""
    return Row(
        cell=Cell(drive=drive, preset=preset, noise=noise, seed=seed),
        settings={"method": {}},
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
        warnings=(),
        made_up_map=True,
    )


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 130 m of the plain part of the made-up town, with map.osm. Shared: do not change it."""
    return town_drive(tmp_path_factory)


@pytest.fixture
def kitti(data: Callable[[str], Path]) -> Path:
    """The tracks and maps of KITTI."""
    return data("kitti")
