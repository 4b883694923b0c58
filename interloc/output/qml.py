"""Styles for QGIS (QML), from `interloc.output.styles`: signs, labels, titles of fields, tips, times.

QGIS reads them from a file ``.qml`` beside that of a layer, from the table ``layer_styles`` of a GeoPackage, and from
projects, whose layers have the same elements.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from itertools import pairwise
from xml.etree import ElementTree as ET

from interloc.output.credits import Credit
from interloc.output.layers import Layer
from interloc.output.styles import GLYPH_PX, OUTLINES, PAPER, STYLES, Area, Label, Line, Mark, Rule, Symbol, Times

MM_PER_PX = 25.4 / 96.0

VERSION = "3.22.0-Białowieża"
"""The oldest version of QGIS that all of it is made for; newer ones read it."""

DOCTYPE = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"

_SHAPES = {  # shape -> that of QGIS, and its half size where ours is 1
    "disc": ("circle", 1.0),
    "square": ("square", 1.0),
    "diamond": ("diamond", 1.25),
    "triangle": ("triangle", 1.0),
    "cross": ("cross2", 0.8),
}
_KINDS = {"Point": "marker", "LineString": "line", "Polygon": "fill"}
_GEOMETRY_TYPES = {"Point": "0", "LineString": "1", "Polygon": "2"}
_INSTANT = "1"  # of a layer whose features have one time
_BY_LINE, _AROUND_POINT = "3", "0"  # placements of labels: curved, around the sign
_ON_LINE = "9"
_TOLD = ("outcome", "error_m", "reason")
"""Properties that a tip shows below the name of a feature."""


def qml(layer: Layer) -> str:
    """Return the style of a layer as a QML document."""
    root = ET.Element("qgis", {"version": VERSION, "styleCategories": "AllStyleCategories", **attributes(layer)})
    root.extend(elements(layer))
    ET.SubElement(root, "layerGeometryType").text = _GEOMETRY_TYPES[layer.geometry]
    return document(root)


def document(root: ET.Element) -> str:
    """Return an element as a document of QGIS."""
    ET.indent(root, " ")
    return DOCTYPE + ET.tostring(root, encoding="unicode") + "\n"


def metadata(layer: Layer, credit: Credit) -> str:
    """Return what QGIS shows as metadata of a layer: what it is, whose data, under which licence."""
    root = ET.Element("qgis", version=VERSION)
    root.extend(metadata_elements(layer, credit))
    return ET.tostring(root, encoding="unicode")


def metadata_elements(layer: Layer, credit: Credit) -> list[ET.Element]:
    """Return the elements of the metadata of a layer, as they stand in a document and in projects."""
    told = {
        "identifier": layer.name,
        "type": "dataset",
        "title": layer.title,
        "abstract": layer.description,
        "rights": credit.attribution,
        "license": credit.license,
    }
    return [_element(tag, text) for tag, text in told.items() if text is not None]


def attributes(layer: Layer) -> dict[str, str]:
    """Return the attributes that the element of a layer has for its style."""
    return {"labelsEnabled": "0" if STYLES[layer.name].label is None else "1"}


def elements(layer: Layer) -> list[ET.Element]:
    """Return the elements of the style of a layer, as they stand in QML and in projects."""
    style = STYLES[layer.name]
    parts = [] if style.times is None else [_temporal(style.times)]
    parts.append(_renderer(layer))
    if style.label is not None:
        parts.append(_labeling(style.label, layer))
    aliases = ET.Element("aliases")
    for index, each in enumerate(layer.attributes):
        ET.SubElement(aliases, "alias", {"field": each.name, "index": str(index), "name": each.title})
    return [*parts, aliases, _element("previewExpression", _name_expression(layer)), _element("mapTip", _tip(layer))]


def _temporal(times: Times) -> ET.Element:
    return ET.Element(
        "temporal",
        {
            "enabled": "1",
            "mode": _INSTANT,
            "startField": times.field,
            "fixedDuration": f"{times.seconds or 0:g}",
            "durationUnit": "s",
            "accumulate": "1" if times.seconds is None else "0",
            "limitMode": "0",
        },
    )


def _renderer(layer: Layer) -> ET.Element:
    style = STYLES[layer.name]
    kind = "singleSymbol" if style.field is None else "categorizedSymbol"
    root = ET.Element("renderer-v2", {"type": kind, "symbollevels": "0", "enableorderby": "0", "forceraster": "0"})
    if style.field is not None:
        is_bool = isinstance(style.rules[0].value, bool)  # QGIS 3.22 knows categories of texts only
        root.set("attr", f"if({style.field}, 'true', 'false')" if is_bool else style.field)
        categories = ET.SubElement(root, "categories")
        for number, rule in enumerate(style.rules):
            categories.append(_category(rule, number))
    symbols = ET.SubElement(root, "symbols")
    for number, rule in enumerate(style.rules):
        symbols.append(_symbol(rule.symbol, layer, str(number)))
    return root


def _category(rule: Rule, number: int) -> ET.Element:
    value = str(rule.value).lower() if isinstance(rule.value, bool) else str(rule.value)
    names = {"symbol": str(number), "label": rule.title, "render": "true"}
    return ET.Element("category", {"value": value, "type": "string", **names})


def _symbol(symbol: Symbol, layer: Layer, name: str) -> ET.Element:
    opacity = 1.0 if isinstance(symbol, Area) else symbol.opacity
    root = ET.Element(
        "symbol",
        {
            "name": name,
            "type": _KINDS[layer.geometry],
            "alpha": f"{opacity:g}",
            "clip_to_extent": "1",
            "force_rhr": "0",
        },
    )
    if isinstance(symbol, Mark):
        root.extend(_marks(symbol))
    elif isinstance(symbol, Line):
        root.extend(_lines(symbol))
    else:
        edge = {"outline_color": _rgba(symbol.edge), "outline_width": _mm(symbol.width_px), "outline_width_unit": "MM"}
        fill = {"color": _rgba(symbol.colour, symbol.opacity), "style": "solid", "outline_style": "solid", **edge}
        root.append(_layer("SimpleFill", {**fill, "joinstyle": "round"}))
    return root


def _marks(mark: Mark) -> Iterable[ET.Element]:
    shape, half = _SHAPES[mark.shape]
    yield _marker(
        shape,
        2.0 * half * mark.radius_px,
        fill=_rgba(mark.colour) if mark.is_filled else _rgba(mark.colour, 0.0),
        line=(mark.edge or mark.colour) if mark.width_px else None,
        width_px=mark.width_px,
    )
    if mark.glyph is None:
        return
    for path in OUTLINES[mark.glyph]:
        for (x, y), (to_x, to_y) in pairwise(path):
            length = math.hypot(to_x - x, to_y - y)
            middle = ((x + to_x) / 2.0 * mark.radius_px, (y + to_y) / 2.0 * mark.radius_px)
            if length < 0.1:  # a dot
                yield _marker("circle", 1.2 * GLYPH_PX, fill=_rgba(PAPER), offset=middle)
            else:
                angle = math.atan2(to_x - x, y - to_y)  # clockwise from upwards, as QGIS turns it
                size = length * mark.radius_px + 0.5 * GLYPH_PX  # so that lines overlap where they meet
                yield _marker("line", size, line=PAPER, width_px=GLYPH_PX, angle=angle, offset=middle)


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
        "outline_color": _rgba(line or PAPER),
        "outline_width": _mm(width_px),
        "outline_width_unit": "MM",
        "scale_method": "diameter",
        "joinstyle": "miter",
        "cap_style": "flat",
    }
    return _layer("SimpleMarker", options)


def _lines(line: Line) -> Iterable[ET.Element]:
    widths = [(line.colour, line.width_px)] if line.casing is None else []
    if line.casing is not None:
        widths = [(line.casing, 2.0 * line.width_px), (line.colour, line.width_px)]
    for colour, width_px in widths:
        style = {"line_color": _rgba(colour), "line_width": _mm(width_px), "line_width_unit": "MM"}
        yield _layer("SimpleLine", {**style, "line_style": "solid", "capstyle": "round", "joinstyle": "round"})


def _layer(kind: str, options: Mapping[str, str]) -> ET.Element:
    root = ET.Element("layer", {"class": kind, "enabled": "1", "locked": "0", "pass": "0"})
    root.append(option_map(options))
    return root


def option_map(options: Mapping[str, str]) -> ET.Element:
    """Return texts by name as QGIS writes them."""
    root = ET.Element("Option", {"type": "Map"})
    for name, value in options.items():
        ET.SubElement(root, "Option", {"type": "QString", "name": name, "value": value})
    return root


def _labeling(label: Label, layer: Layer) -> ET.Element:
    root = ET.Element("labeling", {"type": "simple"})
    settings = ET.SubElement(root, "settings", {"calloutType": "simple"})
    style = {
        "fieldName": label.field,
        "isExpression": "0",
        "fontSize": f"{label.size_pt:g}",
        "fontSizeUnit": "Point",
        "textColor": _rgba(label.colour),
        "textOpacity": "1",
        "fontWeight": "50",
        "multilineHeight": "1",
    }
    buffer = {"bufferDraw": "1", "bufferSize": "0.6", "bufferSizeUnits": "MM", "bufferColor": _rgba(PAPER)}
    text = ET.SubElement(settings, "text-style", style)
    ET.SubElement(text, "text-buffer", {**buffer, "bufferOpacity": "0.85", "bufferJoinStyle": "128"})
    is_line = layer.geometry == "LineString"
    place = {
        "placement": _BY_LINE if is_line else _AROUND_POINT,
        "placementFlags": _ON_LINE if is_line else "10",
        "dist": "0" if is_line else "2.2",
        "distUnits": "MM",
        "priority": "3" if is_line else "8",
        "maxCurvedCharAngleIn": "25",
        "maxCurvedCharAngleOut": "-25",
    }
    ET.SubElement(settings, "placement", place)
    limits = {"scaleVisibility": "1", "scaleMin": "1", "scaleMax": str(label.min_scale), "drawLabels": "1"}
    ET.SubElement(settings, "rendering", {**limits, "mergeLines": "1" if is_line else "0", "obstacle": "1"})
    return root


def _name_expression(layer: Layer) -> str:
    texts = re.split(r"\{(\w+)(?::[^}]*)?\}", layer.label)
    parts = [f"'{text}'" if index % 2 == 0 else _shown(text) for index, text in enumerate(texts) if text]
    return f"concat({', '.join(parts)})"


def _shown(name: str) -> str:
    return f'round("{name}", 1)' if name.endswith(("_m", "_deg")) else f'"{name}"'


def _tip(layer: Layer) -> str:
    """Return HTML with expressions in it; texts may come from a map and are no HTML."""
    lines = [f"<b>[% {_escaped(_name_expression(layer))} %]</b>"]
    for each in layer.attributes:
        if each.name in _TOLD:
            text = f"'<br>{each.title}: ' || {_escaped(_shown(each.name))}" + (" || ' m'" if each.unit == "m" else "")
            lines.append(f"[% coalesce({text}, '') %]")
    return "".join(lines)


def _escaped(expression: str) -> str:
    return f"replace(replace({expression}, '&', '&amp;'), '<', '&lt;')"


def _element(tag: str, text: str) -> ET.Element:
    element = ET.Element(tag)
    element.text = text
    return element


def _mm(px: float) -> str:
    return f"{round(px * MM_PER_PX, 3) + 0.0:g}"


def _rgba(colour: str, opacity: float = 1.0) -> str:
    red, green, blue = (int(colour[index : index + 2], 16) for index in (1, 3, 5))
    return f"{red},{green},{blue},{round(255 * opacity)}"
