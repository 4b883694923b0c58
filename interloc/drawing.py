"""What all figures share: colours that colour-blind readers tell apart, marks, a quiet frame, files."""

from __future__ import annotations

import io
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
    fifth = (high[0] - low[0]) / 5.0
    power = 10.0 ** np.floor(np.log10(fifth))
    length = float(max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= fifth))
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
