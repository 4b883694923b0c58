"""The ground of a scene: its materials, its height, and layers of polygons painted one over the other, in tiles."""

import math
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal, NamedTuple

import cv2
import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Point, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from interloc.arrays import Float32Array, FloatArray, Int32Array, UInt8Array
from interloc.lab.config import StreetConfig
from interloc.lab.raycast import STEP_M, height_at
from interloc.lab.streets import SIDEWALK_M, YARD_SERVICES, Profile, StreetMap

KERB_M = 2 * STEP_M
_CELL_M = 4.0
_SMOOTH_M = 6.0  # width of the Gaussian that smooths the heights along a track
_SLOPE_M, _AHEAD_M = 10.0, 40.0
_PIECE_M, _OFF_PITCH = 5.0, 0.1
ARM_M = 32.0
JUNCTION_REACH_M = 24.0
TURNING_CIRCLE_M = 7.0
MEDIAN_KERB_M = 1.0
_SUBPIXEL_BITS = 4
_TILE_M, _TILES = 64.0, 96  # side of a tile, and number of tiles kept in memory


class Surface(IntEnum):
    """Code of a piece of ground or of an obstacle."""

    TERRAIN = 0
    ROAD = 1
    MARKING = 2
    SIDEWALK = 3
    PARKING = 4
    OTHER_GROUND = 5
    BUILDING = 6
    CAR = 7
    VEGETATION = 8
    FENCE = 9


class Material(NamedTuple):
    """Properties of a surface."""

    label: int
    """SemanticKITTI id."""
    raise_m: float
    """Height above the road."""
    roughness_m: float
    """Standard deviation of the height (ground) or of the range (obstacles)."""
    remission: float
    remission_std: float
    """Mean and spread, as measured on sequence 07 of SemanticKITTI."""
    reflectance: float
    """How well it is seen from afar, relative to a wall."""


MATERIALS: dict[Surface, Material] = {
    Surface.TERRAIN: Material(72, STEP_M, 0.030, 0.35, 0.115, 1.2),
    Surface.ROAD: Material(40, 0.0, 0.005, 0.265, 0.085, 1.0),
    Surface.MARKING: Material(60, 0.0, 0.005, 0.48, 0.12, 1.6),
    Surface.SIDEWALK: Material(48, KERB_M, 0.006, 0.295, 0.088, 1.1),
    Surface.PARKING: Material(44, 0.0, 0.008, 0.28, 0.09, 1.0),
    Surface.OTHER_GROUND: Material(49, KERB_M, 0.012, 0.31, 0.10, 1.1),
    Surface.BUILDING: Material(50, 0.0, 0.03, 0.327, 0.15, 1.0),
    Surface.CAR: Material(10, 0.0, 0.02, 0.12, 0.20, 0.8),
    Surface.VEGETATION: Material(70, 0.0, 0.15, 0.35, 0.12, 0.9),
    Surface.FENCE: Material(51, 0.0, 0.04, 0.30, 0.13, 0.7),
}

MATERIAL_TABLE = np.array([MATERIALS[code] for code in Surface], dtype=np.float64)
"""(surfaces, 6) float64: the columns of `Material`, one row per code; the kernel reads it."""


@dataclass(frozen=True)
class HeightField:
    """Heights on a coarse grid."""

    grid: Float32Array
    """(rows, columns) float32: height in M, metres; sample (r, c) lies at (x0_m + c * cell_m, y0_m + r * cell_m)."""
    x0_m: float
    y0_m: float
    cell_m: float

    @property
    def frame(self) -> FloatArray:
        """(3,) float64: x0, y0, cell, as the kernel takes them."""
        return np.array([self.x0_m, self.y0_m, self.cell_m])

    def at(self, x: float, y: float) -> float:
        """Return the height of a place."""
        return float(height_at(self.grid, self.x0_m, self.y0_m, self.cell_m, float(x), float(y)))


def fit_heights(xyz: FloatArray, *, margin_m: float) -> HeightField:
    """Spread heights known along a track, (N, 3) ground points under the vehicle in M, over its neighbourhood.

    Where the track passes a place again at another height (drift of satellite heights), the mean counts. Push-pull
    interpolation: cell means are averaged into ever coarser grids, and empty cells take the value of the finest coarser
    grid that knows one. Then one blur.
    """
    low = xyz[:, :2].min(axis=0) - margin_m
    size = np.ceil((xyz[:, :2].max(axis=0) + margin_m - low) / _CELL_M).astype(int) + 2
    base = float(np.mean(xyz[:, 2]))
    column, row = np.rint((xyz[:, :2] - low) / _CELL_M).astype(int).T
    weight = np.zeros((size[1], size[0]), np.float32)
    total = np.zeros_like(weight)
    np.add.at(weight, (row, column), 1.0)
    np.add.at(total, (row, column), xyz[:, 2] - base)
    mean = np.divide(total, weight, out=total, where=weight > 0)
    filled = _push_pull(mean, (weight > 0).astype(np.float32))
    blurred = cv2.GaussianBlur(filled, (0, 0), _SMOOTH_M / _CELL_M, borderType=cv2.BORDER_REPLICATE)
    return HeightField((blurred + base).astype(np.float32), float(low[0]), float(low[1]), _CELL_M)


