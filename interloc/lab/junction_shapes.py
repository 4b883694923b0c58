"""Kinds of places where roads meet, drawn by parameters, their axes known exactly.

A plan holds what a draughtsman would know: nodes, the axis and width of each road between two of them, and what lies
beside them. Parameters are drawn from a generator: the same one gives the same plan. Metres; bearings in degrees,
counter-clockwise from +x. Right-hand traffic.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from interloc.arrays import FloatArray, IntArray

STEP_M = 0.5
ARM_M = 70.0
_SMALL_ROUND_M = 16.0  # diameter up to which a roundabout is one node, in its middle


@dataclass(frozen=True)
class Road:
    """A road between two nodes."""

    start: int
    end: int
    xy: FloatArray
    """(N, 2) float64: its axis."""
    width_m: float
    oneway: bool = False


@dataclass
class Plan:
    """A place on paper."""

    rng: np.random.Generator
    kerb_m: float = 5.0
    """Radius of the kerbs between roads."""
    nodes: list[FloatArray] = field(default_factory=list)
    roads: list[Road] = field(default_factory=list)
    surfaces: list[BaseGeometry] = field(default_factory=list)
    """Road beside the roads: lay-bys, squares, drives."""
    islands: list[BaseGeometry] = field(default_factory=list)
    """Not road, though a road would cover it."""
    parking: list[BaseGeometry] = field(default_factory=list)
    """Other ground that cars stand on."""
    cars: list[LineString] = field(default_factory=list)
    """Where cars stand in a row."""
    counted: list[int] | None = None
    """Nodes that are intersections; None: where three roads or more meet."""

    def __post_init__(self) -> None:
        self.kerb_m = self.between(2.0, 9.0)

    def between(self, low: float, high: float) -> float:
        """Draw a number."""
        return float(self.rng.uniform(low, high))

    def sign(self) -> float:
        """Draw a side: 1 left, -1 right."""
        return float(self.rng.choice([-1.0, 1.0]))

    def node(self, x: float, y: float) -> int:
        """Add a node."""
        self.nodes.append(np.array([x, y]))
        return len(self.nodes) - 1

    def road(self, start: int, end: int, width_m: float, xy: FloatArray | None = None, *, oneway: bool = False) -> Road:
        """Add a road, straight unless its axis is given."""
        line = LineString([self.nodes[start], self.nodes[end]] if xy is None else xy)
        self.roads.append(Road(start, end, shapely.get_coordinates(line.segmentize(STEP_M)), width_m, oneway))
        return self.roads[-1]

    def arm(self, node: int, bearing_deg: float, width_m: float, *pieces: tuple[float, float], way: int = 0) -> Road:
        """Add a road that leads away from a node by pieces of (length, turn in degrees); straight on by default.

        `way`: 1 for one-way traffic outwards, -1 inwards.
        """
        xy = walk(self.nodes[node], bearing_deg, *(pieces or ((ARM_M, 0.0),)))
        far = self.node(*xy[-1].tolist())
        if way < 0:
            return self.road(far, node, width_m, xy[::-1], oneway=True)
        return self.road(node, far, width_m, xy, oneway=way > 0)

    def bent_arm(self, node: int, bearing_deg: float, width_m: float) -> Road:
        """Add a road that is straight for 10 to 40 m, and bends then, or not."""
        straight, radius = self.between(10.0, 40.0), self.between(40.0, 200.0)
        turn = min(math.degrees((ARM_M - straight) / radius), 30.0) * float(self.rng.choice([-1.0, 0.0, 1.0]))
        return self.arm(node, bearing_deg, width_m, (straight, 0.0), (ARM_M - straight, turn))

    @property
    def degrees(self) -> IntArray:
        """Number of roads at each node."""
        return np.bincount([n for road in self.roads for n in (road.start, road.end)], minlength=len(self.nodes))

    @property
    def intersections(self) -> list[int]:
        """Nodes that are to be found."""
        return np.flatnonzero(self.degrees >= 3).tolist() if self.counted is None else self.counted


def walk(start: FloatArray, bearing_deg: float, *pieces: tuple[float, float]) -> FloatArray:
    """Return the line, (N, 2), that one walks from a place on: pieces of (length, turn in degrees, left positive)."""
    angles, steps = [np.zeros(0)], [np.zeros(0)]
    heading = math.radians(bearing_deg)
    for length, turn_deg in pieces:
        count = max(round(length / STEP_M), 1)
        turned = np.radians(turn_deg) * (np.arange(count) + 0.5) / count
        angles.append(heading + turned)
        chord = np.radians(turn_deg) / count / 2.0
        steps.append(np.full(count, length / count * np.sinc(chord / np.pi)))
        heading += math.radians(turn_deg)
    angle, step = np.concatenate(angles), np.concatenate(steps)
    moved = np.column_stack([step * np.cos(angle), step * np.sin(angle)])
    line: FloatArray = start + np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    return line


def _beside(axis: FloatArray, begin_m: float, end_m: float, offset_m: float) -> FloatArray:
    """Return the line beside a part of an axis, to its left for positive offsets."""
    return shapely.get_coordinates(shapely.offset_curve(substring(LineString(axis), begin_m, end_m), offset_m))


def _strip(axis: FloatArray, span_m: tuple[float, float], low_m: float, high_m: float, taper_m: float = 0.0) -> Polygon:
    """Return the strip beside a part of an axis between two offsets, whose far side begins and ends with a taper."""
    near, far = _beside(axis, *span_m, low_m), _beside(axis, span_m[0] + taper_m, span_m[1] - taper_m, high_m)
    return Polygon(np.concatenate([near, far[::-1]])).buffer(0.05)


def _meeting(plan: Plan, bearings: list[float], widths: list[float]) -> list[Road]:
    node = plan.node(0.0, 0.0)
    return [plan.bent_arm(node, bearing, width) for bearing, width in zip(bearings, widths, strict=True)]


def _through(plan: Plan, low_deg: float, high_deg: float, stems: int) -> None:
    angle, main, side = plan.between(low_deg, high_deg), plan.between(5.5, 11.0), plan.between(4.5, 8.5)
    if angle < 60.0:
        plan.kerb_m = plan.between(1.5, 4.0)
    angle = angle if plan.sign() > 0 else 180.0 - angle
    _meeting(plan, [0.0, 180.0, angle, angle + 180.0][: 2 + stems], [main, main, side, side][: 2 + stems])


def _hairpin_road(plan: Plan) -> None:
    """Let one arm of the through road turn back, away from the side road."""
    main, side, node = plan.between(5.0, 8.0), plan.between(4.5, 7.0), plan.node(0.0, 0.0)
    plan.kerb_m = plan.between(2.0, 5.0)
    radius, turn = plan.between(7.0, 13.0), plan.between(140.0, 180.0)
    plan.arm(node, 180.0, main)
    plan.arm(node, 0.0, main, (plan.between(3.0, 18.0), 0.0), (radius * math.radians(turn), turn), (45.0, 0.0))
    plan.arm(node, -plan.between(60.0, 120.0), side)


def _hairpin_side(plan: Plan) -> None:
    """Let the side road turn back soon behind the through road."""
    main, side, node = plan.between(5.0, 8.0), plan.between(4.5, 7.0), plan.node(0.0, 0.0)
    plan.kerb_m = plan.between(2.0, 5.0)
    radius, angle = plan.between(7.0, 13.0), plan.between(35.0, 100.0)
    turn = 180.0 - angle - plan.between(0.0, 15.0)
    plan.arm(node, 180.0, main)
    plan.arm(node, 0.0, main)
    plan.arm(node, angle, side, (plan.between(2.0, 15.0), 0.0), (radius * math.radians(turn), turn), (45.0, 0.0))


def _bend(plan: Plan, side: float) -> None:
    """Bend the through road at the node, with the side road on the outer (-1) or inner (1) side."""
    radius, turn, node = plan.between(18.0, 45.0), plan.between(60.0, 110.0), plan.node(0.0, 0.0)
    half = (radius * math.radians(turn / 2), turn / 2)
    main = plan.between(5.0, 8.5)
    plan.arm(node, 0.0, main, half, (45.0, 0.0))
    plan.arm(node, 180.0, main, (half[0], -half[1]), (45.0, 0.0))
    plan.arm(node, side * plan.between(75.0, 105.0), plan.between(4.5, 7.0), (ARM_M if side < 0 else 45.0, 0.0))


def _beside_road(plan: Plan, what: str) -> None:
    """Draw a row of parked cars, a lay-by or a bus bay beside the through road."""
    node, main = plan.node(0.0, 0.0), plan.between(6.0, 9.0)
    side = plan.sign()
    east, west = plan.arm(node, 0.0, main), plan.arm(node, 180.0, main)
    plan.arm(node, side * plan.between(75.0, 105.0), plan.between(5.0, 8.0))
    across, axis = plan.sign(), east.xy if plan.sign() > 0 else west.xy
    begin = plan.between(7.0, 16.0)
    if what == "parking row":
        end, width = begin + plan.between(20.0, 40.0), plan.between(2.0, 5.0)
        plan.parking.append(_strip(axis, (begin, end), across * main / 2, across * (main / 2 + width)))
        plan.cars.append(LineString(_beside(axis, begin, end, across * (main / 2 + 1.1))))
    else:
        taper, length, width = (4.0, 24.0, 2.8) if what == "lay-by" else (10.0, 36.0, 3.2)
        end = begin + length * plan.between(0.8, 1.3)
        plan.surfaces.append(_strip(axis, (begin, end), across * (main / 2 - 0.1), across * (main / 2 + width), taper))
        if what == "lay-by":
            plan.cars.append(LineString(_beside(axis, begin + 4.0, end - 4.0, across * (main / 2 + 1.3))))


def _ragged(plan: Plan) -> None:
    """Draw a skew crossing with a yard that opens into one of its corners."""
    angle, main, side = plan.between(45.0, 75.0), plan.between(6.0, 10.0), plan.between(5.0, 8.0)
    roads = _meeting(plan, [0.0, 180.0, angle, angle + 180.0], [main, main, side, side])
    mouth, across = roads[int(plan.rng.integers(2, 4))], plan.sign()
    edge = _beside(mouth.xy, 3.0, plan.between(12.0, 20.0), across * side / 2 * 0.8)
    ragged = plan.rng.uniform(0.0, 5.0, len(edge) // 4 + 1).repeat(4)[: len(edge), None]
    along = np.gradient(edge, axis=0)
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    out = edge + across * np.column_stack([-along[:, 1], along[:, 0]]) * ragged
    plan.surfaces.append(Polygon(np.concatenate([edge, out[::-1]])).buffer(0.3))


def _staggered(plan: Plan, low_m: float, high_m: float) -> None:
    main, gap = plan.between(5.5, 9.0), plan.between(low_m, high_m)
    one, two = plan.node(-gap / 2, 0.0), plan.node(gap / 2, 0.0)
    side = plan.sign()
    plan.road(one, two, main)
    plan.arm(one, 180.0, main)
    plan.arm(two, 0.0, main)
    plan.arm(one, side * plan.between(75.0, 105.0), plan.between(4.5, 7.0))
    plan.arm(two, -side * plan.between(75.0, 105.0), plan.between(4.5, 7.0))


def _fork(plan: Plan) -> None:
    half, width = plan.between(20.0, 40.0), plan.between(5.5, 8.0)
    _meeting(plan, [180.0, half, -half], [width, plan.between(4.5, width), plan.between(4.5, width)])


def _triangle(plan: Plan) -> None:
    """Part the side road in two around an island."""
    main, leg, along, deep = (
        plan.between(6.0, 8.0),
        plan.between(4.5, 6.0),
        plan.between(12.0, 22.0),
        plan.between(16, 26),
    )
    west, east, south = plan.node(-along, 0.0), plan.node(along, 0.0), plan.node(0.0, -deep)
    plan.kerb_m = 3.0
    plan.road(west, east, main)
    plan.arm(west, 180.0, main)
    plan.arm(east, 0.0, main)
    plan.arm(south, -90.0, plan.between(5.5, 7.5))
    plan.road(west, south, leg)
    plan.road(south, east, leg)


def _slip(plan: Plan) -> None:
    """Cut one corner of a crossing by a one-way road."""
    main, side, node = plan.between(7.0, 10.0), plan.between(6.0, 9.0), plan.node(0.0, 0.0)
    here, there = plan.between(25.0, 40.0), plan.between(25.0, 40.0)
    begin, end = plan.node(-here, 0.0), plan.node(0.0, -there)
    plan.kerb_m = 1.5
    plan.road(begin, node, main)
    plan.road(node, end, side)
    t = np.linspace(0.0, 1.0, 40)[:, None]
    curve = (1 - t) ** 2 * plan.nodes[begin] + 2 * t * (1 - t) * np.array([-0.35 * here, -0.35 * there])
    plan.road(begin, end, plan.between(3.8, 5.0), curve + t**2 * plan.nodes[end], oneway=True)
    plan.arm(begin, 180.0, main, (45.0, 0.0))
    plan.arm(end, -90.0, side, (45.0, 0.0))
    plan.arm(node, 0.0, main)
    plan.arm(node, 90.0, side)


def _dual(plan: Plan) -> None:
    """Draw two carriageways and a road that crosses both, or ends at the far one."""
    width, side = plan.between(6.0, 8.0), plan.between(5.5, 8.0)
    median = plan.between(2.0, 9.0)
    apart = width + median
    near, far = plan.node(0.0, -apart / 2), plan.node(0.0, apart / 2)
    plan.kerb_m = min(plan.between(2.0, 5.0), 0.4 * median)
    plan.road(near, far, side)
    plan.arm(near, 180.0, width, way=-1)
    plan.arm(near, 0.0, width, way=1)
    plan.arm(far, 0.0, width, way=-1)
    plan.arm(far, 180.0, width, way=1)
    plan.arm(near, -90.0, side)
    if plan.sign() > 0:
        plan.arm(far, 90.0, side)


def _round(plan: Plan, low_m: float, high_m: float) -> None:
    diameter, width = plan.between(low_m, high_m), plan.between(5.0, 7.0)
    radius, arms = diameter / 2, int(plan.rng.integers(3, 5))
    bearings = 360.0 / arms * np.arange(arms) + plan.rng.uniform(-12.0, 12.0, arms)
    around = np.radians(bearings)
    ring = [plan.node(radius * math.cos(a), radius * math.sin(a)) for a in around]
    plan.kerb_m = 3.0
    for i in range(arms):
        end = around[(i + 1) % arms] + (2 * math.pi if i == arms - 1 else 0.0)
        angles = np.linspace(around[i], end, 60)
        arc = radius * np.column_stack([np.cos(angles), np.sin(angles)])
        plan.road(ring[i], ring[(i + 1) % arms], width, arc, oneway=True)
        plan.arm(ring[i], float(bearings[i]), plan.between(5.5, 7.5))
    if radius - width / 2 > 1.0:
        plan.islands.append(shapely.Point(0.0, 0.0).buffer(radius - width / 2))
    if diameter <= _SMALL_ROUND_M:
        plan.counted = [plan.node(0.0, 0.0)]


def _square(plan: Plan) -> None:
    """Let roads meet in the middle of a rectangle of road."""
    long, wide = plan.between(22.0, 45.0), plan.between(18.0, 30.0)
    plan.surfaces.append(shapely.box(-long / 2, -wide / 2, long / 2, wide / 2))
    arms = int(plan.rng.integers(3, 5))
    _meeting(plan, [0.0, 180.0, 90.0, 270.0][:arms], [plan.between(5.0, 8.0) for _ in range(arms)])


def _driveways(plan: Plan) -> None:
    main, node = plan.between(5.5, 7.5), plan.node(0.0, 0.0)
    side = plan.sign()
    arms = [plan.arm(node, 0.0, main), plan.arm(node, 180.0, main)]
    plan.arm(node, side * plan.between(75.0, 105.0), plan.between(4.5, 7.0))
    for arm in arms:
        for at in np.arange(15.0, 60.0, 15.0) + plan.rng.uniform(-2.0, 2.0, 3):
            place, across = arm.xy[int(at / STEP_M)], plan.sign()
            length = main / 2 + plan.between(4.0, 10.0)
            plan.surfaces.append(
                LineString([place, place + np.array([0.0, across * length])]).buffer(1.6, cap_style="flat")
            )


def _narrow(plan: Plan) -> None:
    angle, main, lane = plan.between(60.0, 120.0), plan.between(10.0, 14.0), plan.between(3.0, 5.0)
    _meeting(plan, [0.0, 180.0, angle], [main, main, lane])


KINDS: dict[str, Callable[[Plan], None]] = {
    "T": lambda plan: _through(plan, 60.0, 90.0, 1),
    "T, 30 to 60 degrees": lambda plan: _through(plan, 30.0, 60.0, 1),
    "X": lambda plan: _through(plan, 60.0, 90.0, 2),
    "X, 30 to 60 degrees": lambda plan: _through(plan, 30.0, 60.0, 2),
    "T at a hairpin, road turns": _hairpin_road,
    "T at a hairpin, side road turns": _hairpin_side,
    "T on the outside of a bend": lambda plan: _bend(plan, -1.0),
    "T on the inside of a bend": lambda plan: _bend(plan, 1.0),
    "T beside a parking row": lambda plan: _beside_road(plan, "parking row"),
    "T beside a lay-by": lambda plan: _beside_road(plan, "lay-by"),
    "T beside a bus bay": lambda plan: _beside_road(plan, "bus bay"),
    "skew X, ragged mouth": _ragged,
    "staggered, 8 to 20 m": lambda plan: _staggered(plan, 8.0, 20.0),
    "staggered, 20 to 40 m": lambda plan: _staggered(plan, 20.0, 40.0),
    "Y": _fork,
    "Y with an island": _triangle,
    "slip road": _slip,
    "dual carriageway": _dual,
    "roundabout, 8 to 30 m": lambda plan: _round(plan, 8.0, 30.0),
    "roundabout, 30 to 40 m": lambda plan: _round(plan, 30.0, 40.0),
    "square": _square,
    "driveways": _driveways,
    "narrow into wide": _narrow,
}
"""What draws a place of each kind."""
