"""Drives through places whose axes are known exactly, and how far off the intersections found in them are.

A place is drawn by its kind and a number, and driven through along each pair of its arms. What a LiDAR sees of it is
rendered without a scene: rings of points on flat ground, of a class that is looked up in a picture of the place, as far
as no house and no car stands before them. Even numbers are to choose by, odd ones to report by: no place is in both.
"""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise
from typing import Literal

import numpy as np
import pandas as pd
import shapely
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import linear_sum_assignment
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry
from shapely.ops import unary_union

from interloc.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from interloc.config import DetectorConfig
from interloc.drive import Georeference, GroundPoints
from interloc.errors import ConfigError
from interloc.kernels import compiled
from interloc.lab.config import LidarConfig
from interloc.lab.drive import Lidar
from interloc.lab.ground import Layer, Surface, line_parts, paint
from interloc.lab.junction_shapes import KINDS, Plan
from interloc.lab.streets import shortest_path
from interloc.pipeline import detect
from interloc.processes import Progress

Part = Literal["choosing", "reporting"]
PARTS: tuple[Part, ...] = ("choosing", "reporting")
"""Places of even numbers, and of odd ones: decided before anything was measured."""

MATCH_M = 10.0
"""An intersection with no node of its own within it is false; a node without one counts as this far off."""
PASSED_M = 12.0
"""A node nearer than this to the way of the vehicle is to be found."""
_CELL_M = 0.1
_HALF_M = 110.0  # of the picture of a place
_WAY_M = 48.0  # along an arm, before and behind the place
_SHOTS = 768
_WALK_M = 2.0
_MARCH_M = 0.4
_CLEAR_M = 14.0  # around nodes, where no car stands at the kerb
_CAR_M = 1.5
_CAR, _BUILDING = int(Surface.CAR), int(Surface.BUILDING)
_LIDAR = LidarConfig()
_DOWN = -Lidar(_LIDAR).elevations
_RANGES_M = np.sort(_LIDAR.height_m / np.tan(_DOWN[np.radians(1.5) < _DOWN]))
_MOST_WAYS = 6
BOUND_95 = 5.991464547107979
"""Squared distance in sigmas that holds 95 % of a normal distribution in the plane: -2 ln 0.05, 2.45 squared."""
_RESAMPLES = 1000


@dataclass(frozen=True)
class Conditions:
    """What makes it hard to see a place."""

    name: str
    cars: float = 0.0
    """Share of the places along kerbs that are taken."""
    houses: bool = False
    wrong: float = 0.0
    """Share of the labels that are wrong, from point to point."""
    border_m: float = 0.0
    """By how much the borders of labels waver."""
    spacing_m: float = 2.5
    """From a keyframe to the next."""


CONDITIONS = (
    Conditions("clear"),
    Conditions("cars, houses", cars=0.4, houses=True),
    Conditions("labels 20/20", wrong=0.2, houses=True),
    Conditions("borders", cars=0.2, border_m=0.35),
    Conditions("keyframes 8 m apart", spacing_m=8.0, houses=True),
    Conditions("all", cars=0.3, houses=True, wrong=0.05, border_m=0.2, spacing_m=4.0),
)
"""Of a kind, each number has one, in turn."""


