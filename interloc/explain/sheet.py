"""The sheet that every picture is drawn on: a square of W around the vehicle, a key beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray
from interloc.detection.image import BinaryImage
from interloc.drawing import INK, MUTED, PAPER, VERMILION, new_figure
from interloc.explain.evidence import Evidence
from interloc.geometry import rotate_2d

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


DPI = 100
WIDTH, HEIGHT = 1120, 860  # pixels: a picture fits a laptop screen at 100 %
MAP_LEFT, MAP_BOTTOM, MAP_SIDE = 66, 54, 750  # one cell of the usual image is one pixel
_KEY_LEFT = MAP_LEFT + MAP_SIDE + 18
_TICK_M = 20.0
_CAR_M = np.array([[3.4, 0.0], [-2.2, 1.9], [-1.0, 0.0], [-2.2, -1.9]])  # an arrow head as long as a car, in L


def sheet(width: int, height: int) -> Figure:
    """Return an empty figure of a size in pixels whose axes are placed by hand."""
    figure = new_figure(width / DPI, height / DPI)
    figure.set_layout_engine("none")
    return figure


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Add axes at a place given in pixels from the lower left corner."""
    w, h = figure.get_size_inches() * DPI
    return figure.add_axes((left / w, bottom / h, width / w, height / h))


def title(figure: Figure, text: str, subtitle: str) -> None:
    """Write the name of the picture, and below it what it is of, into the upper left corner."""
    w, h = figure.get_size_inches() * DPI
    figure.text(MAP_LEFT / w, 1 - 10 / h, text, fontsize=14, color=INK, va="top", weight="bold")
    figure.text(MAP_LEFT / w, 1 - 34 / h, subtitle, fontsize=9, color=MUTED, va="top", parse_math=False)


def frame_map(axes: Axes, evidence: Evidence, *, labels: bool = True) -> None:
    """Lay the region of interest out in metres along the axes of W, the vehicle in the origin."""
    left, right, bottom, top = extent(evidence)
    frame_square(axes, (left + right) / 2, (bottom + top) / 2, (right - left) / 2, tick_m=_TICK_M)
    if labels:
        axes.set_xlabel("x of W, from the vehicle [m]", fontsize=9, color=INK)
        axes.set_ylabel("y of W, from the vehicle [m]", fontsize=9, color=INK, labelpad=0)
    else:
        axes.tick_params(labelbottom=False, labelleft=False)


def frame_square(axes: Axes, x: float, y: float, half_m: float, *, tick_m: float) -> None:
    """Show a square of the map, with a tick every so many metres."""
    axes.set(xlim=(x - half_m, x + half_m), ylim=(y - half_m, y + half_m), aspect="equal")
    for axis, middle in ((axes.xaxis, x), (axes.yaxis, y)):
        first, last = math.ceil((middle - half_m) / tick_m), math.floor((middle + half_m) / tick_m)
        axis.set_ticks([tick_m * i for i in range(first, last + 1)])
    axes.tick_params(labelsize=8, color=MUTED, labelcolor=INK, length=3)
    axes.spines[:].set_color(MUTED)


def extent(evidence: Evidence) -> tuple[float, float, float, float]:
    """Return left, right, bottom, top of the region of interest, metres from the vehicle."""
    roi = evidence.roi
    left, top = evidence.around(np.array(-0.5), np.array(-0.5))
    side = roi.size * roi.resolution_m
    return left, left + side, top - side, top


def paint(axes: Axes, evidence: Evidence, layers: Sequence[tuple[BoolArray, str]]) -> None:
    """Draw (H, W) masks in a colour each, later ones on top."""
    from matplotlib.colors import to_rgb  # noqa: PLC0415 - slow to import

    picture = np.full((evidence.roi.size, evidence.roi.size, 3), 255, np.uint8)
    for mask, colour in layers:
        picture[mask] = np.round(255 * np.array(to_rgb(colour)))
    axes.imshow(picture, extent=extent(evidence), origin="upper", zorder=0)


def is_set(image: BinaryImage) -> BoolArray:
    """Return the set pixels of an image as (H, W) bool."""
    return image.to_array().astype(np.bool_)


def swatch(axes: Axes, colour: str, text: str) -> None:
    """Add a colour to the key."""
    axes.plot([], [], linestyle="none", marker="s", markersize=9, color=colour, label=text)


def vehicle_outline(evidence: Evidence) -> FloatArray:
    """Return the outline of the vehicle's mark, (4, 2), from the vehicle along the axes of W."""
    return rotate_2d(_CAR_M, evidence.yaw_rad)


def mark_vehicle(axes: Axes, evidence: Evidence, *, outlined: bool = False) -> None:
    """Draw the vehicle, pointing where it heads; as an outline where it must not hide what is below."""
    outline = vehicle_outline(evidence)
    face, edge = ("none", VERMILION) if outlined else (VERMILION, PAPER)
    axes.fill(*outline.T, facecolor=face, edgecolor=edge, linewidth=1.0 + outlined, zorder=8)
    axes.plot(
        [],
        [],
        linestyle="none",
        marker=">",
        markersize=9,
        markerfacecolor=face,
        markeredgecolor=VERMILION,
        label="vehicle and its heading",
    )


def write_key(figure: Figure, axes: Axes, facts: Sequence[str]) -> None:
    """Put the legend and some numbers beside the map, where they cover nothing."""
    w, h = figure.get_size_inches() * DPI
    legend(figure, [axes], _KEY_LEFT / w, (MAP_BOTTOM + MAP_SIDE) / h)
    figure.text(
        _KEY_LEFT / w,
        MAP_BOTTOM / h,
        "\n".join(facts),
        fontsize=9,
        color=INK,
        va="bottom",
        linespacing=1.5,
        parse_math=False,
    )


def legend(figure: Figure, drawn: Sequence[Axes], x: float, y: float, **options: Any) -> None:  # noqa: ANN401
    """Put the legend of some axes, each name once, with its upper left corner at a place of the figure."""
    entries: dict[str, Artist] = {}
    for axes in drawn:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
    style = {"frameon": False, "fontsize": 9, "labelcolor": INK, "borderpad": 0, "borderaxespad": 0} | options
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="upper left",
        bbox_to_anchor=(x, y),
        labelspacing=0.7,
        **style,
    )


def scale_bar(axes: Axes, x: float, y: float, length_m: float) -> None:
    """Draw a length from a place to the right."""
    axes.plot([x, x + length_m], [y, y], color=INK, linewidth=3, solid_capstyle="butt")
    axes.annotate(
        f"{length_m:g} m", (x + length_m / 2, y), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=9
    )
