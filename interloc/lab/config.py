"""Configuration of the simulator: one frozen class per concern. Lengths in metres, angles in degrees."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class LidarConfig:
    """A spinning LiDAR; the defaults are the Velodyne HDL-64E of KITTI."""

    rings: int = 64
    columns: int = 2083
    """Shots of each laser per turn; 2083 are 0.17 degrees apart."""
    top_deg: float = 2.0
    middle_deg: float = -8.33
    bottom_deg: float = -24.9
    """Elevations of the highest laser, of the lowest of the upper block, and of the lowest."""
    height_m: float = 1.73
    """Above the ground."""
    min_range_m: float = 2.0
    """Returns nearer than this hit the vehicle itself and are left out."""
    max_range_m: float = 120.0
    range_noise_m: float = 0.02
    surface_noise: float = 1.0
    """Standard deviation of a range; factor on the roughness of the ground (0: smooth)."""
    dropout: float = 0.03
    """Share of the shots that give no return anywhere."""
    road_half_range_m: float | None = 60.0
    """Range at which half of the shots on flat asphalt are lost; None: no shot is lost."""


def _uniform(rings: int, top_deg: float, columns: int, range_m: float, noise_m: float) -> LidarConfig:
    """Return a LiDAR whose rings are evenly spaced, as much above the horizon as below it.

    On flat asphalt the signal falls with the cube of the distance, at a wall with its square: the range on asphalt is
    that of the HDL-64E, scaled by the published ranges at 80 % reflectance (`max_range_m`) to the power of 2 / 3.
    """
    step = 2 * top_deg / (rings - 1)
    hdl = LidarConfig()
    return LidarConfig(
        rings=rings,
        columns=columns,
        top_deg=top_deg,
        middle_deg=top_deg - step * ((rings + 1) // 2 - 1),
        bottom_deg=-top_deg,
        max_range_m=range_m,
        range_noise_m=noise_m,
        road_half_range_m=round(hdl.road_half_range_m * (range_m / hdl.max_range_m) ** (2 / 3), 1),
    )


SENSORS: dict[str, LidarConfig] = {
    "vlp-16": _uniform(16, 15.0, 1800, 100.0, 0.03),
    "os1-32": _uniform(32, 22.5, 1024, 120.0, 0.03),
    "os1-64": _uniform(64, 22.5, 1024, 120.0, 0.03),
    "hdl-64e": LidarConfig(),
}
"""LiDARs by name: rings, elevations, shots per turn at 10 Hz, range and its noise as their makers publish them.

Velodyne VLP-16: user manual 63-9243. Ouster OS1 of the second generation: OS1 datasheet; the noise is that at a
medium signal. Velodyne HDL-64E S2: user manual 63-HDL64ES2. All of them on the roof of KITTI's car.
"""


@dataclass(frozen=True)
class StreetConfig:
    """How wide streets are, and what runs beside them; the table of classes is `streets.STREET_CLASSES`."""

    corner_radius_factor: float = 1.0
    """Factor on the radius of kerbs at junctions."""
    parking_bay_share: float = 0.2
    """Share of the residential streets with marked bays (label parking) at the kerb."""
    service_roads: Literal["other_ground", "road"] = "other_ground"
    """Label of service roads other than drives and lanes of car parks. The ground truth policy `drive` leaves them out;
    labelled as road, each of their junctions counts as a false positive."""


@dataclass(frozen=True)
class RoadsideConfig:
    """What stands beside the road and occludes it."""

    parked_car_density: float = 0.35
    """Share of the places at the kerb of a residential street that are taken."""
    hedge_share: float = 0.35
    """Share of the back edge of sidewalks with hedge or fence."""
    buildings: Literal["auto", "map", "none"] = "auto"
    """Those of the map, or made up along the streets where the map has none (auto); those of the map alone; none."""


@dataclass(frozen=True)
class SceneConfig:
    """Everything about the world around the track."""

    streets: StreetConfig = StreetConfig()
    roadside: RoadsideConfig = RoadsideConfig()
    cell_m: float = 0.125
    """Side of a cell of the raster of ground classes."""
    reach_m: float = 130.0
    """The world ends at this distance from the track."""
    flat: bool = False
    """Ignore the heights of the track: the ground is the plane z = 0."""
    track_half_width_m: float = 1.5
    """Half width of a strip along the track that is road in any case."""


@dataclass(frozen=True)
class TrackConfig:
    """How a line becomes a drive."""

    speed_mps: float = 8.0
    rate_hz: float = 10.0
    """Scans per second."""
    offset_m: float = 0.0
    """Distance of the path from the given line, to the right."""


@dataclass(frozen=True)
class SimulationOptions:
    """How a drive is simulated, whatever its track and map."""

    seed: int = 0
    """Of everything random: houses, cars, noise. The same seed gives the same drive."""
    keyframes_only: bool = False
    """Write only the scans that the method uses (moved > 2 m or turned > 5 degrees)."""
    ground_only: bool = False
    """Write only the points on the ground, which the method can use: about half the size."""
    max_scans: int | None = None
    """Number of scans after which the drive ends; None: all."""
    scene: SceneConfig = SceneConfig()
    sensor: LidarConfig = LidarConfig()


DEFAULT_OPTIONS = SimulationOptions()
