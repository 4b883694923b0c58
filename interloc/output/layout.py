"""Which files make up a result folder.

========================  ==============================================================================================
file                      content
========================  ==============================================================================================
``run.json``              what the run was: format version, list of files, configuration, versions, timings
``LAYER.geojson``         one per table of the run, and those of its roads, which folders of older versions do not have;
                          properties: the models of `interloc.output.properties`
``LAYER.local.json``      the same of a run without georeference, in metres of W
``road.tif``              the road seen by LiDAR, a GeoTIFF; not in folders of older versions
``report.json``, ...      after an evaluation: the report, its figures, and the layers that hold OpenStreetMap data
========================  ==============================================================================================
"""

from contextlib import AbstractContextManager
from pathlib import Path

from interloc.errors import ConfigError
from interloc.files import atomic_folder

FORMAT = "interloc-result"
FORMAT_VERSION = 1
RUN_FILE = "run.json"
"""The file that makes a folder a result folder; written last."""

ROAD_FILE = "road.tif"

RUN_KEYS = ("format", "format_version", "drive_name", "georeferenced", "files", "first_time", "last_time")
"""What `run.json` holds before what the run records about itself; the times are those of the first and the last
keyframe, RFC 3339, or null."""

BUILDINGS = "osm_buildings"
"""Layer of a scored result whose map holds buildings."""

PLACES = "places"
"""Layer of a result that was placed on the map by its roads."""

MAP_LAYERS = ("osm_nodes", "matches", "osm_roads", BUILDINGS, PLACES)
"""The layers of a result that hold data of OpenStreetMap."""

TABLES = ("detections", "keyframes", "trajectory", "intersections")
ROAD_LAYERS = ("roads", "junctions", "road_surface")


def file_names(*, georeferenced: bool) -> dict[str, str]:
    """Return the file of each of `TABLES` and `ROAD_LAYERS`."""
    ending = "geojson" if georeferenced else "local.json"
    return {layer: f"{layer}.{ending}" for layer in (*TABLES, *ROAD_LAYERS)}


RUN_NAMES = (
    *file_names(georeferenced=True).values(),
    *file_names(georeferenced=False).values(),
    f"{PLACES}.geojson",
    ROAD_FILE,
    RUN_FILE,
)
"""What a run writes, whether it is evaluated or not, in this order."""

FIGURES = "figures"
"""The one folder in a result folder: the figures of an evaluation."""

RESULT_NAMES = frozenset(
    [*RUN_NAMES, "report.json", "report.html", *(f"{layer}.geojson" for layer in MAP_LAYERS), FIGURES]
)
"""What InterLoc itself puts into a result folder. All else in there is the user's and survives a new run."""


def refuse_result_file(out: Path) -> None:
    """Raise ConfigError where a file to write is one of those that make up the result folder it is in."""
    if out.name in RESULT_NAMES and (out.parent / RUN_FILE).is_file():
        raise ConfigError(
            f"{out} is a file of the result {out.parent} itself, and was not touched. Give another name or folder (-o)."
        )


def result_folder(out: Path) -> AbstractContextManager[Path]:
    """Build a result folder that takes its name once it is complete; see `interloc.files.atomic_folder`."""
    return atomic_folder(out, marker=RUN_FILE, names=RESULT_NAMES)