def beyond_ends(xyz: FloatArray) -> FloatArray:
    """Lead a track, (N, 3) ground points in M, on for 40 m beyond both ends, as it rises there.

    Else the ground ahead has heights of elsewhere. A track that is hardly longer than a vehicle has no ends to lead on.
    """
    found = [np.empty((0, 3))]
    for track in (xyz, xyz[::-1]):
        away = np.linalg.norm(track - track[0], axis=1)
        if (away > _SLOPE_M).any():
            row = int(np.argmax(away > _SLOPE_M))
            found.append(
                track[0] + np.arange(_CELL_M, _AHEAD_M, _CELL_M)[:, None] * (track[0] - track[row]) / away[row]
            )
    return np.concatenate(found)


def without_drift(xyz: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """Take out of a track what it rises and the vehicle does not: satellite heights that settle fall by many metres.

    Of (N, 3) ground points, pieces of 5 m that rise by 10 % more, or less, than the vehicle is pitched (N,) rise as it
    is pitched.
    """
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz[:, :2], axis=0), axis=1))])
    at = np.arange(0.0, driven[-1] + 2 * _PIECE_M, _PIECE_M)
    heights = np.interp(at, driven, xyz[:, 2])
    climbed = _PIECE_M * np.tan(np.interp(at[:-1], driven, pitch_rad))
    more = np.diff(heights) - climbed
    more[np.abs(more) < _OFF_PITCH * _PIECE_M] = 0.0
    drift = np.append(np.cumsum(more[::-1])[::-1], 0.0)  # the heights of the end count
    found = xyz.copy()
    found[:, 2] += np.interp(driven, at, drift)
    drifts = more[np.minimum(driven / _PIECE_M, len(more) - 1).astype(np.int64)] != 0.0
    found[drifts, 2] = np.interp(driven[drifts], at, heights + drift)
    return found


def _push_pull(mean: Float32Array, weight: Float32Array) -> Float32Array:
    if weight.all() or max(weight.shape) == 1:
        return mean
    rows, columns = mean.shape
    padded = ((0, rows % 2), (0, columns % 2))
    sums = np.pad(mean * weight, padded).reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2).sum(axis=(1, 3))
    weights = np.pad(weight, padded).reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2).sum(axis=(1, 3))
    coarse_mean = np.divide(sums, weights, out=np.zeros_like(sums), where=weights > 0)
    coarse = _push_pull(coarse_mean, np.minimum(weights, 1.0))
    fine = cv2.resize(coarse, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)[:rows, :columns]
    return np.where(weight > 0, mean, fine).astype(np.float32)


@dataclass
class Layer:
    """Polygons of one surface that are painted together."""

    surface: Surface
    polygons: list[BaseGeometry] = field(default_factory=list)
    tree: shapely.STRtree = field(default_factory=lambda: shapely.STRtree([]))

    def add(self, geometry: BaseGeometry) -> None:
        """Add a polygon unless it is empty."""
        if not geometry.is_empty:
            self.polygons.append(geometry)

    def close(self) -> "Layer":
        """Index the polygons; call once all are in."""
        self.tree = shapely.STRtree(self.polygons)
        return self


