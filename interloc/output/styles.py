"""How GIS draw the layers of a result: the signs of the page, described once.

Shape and colour both tell an outcome, so that no meaning hangs on colour alone. Colours are those of the page on a
light ground. Sizes are pixels of a screen with 96 per inch.
"""

from dataclasses import dataclass
from typing import Literal

from interloc.output.layout import BUILDINGS, PLACES

Shape = Literal["disc", "square", "diamond", "triangle", "cross"]
Glyph = Literal["check", "bang", "gap", "fork"]
Path = tuple[tuple[float, float], ...]

RIGHT, WRONG, PAPER = "#007a59", "#c24f00", "#ffffff"
TRUE, FALSE = "#0072b2", "#d55e00"
FOUND, MISSED, OUTSIDE = "#009e73", "#b3478c", "#8a9095"
FUSED = "#00568a"
TRACK, ROAD, MINOR_ROAD, BUILDING, BUILDING_EDGE = "#2b3136", "#b9b5ac", "#dcd9d2", "#e3ddd3", "#cfcbc2"
ROAD_LINE, SURFACE, SURFACE_EDGE = "#4b3a8f", "#c3c8cc", "#929ca4"
INK, QUIET_INK = "#1d2327", "#656c71"

GLYPHS: dict[Glyph, tuple[Path, ...]] = {
    "check": (((-0.5, 0), (-0.15, 0.38), (0.5, -0.38)),),
    "bang": (((0, -0.4), (0, 0.32)), ((0, 0.68), (0, 0.7))),
    "gap": (((-0.5, 0), (0.5, 0)),),
    "fork": (((0, 0.55), (0, 0), (-0.46, -0.4)), ((0, 0), (0.46, -0.4))),
}
"""Their open lines, at half size 1, y down."""

GLYPH_PX = 1.8
"""Width of the line of a glyph."""


@dataclass(frozen=True)
class Mark:
    """Sign of a point."""

    shape: Shape
    colour: str
    """Of what is filled, or of the line of what is not."""
    radius_px: float
    """Half its size."""
    is_filled: bool = True
    width_px: float = 0.0
    """Of its line; 0: none."""
    edge: str | None = None
    """Colour of the line of what is filled."""
    glyph: Glyph | None = None
    """Drawn in it in white: the verdict is read without its colour."""
    opacity: float = 1.0


@dataclass(frozen=True)
class Line:
    """How a line is drawn; `casing` is the colour of a line below, wider by as much again."""

    colour: str
    width_px: float
    opacity: float = 1.0
    casing: str | None = None


@dataclass(frozen=True)
class Area:
    """How a polygon is drawn."""

    colour: str
    opacity: float
    edge: str
    width_px: float = 0.8


Symbol = Mark | Line | Area


@dataclass(frozen=True)
class Rule:
    """Which features get a symbol: those with `value` in the field of the style, or all where it is None."""

    value: str | bool | None
    title: str
    symbol: Symbol


@dataclass(frozen=True)
class Label:
    """A property that is written beside its feature, from a scale of 1 to `min_scale` on."""

    field: str
    min_scale: int
    colour: str = INK
    size_pt: float = 8.0


@dataclass(frozen=True)
class Style:
    """How a layer is drawn."""

    title: str
    """Short name for a list of layers."""
    rules: tuple[Rule, ...]
    field: str | None = None
    """Property that chooses the rule; None where there is but one."""
    label: Label | None = None
    is_shown: bool = True
    """Whether it is on where layers can be switched."""


def _single(title: str, symbol: Symbol, *, is_shown: bool = True) -> Style:
    return Style(title, (Rule(None, title, symbol),), is_shown=is_shown)


STYLES = {
    "intersections": Style(
        "Intersections",
        (
            Rule("right", "Right", Mark("disc", RIGHT, 7, width_px=1.6, edge=PAPER, glyph="check")),
            Rule("wrong", "Wrong", Mark("triangle", WRONG, 8, width_px=1.6, edge=PAPER, glyph="bang")),
            Rule("not_counted", "Not counted", Mark("disc", OUTSIDE, 7, width_px=1.6, edge=PAPER, glyph="gap")),
            Rule("unscored", "Not scored", Mark("disc", FUSED, 7, width_px=1.6, edge=PAPER, glyph="fork")),
        ),
        field="outcome",
        label=Label("id", 5_000),
    ),
    "detections": Style(
        "Detections",
        (
            Rule("right", "Right, within 5 m", Mark("disc", TRUE, 2.6, opacity=0.5)),
            Rule("wrong", "Wrong", Mark("cross", FALSE, 3.2, is_filled=False, width_px=1.6, opacity=0.8)),
            Rule("unscored", "Not scored", Mark("disc", TRUE, 2.6, opacity=0.5)),
        ),
        field="outcome",
    ),
    "trajectory": _single("Trajectory", Line(TRACK, 1.6, 0.85)),
    "keyframes": _single("Keyframes", Mark("disc", TRACK, 1.6, opacity=0.8), is_shown=False),
    "roads": Style(
        "Roads seen",
        (
            Rule(True, "Driven", Line(ROAD_LINE, 1.8, casing=PAPER)),
            Rule(False, "Seen from others", Line(ROAD_LINE, 1.0, 0.8)),
        ),
        field="is_driven",
        label=Label("width_m", 3_000, QUIET_INK, 7.0),
    ),
    "junctions": _single("Junctions", Area(FUSED, 0.22, FUSED, 0.5)),
    "road_surface": _single("Road surface", Area(SURFACE, 0.6, SURFACE_EDGE, 0.5)),
    "osm_nodes": Style(
        "OSM intersections",
        (
            Rule("found", "Found", Mark("square", FOUND, 9, is_filled=False, width_px=2)),
            Rule("missed", "Missed", Mark("diamond", MISSED, 8, width_px=1.6, edge=PAPER, glyph="gap")),
            Rule("outside", "Out of reach", Mark("square", OUTSIDE, 4, is_filled=False, width_px=1.2)),
        ),
        field="outcome",
    ),
    "matches": Style(
        "Matches",
        (Rule("TP", "Within 5 m (TP)", Line(TRUE, 1.0, 0.55)), Rule("FP", "Farther (FP)", Line(FALSE, 1.0, 0.35))),
        field="outcome",
    ),
    "osm_roads": Style(
        "OSM roads",
        (Rule(True, "Roads", Line(ROAD, 2.4)), Rule(False, "Other ways", Line(MINOR_ROAD, 1.2))),
        field="is_drivable",
        label=Label("name", 5_000, QUIET_INK, 7.0),
    ),
    BUILDINGS: _single("OSM buildings", Area(BUILDING, 0.7, BUILDING_EDGE, 0.5)),
    PLACES: _single("Places that fit", Line(TRACK, 1.4, 0.4), is_shown=False),
    "branches": _single("Branches", Line(FUSED, 2.0, casing=PAPER)),
    "uncertainty": _single("Uncertainty, 95 %", Area(FUSED, 0.22, FUSED)),
}
"""Layer -> how it is drawn."""

ROAD_GROUP = "Roads seen by LiDAR"
GROUPS = {
    "Verdict": ("intersections", "osm_nodes", "branches", "uncertainty"),
    "Evidence": ("detections", "matches", "keyframes", "trajectory"),
    ROAD_GROUP: ("roads", "junctions", "road_surface"),
    "Map of OpenStreetMap": (PLACES, "osm_roads", BUILDINGS),
}
"""Groups of layers, and the layers of each, from the top to the bottom of the map."""
