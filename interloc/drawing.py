"""What all figures share: colours that colour-blind readers tell apart, marks, a quiet frame, files; map sketches."""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from interloc.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette; shapes differ too, so that no meaning hangs on colour alone.
BLUE, VERMILION, GREEN, YELLOW, SKY, PURPLE = "#0072B2", "#D55E00", "#009E73", "#F0E442", "#56B4E9", "#CC79A7"
INK, MUTED, FAINT, PAPER = "#22262b", "#6b7280", "#d7dbe0", "#ffffff"

ImageFormat = Literal["png", "svg"]


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make a figure without pyplot: nothing global is touched, and servers may draw in threads."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second of start-up time

    return Figure(figsize=(width_in, height_in), facecolor=PAPER, layout="constrained")


def quiet(axes: Axes) -> None:
    """Take away what is not data (top and right frame) and draw the rest faintly, with the grid behind."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MUTED)
    axes.tick_params(colors=INK, length=3, color=MUTED, labelsize=9)
    axes.grid(visible=True, axis="y", color=FAINT, linewidth=0.7)
    axes.set_axisbelow(True)


def entitle(axes: Axes, text: str, size: float = 12.0) -> None:
    """Write a title above the left end of axes; `size` in points."""
    # Told where, matplotlib does not look each time whether it must rise above ticks: a tenth of the drawing.
    axes.set_title(text, loc="left", y=1.0, fontsize=size, color=INK)


def mark(axes: Axes, xy: FloatArray, sign: str, size: float, **style: Any) -> None:  # noqa: ANN401 - matplotlib's
    """Draw (N, 2) points as one sign of matplotlib each, `size` in points; `style` goes to `Axes.plot`."""
    axes.plot(*xy.T, linestyle="none", marker=sign, markersize=size, **style)


def credit_roads(axes: Axes, *, is_made_up: bool) -> None:
    """Name OpenStreetMap in the corner of a drawing of its roads, unless a simulator made them up."""
    if not is_made_up:
        text = "Roads © OpenStreetMap contributors, ODbL"
        corner: dict[str, Any] = {"ha": "right", "va": "bottom", "transform": axes.transAxes}
        axes.text(0.995, 0.005, text, fontsize=7, color=MUTED, zorder=9, **corner)


def scale_bar(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    """Draw a round length of about a fifth of a map in its lower left corner; `low`, `high`: its corners, metres."""
    length = _round_length((high[0] - low[0]) / 5.0)
    x, y = low + 0.04 * (high - low)
    box = {"facecolor": PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 2.0}
    axes.plot([x, x + length], [y, y], color=INK, linewidth=3, solid_capstyle="butt", zorder=9)
    axes.annotate(
        f"{length:g} m",
        (x + length / 2.0, y),
        xytext=(0, 5),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=9,
        color=INK,
        bbox=box,
        zorder=8,
    )


def image(figure: Figure, kind: ImageFormat, *, dpi: int = 150) -> bytes:
    """Return the bytes of an image file of a figure; the same figure gives the same bytes."""
    import matplotlib as mpl  # noqa: PLC0415 - slow to import
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: PLC0415

    buffer = io.BytesIO()
    canvas: Any = FigureCanvasSVG(figure) if kind == "svg" else FigureCanvasAgg(figure)  # it has no types
    figure.set_dpi(dpi)
    # The canvas itself draws once; `savefig` would draw twice, as it prepares for boxes that nobody asks for.
    with mpl.rc_context({"svg.hashsalt": "interloc"}):  # else the ids within an SVG are random
        if kind == "svg":
            canvas.print_svg(buffer, metadata={"Date": None})
        else:
            canvas.print_png(buffer, metadata={"Software": None})
    figure.set_layout_engine("none")  # it stays as it was laid out: a second format takes half the time
    return buffer.getvalue()


@dataclass(frozen=True)
class Sign:
    """A point of a map sketch."""

    xy: FloatArray
    """(2,) float64: metres."""
    outcome: str
    """{"right", "wrong", "not_counted", "unscored", "missed"}: decides shape and colour."""
    text: str
    """Shown under the pointer."""


_SIGNS = {  # paths around (0, 0), filled or stroked, and their colour
    "right": ("M-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0z", "fill", GREEN),
    "wrong": ("M-5-5L5 5M-5 5L5-5", "stroke", VERMILION),
    "not_counted": ("M-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0z", "stroke", GREEN),
    "unscored": ("M-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0z", "fill", BLUE),
    "missed": ("M0-7L7 0L0 7L-7 0z", "stroke", PURPLE),
}
_SKETCH_PX, _SKETCH_MIN_PX, _MARGIN_PX = 560, 200, 24
_MAX_POSITIONS = 1000


def map_sketch(
    track: FloatArray, signs: Sequence[Sign], caption: str, roads: FloatArray | None = None, *, north_up: bool = True
) -> str:
    """Return a small map as HTML that needs no script, no style sheet and no network: what a notebook shows.

    `track`, (N, 2), and the two ends of each piece of `roads`, (R, 2, 2), are metres, y up; what of the roads lies far
    from track and signs is not drawn. Where y is north, that is marked.
    """
    places = np.concatenate([track, *(sign.xy.reshape(-1, 2) for sign in signs)])
    places = places[np.isfinite(places).all(axis=1)]
    low, high = (places.min(axis=0), places.max(axis=0)) if len(places) else (np.zeros(2), np.zeros(2))
    size_m = np.maximum(high - low, 1.0)
    scale = (_SKETCH_PX - 2 * _MARGIN_PX) / float(size_m.max())  # pixels per metre
    height_px = max(_SKETCH_MIN_PX, round(float(size_m[1]) * scale) + 2 * _MARGIN_PX)
    middle = (low + high) / 2.0

    def pixels(xy: FloatArray) -> FloatArray:
        return (xy - middle) * (scale, -scale) + (_SKETCH_PX / 2, height_px / 2)

    def line(xy: FloatArray) -> str:
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in pixels(xy).tolist())

    roads = np.empty((0, 2, 2)) if roads is None else roads
    ends = pixels(roads)
    near = (ends.max(axis=1) > 0).all(axis=1) & (ends.min(axis=1) < (_SKETCH_PX, height_px)).all(axis=1)
    thinned = np.unique(np.linspace(0, len(track) - 1, min(len(track), _MAX_POSITIONS)).round().astype(np.int64))
    ground = "".join(map(line, roads[near]))
    parts = [
        f'<path d="{ground}" stroke="currentColor" stroke-opacity="0.25" stroke-width="3" fill="none"/>'
        if ground
        else "",
        f'<path d="{line(track[thinned])}" stroke="currentColor" stroke-width="1.5" fill="none"/>'
        if len(track)
        else "",
    ]
    for sign in signs:
        path, paint, colour = _SIGNS[sign.outcome]
        x, y = pixels(sign.xy).tolist()
        style = f'fill="{colour}"' if paint == "fill" else f'fill="none" stroke="{colour}" stroke-width="2.5"'
        title = html.escape(sign.text)
        parts.append(f'<path d="{path}" transform="translate({x:.1f} {y:.1f})" {style}><title>{title}</title></path>')
    bar_m = _round_length(100.0 / scale)
    bottom = height_px - 8
    parts.append(
        f'<path d="M8 {bottom - 5}v5h{bar_m * scale:.1f}v-5" stroke="currentColor" fill="none"/>'
        f'<text x="14" y="{bottom - 4}" font-size="11" fill="currentColor">{bar_m:g} m</text>'
    )
    if north_up:
        parts.append('<text x="8" y="18" font-size="12" fill="currentColor">N \N{UPWARDS ARROW}</text>')
    text = html.escape(caption)
    return (
        f'<div style="max-width:{_SKETCH_PX}px;font-family:sans-serif">'
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{text}" width="100%" '
        f'viewBox="0 0 {_SKETCH_PX} {height_px}">{"".join(parts)}</svg>'
        f'<div style="font-size:0.85em">{text}</div></div>'
    )


def _round_length(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not larger."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= length))
