"""The files of an evaluation: report.json, report.html, the layers with data of OpenStreetMap, figures."""

import base64
import math
import os
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from interloc.arrays import FloatArray, IntArray, JsonObject
from interloc.drawing import ImageFormat, image
from interloc.errors import Beside, ConfigError, OutputError, expect
from interloc.evaluation.coverage import track_bounds
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M, UNMATCHED
from interloc.evaluation.reasons import KINDS
from interloc.evaluation.record import REPORT_FILE, MapFigures, Report
from interloc.evaluation.roads import BUFFER_M
from interloc.files import reason_of, write_file
from interloc.osm.policies import POLICIES
from interloc.output.credits import map_credit
from interloc.output.geojson import (
    DEGREE_DECIMALS,
    METRE_DECIMALS,
    Feature,
    cut,
    positions,
    rounded,
    write_collection,
    write_record,
)
from interloc.output.layers import LAYERS
from interloc.output.layout import BUILDINGS, FIGURES, ROAD_LAYERS
from interloc.output.properties import origin_of
from interloc.output.roads import building_features, osm_road_features, road_features, roads
from interloc.output.write import TABLE_FEATURES, detection_features, intersection_features
from interloc.results import DriveResult
from interloc.wording import metres, percent

_RATIO_DECIMALS = 6


def write_report(
    evaluation: Evaluation,
    out_dir: str | os.PathLike[str],
    *,
    result: DriveResult | None = None,
    beside: Beside | None = None,
) -> Report:
    """Write the report of an evaluation into the result folder of its run.

    Parameters
    ----------
    evaluation
        Of `result`.
    out_dir
        Folder of the run, as `interloc.write_results` wrote it. Files of an older report are replaced, each whole or
        not at all, and so are its detections and intersections: the same with the verdicts of this evaluation. Write
        into an `interloc.files.atomic_folder` for all or nothing.
    result
        The run as it was written, where that is not the one that was scored (`interloc.localization.apply`). Its
        configuration and timings are part of the report.
    beside
        Collects what of figures, page, roads and layers of the map could not be made, instead of an IncompleteError.

    Returns
    -------
    Report
        What `report.json` holds.

    Raises
    ------
    OutputError
        The folder is missing, or a file could not be written.
    IncompleteError
        All was written but what failed beside the score.
    """
    parts = beside or Beside()
    result, out_dir = result or evaluation.result, Path(out_dir)
    if not out_dir.is_dir():
        raise OutputError(
            f"{out_dir}: no such folder. Expected the result folder of `interloc run` or `interloc.write_results`."
        )
    with parts.part("the score of the roads"):
        _ = evaluation.roads
    evaluation.__dict__.setdefault("roads", None)  # where it failed, it is not tried again
    pictures = _write_figures(evaluation, result, out_dir / FIGURES, parts)
    graph, origin = evaluation.graph, origin_of(result.run, result.drive)
    for layer, features_of in LAYER_FEATURES.items():
        with parts.part(f"the layer {layer}"):
            features = features_of(evaluation, result)
            if layer == BUILDINGS and not features:  # most maps of roads have none; those of an older map are gone
                (out_dir / f"{layer}.geojson").unlink(missing_ok=True)
                continue
            credit = LAYERS[layer].credit(features, made_up_map=graph.is_made_up)
            write_collection(out_dir / f"{layer}.geojson", features, local=False, credit=credit, origin=origin)
    record = report_record(evaluation)
    with parts.part("report.html"):
        write_file(out_dir / "report.html", render_html(record, pictures))
    if parts.missing:
        record["missing"] = parts.missing
    write_record(out_dir / REPORT_FILE, record)  # last: where it is, the rest is complete
    if beside is None:
        parts.check(out_dir)
    return record


