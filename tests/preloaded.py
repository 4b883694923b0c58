"""All that servers, workers and commands import or compile sooner or later: done once, then forked (see `forks`)."""

from __future__ import annotations

import tempfile
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import numpy as np
from matplotlib.figure import Figure

from interloc import cli
from interloc.config import preset
from interloc.drawing import ImageFormat, image
from interloc.drives.open import open_drive
from interloc.evaluation import report
from interloc.evaluation.evaluate import evaluate
from interloc.kernels.lzf import decompress_lzf
from interloc.osm.reader import read_osm
from interloc.output.write import write_results
from interloc.pipeline import detect
from interloc.reduction.reduce import reduce_drive
from tests.app.street import write_street
from tests.networks import write_model

commands = iter_modules(cli.__path__)
for name in ("app.server", "app.work.intersections", *(f"interloc.cli.{each.name}" for each in commands)):
    import_module(name)

with tempfile.TemporaryDirectory() as folder:
    root = Path(folder)
    reduce_drive(write_street(root / "street", 40), root / "reduced", keyframes=None)
    for folder_name in ("street", "reduced"):
        for name in ("paper", "default"):
            result = detect(open_drive(root / folder_name), preset(name))  # numba compiles, or finds all compiled
    write_model(root / "model", height=16, width=128)
    detect(open_drive(root / "street", model=root / "model"), preset("default"))
    decompress_lzf(np.zeros(1, np.uint8), 1)
    write_results(result, root / "result")
    report.write_report(evaluate(result, read_osm(root / "street" / "map.osm")), root / "result")


@cache
def blank(kind: ImageFormat) -> bytes:
    """A picture without anything in it."""
    return image(Figure(), kind)


# The pictures of a report take three quarters of the time of a short job. In the processes that are forked from here
# they are blank: those that look at pictures make them in the process of the test, or start `interloc` as it is.
report.image = lambda _, kind: blank(kind)
