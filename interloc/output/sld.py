"""Styles for other GIS (GeoServer, MapServer, gvSIG): OGC Styled Layer Descriptor 1.1, from `interloc.output.styles`.

The glyphs within signs are left out: there is no well-known mark of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from interloc.output.layers import Layer
from interloc.output.styles import PAPER, STYLES, Area, Label, Line, Mark, Rule, Symbol

_SLD, _SE, _OGC = "http://www.opengis.net/sld", "http://www.opengis.net/se", "http://www.opengis.net/ogc"

_MARKS = {  # shape -> well-known name, its size where the half size of ours is 1, degrees that it is turned by
    "disc": ("circle", 2.0, 0),
    "square": ("square", 2.0, 0),
    "diamond": ("square", 1.77, 45),  # a square on its tip
    "triangle": ("triangle", 2.0, 0),
    "cross": ("x", 1.6, 0),
}


def sld(layer: Layer) -> str:
    """Return the style of a layer as an SLD document."""
    style = STYLES[layer.name]
    for prefix, uri in (("sld", _SLD), ("se", _SE), ("ogc", _OGC)):
        ET.register_namespace(prefix, uri)
    root = ET.Element(f"{{{_SLD}}}StyledLayerDescriptor", {"version": "1.1.0"})
    named = ET.SubElement(root, f"{{{_SLD}}}NamedLayer")
    _text(named, "Name", layer.name)
    user = ET.SubElement(named, f"{{{_SLD}}}UserStyle")
    _text(user, "Name", layer.name)
    features = _add(user, "FeatureTypeStyle")
    for rule in style.rules:
        _add_rule(features, rule, style.field)
    if style.label is not None:
        _add_label(features, style.label, is_line=layer.geometry == "LineString")
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add_rule(parent: ET.Element, rule: Rule, field: str | None) -> None:
    root = _add(parent, "Rule")
    _text(root, "Name", rule.title)
    _text(_add(root, "Description"), "Title", rule.title)
    if field is not None:
        equal = ET.SubElement(ET.SubElement(root, f"{{{_OGC}}}Filter"), f"{{{_OGC}}}PropertyIsEqualTo")
        ET.SubElement(equal, f"{{{_OGC}}}PropertyName").text = field
        value = str(rule.value).lower() if isinstance(rule.value, bool) else str(rule.value)
        ET.SubElement(equal, f"{{{_OGC}}}Literal").text = value
    _add_symbol(root, rule.symbol)


def _add_symbol(parent: ET.Element, symbol: Symbol) -> None:
    if isinstance(symbol, Area):
        area = _add(parent, "PolygonSymbolizer")
        _add_fill(area, symbol.colour, symbol.opacity)
        _add_stroke(area, symbol.edge, symbol.width_px)
    elif isinstance(symbol, Line):
        if symbol.casing is not None:
            _add_stroke(_add(parent, "LineSymbolizer"), symbol.casing, 2.0 * symbol.width_px, symbol.opacity)
        _add_stroke(_add(parent, "LineSymbolizer"), symbol.colour, symbol.width_px, symbol.opacity)
    else:
        _add_mark(parent, symbol)


def _add_mark(parent: ET.Element, mark: Mark) -> None:
    name, size, degrees = _MARKS[mark.shape]
    graphic = _add(_add(parent, "PointSymbolizer"), "Graphic")
    sign = _add(graphic, "Mark")
    _text(sign, "WellKnownName", name)
    if mark.is_filled:
        _add_fill(sign, mark.colour)
    if mark.width_px:
        _add_stroke(sign, mark.edge or mark.colour, mark.width_px)
    if mark.opacity != 1.0:
        _text(graphic, "Opacity", f"{mark.opacity:g}")
    _text(graphic, "Size", f"{size * mark.radius_px:.1f}")
    if degrees:
        _text(graphic, "Rotation", str(degrees))


def _add_label(parent: ET.Element, label: Label, *, is_line: bool) -> None:
    root = _add(parent, "Rule")
    _text(root, "MaxScaleDenominator", str(label.min_scale))
    text = _add(root, "TextSymbolizer")
    ET.SubElement(_add(text, "Label"), f"{{{_OGC}}}PropertyName").text = label.field
    _add_parameters(_add(text, "Font"), (("font-family", "sans-serif"), ("font-size", f"{label.size_pt * 96 / 72:g}")))
    placement = _add(text, "LabelPlacement")
    if is_line:
        _add(placement, "LinePlacement")
    else:
        shift = _add(_add(placement, "PointPlacement"), "Displacement")
        _text(shift, "DisplacementX", "9")
        _text(shift, "DisplacementY", "9")
    halo = _add(text, "Halo")
    _text(halo, "Radius", "2")
    _add_fill(halo, PAPER, 0.85)
    _add_fill(text, label.colour)


def _add_fill(parent: ET.Element, colour: str, opacity: float = 1.0) -> None:
    _add_parameters(_add(parent, "Fill"), (("fill", colour), *_opacity("fill-opacity", opacity)))


def _add_stroke(parent: ET.Element, colour: str, width_px: float, opacity: float = 1.0) -> None:
    line = (("stroke", colour), ("stroke-width", f"{width_px:g}"), *_opacity("stroke-opacity", opacity))
    _add_parameters(_add(parent, "Stroke"), line)


def _opacity(name: str, opacity: float) -> Sequence[tuple[str, str]]:
    return () if opacity == 1.0 else ((name, f"{opacity:g}"),)


def _add_parameters(parent: ET.Element, values: Sequence[tuple[str, str]]) -> None:
    for name, value in values:
        ET.SubElement(parent, f"{{{_SE}}}SvgParameter", {"name": name}).text = value


def _add(parent: ET.Element, tag: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{_SE}}}{tag}")


def _text(parent: ET.Element, tag: str, text: str) -> None:
    _add(parent, tag).text = text
