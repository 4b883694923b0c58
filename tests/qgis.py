"""The QGIS of this machine: answers the questions of a test in a process of its own, since its start is slow."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

PYTHON = "/usr/bin/python3"

_BEFORE = """
import json, os, sys
from qgis.PyQt.QtCore import QSize
from qgis.core import *
from qgis.gui import QgsMapCanvas
app = QgsApplication([], True)
app.initQgis()
log, told = [], {}
app.messageLog().messageReceived.connect(lambda text, topic, level: level and log.append(f"{topic}: {text}"))

def legend_of(layer):
    renderer = layer.renderer()  # None: it has no geometry
    return renderer and [item.label() for item in renderer.legendSymbolItems()]

def types_of(layer):
    return {field.name(): field.typeName() for field in layer.fields()}

def describe(layer):
    about = layer.metadata()
    return {
        "valid": layer.isValid(), "features": layer.featureCount(), "crs": layer.crs().authid(),
        "title": about.title(), "abstract": about.abstract(), "rights": about.rights(), "licenses": about.licenses(),
        "types": types_of(layer), "provider": layer.providerType(),
        "aliases": {field.name(): field.alias() for field in layer.fields()},
        "legend": legend_of(layer), "labels": layer.labelsEnabled(),
    }

def read_project(path):
    project, canvas = QgsProject.instance(), QgsMapCanvas()
    was_read = project.read(path)
    tree = project.layerTreeRoot()
    return {
        "read": was_read, "title": project.title(), "crs": project.crs().authid(),
        "layers": {each.name(): describe(each) for each in tree.layerOrder() if isinstance(each, QgsVectorLayer)},
        "rasters": {
            each.name(): [each.isValid(), each.crs().authid(), each.renderer().type()]
            for each in tree.layerOrder() if isinstance(each, QgsRasterLayer)
        },
        "groups": {group.name(): [each.name() for each in group.children()] for group in tree.children()},
        "hidden": [layer.name() for layer in tree.layerOrder() if not tree.findLayer(layer.id()).isVisible()],
        "credit": project.readEntry("CopyrightLabel", "/Label")[0],
        "extent": project.viewSettings().defaultViewExtent().toString(0), "shown": canvas.extent().toString(0),
    }

def draw_project(path):
    project = QgsProject.instance()
    tree = project.layerTreeRoot()
    settings = QgsMapSettings()
    settings.setLayers([layer for layer in tree.layerOrder() if tree.findLayer(layer.id()).isVisible()])
    settings.setDestinationCrs(project.crs())
    settings.setExtent(project.viewSettings().defaultViewExtent())
    settings.setOutputSize(QSize(600, 600))
    job = QgsMapRendererSequentialJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(path)
    log.extend(each.message for each in job.errors())

"""

_AFTER = """
told["log"] = log
print(json.dumps(told), flush=True)
os._exit(0)  # without a word to the layers, which would outlive what they are part of
"""


def require_qgis() -> None:
    if subprocess.run([PYTHON, "-c", "import qgis.core"], check=False, capture_output=True).returncode:
        pytest.skip("QGIS for Python (Debian: python3-qgis) is not installed")


def ask_qgis(script: str, *arguments: str | Path, home: Path) -> dict[str, Any]:
    """Return the dictionary `told`, which a script fills that knows the functions above, and `log`: its warnings."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(home), "QT_QPA_PLATFORM": "offscreen"}
    command = [PYTHON, "-c", f"{_BEFORE}{script}{_AFTER}", *arguments]
    outcome = subprocess.run(command, check=False, capture_output=True, text=True, env=environment, timeout=120)
    assert outcome.returncode == 0, outcome.stderr
    told: dict[str, Any] = json.loads(outcome.stdout.splitlines()[-1])
    return told


def pixels_of(picture: Path, colour: str) -> int:
    """Return how many pixels of a picture have a colour, ``#rrggbb``."""
    rgb = [int(colour[index : index + 2], 16) for index in (1, 3, 5)]
    return int((np.asarray(Image.open(picture).convert("RGB")) == rgb).all(axis=-1).sum())
