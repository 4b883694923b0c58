"""Draw the picture of docs/roads.md: `python -m docs.roads_picture`; the demo drive is simulated for it.

`python -m docs.roads_picture RESULT OUT.png` draws the roads of any result.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib import pyplot as plt

import interloc
from docs.screenshots import DEMO, FIGURES, shrink
from interloc.cli.main import run
from interloc.output.styles import FUSED, PAPER, ROAD_LINE, SURFACE, SURFACE_EDGE, TRACK


def draw(result: Path, out: Path) -> None:
    """Draw the roads of a result folder."""
    network = interloc.roads(interloc.read_results(result))
    mpl.use("Agg")
    figure, axes = plt.subplots(figsize=(12, 6), dpi=120, layout="constrained")
    for polygon in network.surface:
        axes.fill(*np.asarray(polygon.exterior.coords).T, color=SURFACE, ec=SURFACE_EDGE, lw=0.4)
        for hole in polygon.interiors:
            axes.fill(*np.asarray(hole.coords).T, color=PAPER, ec=SURFACE_EDGE, lw=0.4)
    for node in network.nodes:
        if node.area is not None:
            axes.fill(*np.asarray(node.area.exterior.coords).T, color=FUSED, alpha=0.35, ec=TRACK, lw=0.6)
    halo = [patheffects.withStroke(linewidth=2.5, foreground=PAPER)]
    for edge in network.edges:
        axes.plot(*edge.xy.T, color=ROAD_LINE, lw=1.8 if edge.is_driven else 0.9, ls="-" if edge.seen == 1 else ":")
        if np.isfinite(edge.width_m) and edge.length_m > 30:
            text = f"{edge.width_m:.1f}" if edge.is_driven else f"≥ {edge.width_m:.1f}"
            axes.annotate(text, edge.xy[len(edge.xy) // 2], fontsize=8, ha="center", va="center", path_effects=halo)
    for node in network.nodes:
        is_junction = node.kind == "intersection"
        axes.plot(*node.xy, "o" if is_junction else "s", color=TRACK if is_junction else SURFACE_EDGE, ms=5, mec=PAPER)
    axes.set_aspect("equal")
    axes.set_axis_off()
    figure.savefig(out)
    plt.close(figure)


def main() -> None:
    """Simulate the demo drive and draw its roads, or draw those of a result."""
    if len(sys.argv) == 3:
        draw(Path(sys.argv[1]), Path(sys.argv[2]))
        return
    with tempfile.TemporaryDirectory() as folder:
        drive, result = Path(folder) / "drive", Path(folder) / "result"
        for step in ([*DEMO, "-o", str(drive)], ["run", str(drive), "-o", str(result)]):
            assert run([*step, "--quiet"]) == 0
        draw(result, result / "roads.png")
        (FIGURES / "roads.png").write_bytes(shrink((result / "roads.png").read_bytes()))


if __name__ == "__main__":
    main()