def render_html(record: Report, pictures: dict[str, str]) -> str:
    """Return the page of a report as one file that needs no server; `pictures` are data addresses of its figures."""
    standard = threshold_name(STANDARD_THRESHOLD_M)
    nodes = sorted(record["nodes"], key=lambda n: (not n["in_zone"], n["found"], -(n["median_error_m"] or 0.0)))
    order = {"wrong": 0, "not_counted": 1, "right": 2, "unscored": 3}
    intersections = sorted(
        record["intersections"], key=lambda each: (order[each["outcome"]], -(each["error_m"] or 0.0), each["id"])
    )
    counts = record["reasons"]  # of kinds that cannot occur in a table it has none
    kinds = [(meaning, {table: counts[table].get(kind) for table in counts}) for kind, meaning in KINDS.items()]
    return _template().render(
        record=record,
        standard=standard,
        threshold=f"{STANDARD_THRESHOLD_M:g}\N{NO-BREAK SPACE}m",
        policy_meaning=POLICIES[record["policy"]].meaning,
        nodes=nodes,
        intersections=intersections,
        pictures=pictures,
        kinds=[(meaning, row) for meaning, row in kinds if any(row.values())],
    )


@cache
def _template() -> Template:
    """Return the template of the page, with `percent` and `metres`."""
    environment = Environment(
        loader=PackageLoader("interloc.evaluation"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"percent": percent, "metres": metres}
    return environment.get_template("report.html")


def _write_figures(evaluation: Evaluation, result: DriveResult, folder: Path, parts: Beside) -> dict[str, str]:
    """Write the figures; return their data addresses, "" of one that failed."""
    from interloc.evaluation.figures import map_figure, threshold_figure  # noqa: PLC0415 - slow to import

    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder} could not be created: {reason_of(error)}.") from error
    # Thousands of marks are smaller and faster as pixels; curves are sharper as curves.
    figures: dict[str, tuple[ImageFormat, str, Callable[[], Any]]] = {
        "map": ("png", "image/png", lambda: map_figure(evaluation, result)),
        "thresholds": ("svg", "image/svg+xml", lambda: threshold_figure(evaluation)),
    }
    pictures = dict.fromkeys(figures, "")
    for name, (kind, mime_type, draw) in figures.items():
        with parts.part(f"the figure {name}"):
            picture = image(draw(), kind)
            write_file(folder / f"{name}.{kind}", picture)
            pictures[name] = f"data:{mime_type};base64,{base64.b64encode(picture).decode()}"
    return pictures


def _match_features(evaluation: Evaluation, result: DriveResult) -> list[Feature]:
    detections, matching = evaluation.detections, evaluation.matching
    rows = np.flatnonzero(matching.is_matched)
    node, error = matching.node[rows], matching.error_m[rows]
    frame = evaluation.keyframes.frame[detections.keyframe[rows]]
    every = evaluation.detection_row[rows].tolist()
    names = result.detections.names(result.keyframes)
    ids = [*result.intersections.id.tolist(), None]  # row -1: not fused
    seen = positions(detections.degrees[rows], local=False)
    truth = positions(evaluation.nodes.lonlat[node], local=False)
    return LAYERS["matches"].features(
        [list(line) for line in zip(seen, truth, strict=True)],
        frame=frame,
        error_m=error,
        outcome=["TP" if each < STANDARD_THRESHOLD_M else "FP" for each in error.tolist()],
        osm_id=evaluation.nodes.osm_id[node],
        detection=[names[row] for row in every],
        intersection=[ids[result.detections.intersection[row]] for row in every],
    )


def _road_features(evaluation: Evaluation, result: DriveResult) -> list[Feature]:
    seen = {} if evaluation.roads is None else {row: way._asdict() for row, way in evaluation.roads.ways.items()}
    return osm_road_features(evaluation.graph, track_bounds(result.keyframes.degrees), seen)


LAYER_FEATURES: dict[str, Callable[[Evaluation, DriveResult], list[Feature]]] = {
    "detections": lambda evaluation, result: detection_features(result, evaluation.verdicts.detections),
    "intersections": lambda evaluation, result: intersection_features(
        result, evaluation.verdicts.intersections, evaluation.verdicts.uids, evaluation.verdicts.names
    ),
    "osm_nodes": lambda evaluation, _: _node_features(evaluation),
    "matches": _match_features,
    "osm_roads": _road_features,
    BUILDINGS: lambda evaluation, result: building_features(evaluation.graph, result.keyframes.degrees),
}
"""The features of each layer that an evaluation adds to a result, or says more of."""


