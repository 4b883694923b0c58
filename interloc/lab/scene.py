"""The world around a track: ground, heights and what occludes them, ready for the LiDAR."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import shapely
from scipy.spatial import cKDTree
from shapely.geometry import GeometryCollection, LineString, MultiPoint, Point, Polygon
from shapely.geometry.base import BaseGeometry

from interloc.arrays import FloatArray, IntArray, UInt8Array
from interloc.errors import MapError
from interloc.lab.config import RoadsideConfig, SceneConfig
from interloc.lab.ground import (
    GroundRaster,
    HeightField,
    Surface,
    beyond_ends,
    fit_heights,
    plan_ground,
    polygon_parts,
    without_drift,
)
from interloc.lab.streets import (
    CLEARANCE_M,
    Crossing,
    MapData,
    Profile,
    StreetMap,
    find_crossings,
    street_map_of,
    street_profiles,
    visible_lines,
)
from interloc.lab.tracks import LidarTrack, LocalFrame

MAX_WALL_M = 24.0
_CELL_M = 24.0
CAR_SLOT_M = 6.0
VEHICLE_CLEARANCE_M = 2.5
JUNCTION_CLEARANCE_M = 9.0
BUILT_SHARE = 0.75  # of the plots of a made-up town
PLOT_M = 17.0
LEVEL_REACH_M = 45.0


@dataclass
class WallList:
    """Walls while a scene is being built; heights above the ground."""

    walls: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    surfaces: list[int] = field(default_factory=list)

    def add_line(self, xy: FloatArray, bottom_m: float, top_m: float, surface: Surface) -> None:
        """Add a wall along (N, 2) points; long pieces are divided, so that each follows the ground."""
        for a, b in pairwise(xy):
            pieces = max(int(np.ceil(float(np.hypot(*(b - a))) / MAX_WALL_M)), 1)
            ends = np.linspace(a, b, pieces + 1)
            for p, q in pairwise(ends):
                self.walls.append((float(p[0]), float(p[1]), float(q[0]), float(q[1]), bottom_m, top_m))
                self.surfaces.append(int(surface))

    def add_box(
        self,
        centre: FloatArray,
        heading_rad: float,
        size: tuple[float, float],
        bottom_m: float,
        top_m: float,
        surface: Surface,
    ) -> None:
        """Add the four sides of a box of a length and a width."""
        c, s = np.cos(heading_rad), np.sin(heading_rad)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * np.array(size) / 2
        self.add_line(corners @ np.array([[c, s], [-s, c]]) + centre, bottom_m, top_m, surface)


class Obstacles:
    """All walls of a scene, found by place, on the ground of each level from which the scene is seen."""

    def __init__(self, walls: WallList, fields: list[HeightField]) -> None:
        flat = np.array(walls.walls, dtype=np.float64).reshape(-1, 6)
        middle = (flat[:, :2] + flat[:, 2:4]) / 2
        self._cells = np.floor(middle / _CELL_M).astype(np.int64)
        order = np.lexsort((self._cells[:, 0], self._cells[:, 1]))
        flat, middle, self._cells = flat[order], middle[order], self._cells[order]
        self._surfaces = np.array(walls.surfaces, dtype=np.uint8)[order]
        self._walls = []
        for heights in fields:
            placed = flat.copy()
            placed[:, 4:] += np.array([heights.at(x, y) for x, y in middle]).reshape(-1, 1)
            self._walls.append(placed)

    def near(self, x: float, y: float, reach_m: float, *, level: int = 0) -> tuple[FloatArray, UInt8Array]:
        """Return the (S, 6) float64 walls (ends, bottom, top in M) and (S,) uint8 surfaces around a place."""
        span = int(np.ceil((reach_m + MAX_WALL_M / 2) / _CELL_M))
        column, row = int(np.floor(x / _CELL_M)), int(np.floor(y / _CELL_M))
        rows = self._cells[:, 1]
        pieces = []
        for r in range(row - span, row + span + 1):
            a, b = np.searchsorted(rows, [r, r + 1])
            if a < b:
                c, d = np.searchsorted(self._cells[a:b, 0], [column - span, column + span + 1])
                pieces.append(slice(int(a + c), int(a + d)))
        if not pieces:
            return np.zeros((0, 6)), np.zeros(0, np.uint8)
        walls = self._walls[level]
        return np.concatenate([walls[p] for p in pieces]), np.concatenate([self._surfaces[p] for p in pieces])


def furnish(
    street_map: StreetMap,
    profiles: Sequence[Profile],
    lines: Sequence[BaseGeometry],
    config: RoadsideConfig,
    *,
    driven_xy: FloatArray,
    seed: int,
) -> WallList:
    """Place everything that stands beside the road, along the visible part of each street's centre line.

    No obstacle comes nearer than its clearance to where the vehicle was, (N, 2) places at most some metres apart. The
    seed, with the ids of the streets, decides everything: the same street looks the same in every run.
    """
    walls = WallList()
    yard = Yard(profiles, lines, driven_xy, [xy for _, xy in street_map.parking])
    for xy, height in _buildings(street_map, profiles, lines, config, yard, seed):
        walls.add_line(xy, -1.0, height, Surface.BUILDING)
    for number, (profile, line) in enumerate(zip(profiles, lines, strict=True)):
        if not isinstance(line, LineString) or line.is_empty:
            continue
        street = profile.street
        rng = np.random.default_rng([seed, street.way_id & 0x7FFFFFFF, street.part, 2])
        _park_cars(walls, profile, line, config, yard, rng, number)
        if not profile.is_service:
            _grow_hedges(walls, profile, line, config, yard, rng)
    return walls


class Yard:
    """Tells what is free: neither road nor car park nor the path of the vehicle."""

    def __init__(
        self,
        profiles: Sequence[Profile],
        lines: Sequence[BaseGeometry],
        driven_xy: FloatArray,
        lots: Sequence[FloatArray],
    ) -> None:
        self._roads = [line.buffer(p.half_m) for p, line in zip(profiles, lines, strict=True)]
        self._tree = shapely.STRtree(self._roads)
        self._lots = [Polygon(xy) for xy in lots]
        self._driven = cKDTree(driven_xy)

    def off_road(self, geometry: BaseGeometry, distance_m: float = 0.0, *, besides: int = -1) -> bool:
        """Tell whether no street (but the one of that number) comes nearer than a distance."""
        found = self._tree.query(geometry, predicate="dwithin", distance=distance_m)
        return not any(int(i) != besides for i in found)

    def off_lots(self, geometry: BaseGeometry) -> bool:
        """Tell whether a geometry touches no car park."""
        return not any(lot.intersects(geometry) for lot in self._lots)

    def clear(self, places: FloatArray, distance_m: float) -> bool:
        """Tell whether the vehicle never came nearer to any of (N, 2) places."""
        return bool(np.min(self._driven.query(places)[0]) > distance_m)

    def cut(self, outline: Polygon) -> BaseGeometry:
        """Cut the streets and the path of the vehicle out of a building."""
        near = [self._roads[int(i)] for i in self._tree.query(outline, predicate="dwithin", distance=0.5)]
        centre = shapely.minimum_bounding_radius(outline)
        x, y = shapely.get_coordinates(outline.centroid)[0]
        driven = self._driven.query_ball_point([x, y], centre * 2 + VEHICLE_CLEARANCE_M)
        if driven:
            near.append(shapely.MultiPoint(self._driven.data[driven]).buffer(VEHICLE_CLEARANCE_M))
        return outline.difference(shapely.union_all(near).buffer(0.5)) if near else outline


def _buildings(
    street_map: StreetMap,
    profiles: Sequence[Profile],
    lines: Sequence[BaseGeometry],
    config: RoadsideConfig,
    yard: Yard,
    seed: int,
) -> Iterator[tuple[FloatArray, float]]:
    """Yield outlines and heights."""
    if config.buildings == "none":
        return
    for i, (tags, xy) in enumerate(street_map.buildings):
        if tags.get("layer", "0").startswith("-") or tags.get("location") == "underground":
            continue
        height = _height_m(tags, np.random.default_rng([seed, i, 3]))
        for outline in polygon_parts(shapely.make_valid(Polygon(xy))):
            for part in polygon_parts(yard.cut(outline)):
                if part.area > 8.0:
                    yield shapely.get_coordinates(part.exterior), height
    if config.buildings == "auto" and not street_map.buildings:
        yield from made_up_houses(profiles, lines, yard, seed)


def made_up_houses(
    profiles: Sequence[Profile], lines: Sequence[BaseGeometry], yard: Yard, seed: int
) -> Iterator[tuple[FloatArray, float]]:
    """Yield outlines (N, 2) in M and heights of a row of houses on both sides of every street of a town."""
    taken: list[Polygon] = []
    tree = shapely.STRtree([])
    for profile, line in zip(profiles, lines, strict=True):
        if not profile.urban or profile.is_service or not isinstance(line, LineString):
            continue
        rng = np.random.default_rng([seed, profile.street.way_id & 0x7FFFFFFF, profile.street.part, 4])
        fresh: list[Polygon] = []
        for left in (True, False):
            for along in np.arange(PLOT_M / 2, line.length, PLOT_M):
                built, width, depth, back, storeys = rng.random(5)
                if built > BUILT_SHARE:
                    continue
                place, heading = _at(line, float(along))
                depth_m = 8.5 + 4 * depth
                offset = profile.edge_m(left=left) + 2.0 + 5.0 * back + depth_m / 2
                centre = place + (1 if left else -1) * offset * np.array([-np.sin(heading), np.cos(heading)])
                corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([9.0 + 5.0 * width, depth_m]) / 2
                c, s = np.cos(heading), np.sin(heading)
                outline = Polygon(corners @ np.array([[c, s], [-s, c]]) + centre)
                if not (yard.off_road(outline, 3.5) and yard.off_lots(outline)) or not yard.clear(
                    shapely.get_coordinates(outline), 5.0
                ):
                    continue
                if len(tree.query(outline, predicate="dwithin", distance=1.0)) or any(
                    outline.distance(other) < 1.0 for other in fresh
                ):
                    continue
                fresh.append(outline)
                yield shapely.get_coordinates(outline.exterior), 5.0 + 6.0 * storeys
        taken += fresh
        tree = shapely.STRtree(taken)


def _park_cars(
    walls: WallList,
    profile: Profile,
    line: LineString,
    config: RoadsideConfig,
    yard: Yard,
    rng: np.random.Generator,
    number: int,
) -> None:
    """Fill some of the places at the kerb, in bays, and across the lanes of car parks."""
    aisle = profile.street.tags.get("service") == "parking_aisle"
    if not aisle and not (profile.urban and profile.kind.parking):
        return
    density = config.parked_car_density * rng.uniform(0.4, 1.6)
    slot = 2.7 if aisle else CAR_SLOT_M
    for left in (True, False):
        bay = profile.bay_left_m if left else profile.bay_right_m
        if not aisle and not bay and left and profile.half_m < 2.9:
            continue  # too narrow for cars on both sides
        for along in np.arange(JUNCTION_CLEARANCE_M, line.length - JUNCTION_CLEARANCE_M, slot):
            taken, shift, jitter, van = rng.random(4)
            if taken > density:
                continue
            place, heading = _at(line, float(along + 0.6 * (shift if not aisle else 0)))
            if aisle:
                offset, heading_car = profile.half_m + 2.6, heading + np.pi / 2
            else:
                offset, heading_car = profile.half_m + (bay / 2 if bay else -0.75) + 0.3 * (jitter - 0.5), heading
            centre = place + (1 if left else -1) * offset * np.array([-np.sin(heading), np.cos(heading)])
            if not yard.clear(centre[None], VEHICLE_CLEARANCE_M) or not yard.off_road(
                Point(centre), 0.7, besides=number
            ):
                continue
            _add_car(walls, centre, heading_car + 0.04 * (jitter - 0.5), van > 0.9)


def _add_car(walls: WallList, centre: FloatArray, heading: float, van: bool) -> None:
    if van:
        walls.add_box(centre, heading, (4.9, 1.9), 0.0, 2.0, Surface.CAR)
        return
    walls.add_box(centre, heading, (4.3, 1.76), 0.0, 0.85, Surface.CAR)
    walls.add_box(centre, heading, (2.4, 1.55), 0.85, 1.45, Surface.CAR)


def _grow_hedges(
    walls: WallList, profile: Profile, line: LineString, config: RoadsideConfig, yard: Yard, rng: np.random.Generator
) -> None:
    """Stand hedges and fences behind the sidewalk, bushes farther off along country roads."""
    for left in (True, False):
        if left and profile.median_left:
            continue
        along = rng.uniform(2.0, 10.0)
        while along < line.length - 4.0:
            length, grown, tall, fence, away = rng.random(5)
            stop = min(along + 6.0 + 12.0 * length, line.length)
            offset = profile.edge_m(left=left) + (0.3 if profile.urban else 2.0 + 6.0 * away)
            ends = []
            for s in (along, (along + stop) / 2, stop):
                place, heading = _at(line, s)
                ends.append(place + (1 if left else -1) * offset * np.array([-np.sin(heading), np.cos(heading)]))
            xy = np.array(ends)
            if (
                grown < config.hedge_share
                and yard.off_road(LineString(xy), 0.8)
                and yard.clear(xy, VEHICLE_CLEARANCE_M)
            ):
                height = 0.5 + 1.3 * tall if profile.urban else 1.0 + 3.0 * tall
                walls.add_line(xy, -0.3, height, Surface.FENCE if fence < 0.4 else Surface.VEGETATION)
            along = stop + 3.0 + 3.0 * away


def _at(line: LineString, along_m: float) -> tuple[FloatArray, float]:
    """Return the place and the heading at a distance along a line."""
    a = shapely.get_coordinates(line.interpolate(max(along_m - 0.5, 0.0)))[0]
    b = shapely.get_coordinates(line.interpolate(along_m + 0.5))[0]
    return shapely.get_coordinates(line.interpolate(along_m))[0], float(np.arctan2(*(b - a)[::-1]))


def _height_m(tags: dict[str, str], rng: np.random.Generator) -> float:
    for key, factor, extra in (("height", 1.0, 0.0), ("building:levels", 3.0, 2.0)):
        match = re.match(r"\s*(\d+(?:\.\d+)?)", tags.get(key, ""))
        if match:
            return float(np.clip(float(match.group(1)) * factor + extra, 2.0, 80.0))
    return float(rng.uniform(2.5, 3.0) if tags.get("building") in {"garage", "garages", "shed"} else rng.uniform(5, 11))


@dataclass
class Scene:
    """Everything that a LiDAR can see along a track; `build_scene` makes one."""

    street_map: StreetMap
    profiles: list[Profile]
    """Cross-sections of the streets."""
    ground: GroundRaster
    heights: list[HeightField]
    """As seen from the usual level and, where the track needs it, from streets that are hidden from there."""
    obstacles: Obstacles
    T_map_lidar: FloatArray
    """(N, 4, 4) float64: the poses of the track, with the sensor at its height above this ground."""
    level: IntArray
    """(N,) int64: from which level each pose sees the scene."""

    @property
    def frame(self) -> LocalFrame:
        """The plane M in which the scene is drawn."""
        return self.street_map.frame


def build_scene(
    track: LidarTrack, data: MapData, *, config: SceneConfig | None = None, sensor_height_m: float = 1.73, seed: int = 0
) -> Scene:
    """Draw the world of a map, from `read_map`, around a track; a map that lies elsewhere is a MapError.

    The track has all poses of the drive, also those that are not simulated: they carry the heights. Houses are made up
    if the map has no building at all. All that is random follows from the seed.
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
    towns = config.roadside.buildings == "none" or not street_map.buildings
    profiles = street_profiles(street_map, config.streets, towns=towns, seed=seed)

    crossings = find_crossings(profiles)
    level = _levels(profiles, crossings, xy)
    levels = int(level.max()) + 1
    driven = _driven(xy, config.track_half_width_m, level, crossings)
    lines = [visible_lines(profiles, crossings, from_hidden=bool(k)) for k in range(levels)]
    plans = [plan_ground(street_map, profiles, lines[k], config.streets, driven=driven[k]) for k in range(levels)]
    differences = shapely.union_all([c.clearing for c in crossings]).buffer(LEVEL_REACH_M)
    ground = GroundRaster(plans, differences, box, cell_m=config.cell_m)
    heights = _heights(poses, level, sensor_height_m, config)
    for i, pose in enumerate(poses):
        # Above this ground, not at the satellites' altitude, which drifts by metres between two visits.
        pose[2, 3] = heights[level[i]].at(pose[0, 3], pose[1, 3]) + sensor_height_m
    walls = furnish(street_map, profiles, lines[0], config.roadside, driven_xy=_every_metre(xy), seed=seed)
    return Scene(street_map, profiles, ground, heights, Obstacles(walls, heights), poses, level)


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


def _heights(poses: FloatArray, level: IntArray, sensor_height_m: float, config: SceneConfig) -> list[HeightField]:
    if config.flat:
        return [HeightField(np.zeros((2, 2), np.float32), 0.0, 0.0, 1.0)] * (int(level.max()) + 1)  # the plane z = 0
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
