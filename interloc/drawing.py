"""What all figures share: colours that colour-blind readers tell apart, marks, a quiet frame, and image files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from interloc.arrays import FloatArray
from interloc.files import atomic_write

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


def quiet(axes: Axes, *, grid: Literal["x", "y", "both"] = "y") -> None:
    """Take away what is not data (top and right frame) and draw the rest faintly, with the grid behind."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MUTED)
    axes.tick_params(colors=INK, length=3, color=MUTED, labelsize=9)
    axes.grid(visible=True, axis=grid, color=FAINT, linewidth=0.7)
    axes.set_axisbelow(True)


def mark(axes: Axes, xy: FloatArray, sign: str, size: float, **style: Any) -> None:  # noqa: ANN401 - matplotlib's
    """Draw (N, 2) points as one sign of matplotlib each, `size` in points; `style` goes to `Axes.plot`."""
    axes.plot(*xy.T, linestyle="none", marker=sign, markersize=size, **style)


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


def write_image(path: Path, content: bytes) -> None:
    """Write an image file, whole or not at all."""
    with atomic_write(path) as handle:
        handle.write(content)


def percent(value: float | None) -> str:
    """Return a ratio for a person: "94.2 %", or a dash where it is undefined."""
    return "–" if value is None else f"{100.0 * value:.1f} %"  # noqa: RUF001 - a dash, not a minus


def metres(value: float | None) -> str:
    """Return a distance for a person: "1.28 m", or a dash where it is undefined."""
    return "–" if value is None else f"{value:.2f} m"  # noqa: RUF001