def report_record(evaluation: Evaluation) -> Report:
    """Return what `report.json` holds."""
    scores, errors = evaluation.scores, evaluation.errors
    map_level = _map_level(evaluation)
    names = [threshold_name(d) for d in scores.threshold_m]
    return {
        "drive": evaluation.drive,
        "policy": evaluation.nodes.policy,
        "tolerance_m": evaluation.nodes.tolerance_m,
        **map_credit(is_made_up=evaluation.graph.is_made_up).members,  # type: ignore[typeddict-item]  # any dict
        "osm": {
            "source": evaluation.graph.source,
            "made_up": evaluation.graph.is_made_up,
            "date": evaluation.graph.date,
            "nodes": len(evaluation.nodes),
            "bounds": evaluation.graph.bounds,
            "highways": len(evaluation.graph.ways),
            "clipped_highways": evaluation.graph.clipped_ways,
            "buildings": len(evaluation.graph.buildings),
        },
        "keyframes": len(evaluation.keyframes),
        "detections": len(evaluation.detections),
        "detections_outside_map": evaluation.detections_outside_map,
        "matched": int(evaluation.matching.is_matched.sum()),
        "ace_m": _metres(errors.ace_m),
        "ace_tp_m": _metres(errors.ace_tp_m),
        "ace_tp_threshold_m": STANDARD_THRESHOLD_M,
        "ace_under_10_m": _metres(errors.ace_under_10_m),
        "ace_under_threshold_m": NEAR_PAIR_M,
        "median_m": _metres(errors.median_m),
        "p95_m": _metres(errors.p95_m),
        "rmse_m": _metres(errors.rmse_m),
        "tp": dict(zip(names, scores.tp.tolist(), strict=True)),
        "fp": dict(zip(names, scores.fp.tolist(), strict=True)),
        "fn": dict.fromkeys(names, scores.fn),  # the same for every D: a match has no limit of distance
        "precision": dict(zip(names, _ratios(scores.precision), strict=True)),
        "recall": dict(zip(names, _ratios(scores.recall), strict=True)),
        "f1": dict(zip(names, _ratios(scores.f1), strict=True)),
        "roi_m": evaluation.roi_m,
        "relevant_zone_m": evaluation.relevant_zone_m,
        "nodes_in_zone": evaluation.nodes_in_zone,
        "nodes_found": evaluation.nodes_found,
        "map_level": map_level,
        "map_line": map_line(map_level),
        "roads": _road_record(evaluation),
        "reasons": evaluation.verdicts.counts,
        "georeference": evaluation.georeference,
        "track_to_road_m": _metres(evaluation.track_to_road_m),
        "warnings": list(evaluation.warnings),
        "intersections": _intersection_rows(evaluation),
        "nodes": _node_rows(evaluation),
        "with_service": None if (other := evaluation.with_service) is None else _map_record(other),
    }


def _map_record(evaluation: Evaluation) -> JsonObject:
    """Return what another policy says about the fused map: what a reader can switch to without another run."""
    level = _map_level(evaluation)
    return {
        "policy": evaluation.nodes.policy,
        "map_level": level,
        "map_line": map_line(level),
        "intersections": [
            {name: row[name] for name in ("id", "outcome", "osm_id", "error_m", "reason", "names")}
            for row in _intersection_rows(evaluation)
        ],
        "nodes": _node_rows(evaluation),
    }


def _road_record(evaluation: Evaluation) -> dict[str, float] | None:
    scores = evaluation.roads
    if scores is None:
        return None
    ratios = {name: round(getattr(scores, name), 4) for name in ("completeness", "correctness", "quality")}
    return {"buffer_m": BUFFER_M, **ratios, "map_m": round(scores.map_m), "roads_m": round(scores.roads_m)}