def plan_ground(
    street_map: StreetMap,
    profiles: Sequence[Profile],
    lines: Sequence[BaseGeometry],
    config: StreetConfig,
    *,
    driven: BaseGeometry,
) -> list[Layer]:
    """Lay out the ground along the visible part of each street's centre line.

    Where was `driven` is road in any case. Bottom first: footways, car parks, drives, sidewalks and medians, bays,
    lanes of car parks, service roads, roads with rounded kerbs, lane markings.
    """
    paths, lots, drives = Layer(Surface.SIDEWALK), Layer(Surface.PARKING), Layer(Surface.PARKING)
    medians, walks, bays = Layer(Surface.OTHER_GROUND), Layer(Surface.SIDEWALK), Layer(Surface.PARKING)
    aisles, alleys = Layer(Surface.PARKING), Layer(Surface.OTHER_GROUND)
    roads, marks = Layer(Surface.ROAD), Layer(Surface.MARKING)
    for tags, xy in street_map.footways:
        paths.add(LineString(xy).buffer(1.8 if tags["highway"] == "pedestrian" else 1.1))
    for _, xy in street_map.parking:
        lots.add(shapely.make_valid(Polygon(xy)))
    for profile, line in zip(profiles, lines, strict=True):
        surface = line.buffer(profile.half_m)
        aside = _aside(profile, config)
        if aside is not None:
            {"drive": drives, "aisle": aisles, "alley": alleys}[aside].add(surface)
            continue
        roads.add(surface)
        for part in line_parts(line):
            _add_sides(part, profile, walks, medians, bays)
            if profile.kind.marked:
                _add_dashes(part, profile, marks)
    for fillet, profile_walk in _fillets(street_map, profiles, lines, config):
        roads.add(fillet)
        if profile_walk > 0:
            walks.add(fillet.buffer(profile_walk))
    on_road = {n for p in profiles if _aside(p, config) is None for n in p.street.nodes}
    for node in on_road.intersection(street_map.turning_circles):
        disc = Point(street_map.node_xy[node]).buffer(TURNING_CIRCLE_M)
        roads.add(disc)
        walks.add(disc.buffer(SIDEWALK_M))
    roads.add(driven)
    return [layer.close() for layer in (paths, lots, drives, medians, walks, bays, aisles, alleys, roads, marks)]


def _aside(profile: Profile, config: StreetConfig) -> Literal["drive", "aisle", "alley"] | None:
    """Return the kind of a driven street that is not labelled road; None for road."""
    if (service := profile.street.tags.get("service")) in YARD_SERVICES:  # labelled as parking
        return "drive" if service == "driveway" else "aisle"
    return "alley" if profile.is_service and config.service_roads == "other_ground" else None


def paint(layers: Iterable[Layer], x0: float, y0: float, side_m: float, cells: int) -> UInt8Array:
    """Paint the square of ground whose corner of least x and y in M is (x0, y0).

    Returns (cells, cells) uint8 surface codes; row 0 at y0, column 0 at x0.
    """
    image = np.zeros((cells, cells), np.uint8)
    box = shapely.box(x0, y0, x0 + side_m, y0 + side_m)
    scale = cells / side_m * (1 << _SUBPIXEL_BITS)
    origin = np.array([x0, y0])
    half = 1 << (_SUBPIXEL_BITS - 1)

    def fill(polygon: Polygon, code: int) -> None:
        rings = [
            np.rint((shapely.get_coordinates(ring) - origin) * scale - half).astype(np.int32)
            for ring in (polygon.exterior, *polygon.interiors)
        ]
        cv2.fillPoly(image, rings, code, lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)

    around = box.buffer(1.0)
    for layer in layers:
        for i in layer.tree.query(box, predicate="intersects"):
            for polygon in polygon_parts(layer.polygons[int(i)].intersection(around)):
                fill(polygon, int(layer.surface))
    return image


def polygon_parts(geometry: BaseGeometry) -> list[Polygon]:
    """Return the polygons of a geometry of any kind."""
    if isinstance(geometry, Polygon):
        return [] if geometry.is_empty else [geometry]
    return [p for part in getattr(geometry, "geoms", ()) for p in polygon_parts(part)]


def line_parts(line: BaseGeometry) -> list[LineString]:
    """Return the pieces of a line that may be cut, or gone."""
    parts = line.geoms if hasattr(line, "geoms") else [line]
    return [part for part in parts if isinstance(part, LineString) and part.length > 0.5]


def _side(line: LineString, left_m: float) -> BaseGeometry:
    """Return the strip beside a line, to the left for positive widths."""
    return shapely.make_valid(line.buffer(left_m, single_sided=True))


def _add_sides(line: LineString, profile: Profile, walks: Layer, medians: Layer, bays: Layer) -> None:
    left, right = profile.edge_m(left=True), profile.edge_m(left=False)
    if profile.walk_left_m and profile.walk_right_m and math.isclose(left, right):
        walks.add(line.buffer(left))
    else:
        if profile.walk_left_m:
            walks.add(_side(line, left))
        if profile.walk_right_m:
            walks.add(_side(line, -right))
    if profile.median_left:
        medians.add(_side(line, profile.half_m + MEDIAN_KERB_M))
    if line.length > 40.0 and (profile.bay_left_m or profile.bay_right_m):
        middle = LineString(substring(line, 12.0, line.length - 12.0).coords)
        if profile.bay_left_m:
            bays.add(_side(middle, profile.half_m + profile.bay_left_m))
        if profile.bay_right_m:
            bays.add(_side(middle, -profile.half_m - profile.bay_right_m))


def _add_dashes(line: LineString, profile: Profile, marks: Layer) -> None:
    """Mark the middle of two-way streets and of carriageways with an even number of lanes: 3 m lines, 6 m gaps."""
    if profile.oneway and round(2 * profile.half_m / 3.5) % 2:
        return
    for start in np.arange(9.0, line.length - 12.0, 9.0):
        marks.add(substring(line, float(start), float(start) + 3.0).buffer(0.075, cap_style="flat"))


