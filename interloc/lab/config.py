"""Configuration of the simulator: one frozen model per concern. Lengths in metres, angles in degrees."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class _Config(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LidarConfig(_Config):
    """A spinning LiDAR; the defaults are the Velodyne HDL-64E of KITTI."""

    rings: int = Field(64, ge=1, le=256, description="Lasers, one above the other.")
    columns: int = Field(2083, ge=8, le=8192, description="Shots of each laser per turn; 2083 are 0.17 degrees apart.")
    top_deg: float = Field(2.0, ge=-89, le=89, description="Elevation of the highest laser.")
    middle_deg: float = Field(-8.33, ge=-89, le=89, description="Elevation of the lowest laser of the upper block.")
    bottom_deg: float = Field(-24.9, ge=-89, le=89, description="Elevation of the lowest laser.")
    height_m: float = Field(1.73, gt=0, le=20, description="Height of the sensor above the ground.")
    min_range_m: float = Field(
        2.0, ge=0, description="Returns nearer than this hit the vehicle itself and are left out."
    )
    max_range_m: float = Field(120.0, gt=1, le=300, description="Returns beyond this range are left out.")
    range_noise_m: float = Field(0.02, ge=0, le=1, description="Standard deviation of a range.")
    surface_noise: float = Field(1.0, ge=0, le=10, description="Factor on the roughness of the ground (0: smooth).")
    dropout: float = Field(0.03, ge=0, lt=1, description="Share of the shots that give no return anywhere.")
    road_half_range_m: float | None = Field(
        60.0,
        gt=1,
        description="Range at which half of the shots on flat asphalt are lost; null: no shot is lost.",
    )


def _uniform(rings: int, top_deg: float, columns: int, range_m: float, noise_m: float) -> LidarConfig:
    """Return a LiDAR whose rings are evenly spaced, as much above the horizon as below it.

    On flat asphalt the signal falls with the cube of the distance, at a wall with its square: the range on asphalt is
    that of the HDL-64E, scaled by the published ranges at 80 % reflectance (`max_range_m`) to the power of 2 / 3.
    """
    step = 2 * top_deg / (rings - 1)
    hdl = LidarConfig()
    assert hdl.road_half_range_m is not None
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


class StreetConfig(_Config):
    """How wide streets are, and what runs beside them; the table of classes is `osm_map.STREET_CLASSES`."""

    corner_radius_factor: float = Field(1.0, ge=0, le=3, description="Factor on the radius of kerbs at junctions.")
    sidewalks: bool = Field(True, description="Draw sidewalks along streets unless the map says that there are none.")
    sidewalk_width_m: float = Field(1.9, gt=0.3, le=10, description="Width of a sidewalk.")
    parking_bay_share: float = Field(
        0.2, ge=0, le=1, description="Share of the residential streets with marked bays (label parking) at the kerb."
    )
    parking_bay_width_m: float = Field(2.1, gt=1, le=6, description="Width of a marked bay.")
    service_roads: Literal["other_ground", "road"] = Field(
        "other_ground",
        description="Label of service roads other than drives and lanes of car parks. The ground truth policy "
        "`drive` leaves them out; labelled as road, each of their junctions counts as a false positive.",
    )


class RoadsideConfig(_Config):
    """What stands beside the road and occludes it."""

    parked_car_density: float = Field(
        0.35, ge=0, le=1, description="Share of the places at the kerb of a residential street that are taken."
    )
    hedge_share: float = Field(0.35, ge=0, le=1, description="Share of the back edge of sidewalks with hedge or fence.")
    buildings: Literal["auto", "map", "made_up", "none"] = Field(
        "auto",
        description="Buildings of the map (map), made up along the streets (made_up), made up only if the map has "
        "no building (auto), or none.",
    )
    building_share: float = Field(0.75, ge=0, le=1, description="Share of the made-up plots that are built on.")


class SceneConfig(_Config):
    """Everything about the world around the track."""

    streets: StreetConfig = StreetConfig()
    roadside: RoadsideConfig = RoadsideConfig()
    cell_m: float = Field(0.125, gt=0.02, le=1, description="Side of a cell of the raster of ground classes.")
    tile_m: float = Field(64.0, ge=8, le=512, description="Side of a tile of the raster of ground classes.")
    tiles_in_memory: int = Field(96, ge=16, le=4096, description="Number of tiles kept in memory.")
    reach_m: float = Field(130.0, ge=20, le=400, description="The world ends at this distance from the track.")
    flat: bool = Field(False, description="Ignore the heights of the track: the ground is the plane z = 0.")
    track_half_width_m: float = Field(
        1.5,
        ge=0,
        le=5,
        description="Half width of a strip along the track that is road in any case.",
    )


class TrackConfig(_Config):
    """How a route (GPX, CSV, or the town's) becomes a drive."""

    speed_mps: float = Field(8.0, gt=0.1, le=60, description="Speed along the route; times in the file are not used.")
    rate_hz: float = Field(10.0, gt=0.1, le=100, description="Scans per second.")
    smoothing_m: float = Field(3.0, ge=0, le=50, description="Width of the Gaussian that smooths the path.")
    offset_m: float = Field(0.0, ge=-20, le=20, description="Distance of the path from the given line, to the right.")


class SimulationOptions(_Config):
    """How a drive is simulated, whatever its track and map."""

    seed: int = Field(
        0, ge=0, description="Seed of everything random: houses, cars, noise. The same seed gives the same drive."
    )
    keyframes_only: bool = Field(
        False,
        description="Write only the scans that the method uses (moved > 2 m or turned > 5 degrees).",
    )
    ground_only: bool = Field(
        False, description="Write only the points on the ground, which the method can use: about half the size."
    )
    max_scans: int | None = Field(None, ge=1, description="Number of scans after which the drive ends; null: all.")
    scene: SceneConfig = SceneConfig()
    sensor: LidarConfig = LidarConfig()


DEFAULT_OPTIONS = SimulationOptions()