class Place:
    """A place of a kind by its number, turned and mirrored at random, its middle at the origin."""

    def __init__(self, kind: str, number: int) -> None:
        self.kind, self.number = kind, number
        self.conditions = CONDITIONS[number // 2 % len(CONDITIONS)]
        self.rng = np.random.default_rng([zlib.crc32(kind.encode()), number])
        self.plan = Plan(self.rng)
        KINDS[kind](self.plan)
        turn, mirror = self.rng.uniform(0.0, 2.0 * np.pi), self.rng.choice([-1.0, 1.0])
        self._turn = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ np.diag([1.0, mirror])
        self._offset = self.rng.uniform(-1.0, 1.0, 2)

    def _placed(self, xy: FloatArray) -> FloatArray:
        placed: FloatArray = xy @ self._turn.T + self._offset
        return placed

    @cached_property
    def nodes(self) -> FloatArray:
        """(N, 2) float64: where the axes meet, metres in W."""
        return self._placed(np.array(self.plan.nodes)[self.plan.intersections])

    def ways(self) -> Iterator[tuple[str, FloatArray]]:
        """Yield a name and the axis, (P, 2), of each way through the place, from arm to arm, at most six."""
        ends = [n for n, degree in enumerate(self.plan.degrees) if degree == 1]
        found = []
        for a, b in combinations(ends, 2):
            one, other = (a, b) if self.rng.random() < 0.5 else (b, a)
            line = self._shortest(one, other)
            line = self._shortest(other, one) if line is None else line
            if line is not None:
                found.append((f"{one} to {other}", line))
        for i in np.unique(np.linspace(0, len(found) - 1, min(len(found), _MOST_WAYS)).round().astype(int)).tolist():
            yield found[i]

    def _shortest(self, start: int, goal: int) -> FloatArray | None:
        steps: dict[int, list[tuple[int, float]]] = {}
        lines: dict[tuple[int, int], tuple[float, FloatArray]] = {}
        for road in self.plan.roads:
            length = LineString(road.xy).length
            for a, b, xy in ((road.start, road.end, road.xy), (road.end, road.start, road.xy[::-1]))[: 2 - road.oneway]:
                steps.setdefault(a, []).append((b, length + 1e-6 * b))
                lines[a, b] = min(lines.get((a, b), (np.inf, xy)), (length, xy), key=lambda each: each[0])
        path = shortest_path(steps, start, goal)
        return None if path is None else self._placed(np.concatenate([lines[step][1] for step in pairwise(path)]))

    @cached_property
    def picture(self) -> tuple[UInt8Array, FloatArray]:
        """The classes of ground and obstacles, and the corner of least x and y."""
        plan, hard = self.plan, self.conditions
        roads = unary_union([LineString(road.xy).buffer(road.width_m / 2, cap_style="flat") for road in plan.roads])
        surface = unary_union([roads.buffer(plan.kerb_m).buffer(-plan.kerb_m), *plan.surfaces])
        surface = surface.difference(unary_union(plan.islands)) if plan.islands else surface
        paved = unary_union([surface, *plan.parking])
        cars = [self._row(line, 0.75) for line in plan.cars]
        crossings = unary_union([shapely.Point(node).buffer(_CLEAR_M) for node in plan.nodes])
        for road in plan.roads if hard.cars else ():
            line = LineString(road.xy)
            if line.length > 40.0 and road.width_m > 5.5 and not road.oneway:
                side = float(self.rng.choice([-1.0, 1.0])) * (road.width_m / 2 - 1.1)
                cars += [
                    self._row(part, hard.cars) for part in line_parts(line.offset_curve(side).difference(crossings))
                ]
        layers = [
            (Surface.SIDEWALK, paved.buffer(_WALK_M)),
            (Surface.ROAD, surface),
            (Surface.PARKING, unary_union(plan.parking)),
            (Surface.CAR, unary_union(cars)),
        ]
        if hard.houses:
            gap = self.rng.uniform(3.0, 9.0)
            layers.insert(0, (Surface.TERRAIN, paved.buffer(_WALK_M + gap)))
        low, side = np.full(2, -_HALF_M), 2 * _HALF_M
        whole = Layer(Surface.BUILDING if hard.houses else Surface.TERRAIN, [shapely.box(*low, *-low)])
        placed = [Layer(code, [shapely.transform(shape, self._placed)]) for code, shape in layers]
        layers_of = [layer.close() for layer in (whole, *placed)]
        return paint(layers_of, -_HALF_M, -_HALF_M, side, int(side / _CELL_M)), low

    def _row(self, line: LineString, share: float) -> BaseGeometry:
        """Return the cars of a row."""
        cars = []
        for at in np.arange(3.0, line.length - 2.5, 5.6):
            if self.rng.random() < share:
                ends = [line.interpolate(at - 2.2), line.interpolate(at + 2.2)]
                cars.append(LineString(ends).buffer(0.9, cap_style="flat"))
        return unary_union(cars)


@dataclass(frozen=True)
class PlaceDrive:
    """A drive through a place; W is the frame of the place."""

    name: str
    place: Place
    way: FloatArray
    seed: int
    georeference: Georeference | None = None
    times_s: FloatArray | None = None

    @cached_property
    def driven(self) -> FloatArray:
        """(N, 3) float64: x, y and heading at each keyframe, on the right-hand side of the road."""
        rng = np.random.default_rng(self.seed)
        line = LineString(self.way)
        nodes = [line.project(shapely.Point(node)) for node in self.place.nodes]
        begin, end = max(min(nodes) - _WAY_M, 0.0), min(max(nodes) + _WAY_M, line.length)
        along = np.arange(begin, end, 0.5)
        xy = shapely.get_coordinates([line.interpolate(each) for each in along])
        heading = self._heading(gaussian_filter1d(xy, 6.0, axis=0, mode="nearest"))
        aside = np.column_stack([np.sin(heading), -np.cos(heading)])
        xy = gaussian_filter1d(xy + rng.uniform(1.0, 1.8) * aside, 6.0, axis=0, mode="nearest")
        gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
        rows = np.unique(np.searchsorted(gone, np.arange(0.0, gone[-1], self.place.conditions.spacing_m)))
        return np.column_stack([xy, self._heading(xy)])[rows]

    @staticmethod
    def _heading(xy: FloatArray) -> FloatArray:
        along = np.gradient(xy, axis=0)
        return np.arctan2(along[:, 1], along[:, 0])

    @property
    def frames(self) -> IntArray:
        """(N,) int64 numbers."""
        return np.arange(len(self.driven))

    @cached_property
    def T_world_lidar(self) -> FloatArray:
        """(N, 4, 4) float64."""
        poses = np.tile(np.eye(4), (len(self.driven), 1, 1))
        cos, sin = np.cos(self.driven[:, 2]), np.sin(self.driven[:, 2])
        poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1] = cos, -sin, sin, cos
        poses[:, :2, 3] = self.driven[:, :2]
        return poses

    def ground_points(self, index: int) -> GroundPoints:
        """Render a scan."""
        rng = np.random.default_rng([self.seed, index])
        hard = self.place.conditions
        x, y, heading = self.driven[index].tolist()
        picture, low = self.place.picture
        angles = 2.0 * np.pi * (np.arange(_SHOTS) + rng.random()) / _SHOTS
        way = np.column_stack([np.cos(angles), np.sin(angles)])
        turned = way @ np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        seen = see(picture, (np.array([x, y]) - low) / _CELL_M, turned / _CELL_M, _RANGES_M, _CAR_M / _LIDAR.height_m)
        lost = 0.03 + 0.5 * np.minimum((_RANGES_M / 60.0) ** 3, 1.9)
        shot, ring = np.nonzero(seen & (rng.random(seen.shape, np.float32) > lost))
        away = (_RANGES_M[ring] + 0.02 * rng.standard_normal(len(ring)))[:, None]
        points = np.column_stack([away * way[shot], np.full(len(ring), -_LIDAR.height_m)])
        places = np.array([x, y]) + away * turned[shot]
        if hard.border_m:
            places = places + hard.border_m * self._wavering(places, index)
        cells = np.clip((places - low) / _CELL_M, 0, len(picture) - 1).astype(np.int64)
        code = picture[cells[:, 1], cells[:, 0]]
        is_road = code == Surface.ROAD
        is_other = (code == Surface.SIDEWALK) | (code == Surface.PARKING)
        if hard.wrong:  # as `MislabelledDrive`: road points are lost, other ground is taken for road
            wrong = rng.random(len(code)) < hard.wrong
            is_road, is_other = (is_road & ~wrong) | (is_other & wrong), is_other & ~wrong
        kept = is_road | is_other
        return GroundPoints.split(points[kept].astype(np.float32), is_road[kept])

    def _wavering(self, xy: FloatArray, index: int) -> FloatArray:
        """Return by how much borders are off at places, as a share: waves of 3 to 12 m that change along the drive."""
        rng = np.random.default_rng([self.seed, 7])
        total = np.zeros_like(xy)
        for _ in range(6):
            bearing, length, phase = rng.uniform([0.0, 3.0, 0.0], [2.0 * np.pi, 12.0, 2.0 * np.pi])
            wave = np.sin(2.0 * np.pi / length * (xy @ [np.cos(bearing), np.sin(bearing)]) + phase + 0.1 * index)
            total += wave[:, None] * rng.standard_normal(2)
        total /= np.sqrt(6.0)
        return total


