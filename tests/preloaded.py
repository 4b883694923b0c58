"""All that servers, workers and commands import or compile sooner or later: done once, then forked (see `forks`)."""

import gc
import tempfile
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from app.main import create_app
from app.settings import Settings
from interloc import cli
from interloc.config import preset
from interloc.drives.open import open_drive
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.osm.reader import read_osm
from interloc.output.write import write_results
from interloc.pipeline import detect
from interloc.reduction.reduce import reduce_drive
from tests.app.street import write_street
from tests.networks import write_model

gc.disable()  # so much is imported that looking for garbage takes a quarter of the time
commands = iter_modules(cli.__path__)
late = ("app.server", "app.work.warm", "interloc.client.connection", "interloc.client.jobs", "rich.console")
for name in (*late, *(f"interloc.cli.{each.name}" for each in commands)):
    import_module(name)

create_app(Settings()).openapi()  # FastAPI makes the routes when they are asked for

with tempfile.TemporaryDirectory() as folder:
    root = Path(folder)
    reduce_drive(write_street(root / "street", 8), root / "reduced", keyframes=None)
    for folder_name in ("street", "reduced"):
        for name in ("paper", "default"):
            result = detect(open_drive(root / folder_name), preset(name))  # numba compiles, or finds all compiled
    write_model(root / "model", height=16, width=128, road_half_width_m=5.0)
    detect(open_drive(root / "street", model=root / "model"), preset("default"))
    write_results(result, root / "result")
    write_report(evaluate(result, read_osm(root / "street" / "map.osm")), root / "result")

# No collection of a fork looks at all this again, which would copy it.
gc.collect()
gc.freeze()
gc.enable()
