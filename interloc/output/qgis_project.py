"""A result as a project of QGIS: its layers in groups, drawn as on the page, ready to play by time.

A file ``.qgz`` is a ZIP of the project and of the GeoPackage that it shows, as QGIS 3.22 and newer keep attachments:
one file, that opens by a double click and can be moved and renamed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree as ET
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from interloc.arrays import FloatArray
from interloc.mapping.mosaic import utm_zone
from interloc.output.credits import ODBL
from interloc.output.layers import Layer, Rows
from interloc.output.layout import ROAD_FILE
from interloc.output.qml import VERSION, attributes, document, elements, metadata_elements
from interloc.output.road import ALPHA, GREY, ROAD_LAYER, ROAD_TITLE
from interloc.output.styles import GROUPS, ROAD_GROUP, STYLES

_DATA = "result.gpkg"
_MARGIN = 0.08  # of the extent, around it
_MIN_EXTENT_M = 50.0
_STEPS = 200  # frames of a whole drive
_OSM_CREDIT = "© OpenStreetMap contributors, ODbL 1.0"

Layers = Sequence[tuple[Layer, Rows]]


@dataclass(frozen=True)
class Source:
    """Where the data of a layer is."""

    provider: str
    """The part of QGIS that reads it: ``ogr`` for files, ``OAPIF`` for OGC API - Features."""
    place: str
    """In the words of the provider."""


_ROAD = Source("gdal", f"attachment:{ROAD_FILE}")


def write_qgz(out: Path, database: Path, layers: Layers, name: str, *, local: bool, road: Path | None = None) -> None:
    """Write a project with its data.

    Parameters
    ----------
    out
        File to write.
    database
        The GeoPackage.
    layers
        What it holds.
    name
        Title of the project.
    local
        Whether the layers are in metres of their own frame.
    road
        The road seen by LiDAR, a GeoTIFF, where there is one; it lies below the others.
    """

    def source_of(layer: Layer) -> Source:
        return Source("ogr", f"attachment:{_DATA}|layername={layer.name}")

    text = project(layers, name, source_of, local=local, has_road=road is not None)
    with ZipFile(out, "w", ZIP_DEFLATED) as archive:
        archive.writestr(ZipInfo("project.qgs"), text, ZIP_DEFLATED)
        archive.write(database, _DATA)
        if road is not None:
            archive.write(road, ROAD_FILE)


def project(
    layers: Layers, name: str, source_of: Callable[[Layer], Source], *, local: bool = False, has_road: bool = False
) -> str:
    """Return a project as a document of QGIS (``.qgs``).

    Parameters
    ----------
    layers
        Those of a result.
    name
        Title of the project.
    source_of
        Tells where the data of a layer is.
    local
        Whether the layers are in metres of their own frame.
    has_road
        Whether the road seen by LiDAR lies beside the project, as `road.tif`.
    """
    there = {layer.name: (layer, rows) for layer, rows in layers}
    points = there["keyframes"][1].points()
    epsg = None if local or not len(points) else utm_zone(*points[0].tolist())
    root = ET.Element("qgis", {"version": VERSION, "projectname": name})
    ET.SubElement(root, "title").text = name
    _add_crs(ET.SubElement(root, "projectCrs"), epsg)
    groups = {title: [each for each in names if each in there] for title, names in GROUPS.items()}
    tree = _tree(groups, lambda each: source_of(there[each][0]))
    root.append(tree)
    shown = ET.SubElement(root, "projectlayers")
    for each in (name for names in groups.values() for name in names):
        layer, rows = there[each]
        shown.append(_layer(layer, rows, source_of(layer), None if local else 4326))
    if has_road:
        group = tree.find(f"layer-tree-group[@name='{ROAD_GROUP}']")
        (tree if group is None else group).append(
            _tree_layer(ROAD_LAYER, ROAD_TITLE, _ROAD, is_shown=True, is_open=False)
        )
        shown.append(_road(None if local else epsg))
    times = list(_times(layers))
    root.append(_properties(credited=any(rows.credit.license == ODBL for _, rows in layers), times=times))
    about = ET.SubElement(root, "projectMetadata")
    ET.SubElement(about, "title").text = name
    root.append(_view(points, epsg))
    if times:
        root.append(_time_settings(min(times), max(times)))
    return document(root)


def _tree(groups: Mapping[str, Sequence[str]], source_of: Callable[[str], Source]) -> ET.Element:
    root = ET.Element("layer-tree-group")
    for title, names in groups.items():
        if not names:
            continue
        group = ET.SubElement(root, "layer-tree-group", {"name": title, "checked": "Qt::Checked", "expanded": "1"})
        for name in names:
            style = STYLES[name]
            is_open = len(style.rules) > 1
            group.append(_tree_layer(name, style.title, source_of(name), is_shown=style.is_shown, is_open=is_open))
    return root


def _tree_layer(name: str, title: str, source: Source, *, is_shown: bool, is_open: bool) -> ET.Element:
    return ET.Element(
        "layer-tree-layer",
        {
            "id": _id(name),
            "name": title,
            "source": source.place,
            "providerKey": source.provider,
            "checked": "Qt::Checked" if is_shown else "Qt::Unchecked",
            "expanded": "1" if is_open else "0",
        },
    )


def _road(epsg: int | None) -> ET.Element:
    """Return the layer of the road seen by LiDAR, drawn as on the page."""
    root = ET.Element("maplayer", {"type": "raster"})
    for tag, text in (("id", _id(ROAD_LAYER)), ("datasource", _ROAD.place), ("layername", ROAD_TITLE)):
        ET.SubElement(root, tag).text = text
    _add_crs(ET.SubElement(root, "srs"), epsg)
    ET.SubElement(root, "provider").text = _ROAD.provider
    band = {"type": "singlebandpseudocolor", "band": "1", "opacity": "1", "alphaBand": "-1"}
    renderer = ET.SubElement(ET.SubElement(root, "pipe"), "rasterrenderer", band)
    ramp = ET.SubElement(ET.SubElement(renderer, "rastershader"), "colorrampshader", {"colorRampType": "DISCRETE"})
    colour = "#{:02x}{:02x}{:02x}".format(*GREY)
    for value, alpha in enumerate(ALPHA):
        item = {"value": "inf" if value == len(ALPHA) - 1 else str(value), "label": str(value), "color": colour}
        ET.SubElement(ramp, "item", {**item, "alpha": str(alpha)})
    return root


def _layer(layer: Layer, rows: Rows, source: Source, epsg: int | None) -> ET.Element:
    root = ET.Element("maplayer", {"type": "vector", "geometry": layer.geometry, **attributes(layer)})
    for tag, text in (("id", _id(layer.name)), ("datasource", source.place), ("layername", STYLES[layer.name].title)):
        ET.SubElement(root, tag).text = text
    _add_crs(ET.SubElement(root, "srs"), epsg)
    about = ET.SubElement(root, "resourceMetadata")
    about.extend(metadata_elements(layer, rows.credit))
    ET.SubElement(root, "provider", {"encoding": "UTF-8"}).text = source.provider
    has_times = any(True for _ in _times([(layer, rows)]))
    root.extend(each for each in elements(layer) if has_times or each.tag != "temporal")
    return root


def _id(name: str) -> str:
    """Return the id of a layer; QGIS gives those of up to ten letters another one."""
    return f"interloc_{name}"


def _add_crs(parent: ET.Element, epsg: int | None) -> None:
    if epsg is None:
        return
    from pyproj import CRS  # noqa: PLC0415 - slow to import

    system = ET.SubElement(parent, "spatialrefsys")
    ET.SubElement(system, "wkt").text = CRS.from_epsg(epsg).to_wkt("WKT2_2019")
    ET.SubElement(system, "authid").text = f"EPSG:{epsg}"


def _times(layers: Layers) -> Iterator[datetime]:
    for layer, rows in layers:
        style = STYLES[layer.name]
        if style.times is not None:
            yield from (datetime.fromisoformat(each) for each in rows.column(style.times.field) if each is not None)


def _properties(*, credited: bool, times: Sequence[datetime]) -> ET.Element:
    """Return settings by topic: whose map it is, on the map, and the time to play."""
    root = ET.Element("properties")
    topics: dict[str, dict[str, tuple[str, str]]] = {"SpatialRefSys": {"ProjectionsEnabled": ("int", "1")}}
    if credited:
        topics["CopyrightLabel"] = {"Enabled": ("bool", "true"), "Label": ("QString", _OSM_CREDIT)}
    if times:
        ends = {"StartDateTime": ("QString", _iso(min(times))), "EndDateTime": ("QString", _iso(max(times)))}
        topics["TemporalControllerWidget"] = {**ends, "NavigationMode": ("int", "0")}
    for topic, values in topics.items():
        parent = ET.SubElement(root, topic)
        for name, (kind, value) in values.items():
            ET.SubElement(parent, name, {"type": kind}).text = value
    return root


def _view(points: FloatArray, epsg: int | None) -> ET.Element:
    """Return the part of the map that is shown first: where the drive was."""
    root = ET.Element("ProjectViewSettings", {"UseProjectScales": "0", "rotation": "0"})
    if not len(points):
        return root
    xy = points
    if epsg is not None:
        from pyproj import Transformer  # noqa: PLC0415 - slow to import

        xy = np.stack(Transformer.from_crs(4326, epsg, always_xy=True).transform(*points.T), axis=-1)
    low, high = xy.min(axis=0), xy.max(axis=0)
    margin = np.maximum(_MARGIN * (high - low).max(), _MIN_EXTENT_M)
    corners = zip(("xmin", "ymin", "xmax", "ymax"), (*(low - margin), *(high + margin)), strict=True)
    extent = ET.SubElement(root, "DefaultViewExtent", {name: f"{value:.2f}" for name, value in corners})
    _add_crs(extent, epsg)
    return root


def _time_settings(start: datetime, end: datetime) -> ET.Element:
    step = max(1, round((end - start).total_seconds() / _STEPS))
    settings = {"timeStep": str(step), "timeStepUnit": "s", "frameRate": "10", "cumulativeTemporalRange": "0"}
    root = ET.Element("ProjectTimeSettings", settings)
    span = ET.SubElement(root, "TemporalRange")
    ET.SubElement(span, "start").text = _iso(start)
    ET.SubElement(span, "end").text = _iso(end + timedelta(seconds=1))
    return root


def _iso(time: datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ")
