"""Findings as those take them who mend maps: MapRoulette, GeoJSON.

MapRoulette tells by an identity whether a finding is new. It must be the same at each upload, else mappers get the
same task twice, and what they marked as wrong comes back. It is that of the finding (`Finding.id`), never its position.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from interloc.arrays import FloatArray, JsonObject
from interloc.city.audit import Audit, Finding
from interloc.city.citymap import CityMap
from interloc.city.models import AuditConfig
from interloc.files import atomic_folder, write_file
from interloc.output.credits import map_credit
from interloc.output.geojson import Feature, FeatureCollection, encode, positions, read_as, read_json, write_collection
from interloc.output.layers import CITY_LAYERS

AUDIT_FILE, FINDINGS_FILE = "audit.json", "findings.geojson"
MAPROULETTE_FILE = "maproulette.geojson"
PICTURES = "pictures"
AUDIT_NAMES = frozenset([AUDIT_FILE, FINDINGS_FILE, MAPROULETTE_FILE, PICTURES])
"""What the folder of an audit may hold."""

MAX_TASKS = 1000
"""Of one file for MapRoulette: more than mappers look at in a month helps nobody."""

_RECORD_SEPARATOR = "\x1e"

HALF_M = 40.0
_CELL_M = 0.5
_SIDE = round(2 * HALF_M / _CELL_M)
_SCALE = 4  # pixels per cell
_UNSEEN, _OTHER, _ROAD, _TRACK, _PLACE, _NODE = (
    tuple(int(colour[i : i + 2], 16) for i in (5, 3, 1))  # OpenCV: blue, green, red
    for colour in ("#ffffff", "#d9e6cf", "#6f7880", "#0072b2", "#d55e00", "#b3478c")
)


def known_findings(folder: Path) -> frozenset[str]:
    """Return the ids of the findings of an earlier audit in a folder, also of those that people marked wrong."""
    if not (folder / FINDINGS_FILE).is_file():
        return frozenset()
    found = [str(each["id"]) for each in read_as(FeatureCollection, folder / FINDINGS_FILE)["features"]]
    return frozenset(found).union(read_json(folder / AUDIT_FILE).get("marked_wrong", []))


def write_audit(
    found: Audit, city: CityMap, folder: Path, config: AuditConfig, *, source: str, made_up: bool = False
) -> list[Feature]:
    """Write the findings of an audit in all forms, all or nothing; an earlier audit in the folder goes.

    `source` is the OpenStreetMap data, or was made up by a simulator. Returns the features of the findings. An
    `OutputError` says that the folder is something else, or could not be written.
    """
    credit = map_credit(is_made_up=made_up)
    features = finding_features(found.findings, city)
    with atomic_folder(folder, marker=AUDIT_FILE, names=AUDIT_NAMES) as new:
        write_collection(new / FINDINGS_FILE, features, local=False, credit=credit)
        texts = {
            MAPROULETTE_FILE: maproulette(features[:MAX_TASKS]),
            AUDIT_FILE: encode(audit_record(found, config, source), indent=2) + "\n",
        }
        for name, text in texts.items():
            write_file(new / name, text)
        (new / PICTURES).mkdir()
        for each in found.findings[:MAX_TASKS]:
            write_file(new / PICTURES / f"{each.id}.png", picture_of(city, each.xy, each.drives, each.node_xy))
    return features


def audit_record(found: Audit, config: AuditConfig, source: str) -> JsonObject:
    """Return what `audit.json` holds: counts, settings, and what was not claimed."""
    return {
        "osm": source,
        "findings": len(found.findings),
        "by_kind": {kind: sum(each.kind == kind for each in found.findings) for kind in config.kinds},
        "junctions_passed": found.junctions,
        "osm_offset_m": [round(value, 3) for value in found.offset_m.tolist()],
        "held_back": found.held_back,
        "marked_wrong": found.marked_wrong,
        "config": config.model_dump(mode="json"),
    }


def finding_features(findings: Sequence[Finding], city: CityMap) -> list[Feature]:
    """Return the features of the layer `findings`."""
    xy = np.array([each.xy for each in findings]).reshape(-1, 2)
    lonlat = positions(city.lonlat(xy), local=False) if len(findings) else []
    return CITY_LAYERS["findings"].features(
        lonlat,
        id=[each.id for each in findings],
        kind=[each.kind for each in findings],
        text=[each.text for each in findings],
        uid=[each.uid for each in findings],
        osm_id=[each.osm_node for each in findings],
        passes=[each.passes for each in findings],
        drive_names=[", ".join(each.drives) for each in findings],
        distance_m=[each.distance_m for each in findings],
        branch_bearings_deg=[each.branch_bearings_deg for each in findings],
        branch_widths_m=[each.branch_widths_m for each in findings],
        osm_ways=["; ".join(each.ways) for each in findings],
        osm_link=[f"https://www.openstreetmap.org/?mlat={lat}&mlon={lon}#map=19/{lat}/{lon}" for lon, lat in lonlat],
    )


def maproulette(features: Sequence[Feature]) -> str:
    """Return line-by-line GeoJSON: a record separator and a FeatureCollection for each task.

    The separator tells MapRoulette that a file of one line is of this form, too (`ChallengeProvider.scala`). A task's
    name is the text `id` of its first feature; without one it is random, and a second upload doubles all.
    """
    lines = []
    for feature in features:
        task = {**feature, "properties": {"id": feature["id"], **feature["properties"]}}
        lines.append(_RECORD_SEPARATOR + encode({"type": "FeatureCollection", "features": [task]}) + "\n")
    return "".join(lines)


def picture_of(city: CityMap, xy: FloatArray, names: tuple[str, ...], node_xy: FloatArray | None = None) -> bytes:
    """Draw the 80 m around a place in the plane of the map (a cross), north up, as PNG.

    The ground and tracks (blue) of some drives are drawn: the darker the road, the more of them saw it. The node of
    OpenStreetMap that it is about is a ring.
    """
    step = (np.arange(_SIDE) + 0.5) * _CELL_M - HALF_M
    east, south = np.meshgrid(step, step)
    cells = xy + np.stack([east, -south], axis=-1).reshape(-1, 2)
    road, other = np.zeros((2, len(cells)))
    for name in names:
        saw_road, saw_other = city.drives[name].ground_at(cells, city.epsg)
        road, other = road + saw_road / len(names), np.maximum(other, saw_other)
    image = np.full((len(cells), 3), _UNSEEN, dtype=np.float64)
    image[other > 0] = _OTHER
    depth = np.where(road > 0, 0.35 + 0.65 * road, 0.0)[:, None]
    image = (1.0 - depth) * image + depth * np.array(_ROAD)
    small = image.reshape(_SIDE, _SIDE, 3).astype(np.uint8)
    drawn = np.ascontiguousarray(np.kron(small, np.ones((_SCALE, _SCALE, 1), dtype=np.uint8)))

    def pixel(at: FloatArray) -> Any:  # noqa: ANN401 - as OpenCV takes them
        return np.round((np.array([1.0, -1.0]) * (at - xy) + HALF_M) * _SCALE / _CELL_M).astype(np.int32)

    for name in names:
        drive = city.drives[name]
        cv2.polylines(drawn, [pixel(drive.track_xy - drive.knots.mean(axis=0))], False, _TRACK, 2, cv2.LINE_AA)
    cv2.drawMarker(drawn, pixel(xy).tolist(), _PLACE, cv2.MARKER_TILTED_CROSS, 22, 3, cv2.LINE_AA)
    if node_xy is not None:
        cv2.circle(drawn, pixel(node_xy).tolist(), 11, _NODE, 3, cv2.LINE_AA)
    return bytes(cv2.imencode(".png", drawn)[1])
