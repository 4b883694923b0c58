"""Evaluations of one drive side by side: which inputs and settings differ, which figures, which nodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from typing import Any, Literal

from pydantic import BaseModel, Field

from interloc.arrays import JsonObject
from interloc.config import flatten
from interloc.errors import ConfigError
from interloc.evaluation.record import Report
from interloc.results import RunRecord

Outcome = Literal["found", "missed", "outside"]


class Difference(BaseModel):
    """An input or a setting in which runs differ."""

    name: str = Field(examples=["bev.resolution_m"])
    values: list[Any] = Field(description="In the order of the runs.", examples=[[0.16, 0.25]])


class Figure(BaseModel):
    """A figure of the reports."""

    name: str = Field(examples=["ace_m"])
    title: str = Field(description="Its name in words.", examples=["mean error of detections (ACE) [m]"])
    values: list[int | float | None]


class ComparedNode(BaseModel):
    """An OpenStreetMap node with different outcomes."""

    osm_id: str
    lon: float
    lat: float
    degree: int
    outcomes: list[Outcome] = Field(
        description="In the order of the runs; outside: it lay in no zone in which a missed node counts."
    )
    median_error_m: list[float | None]


class Comparison(BaseModel):
    """Reports of one drive side by side; lists of values are in the order of the runs."""

    runs: list[str] = Field(description="Names of the runs.")
    inputs: list[Difference] = Field(description="Labels and georeference, where the runs differ in them.")
    settings: list[Difference] = Field(description="Settings in which the runs differ.")
    figures: list[Figure]
    nodes: list[ComparedNode] = Field(description="Nodes with different outcomes.")
    found_by_all: int
    missed_by_all: int
    found_only_by: list[list[str]] = Field(description="OSM ids of the nodes that only this run found.")
    warnings: list[str] = Field(description="Why figures may not be comparable.")


def compare_reports(names: Sequence[str], reports: Sequence[Report], runs: Sequence[RunRecord]) -> Comparison:
    """Put `report.json` and `run.json` of several runs over one drive side by side, in the order of their names."""
    if len(names) < 2 or not len(names) == len(reports) == len(runs):
        raise ConfigError(f"a comparison takes two runs or more, each with its report; {len(names)} given")
    tables = [{str(node["osm_id"]): node for node in report["nodes"]} for report in reports]
    nodes = [_node(osm_id, tables) for osm_id in dict.fromkeys(osm_id for table in tables for osm_id in table)]
    found = [{node.osm_id for node in nodes if node.outcomes[i] == "found"} for i in range(len(names))]
    missed = [{node.osm_id for node in nodes if node.outcomes[i] == "missed"} for i in range(len(names))]
    only = [mine.difference(*(other for other in found if other is not mine)) for mine in found]
    return Comparison(
        runs=list(names),
        inputs=_differing([{name: run.get(key) for name, key in _INPUTS.items()} for run in runs]),
        settings=_differing([dict(flatten(run.get("config", {}))) for run in runs]),
        figures=[
            Figure(name=name, title=title, values=[_figure(report, path) for report in reports])
            for name, title, path in _FIGURES
        ],
        nodes=[node for node in nodes if len(set(node.outcomes)) > 1],
        found_by_all=len(set.intersection(*found)),
        missed_by_all=len(set.intersection(*missed)),
        found_only_by=[sorted(each, key=int) for each in only],
        warnings=_warnings(reports, runs),
    )


_INPUTS = {"drive": "drive_name", "labels": "labels", "road ids": "road_ids"}
_INPUTS |= {"frames": "frames", "poses": "poses", "georeference": "georeference"}
"""What a comparison calls an input -> where `run.json` has it; the map is that of the report."""

_FIGURES = (  # name, title, and where the report has it; a second place is subtracted
    ("map_right", "intersections right", "map_level/true"),
    ("map_wrong", "intersections wrong", "map_level/false"),
    ("map_nodes_found", "OSM nodes found", "map_level/nodes_in_zone - map_level/missed"),
    ("map_median_m", "median error of intersections [m]", "map_level/median_m"),
    ("map_precision", "precision of intersections", "map_level/precision"),
    ("map_recall", "recall of intersections", "map_level/recall"),
    ("map_mean_m", "mean error of intersections [m]", "map_level/mean_m"),
    ("keyframes", "keyframes", "keyframes"),
    ("detections", "detections", "detections"),
    ("ace_m", "mean error of detections (ACE) [m]", "ace_m"),
    ("median_m", "median error of detections [m]", "median_m"),
    ("p95_m", "95 % of detections within [m]", "p95_m"),
    ("precision_at_5", "precision, D = 5 m", "precision/5.0"),
    ("recall_at_5", "recall, D = 5 m", "recall/5.0"),
    ("f1_at_5", "F1, D = 5 m", "f1/5.0"),
    ("nodes_in_zone", "OSM nodes in the zone", "nodes_in_zone"),
    ("nodes_found", "OSM nodes with a detection within 5 m", "nodes_found"),
)


def _figure(report: Report, place: str) -> Any:  # noqa: ANN401 - a number or None
    figures: Any = report
    first, *rest = (reduce(getitem, each.split("/"), figures) for each in place.split(" - "))
    return first - rest[0] if rest else first


def _differing(flat: Sequence[Mapping[str, Any]]) -> list[Difference]:
    names = dict.fromkeys(name for each in flat for name in each)
    rows = [Difference(name=name, values=[each.get(name) for each in flat]) for name in names]
    return [row for row in rows if any(value != row.values[0] for value in row.values)]


def _node(osm_id: str, tables: Sequence[Mapping[str, JsonObject]]) -> ComparedNode:
    rows = [table.get(osm_id) for table in tables]
    known = next(row for row in rows if row is not None)
    return ComparedNode(
        osm_id=osm_id,
        lon=known["lon"],
        lat=known["lat"],
        degree=known["degree"],
        outcomes=["outside" if row is None or not row["in_zone"] else row["outcome"] for row in rows],
        median_error_m=[None if row is None else row["median_error_m"] for row in rows],
    )


def _warnings(reports: Sequence[Report], runs: Sequence[RunRecord]) -> list[str]:
    notes = []
    for what, values in (
        ("drives", [run.get("drive_name") for run in runs]),
        ("ground truth policies", [report["policy"] for report in reports]),
        ("maps", [report["osm"]["source"] for report in reports]),
        ("dates of the map", [report["osm"]["date"] for report in reports]),
        ("numbers of nodes on the map", [report["osm"]["nodes"] for report in reports]),
        ("sides of the zones", [f"{report['roi_m']:g} / {report['relevant_zone_m']:g} m" for report in reports]),
        ("tolerances", [report.get("tolerance_m") for report in reports]),
        ("numbers of keyframes", [report["keyframes"] for report in reports]),
        ("ways of counting", ["as now" if "not_counted" in each["map_level"] else "as 0.2.0" for each in reports]),
    ):
        if len({str(value) for value in values}) > 1:
            listed = ", ".join(str(value) for value in values)
            notes.append(f"The runs have different {what} ({listed}): their figures cannot be compared.")
    return notes


# The figures that the paper reports, for comparison with those of this implementation.

SEQUENCES = ("00", "02", "05", "06", "07", "08", "09", "10")
"""SemanticKITTI sequences of the paper's tables."""

