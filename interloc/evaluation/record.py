"""What `report.json` holds, and how it is read again."""

from pathlib import Path
from typing import NotRequired

from typing_extensions import TypedDict

from interloc.arrays import JsonObject
from interloc.osm.policies import Policy
from interloc.output.geojson import read_as

REPORT_FILE = "report.json"


class MapFigures(TypedDict):
    """The fused intersections against the nodes of the map."""

    gate_m: float
    intersections: int
    intersections_in_zone: int
    nodes_in_zone: int
    assigned: int
    true: int
    false: int
    not_counted: NotRequired[int]  # what is not required, 0.2 did not write
    not_judged: NotRequired[int]
    missed: int
    precision: float | None
    recall: float | None
    mean_m: float | None
    median_m: float | None
    p95_m: float | None
    max_m: float | None


class Report(TypedDict):
    """What `report.json` holds; what is undefined is None. Figures over D have a key for each threshold: "5.0"."""

    drive: str
    policy: Policy
    tolerance_m: float | None
    attribution: str
    license: NotRequired[str]
    osm: JsonObject
    """What the map is: its source, date, bounds, and how much it holds."""
    keyframes: int
    detections: int
    detections_outside_map: int
    matched: int
    ace_m: float | None
    ace_tp_m: float | None
    ace_tp_threshold_m: float
    ace_under_10_m: float | None
    ace_under_threshold_m: float
    median_m: float | None
    p95_m: float | None
    rmse_m: float | None
    tp: dict[str, int]
    fp: dict[str, int]
    fn: dict[str, int]
    precision: dict[str, float | None]
    recall: dict[str, float | None]
    f1: dict[str, float | None]
    roi_m: float
    relevant_zone_m: float
    nodes_in_zone: int
    nodes_found: int
    map_level: MapFigures
    map_line: str
    roads: NotRequired[dict[str, float] | None]
    reasons: dict[str, dict[str, int]]
    georeference: JsonObject
    track_to_road_m: float | None
    warnings: list[str]
    intersections: list[JsonObject]
    nodes: list[JsonObject]
    """Positions, errors, and the properties of the layers `intersections` and `osm_nodes`."""
    with_service: NotRequired[JsonObject | None]
    """The same of the fused map under policy drive+service."""
    missing: NotRequired[list[str]]


def read_report(folder: Path) -> Report:
    """Read the report of a result folder; a DamagedResultError says what of it is missing or wrong."""
    return read_as(Report, folder / REPORT_FILE)
