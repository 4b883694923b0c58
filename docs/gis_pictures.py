"""Take the pictures of QGIS for docs/gis.md: `python -m docs.gis_pictures`.

Simulates the demo drive, works on it, exports the project, and has the QGIS of this machine (Debian: python3-qgis) open
it without a screen. The pictures go to docs/figures.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from docs.screenshots import DEMO, FIGURES, shrink
from interloc.cli.main import run

PYTHON = "/usr/bin/python3"
PAPER = ("--preset", "paper")  # it misses some

IN_QGIS = """
import os, sys
from qgis.PyQt.QtCore import Qt
from qgis.PyQt.QtWidgets import QSplitter
from qgis.core import *
from qgis.gui import *
source, out = sys.argv[1:]
app = QgsApplication([], True)
app.initQgis()
app.setStyle("fusion")
project = QgsProject.instance()
canvas, tree = QgsMapCanvas(), QgsLayerTreeView()
QgsLayerTreeMapCanvasBridge(project.layerTreeRoot(), canvas)
assert project.read(source), project.error()
font = app.font()
font.setPointSize(9)
app.setFont(font)
model = QgsLayerTreeModel(project.layerTreeRoot())
model.setFlag(QgsLayerTreeModel.AllowNodeChangeVisibility)
tree.setModel(model)
canvas.setDestinationCrs(project.crs())
canvas.setLayers([each for each in project.layerTreeRoot().layerOrder()
                  if project.layerTreeRoot().findLayer(each.id()).isVisible()])
window = QSplitter(Qt.Horizontal)
window.addWidget(tree)
window.addWidget(canvas)
window.resize(1060, 600)
window.setSizes([240, 820])
window.show()

def take(name, widget):
    canvas.refresh()
    canvas.waitWhileRendering()
    app.processEvents()
    widget.grab().save(f"{out}/{name}.png")

canvas.setReferencedExtent(project.viewSettings().defaultViewExtent())
take("qgis_project", window)
(layer,) = project.mapLayersByName("Intersections")
there = QgsCoordinateTransform(layer.crs(), project.crs(), project)
farthest = max(layer.getFeatures(), key=lambda each: each["error_m"])
place = there.transform(farthest.geometry().asPoint())
canvas.setExtent(QgsRectangle(place.x() - 24, place.y() - 13, place.x() + 24, place.y() + 13))
window.resize(1000, 400)
window.setSizes([0, 1000])
take("qgis_intersection", canvas)
os._exit(0)
"""


def main() -> None:
    """Take all pictures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        steps = (
            [*DEMO, "-o", str(folder / "town")],
            ["run", str(folder / "town"), "-o", str(folder / "out"), "--osm", str(folder / "town/map.osm"), *PAPER],
            ["export", str(folder / "out"), "-o", str(folder / "town.qgz")],
        )
        for step in steps:
            assert run([*step, "--quiet"]) == 0
        take(folder / "town.qgz", folder)
        for picture in sorted(folder.glob("qgis_*.png")):
            (FIGURES / picture.name).write_bytes(shrink(picture.read_bytes()))


def take(project: Path, folder: Path) -> None:
    """Have QGIS draw its pictures of a project into a folder."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(folder), "QT_QPA_PLATFORM": "offscreen"}
    subprocess.run([PYTHON, "-c", IN_QGIS, project, folder], check=True, env=environment)  # noqa: S603


if __name__ == "__main__":
    main()
