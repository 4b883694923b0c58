"""Find road intersections in LiDAR drives, map them, and score them against OpenStreetMap.

import interloc

drive = interloc.open_drive("sequences/07", oxts="2011_09_30_drive_0027_sync")
result = interloc.detect(drive)                                   # offline, the whole drive
evaluation = interloc.evaluate(result, interloc.read_osm("map.osm.gz"))

detector = interloc.Detector()                                    # online, scan by scan
detections = detector.push(interloc.Scan(frame, T_world_lidar, road_points))
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from interloc.config import DetectorConfig as DetectorConfig
    from interloc.config import preset as preset
    from interloc.detect.detector import Detector as Detector
    from interloc.detect.scan import Scan as Scan
    from interloc.drives.inspect import inspect_drive as inspect_drive
    from interloc.drives.open import open_drive as open_drive
    from interloc.errors import InterLocError as InterLocError
    from interloc.evaluate.evaluate import evaluate as evaluate
    from interloc.evaluate.report import write_report as write_report
    from interloc.mapping.exports import read_results as read_results
    from interloc.mapping.exports import write_results as write_results
    from interloc.osm.reader import read_osm as read_osm
    from interloc.pipeline import detect as detect

# Imported when first asked for: the compiler behind the kernels alone takes half a second to load.
# `detect` and `evaluate` are packages too; these can be called (see `interloc._callable`).
_HOME = {
    "DetectorConfig": "interloc.config",
    "preset": "interloc.config",
    "Detector": "interloc.detect.detector",
    "Scan": "interloc.detect.scan",
    "inspect_drive": "interloc.drives.inspect",
    "open_drive": "interloc.drives.open",
    "InterLocError": "interloc.errors",
    "write_report": "interloc.evaluate.report",
    "read_results": "interloc.mapping.exports",
    "write_results": "interloc.mapping.exports",
    "read_osm": "interloc.osm.reader",
}

__all__ = [*_HOME, "detect", "evaluate"]  # noqa: PLE0604 - the names of _HOME are strings


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any of the names above
    if name in {"detect", "evaluate"}:
        return import_module(f"interloc.{name}")
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'interloc' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