def _fillets(
    street_map: StreetMap, profiles: Sequence[Profile], lines: Sequence[BaseGeometry], config: StreetConfig
) -> Iterable[tuple[BaseGeometry, float]]:
    """Round the kerbs of every junction; yield the surface and the width of the sidewalk around it.

    Closing the union of the arms by a disc fills each corner with an arc of that radius. Only the arms of one node
    take part, so that the strip between two carriageways stays.
    """
    number = {id(p.street): i for i, p in enumerate(profiles)}
    for node, arms in street_map.arms().items():
        centre = Point(street_map.node_xy[node])
        chosen = []
        for street, starts in arms:
            i = number[id(street)]
            if _aside(profiles[i], config) or lines[i].is_empty or lines[i].distance(centre) > 0.1:
                continue
            line = profiles[i].line
            arm = substring(line, 0, ARM_M) if starts else substring(line, line.length - ARM_M, line.length)
            chosen.append((profiles[i], arm.intersection(lines[i].buffer(0.1))))
        if len(chosen) < 3:
            continue
        radius = min(p.kind.corner_radius_m for p, _ in chosen) * config.corner_radius_factor
        union = shapely.union_all([arm.buffer(p.half_m) for p, arm in chosen])
        rounded = union.buffer(radius, quad_segs=6).buffer(-radius, quad_segs=6)
        fillet = rounded.intersection(centre.buffer(JUNCTION_REACH_M))
        walk = max(max(p.walk_left_m, p.walk_right_m) for p, _ in chosen)
        if isinstance(fillet, Polygon | MultiPolygon):
            yield fillet, walk


class GroundRaster:
    """The ground around the sensor as surface codes.

    The plans are the ground as seen from the usual level, and (optional) from a street that it hides; where they do not
    differ they share tiles. `box` is the world in M: least x, least y, greatest x, greatest y.
    """

    def __init__(
        self, plans: Sequence[list[Layer]], differences: BaseGeometry, box: Sequence[float], *, cell_m: float
    ) -> None:
        self._plans = plans
        self._differences = differences
        self._cells = max(round(_TILE_M / cell_m), 1)
        self._x0, self._y0 = float(box[0]), float(box[1])
        columns, rows = (int(np.ceil((box[i + 2] - box[i]) / _TILE_M)) + 1 for i in (0, 1))
        self.index: Int32Array = np.full((rows, columns), -1, np.int32)
        self.tiles: UInt8Array = np.zeros((_TILES, self._cells, self._cells), np.uint8)
        self._slots: OrderedDict[tuple[int, int, int], int] = OrderedDict()
        self._shown: list[tuple[int, int]] = []

    @property
    def frame(self) -> FloatArray:
        """(3,) float64: x0, y0, side of a tile, as the kernel takes them."""
        return np.array([self._x0, self._y0, _TILE_M])

    def show(self, x: float, y: float, reach_m: float, *, plan: int = 0) -> None:
        """Make `index` and `tiles` hold everything within `reach_m` of a place."""
        for row, column in self._shown:
            self.index[row, column] = -1
        low = np.floor((np.array([x, y]) - reach_m - [self._x0, self._y0]) / _TILE_M).astype(int)
        high = np.floor((np.array([x, y]) + reach_m - [self._x0, self._y0]) / _TILE_M).astype(int)
        rows = range(max(low[1], 0), min(high[1], self.index.shape[0] - 1) + 1)
        columns = range(max(low[0], 0), min(high[0], self.index.shape[1] - 1) + 1)
        self._shown = [(row, column) for row in rows for column in columns]
        if len(self._shown) > len(self.tiles):
            self.tiles = np.concatenate([self.tiles, np.zeros((len(self._shown), *self.tiles.shape[1:]), np.uint8)])
        for row, column in self._shown:
            self.index[row, column] = self._slot(row, column, plan)

    def _slot(self, row: int, column: int, plan: int) -> int:
        left, bottom = self._x0 + column * _TILE_M, self._y0 + row * _TILE_M
        if plan:
            tile = shapely.box(left, bottom, left + _TILE_M, bottom + _TILE_M)
            plan = plan if self._differences.intersects(tile) else 0
        key = (row, column, plan)
        if key in self._slots:
            self._slots.move_to_end(key)
            return self._slots[key]
        full = len(self._slots) == len(self.tiles)
        slot = self._slots.popitem(last=False)[1] if full else len(self._slots)
        self.tiles[slot] = paint(self._plans[plan], left, bottom, _TILE_M, self._cells)
        self._slots[key] = slot
        return slot