def map_line(level: MapFigures) -> str:
    """Return `map_level` of a report in one line, with its gate named.

    "13 of 14 intersections right within 10 m, 1 not judged, 5 of 5 nodes found, median 0.9 m".
    """
    right, scored = level["true"], level["intersections_in_zone"] - level["not_counted"]
    nodes = level["nodes_in_zone"]
    what = "intersection" if scored == 1 else "intersections"
    neutral = {"not counted by this policy": level["not_counted"], "not judged": level["not_judged"]}
    named = [f"{count} {words}" for words, count in neutral.items() if count]
    judged = [] if named and not scored else ["no intersections"]
    parts = [
        *([f"{right} of {scored} {what} right within {level['gate_m']:g} m"] if scored else judged),
        *named,
        f"{nodes - level['missed']} of {nodes} {'node' if nodes == 1 else 'nodes'} found",
    ]
    if level["median_m"] is not None:
        parts.append(f"median {level['median_m']:.1f} m")
    return ", ".join(parts)


def threshold_name(threshold_m: float) -> str:
    """Return the key of a threshold in the maps of the report: "5.0"."""
    return f"{threshold_m:.1f}"


def _node_features(evaluation: Evaluation) -> list[Feature]:
    nodes, table, verdicts = evaluation.nodes, evaluation.node_table, evaluation.verdicts
    ids = [*evaluation.intersections.id.tolist(), None]  # row -1: none
    return LAYERS["osm_nodes"].features(
        positions(nodes.lonlat, local=False),
        osm_id=nodes.osm_id,
        degree=nodes.degree,
        in_zone=table.in_zone,
        found=[outcome == "found" for outcome in verdicts.node_outcome],
        detected=table.found,
        keyframes_in_zone=table.zone_keyframes,
        keyframes_missed=table.missed_keyframes,
        detections=table.detections,
        median_error_m=table.median_error_m,
        outcome=verdicts.node_outcome,
        intersection=[ids[row] for row in verdicts.node_intersection.tolist()],
        reason=verdicts.node_reason,
        names=verdicts.node_names,
    )


def _node_rows(evaluation: Evaluation) -> list[JsonObject]:
    """Return the nodes that mattered: in the zone of some keyframe, or matched by some detection."""
    nodes, table, level = evaluation.nodes, evaluation.node_table, evaluation.map_level
    features = _node_features(evaluation)
    on_map = dict(zip(level.node.tolist(), level.error_m.tolist(), strict=True))
    rows = []
    for row in np.flatnonzero(table.in_zone | (table.detections > 0)).tolist():
        properties = features[row]["properties"] | features[row]["details"]
        lon, lat = (rounded(degrees, DEGREE_DECIMALS) for degrees in nodes.lonlat[row])
        errors = {
            "best_error_m": _metres(table.best_error_m[row]),
            "median_error_m": properties.pop("median_error_m"),
            "map_error_m": _metres(on_map.get(row)),
        }
        rows.append({"osm_id": properties.pop("osm_id"), "lon": lon, "lat": lat, **properties, **errors})
    return rows


def _intersection_rows(evaluation: Evaluation) -> list[JsonObject]:
    """Return the fused intersections with their verdicts; positions as scored."""
    table, verdicts = evaluation.intersections, evaluation.verdicts
    judged = verdicts.intersections
    return [
        {
            "id": int(table.id[row]),
            "uid": verdicts.uids[row],
            "lon": lon,
            "lat": lat,
            "outcome": judged.outcome[row],
            "osm_id": None if (node := judged.osm_id[row]) is None else str(node),
            "error_m": _metres(judged.error_m[row]),
            "position_std_m": _metres(table.position_std_m[row]),
            "observations": int(table.observations[row]),
            "confidence": _ratio(float(table.confidence[row])),
            "branch_count": len(table.bearings_deg[row]),
            "reason": judged.reason[row],
            "names": verdicts.names[row],
        }
        for row, (lon, lat) in enumerate(positions(table.degrees, local=False))
    ]