@compiled
def see(picture: UInt8Array, start: FloatArray, way: FloatArray, ranges: FloatArray, car: float) -> BoolArray:
    """Return which rings are seen in each direction, (S, R).

    Parameters
    ----------
    picture, start
        Classes, and column and row of the LiDAR in it.
    way : (S, 2) float64
        By how many columns and rows a metre leads.
    ranges : (R,) float64
        Of the rings on the ground, ascending, metres.
    car : float
        Height of a car, as a share of that of the LiDAR: a ring that passes over its roof is seen behind it.
    """
    seen = np.zeros((len(way), len(ranges)), np.bool_)
    for i in range(len(way)):
        at, hidden_m = 1.0, 0.0
        for k in range(len(ranges)):
            while at < ranges[k]:
                col, row = int(start[0] + at * way[i, 0]), int(start[1] + at * way[i, 1])
                if min(col, row) < 0 or max(col, row) >= len(picture) or picture[row, col] == _BUILDING:
                    hidden_m = np.inf
                elif picture[row, col] == _CAR:
                    hidden_m = max(hidden_m, at)
                at += _MARCH_M
            seen[i, k] = hidden_m <= ranges[k] * (1.0 - car)
    return seen


def measure_place(kind: str, number: int, config: DetectorConfig) -> list[dict[str, object]]:
    """Drive through a place along each pair of its arms; return a row for each node passed and each false intersection.

    `error_m` is NaN where a node was missed, `node` -1 where nothing is.
    """
    place, rows = Place(kind, number), list[dict[str, object]]()
    for count, (name, way) in enumerate(place.ways()):
        drive = PlaceDrive(name, place, way, seed=zlib.crc32(f"{kind} {number} {count}".encode()))
        found = detect(drive, config).intersections
        distance = np.hypot(*np.moveaxis(place.nodes[:, None] - found.world_xy, -1, 0))
        node, row = linear_sum_assignment(np.minimum(distance, MATCH_M))
        pairs = {n: r for n, r in zip(node.tolist(), row.tolist(), strict=True) if distance[n, r] < MATCH_M}
        passed = shapely.distance(LineString(drive.driven[:, :2]), shapely.points(place.nodes)) < PASSED_M
        about = {"kind": kind, "number": number, "conditions": place.conditions.name, "way": name}
        for n in np.flatnonzero(passed).tolist():
            squared = error = np.nan
            if n in pairs:
                off = found.world_xy[pairs[n]] - place.nodes[n]
                error = float(np.hypot(*off))
                squared = float(off @ np.linalg.solve(found.covariances[pairs[n]], off))
            rows.append({**about, "node": n, "error_m": error, "squared": squared})
        rows += [{**about, "node": -1, "error_m": np.nan, "squared": np.nan}] * (len(found) - len(pairs))
    return rows


