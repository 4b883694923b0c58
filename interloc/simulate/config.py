"""Configuration of the simulator: one frozen model a concern. Lengths in metres, angles in degrees."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class _Config(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LidarConfig(_Config):
    """A spinning LiDAR; the defaults are the Velodyne HDL-64E of KITTI."""

    rings: int = Field(64, ge=1, le=256, description="Lasers, one above the other.")
    columns: int = Field(2083, ge=8, le=8192, description="Shots of each laser a turn: 0.17 degrees apart.")
    top_deg: float = Field(2.0, ge=-89, le=89, description="Elevation of the highest laser.")
    middle_deg: float = Field(-8.33, ge=-89, le=89, description="Elevation of the lowest laser of the upper block.")
    bottom_deg: float = Field(-24.9, ge=-89, le=89, description="Elevation of the lowest laser.")
    height_m: float = Field(1.73, gt=0, le=20, description="Height of the sensor above the ground.")
    min_range_m: float = Field(2.0, ge=0, description="Nearer returns are the vehicle itself.")
    max_range_m: float = Field(120.0, gt=1, le=300, description="Range limit.")
    range_noise_m: float = Field(0.02, ge=0, le=1, description="Standard deviation of a range.")
    surface_noise: float = Field(1.0, ge=0, le=10, description="Factor on the roughness of the ground (0: smooth).")
    dropout: float = Field(0.03, ge=0, lt=1, description="Share of the shots that give no return anywhere.")
    road_half_range_m: float | None = Field(
        60.0, gt=1, description="Range at which half of the shots on flat asphalt give no return; none: all do."
    )


class StreetConfig(_Config):
    """How wide streets are, and what runs beside them; the table of classes is in `street_classes.py`."""

    width_factor: float = Field(1.0, gt=0.2, le=3, description="Factor on every default width.")
    use_width_tags: bool = Field(True, description="Believe the tags `width` and `lanes` of the map.")
    corner_radius_factor: float = Field(1.0, ge=0, le=3, description="Factor on the radius of kerbs at junctions.")
    sidewalks: bool = Field(True, description="Sidewalks along streets where the map does not deny them.")
    sidewalk_width_m: float = Field(1.9, gt=0.3, le=10)
    parking_bay_share: float = Field(
        0.2, ge=0, le=1, description="Share of the residential streets with marked bays (label parking) at the kerb."
    )
    parking_bay_width_m: float = Field(2.1, gt=1, le=6)
    service_roads: Literal["other_ground", "road"] = Field(
        "other_ground",
        description="What service roads (not drives or lanes of car parks) are labelled. The ground truth policy "
        "`drive` leaves them out; as road, each of their junctions is a false positive there.",
    )
    lane_markings: bool = Field(True, description="Dashed centre lines on the larger streets.")


class RoadsideConfig(_Config):
    """What stands beside the road and occludes it."""

    parked_car_density: float = Field(
        0.35, ge=0, le=1, description="Share of the places at the kerb of a residential street that are taken."
    )
    hedge_share: float = Field(0.35, ge=0, le=1, description="Share of the back edge of sidewalks with hedge or fence.")
    buildings: Literal["auto", "map", "made_up", "none"] = Field(
        "auto", description="From the map, made up along the streets, or made up only where the map has none (auto)."
    )
    building_share: float = Field(0.75, ge=0, le=1, description="Share of the made-up plots that are built on.")


class SceneConfig(_Config):
    """Everything about the world around the track."""

    streets: StreetConfig = StreetConfig()
    roadside: RoadsideConfig = RoadsideConfig()
    cell_m: float = Field(0.125, gt=0.02, le=1, description="Cell of the raster of ground classes.")
    tile_m: float = Field(64.0, ge=8, le=512, description="Side of its tiles.")
    tiles_in_memory: int = Field(96, ge=16, le=4096)
    reach_m: float = Field(130.0, ge=20, le=400, description="The world ends at this distance from the track.")
    flat: bool = Field(False, description="Ignore the heights of the track: the ground is the plane z = 0.")
    track_half_width_m: float = Field(
        1.5, ge=0, le=5, description="What the vehicle drove over is road, wherever the map puts the street."
    )
    max_map_distance_m: float = Field(
        30.0, gt=0, description="A track whose median distance from the streets of the map is larger is refused."
    )


class TrackConfig(_Config):
    """How a route (GPX, CSV, or the town's) becomes a drive."""

    speed_mps: float = Field(8.0, gt=0.1, le=60, description="Speed along the route; times in the file are not used.")
    rate_hz: float = Field(10.0, gt=0.1, le=100, description="Scans a second.")
    smoothing_m: float = Field(3.0, ge=0, le=50, description="The path is smoothed by a Gaussian of this width.")
    offset_m: float = Field(0.0, ge=-20, le=20, description="Drive so far to the right of the given line.")
    max_gap_m: float = Field(500.0, gt=1, description="Two points of the line further apart are refused.")