MMINSECTDET = "MMInsectDet"


@dataclass(frozen=True)
class Published:
    """Published figures of one table cell."""

    ace_m: float
    """Average center error over all matched pairs, metres."""
    precision: float
    recall: float
    """Shares, 0..1."""


PERFORMANCE: dict[str, Published] = {
    "00": Published(1.28, 0.9723, 0.9415),
    "02": Published(2.76, 0.8147, 0.7295),
    "05": Published(0.62, 1.0, 0.9187),
    "06": Published(4.21, 0.4472, 0.2590),
    "07": Published(1.25, 1.0, 0.7730),
    "08": Published(1.66, 0.9186, 0.9686),
    "09": Published(3.16, 0.7857, 0.5284),
    "10": Published(3.01, 1.0, 0.6757),
}
"""Sequence -> figures at D = 5 m, RangeNet++ labels (paper's table of the performance on SemanticKITTI)."""

AVERAGE = Published(1.92, 0.8948, 0.7674)
"""The column "Average" of that table. It is not the mean of the columns (that is 2.24 m, 85.7 %): it is pooled."""

COMPARISON: dict[str, Published] = {
    MMINSECTDET: Published(4.25, 0.8923, 0.8310),
    "InterLoc, published": Published(1.92, 0.9438, 0.8428),
}
"""Method -> ACE, precision at 6.9 m, recall at 13.3 m (paper's comparison)."""

LABEL_ERRORS: dict[str, Published] = {
    "0/0": Published(1.86, 0.9006, 0.8069),
    "5/5": Published(2.26, 0.9059, 0.7614),
    "5/20": Published(2.32, 0.9059, 0.7644),
    "20/5": Published(2.94, 0.8095, 0.6839),
    "20/20": Published(3.23, 0.7883, 0.6800),
}
"""r-FPR / r-FNR in percent -> figures at D = 5 m, hand labels, all eight sequences (paper's table of label errors)."""