def _map_level(evaluation: Evaluation) -> MapFigures:
    level = evaluation.map_level
    errors, outcomes = level.errors_m, Counter(evaluation.verdicts.intersections.outcome)
    right, wrong = outcomes["right"], outcomes["wrong"]
    return {
        "gate_m": level.gate_m,
        "intersections": len(level.node),
        "intersections_in_zone": int(level.counts.sum()),
        "nodes_in_zone": int(level.node_in_zone.sum()),
        "assigned": int((level.node != UNMATCHED).sum()),
        "true": right,
        "false": wrong,
        "not_counted": outcomes["not_counted"],
        "not_judged": outcomes["unscored"],
        "missed": int(level.missed.sum()),
        "precision": _ratio(right / (right + wrong)) if right + wrong else None,
        "recall": _ratio(level.recall),
        "mean_m": _metres(errors.mean() if len(errors) else None),
        "median_m": _metres(np.median(errors) if len(errors) else None),
        "p95_m": _metres(np.percentile(errors, 95.0) if len(errors) else None),
        "max_m": _metres(errors.max() if len(errors) else None),
    }


def _metres(value: float | np.floating[Any] | None) -> float | None:
    return None if value is None else rounded(float(value), METRE_DECIMALS)


def _ratio(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else round(value, _RATIO_DECIMALS)


def _ratios(values: FloatArray | IntArray) -> list[float | None]:
    return [_ratio(float(value)) for value in values]


# The layers of a result as GeoDataFrames, for notebooks and GIS in Python.

_DTYPES = {"int": "Int64", "float": "float64", "bool": "boolean", "text": "string", "time": "string"}
"""Kind of a property -> column of pandas; all but `float64` know null."""


def geodataframe(of: DriveResult | Evaluation, layer: str = "intersections") -> Any:  # noqa: ANN401 - no types
    """Return a layer of a result or an evaluation as a GeoDataFrame; its `explore` shows it on a map.

    Parameters
    ----------
    of
        An evaluation adds its verdicts, and the layers `osm_nodes` and `matches`.
    layer : str
        intersections, detections, keyframes, trajectory, roads, junctions or road_surface; of an evaluation osm_nodes,
        matches, osm_roads or osm_buildings too.

    Returns
    -------
    geopandas.GeoDataFrame
        The columns are the properties of the GeoJSON files (`interloc.output.layers`) without their details; `attrs`
        has drive, job, preset and labels. Coordinates are longitude and latitude (EPSG:4326); without georeference
        they are metres in the frame of the first scan, and there is no coordinate system.

    Raises
    ------
    ConfigError
        There is no such layer.
    """
    from geopandas import GeoDataFrame  # noqa: PLC0415 - slow to import
    from shapely.geometry import shape  # noqa: PLC0415

    result = of.result if isinstance(of, Evaluation) else of
    expect(result, DriveResult)
    if isinstance(of, Evaluation) and layer in LAYER_FEATURES:
        features = LAYER_FEATURES[layer](of, result)
    elif layer in TABLE_FEATURES:
        features = TABLE_FEATURES[layer](result)
    elif layer in ROAD_LAYERS:
        features = road_features(roads(of.given if isinstance(of, Evaluation) else of))[layer]
    elif layer in LAYER_FEATURES:
        raise ConfigError(
            f"{layer!r} is a layer of an evaluation: interloc.evaluate(result, graph).geodataframe({layer!r})"
        )
    else:
        raise ConfigError(
            f"{layer!r} is not a layer. Expected one of "
            f"{', '.join(dict.fromkeys((*TABLE_FEATURES, *ROAD_LAYERS, *LAYER_FEATURES)))}."
        )
    fields = LAYERS[layer].fields
    places = [cut(each["geometry"]) if result.is_georeferenced else each["geometry"] for each in features]
    table = GeoDataFrame(
        {name: [feature["properties"][name] for feature in features] for name in fields},
        geometry=[place and shape({**place}) for place in places],
        crs="EPSG:4326" if result.is_georeferenced else None,
    )
    table.attrs |= origin_of(result.run, result.drive)
    return table.astype({name: _DTYPES[kind] for name, kind in fields.items() if kind in _DTYPES})
