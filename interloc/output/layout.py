"""Which files make up a result folder.

========================  ==============================================================================================
file                      properties
========================  ==============================================================================================
``detections.geojson``    ``frame``, ``x_m``, ``y_m`` (in L, levelled), ``world_x_m``, ``world_y_m``, ``branch_count``,
                          ``branch_bearings_deg``, ``score``, ``intersection`` (id of the fused one, null for none)
``keyframes.geojson``     ``frame``, ``time_s``, ``heading_deg``, ``detections``, ``world_x_m``, ``world_y_m``,
                          ``world_yaw_rad`` (heading in W, to which the region of interest is aligned)
``intersections.geojson`` ``id``, ``observations``, ``position_std_m``, ``branch_count``, ``branch_bearings_deg``,
                          ``first_frame``, ``last_frame``, ``confidence``, ``world_x_m``, ``world_y_m``
``trajectory.geojson``    ``scans``, ``thinned_to_m``; beside the geometry ``world_xy_m``, the same track in W
``run.json``              what the run was: format version, list of files, configuration, versions, timings
========================  ==============================================================================================

Bearings and headings are degrees clockwise from north, or from +y of W without georeference; the files are then named
``*.local.json`` and hold metres of W.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from interloc.files import atomic_folder

FORMAT = "interloc-result"
FORMAT_VERSION = 1
RUN_FILE = "run.json"
"""The file that makes a folder a result folder; written last."""

RUN_KEYS = ("format", "format_version", "drive_name", "georeferenced", "files")
"""What `run.json` holds besides what the run says of itself."""

TABLES = ("detections", "keyframes", "trajectory", "intersections")


def file_names(*, georeferenced: bool) -> dict[str, str]:
    """Return the file of each of `TABLES`."""
    ending = "geojson" if georeferenced else "local.json"
    return {table: f"{table}.{ending}" for table in TABLES}


RESULT_NAMES = frozenset(
    [
        RUN_FILE,
        *file_names(georeferenced=True).values(),
        *file_names(georeferenced=False).values(),
        "report.json",
        "report.html",
        "osm_nodes.geojson",
        "matches.geojson",
        "osm_roads.geojson",
        "figures",
    ]
)
"""What InterLoc itself puts into a result folder. All else in there is the user's and survives a new run."""


def result_folder(out: Path) -> AbstractContextManager[Path]:
    """Build a result folder that takes its name once it is complete; see `interloc.files.atomic_folder`."""
    return atomic_folder(out, marker=RUN_FILE, names=RESULT_NAMES)
