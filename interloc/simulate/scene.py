"""The world around a track: ground, heights and obstacles, ready for the LiDAR."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import GeometryCollection, LineString, MultiPoint, Point
from shapely.geometry.base import BaseGeometry

from interloc.arrays import FloatArray, IntArray
from interloc.errors import MapError
from interloc.simulate.config import SceneConfig
from interloc.simulate.ground import GroundRaster, plan_ground
from interloc.simulate.heights import HeightField, beyond_ends, fit_heights, flat_field, without_drift
from interloc.simulate.obstacles import Obstacles, furnish
from interloc.simulate.osm_map import MapData, StreetMap, street_map_of
from interloc.simulate.profiles import CLEARANCE_M, Crossing, Profile, find_crossings, street_profiles, visible_lines
from interloc.simulate.tracks import LidarTrack

LEVEL_REACH_M = 45.0


class Scene:
    """Everything that a LiDAR can see along a track; `build_scene` makes one.

    Attributes
    ----------
    frame : LocalFrame
        The plane M in which the scene is drawn.
    street_map : StreetMap
    profiles : list of Profile
        Cross-sections of the streets.
    ground : GroundRaster
    heights : list of HeightField
        As seen from the usual level and, where the track needs it, from streets that are hidden from there.
    obstacles : Obstacles
    T_map_lidar : (N, 4, 4) float64
        The poses of the track, with the sensor at its height above this ground.
    level : (N,) int64
        From which level each pose sees the scene.
    wear : float
        Spread of the brightness of the ground from patch to patch.
    """

    def __init__(
        self,
        street_map: StreetMap,
        profiles: list[Profile],
        ground: GroundRaster,
        heights: list[HeightField],
        obstacles: Obstacles,
        T_map_lidar: FloatArray,
        level: IntArray,
        wear: float = 0.0,
    ) -> None:
        self.wear = wear
        self.frame = street_map.frame
        self.street_map = street_map
        self.profiles = profiles
        self.ground = ground
        self.heights = heights
        self.obstacles = obstacles
        self.T_map_lidar = T_map_lidar
        self.level = level


def build_scene(
    track: LidarTrack,
    data: MapData,
    *,
    config: SceneConfig | None = None,
    sensor_height_m: float = 1.73,
    seed: int = 0,
) -> Scene:
    """Draw the world of a map around a track.

    Parameters
    ----------
    track
        All poses of the drive, also those that are not simulated: they carry the heights.
    data
        The map, from `read_map`. Houses are made up if it has no building at all.
    config, seed
        What to draw, and the seed of everything random.
    sensor_height_m
        Height of the LiDAR above the ground.

    Raises
    ------
    MapError
        The map lies elsewhere.
    """
    config = config or SceneConfig()
    frame = track.frame()
    poses = track.T_map_lidar(frame)
    xy = poses[:, :2, 3]
    box = (*(xy.min(axis=0) - config.reach_m), *(xy.max(axis=0) + config.reach_m))
    street_map = street_map_of(data, frame, box)
    if not street_map.streets:
        raise MapError(
            f"{data.path}: no street within reach of the track, which is at latitude {track.lat_deg.mean():.4f}, "
            f"longitude {track.lon_deg.mean():.4f}. Usual cause: the map of another place, or lon and lat in each "
            "other's column."
        )
    towns = config.roadside.buildings in {"made_up", "none"} or not street_map.buildings
    profiles = street_profiles(street_map, config.streets, towns=towns, seed=seed)
    _refuse_elsewhere(data.path, profiles, xy, config.max_map_distance_m)

    crossings = find_crossings(profiles)
    level = _levels(profiles, crossings, xy)
    levels = int(level.max()) + 1
    driven = _driven(xy, config.track_half_width_m, level, crossings)
    lines = [visible_lines(profiles, crossings, from_hidden=bool(k)) for k in range(levels)]
    plans = [plan_ground(street_map, profiles, lines[k], config.streets, driven=driven[k]) for k in range(levels)]
    differences = shapely.union_all([c.clearing for c in crossings]).buffer(LEVEL_REACH_M)
    ground = GroundRaster(
        plans, differences, box, tile_m=config.tile_m, cell_m=config.cell_m, capacity=config.tiles_in_memory
    )
    heights = _heights(poses, level, sensor_height_m, config, flat=config.flat or not track.altitude_known)
    for i, pose in enumerate(poses):
        # Above this ground, not at the satellites' altitude, which drifts by metres between two visits.
        pose[2, 3] = heights[level[i]].at(pose[0, 3], pose[1, 3]) + sensor_height_m
    walls = furnish(street_map, profiles, lines[0], config.roadside, driven_xy=_every_metre(xy), seed=seed)
    return Scene(street_map, profiles, ground, heights, Obstacles(walls, heights), poses, level, config.wear)


def _refuse_elsewhere(roads: Path, profiles: list[Profile], xy: FloatArray, limit_m: float) -> None:
    tree = shapely.STRtree([p.line for p in profiles])
    _, distance = tree.query_nearest(shapely.points(xy), return_distance=True, all_matches=False)
    median = float(np.median(distance))
    if median > limit_m:
        raise MapError(
            f"{roads}: the track runs {median:,.0f} m (median) from the nearest street of this map. "
            f"Expected at most {limit_m:g} m. Usual cause: the map of another place, or of a part of the track."
        )


def _levels(profiles: list[Profile], crossings: list[Crossing], xy: FloatArray) -> IntArray:
    """Tell for each pose whether it is on, or just before or behind, a street that is hidden from the usual level."""
    level = np.zeros(len(xy), dtype=np.int64)
    for crossing in crossings:
        near = np.hypot(xy[:, 0] - crossing.x_m, xy[:, 1] - crossing.y_m) < LEVEL_REACH_M
        for visit in np.split(np.flatnonzero(near), np.flatnonzero(np.diff(np.flatnonzero(near)) > 1) + 1):
            inside = visit[np.hypot(*(xy[visit] - [crossing.x_m, crossing.y_m]).T) < CLEARANCE_M]
            # The street along which the visit ran nearest on the whole is the one that was driven.
            places = [Point(p) for p in xy[inside]]
            shown, hidden = (
                sum(p.distance(profiles[i].line) for p in places) for i in (crossing.shown, crossing.hidden)
            )
            if hidden < shown:
                level[visit] = 1
    return level


def _driven(xy: FloatArray, half_width_m: float, level: IntArray, crossings: list[Crossing]) -> list[BaseGeometry]:
    """Return what the vehicle drove over, as seen from each level."""
    strips: tuple[list[BaseGeometry], list[BaseGeometry]] = ([], [])
    for run in np.split(np.arange(len(xy)), np.flatnonzero(np.diff(level)) + 1):
        for start in range(0, len(run) - 1, 50):  # in pieces: a long line is slow to cut into tiles
            piece = xy[run[start : start + 51]]
            strips[level[run[0]]].append(LineString(piece).simplify(0.05).buffer(half_width_m))
    clearings = shapely.union_all([c.clearing for c in crossings])
    above = [*strips[1], *(strip.difference(clearings) for strip in strips[0])]
    return [GeometryCollection(strips[0]), GeometryCollection(above)]


def _heights(
    poses: FloatArray, level: IntArray, sensor_height_m: float, config: SceneConfig, *, flat: bool
) -> list[HeightField]:
    if flat:
        return [flat_field() for _ in range(int(level.max()) + 1)]
    under = without_drift(poses[:, :3, 3] - sensor_height_m * poses[:, :3, 2], np.arcsin(poses[:, 2, 0]))
    ahead = beyond_ends(under)
    fields = []
    for k in range(int(level.max()) + 1):
        known = level == k
        if k:  # the other level counts where it is far from this one
            above = MultiPoint(under[known][:, :2]).buffer(LEVEL_REACH_M)
            known = known | ~shapely.contains_xy(above, under[:, 0], under[:, 1])
        fields.append(fit_heights(np.concatenate([under[known], ahead]), margin_m=config.reach_m))
    return fields


def _every_metre(xy: FloatArray) -> FloatArray:
    """Fill the gaps between poses, so that nothing stands between two of them."""
    pieces = [xy[:1]]
    for a, b in pairwise(xy):
        count = int(np.hypot(*(b - a)))
        if count > 1:
            pieces.append(np.linspace(a, b, count + 1)[1:-1])
        pieces.append(b[None])
    return np.concatenate(pieces)