def measure_places(
    config: DetectorConfig,
    part: Part,
    *,
    kinds: Sequence[str] = (),
    places: int = len(CONDITIONS),
    progress: Progress | None = None,
) -> pd.DataFrame:
    """Measure so many places of each kind, of one part; see `measure_place`."""
    for kind in kinds:
        if kind not in KINDS:
            raise ConfigError(f"--kind {kind}: there is no such kind. Expected one of: {'; '.join(KINDS)}.")
    todo = [(kind, 2 * i + PARTS.index(part)) for kind in dict.fromkeys(kinds or KINDS) for i in range(places)]
    rows = []
    for done, (kind, number) in enumerate(todo, start=1):
        rows += measure_place(kind, number, config)
        if progress is not None:
            progress(done, len(todo))
    return pd.DataFrame(rows)


def loss_m(errors: FloatArray) -> float:
    """Return the mean of errors, NaN counting as `MATCH_M`, and on top of it the mean of the worst tenth."""
    errors = np.sort(np.where(np.isfinite(errors), errors, MATCH_M))
    return float(errors.mean() + errors[-max(round(len(errors) / 10), 1) :].mean()) if len(errors) else np.nan


def _interval(drawn: Sequence[float] | pd.Series) -> str | float:
    """Return the middle 95 % of the values that are known; NaN where none is."""
    known = np.array([each for each in drawn if np.isfinite(each)])
    return "{:.2f} to {:.2f}".format(*np.percentile(known, (2.5, 97.5))) if len(known) else np.nan


def table_of_kinds(rows: pd.DataFrame) -> pd.DataFrame:
    """Return what was found of each kind, and of the mean of all: with the middle 95 % of a bootstrap over places."""
    lines, drawn = {}, {}
    for kind, of_kind in rows.groupby("kind", sort=False):
        real, rng = of_kind[of_kind["node"] >= 0], np.random.default_rng(0)
        by_place = [group["error_m"].to_numpy() for _, group in real.groupby("number")]
        picks = rng.integers(0, len(by_place), (_RESAMPLES, len(by_place)))
        samples = [np.concatenate([by_place[i] for i in pick]) for pick in picks]
        drawn[kind] = [s[np.isfinite(s)].mean() if np.isfinite(s).any() else np.nan for s in samples]
        errors = real["error_m"].to_numpy()
        found, drives = errors[np.isfinite(errors)], len(of_kind.groupby(["number", "way"]))
        lines[kind] = {
            "places": len(by_place),
            "drives": drives,
            "found [%]": 100.0 * len(found) / len(errors),
            "false per drive": float((of_kind["node"] < 0).sum()) / drives,
            "mean [m]": found.mean() if len(found) else np.nan,
            "interval": _interval(drawn[kind]),
            "95 % [m]": np.percentile(found, 95) if len(found) else np.nan,
            "worst [m]": found.max() if len(found) else np.nan,
            "loss [m]": loss_m(errors),
            "within 95 % [%]": 100.0 * (real["squared"].dropna() <= BOUND_95).mean(),
        }
    table = pd.DataFrame.from_dict(lines, orient="index")
    total = table.drop(columns="interval").mean()
    total[["places", "drives"]] = table[["places", "drives"]].sum()
    total["worst [m]"] = table["worst [m]"].max()
    table.loc["mean over kinds"] = {**total, "interval": _interval(pd.DataFrame(drawn).mean(axis=1))}
    return table.astype({"places": int, "drives": int})
