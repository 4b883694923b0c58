"""Results in QGIS: styles of layers (QML) and projects, from `interloc.output.styles`.

QGIS reads QML from a file ``.qml`` beside that of a layer, from the table ``layer_styles`` of a GeoPackage, and from
projects, whose layers have the same elements. A file ``.qgz`` is a ZIP of a project and of the GeoPackage that it
shows, as QGIS 3.22 and newer keep attachments: one file, that opens by a double click and can be moved and renamed.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import projection, utm_zone
from interloc.output import styles
from interloc.output.credits import ODBL, Credit
from interloc.output.layers import Layer, Rows
from interloc.output.layout import ROAD_FILE
from interloc.output.road import ALPHA, GREY, ROAD_LAYER, ROAD_TITLE

_VERSION = "3.22.0-Białowieża"  # the oldest version of QGIS that all of it is made for; newer ones read it
_DOCTYPE = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_MM_PER_PX = 25.4 / 96.0
_SHAPES = {  # shape -> that of QGIS, and its half size where ours is 1
    "disc": ("circle", 1.0),
    "square": ("square", 1.0),
    "diamond": ("diamond", 1.25),
    "triangle": ("triangle", 1.0),
    "cross": ("cross2", 0.8),
}
_GEOMETRIES = {"Point": ("marker", "0"), "LineString": ("line", "1"), "Polygon": ("fill", "2")}

_DATA = "result.gpkg"
_MARGIN = 0.08  # of the extent, around it
_MIN_EXTENT_M = 50.0
_ROAD = f"attachment:{ROAD_FILE}"
_OSM_CREDIT = "© OpenStreetMap contributors, ODbL 1.0"

Layers = Sequence[tuple[Layer, Rows]]


def qml(layer: Layer) -> str:
    """Return the style of a layer as a QML document."""
    root = _element(
        "qgis",
        *_style_elements(layer),
        _element("layerGeometryType", _GEOMETRIES[layer.geometry][1]),
        version=_VERSION,
        styleCategories="AllStyleCategories",
        labelsEnabled=_has_labels(layer),
    )
    return _document(root)


def _element(tag: str, *children: ET.Element | str, **attributes: str) -> ET.Element:
    """Return an element with others, or a text, in it."""
    element = ET.Element(tag, attributes)
    for each in children:
        if isinstance(each, str):
            element.text = each
        else:
            element.append(each)
    return element


def _document(root: ET.Element) -> str:
    ET.indent(root, " ")
    return _DOCTYPE + ET.tostring(root, encoding="unicode") + "\n"


def _about(layer: Layer, credit: Credit) -> list[ET.Element]:
    texts = {
        "identifier": layer.name,
        "type": "dataset",
        "title": layer.title,
        "abstract": layer.description,
        "rights": credit.attribution,
        "license": credit.license,
    }
    return [_element(tag, text) for tag, text in texts.items() if text is not None]


def _has_labels(layer: Layer) -> str:
    return "0" if styles.STYLES[layer.name].label is None else "1"


def _style_elements(layer: Layer) -> list[ET.Element]:
    """Return the elements of the style of a layer, as they stand in QML and in projects."""
    style = styles.STYLES[layer.name]
    parts = [_renderer(layer)]
    if style.label is not None:
        parts.append(_labeling(style.label, is_line=layer.geometry == "LineString"))
    aliases = (
        _element("alias", field=each.name, index=str(index), name=each.title)
        for index, each in enumerate(layer.attributes)
    )
    name = _element("previewExpression", _name_expression(layer))
    return [*parts, _element("aliases", *aliases), name]


# signs ----------------------------------------------------------------------------------------------------------------


def _renderer(layer: Layer) -> ET.Element:
    style = styles.STYLES[layer.name]
    kind = "singleSymbol" if style.field is None else "categorizedSymbol"
    root = _element("renderer-v2", type=kind, symbollevels="0", enableorderby="0", forceraster="0")
    if style.field is not None:
        is_bool = isinstance(style.rules[0].value, bool)  # QGIS 3.22 knows categories of texts only
        root.set("attr", f"if({style.field}, 'true', 'false')" if is_bool else style.field)
        root.append(_element("categories", *(_category(rule, number) for number, rule in enumerate(style.rules))))
    symbols = (_symbol(rule.symbol, layer, str(number)) for number, rule in enumerate(style.rules))
    root.append(_element("symbols", *symbols))
    return root


def _category(rule: styles.Rule, number: int) -> ET.Element:
    value = str(rule.value).lower() if isinstance(rule.value, bool) else str(rule.value)
    return _element("category", value=value, type="string", symbol=str(number), label=rule.title, render="true")


def _symbol(symbol: styles.Symbol, layer: Layer, name: str) -> ET.Element:
    opacity = 1.0 if isinstance(symbol, styles.Area) else symbol.opacity
    kind, _ = _GEOMETRIES[layer.geometry]
    if isinstance(symbol, styles.Mark):
        parts = list(_marks(symbol))
    elif isinstance(symbol, styles.Line):
        parts = list(_lines(symbol))
    else:
        edge = {"outline_color": _rgba(symbol.edge), "outline_width": _mm(symbol.width_px), "outline_width_unit": "MM"}
        fill = {"color": _rgba(symbol.colour, symbol.opacity), "style": "solid", "outline_style": "solid", **edge}
        parts = [_symbol_layer("SimpleFill", {**fill, "joinstyle": "round"})]
    return _element("symbol", *parts, name=name, type=kind, alpha=f"{opacity:g}", clip_to_extent="1", force_rhr="0")


def _marks(mark: styles.Mark) -> Iterator[ET.Element]:
    shape, half = _SHAPES[mark.shape]
    yield _marker(
        shape,
        2.0 * half * mark.radius_px,
        fill=_rgba(mark.colour) if mark.is_filled else _rgba(mark.colour, 0.0),
        line=(mark.edge or mark.colour) if mark.width_px else None,
        width_px=mark.width_px,
    )
    for path in () if mark.glyph is None else styles.GLYPHS[mark.glyph]:
        for (x, y), (to_x, to_y) in pairwise(path):
            length = math.hypot(to_x - x, to_y - y)
            middle = ((x + to_x) / 2.0 * mark.radius_px, (y + to_y) / 2.0 * mark.radius_px)
            if length < 0.1:  # a dot
                yield _marker("circle", 1.2 * styles.GLYPH_PX, fill=_rgba(styles.PAPER), offset=middle)
            else:
                angle = math.atan2(to_x - x, y - to_y)  # clockwise from upwards, as QGIS turns it
                size = length * mark.radius_px + 0.5 * styles.GLYPH_PX  # so that lines overlap where they meet
                yield _marker("line", size, line=styles.PAPER, width_px=styles.GLYPH_PX, angle=angle, offset=middle)


def _marker(
    shape: str,
    size_px: float,
    *,
    fill: str = "255,255,255,0",
    line: str | None = None,
    width_px: float = 0.0,
    angle: float = 0.0,
    offset: tuple[float, float] = (0.0, 0.0),
) -> ET.Element:
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = (cos * offset[0] + sin * offset[1], cos * offset[1] - sin * offset[0])  # QGIS turns the offset, too
    options = {
        "name": shape,
        "size": _mm(size_px),
        "size_unit": "MM",
        "color": fill,
        "angle": f"{math.degrees(angle):.2f}",
        "offset": f"{_mm(x)},{_mm(y)}",
        "offset_unit": "MM",
        "outline_style": "no" if line is None else "solid",
        "outline_color": _rgba(line or styles.PAPER),
        "outline_width": _mm(width_px),
        "outline_width_unit": "MM",
        "scale_method": "diameter",
        "joinstyle": "miter",
        "cap_style": "flat",
    }
    return _symbol_layer("SimpleMarker", options)


def _lines(line: styles.Line) -> Iterator[ET.Element]:
    casing = [] if line.casing is None else [(line.casing, 2.0 * line.width_px)]
    for colour, width_px in (*casing, (line.colour, line.width_px)):
        style = {"line_color": _rgba(colour), "line_width": _mm(width_px), "line_width_unit": "MM"}
        yield _symbol_layer("SimpleLine", {**style, "line_style": "solid", "capstyle": "round", "joinstyle": "round"})


def _symbol_layer(kind: str, options: Mapping[str, str]) -> ET.Element:
    pairs = (_element("Option", type="QString", name=name, value=value) for name, value in options.items())
    root = ET.Element("layer", {"class": kind, "enabled": "1", "locked": "0", "pass": "0"})
    root.append(_element("Option", *pairs, type="Map"))
    return root


def _mm(px: float) -> str:
    return f"{round(px * _MM_PER_PX, 3) + 0.0:g}"


def _rgba(colour: str, opacity: float = 1.0) -> str:
    red, green, blue = (int(colour[index : index + 2], 16) for index in (1, 3, 5))
    return f"{red},{green},{blue},{round(255 * opacity)}"


# labels -----------------------------------------------------------------------------------------------------------


_LABELS = """
<labeling type="simple"><settings calloutType="simple">
  <text-style fieldName="{field}" isExpression="0" fontSize="{size}" fontSizeUnit="Point" textColor="{colour}"
              textOpacity="1" fontWeight="50" multilineHeight="1">
    <text-buffer bufferDraw="1" bufferSize="0.6" bufferSizeUnits="MM" bufferColor="{paper}" bufferOpacity="0.85"
                 bufferJoinStyle="128"/>
  </text-style>
  <placement {place} distUnits="MM" maxCurvedCharAngleIn="25" maxCurvedCharAngleOut="-25"/>
  <rendering scaleVisibility="1" scaleMin="1" scaleMax="{min_scale}" drawLabels="1" mergeLines="{merge}" obstacle="1"/>
</settings></labeling>
"""
_ALONG_LINE = 'placement="3" placementFlags="9" dist="0" priority="3"'
_AROUND_POINT = 'placement="0" placementFlags="10" dist="2.2" priority="8"'


def _labeling(label: styles.Label, *, is_line: bool) -> ET.Element:
    text = _LABELS.format(
        field=label.field,
        size=f"{label.size_pt:g}",
        colour=_rgba(label.colour),
        paper=_rgba(styles.PAPER),
        place=_ALONG_LINE if is_line else _AROUND_POINT,
        min_scale=label.min_scale,
        merge=1 if is_line else 0,
    )
    return ET.fromstring(text)  # noqa: S314 - our own


def _name_expression(layer: Layer) -> str:
    texts = re.split(r"\{(\w+)(?::[^}]*)?\}", layer.label)
    parts = [f"'{text}'" if index % 2 == 0 else _shown(text) for index, text in enumerate(texts) if text]
    return f"concat({', '.join(parts)})"


def _shown(name: str) -> str:
    return f'round("{name}", 1)' if name.endswith(("_m", "_deg")) else f'"{name}"'


# projects -------------------------------------------------------------------------------------------------------------


def write_qgz(out: Path, database: Path, layers: Layers, name: str, *, local: bool, road: Path | None) -> None:
    """Write a project with this title and its data: the GeoPackage, and below it `road.tif`, where there is one.

    `local`: the layers are in metres of their own frame.
    """
    text = _project(layers, name, local=local, has_road=road is not None)
    with ZipFile(out, "w", ZIP_DEFLATED) as archive:
        archive.writestr(ZipInfo("project.qgs"), text, ZIP_DEFLATED)
        archive.write(database, _DATA)
        if road is not None:
            archive.write(road, ROAD_FILE)


def _project(layers: Layers, name: str, *, local: bool, has_road: bool) -> str:
    there = {layer.name: (layer, rows) for layer, rows in layers}
    points = there["keyframes"][1].points()
    epsg = None if local or not len(points) else utm_zone(*points[0].tolist())
    tree, shown = ET.Element("layer-tree-group"), ET.Element("projectlayers")
    for title, names in styles.GROUPS.items():
        group = ET.Element("layer-tree-group", {"name": title, "checked": "Qt::Checked", "expanded": "1"})
        for layer, rows in (there[each] for each in names if each in there):
            style, place = styles.STYLES[layer.name], f"attachment:{_DATA}|layername={layer.name}"
            node = _tree_layer(layer.name, style.title, place, is_shown=style.is_shown, is_open=len(style.rules) > 1)
            group.append(node)
            shown.append(_vector(layer, rows, place, None if local else 4326))
        if has_road and title == styles.ROAD_GROUP:
            group.append(_tree_layer(ROAD_LAYER, ROAD_TITLE, _ROAD, is_shown=True, is_open=False, provider="gdal"))
        if len(group):
            tree.append(group)
    if has_road:
        shown.append(_raster(None if local else epsg))
    credited = any(rows.credit.license == ODBL for _, rows in layers)
    root = _element(
        "qgis",
        _element("title", name),
        _element("projectCrs", *_crs(epsg)),
        tree,
        shown,
        _properties(credited=credited),
        _element("projectMetadata", _element("title", name)),
        _view(points, epsg),
        version=_VERSION,
        projectname=name,
    )
    return _document(root)


def _tree_layer(
    name: str, title: str, place: str, *, is_shown: bool, is_open: bool, provider: str = "ogr"
) -> ET.Element:
    return ET.Element(
        "layer-tree-layer",
        {
            "id": _id(name),
            "name": title,
            "source": place,
            "providerKey": provider,
            "checked": "Qt::Checked" if is_shown else "Qt::Unchecked",
            "expanded": "1" if is_open else "0",
        },
    )


def _raster(epsg: int | None) -> ET.Element:
    """Return the layer of the road seen by LiDAR, drawn as on the page."""
    colour = "#{:02x}{:02x}{:02x}".format(*GREY)
    ramp = _element("colorrampshader", colorRampType="DISCRETE")
    for value, alpha in enumerate(ALPHA):
        limit = "inf" if value == len(ALPHA) - 1 else str(value)
        ramp.append(_element("item", value=limit, label=str(value), color=colour, alpha=str(alpha)))
    band = {"type": "singlebandpseudocolor", "band": "1", "opacity": "1", "alphaBand": "-1"}
    return _element(
        "maplayer",
        *_place_of(ROAD_LAYER, _ROAD, ROAD_TITLE, epsg),
        _element("provider", "gdal"),
        _element("pipe", _element("rasterrenderer", _element("rastershader", ramp), **band)),
        type="raster",
    )


def _vector(layer: Layer, rows: Rows, place: str, epsg: int | None) -> ET.Element:
    return _element(
        "maplayer",
        *_place_of(layer.name, place, styles.STYLES[layer.name].title, epsg),
        _element("resourceMetadata", *_about(layer, rows.credit)),
        _element("provider", "ogr", encoding="UTF-8"),
        *_style_elements(layer),
        type="vector",
        geometry=layer.geometry,
        labelsEnabled=_has_labels(layer),
    )


def _place_of(name: str, place: str, title: str, epsg: int | None) -> Iterable[ET.Element]:
    texts = {"id": _id(name), "datasource": place, "layername": title}
    return [*(_element(tag, text) for tag, text in texts.items()), _element("srs", *_crs(epsg))]


def _id(name: str) -> str:
    """Return the id of a layer; QGIS gives those of up to ten letters another one."""
    return f"interloc_{name}"


def _crs(epsg: int | None) -> list[ET.Element]:
    if epsg is None:
        return []
    from pyproj import CRS  # noqa: PLC0415 - slow to import

    wkt = CRS.from_epsg(epsg).to_wkt("WKT2_2019")
    return [_element("spatialrefsys", _element("wkt", wkt), _element("authid", f"EPSG:{epsg}"))]


def _properties(*, credited: bool) -> ET.Element:
    """Return settings by topic, among them whose map it is, on the map."""
    topics: dict[str, dict[str, tuple[str, str]]] = {"SpatialRefSys": {"ProjectionsEnabled": ("int", "1")}}
    if credited:
        topics["CopyrightLabel"] = {"Enabled": ("bool", "true"), "Label": ("QString", _OSM_CREDIT)}
    return _element(
        "properties",
        *(
            _element(topic, *(_element(name, value, type=kind) for name, (kind, value) in values.items()))
            for topic, values in topics.items()
        ),
    )


def _view(points: FloatArray, epsg: int | None) -> ET.Element:
    """Return the part of the map that is shown first: where the drive was."""
    root = _element("ProjectViewSettings", UseProjectScales="0", rotation="0")
    if not len(points):
        return root
    xy = points if epsg is None else projection(4326, epsg)(points)
    low, high = xy.min(axis=0), xy.max(axis=0)
    margin = np.maximum(_MARGIN * (high - low).max(), _MIN_EXTENT_M)
    corners = zip(("xmin", "ymin", "xmax", "ymax"), (*(low - margin), *(high + margin)), strict=True)
    root.append(_element("DefaultViewExtent", *_crs(epsg), **{name: f"{value:.2f}" for name, value in corners}))
    return root
