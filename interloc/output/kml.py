"""Styles in KML, and KMZ: all layers of a result in one file for Google Earth, with the signs of the page as pictures.

GDAL writes the features; what its driver leaves out is added to the XML: styles, titles of fields, what is hidden.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from xml.etree import ElementTree as ET
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from interloc.output.layers import Layer, Rows
from interloc.output.styles import GLYPH_PX, OUTLINES, PAPER, STYLES, Area, Glyph, Mark, Rule, Shape

_NS = "http://www.opengis.net/kml/2.2"

NAMES = {"id": "number", "name": "street", "time": "timestamp", "first_time": "begin", "last_time": "end"}
"""Properties that mean something else in KML, or something that KML has a name for -> what they are called there."""

_GOOGLE = "https://maps.google.com/mapfiles/kml/shapes"
_SHAPES: dict[Shape, str] = {  # that Google Earth has itself, white
    "disc": "placemark_circle",
    "square": "square",
    "diamond": "open-diamond",
    "triangle": "triangle",
    "cross": "forbidden",
}
_ICON_PX = 64
_SHOWN_PX = 32  # of an icon at scale 1 in Google Earth
_FINER = 4  # drawn as much larger, then reduced: smooth edges


def style_kml(content: bytes, layer: Layer, rows: Rows) -> bytes:
    """Return a KML file of GDAL with the styles of its layer; its icons are those that Google Earth has.

    Parameters
    ----------
    content
        The file, with one placemark per feature.
    layer, rows
        What it holds.
    """
    return _document(_styled(content, layer, rows, in_archive=False))


def pack_kmz(files: Iterable[tuple[bytes, Layer, Rows]], name: str) -> bytes:
    """Return KML files of GDAL as one KMZ with their styles and icons, the same bytes for the same result.

    Parameters
    ----------
    files
        Each with its layer and what it holds.
    name
        Of the result.
    """
    root = ET.Element(_tag("kml"))
    document = ET.SubElement(root, _tag("Document"))
    ET.SubElement(document, _tag("name")).text = name
    ET.SubElement(document, _tag("open")).text = "1"
    parts: list[ET.Element] = []
    icons: dict[str, bytes] = {}
    for content, layer, rows in files:
        parts.extend(_styled(content, layer, rows, in_archive=True).iterfind(f"{_tag('Document')}/*"))
        for number, rule in enumerate(STYLES[layer.name].rules):
            if isinstance(rule.symbol, Mark):
                icons[_icon_path(layer, number)] = _draw(rule.symbol)
    for tag in ("Style", "Schema", "Document"):  # the order of the standard
        document.extend(part for part in parts if part.tag == _tag(tag))
    buffer = io.BytesIO()
    with ZipFile(buffer, "w", ZIP_DEFLATED) as archive:
        for path, content in (("doc.kml", _document(root)), *icons.items()):
            archive.writestr(ZipInfo(path), content, ZIP_DEFLATED)
    return buffer.getvalue()


def _styled(content: bytes, layer: Layer, rows: Rows, *, in_archive: bool) -> ET.Element:
    root = ET.fromstring(content)  # noqa: S314 - our own
    document = root.find(_tag("Document"))
    assert document is not None
    style = STYLES[layer.name]
    styles = [_style(rule, layer, number, in_archive=in_archive) for number, rule in enumerate(style.rules)]
    document[:0] = styles
    titles = {NAMES.get(each.name, each.name): each.title for each in layer.attributes}
    for field in root.iter(_tag("SimpleField")):
        ET.SubElement(field, _tag("displayName")).text = titles[field.get("name", "")]
    ids = {rule.value: each.get("id") for rule, each in zip(style.rules, styles, strict=True)}
    values = [None] * len(rows.features) if style.field is None else rows.column(style.field)
    for placemark, value in zip(root.iter(_tag("Placemark")), values, strict=True):
        at = next(index for index, each in enumerate(placemark) if each.tag == _tag("name")) + 1
        if not style.is_shown:
            placemark.insert(at, _element("visibility", "0"))
            at += 1
        while placemark[at].tag in _BEFORE_STYLE:
            at += 1
        placemark.insert(at, _element("styleUrl", f"#{ids[value]}"))
    for part in document.iterfind(_tag("Document")):
        part[:] = sorted(part, key=lambda each: each.tag != _tag("name"))
        part.insert(1, _element("visibility", "1" if style.is_shown else "0"))
    return root


def _style(rule: Rule, layer: Layer, number: int, *, in_archive: bool) -> ET.Element:
    symbol = rule.symbol
    root = ET.Element(_tag("Style"), {"id": f"{layer.name}.{number}"})
    if isinstance(symbol, Mark):
        icon = ET.SubElement(root, _tag("IconStyle"))
        if not in_archive:  # where it has its own icons, they have their colours
            icon.append(_element("color", _abgr(symbol.colour, symbol.opacity)))
        scale = 2.0 * _half_px(symbol) / _SHOWN_PX if in_archive else symbol.radius_px / 10.0
        icon.append(_element("scale", f"{scale:.2f}"))
        address = _icon_path(layer, number) if in_archive else f"{_GOOGLE}/{_SHAPES[symbol.shape]}.png"
        ET.SubElement(icon, _tag("Icon")).append(_element("href", address))
        has_label = STYLES[layer.name].label is not None  # else names of hundreds of points hide the map
        ET.SubElement(root, _tag("LabelStyle")).append(_element("scale", "0.8" if has_label else "0"))
    else:
        line = ET.SubElement(root, _tag("LineStyle"))
        colour, opacity = (symbol.edge, 1.0) if isinstance(symbol, Area) else (symbol.colour, symbol.opacity)
        line.extend((_element("color", _abgr(colour, opacity)), _element("width", f"{symbol.width_px:g}")))
        if isinstance(symbol, Area):
            ET.SubElement(root, _tag("PolyStyle")).append(_element("color", _abgr(symbol.colour, symbol.opacity)))
    return root


_BEFORE_STYLE = {f"{{{_NS}}}{tag}" for tag in ("open", "description", "Snippet", "TimeStamp", "TimeSpan")}


def _icon_path(layer: Layer, number: int) -> str:
    return f"icons/{layer.name}-{STYLES[layer.name].rules[number].value or 'all'}.png"


def _half_px(mark: Mark) -> float:
    """Return half the size of the picture of a sign, on the screen."""
    reach = max((abs(value) for path in OUTLINES.get(mark.shape, ()) for point in path for value in point), default=1.0)
    return reach * mark.radius_px + mark.width_px / 2.0 + 0.5


def _draw(mark: Mark) -> bytes:
    from PIL import Image, ImageDraw  # noqa: PLC0415 - slow to import

    half = _ICON_PX * _FINER / 2.0
    scale = half / _half_px(mark)
    image = Image.new("RGBA", (_ICON_PX * _FINER,) * 2, f"{PAPER}00")
    pen = ImageDraw.Draw(image)
    radius = mark.radius_px * scale
    width = round(mark.width_px * scale)
    line = mark.edge or mark.colour

    def place(shape: Shape | Glyph) -> list[list[tuple[float, float]]]:
        return [[(half + x * radius, half + y * radius) for x, y in path] for path in OUTLINES[shape]]

    if mark.shape == "disc":
        reach = radius + width / 2.0
        pen.ellipse((half - reach, half - reach, half + reach, half + reach), mark.colour, line, width)
    elif mark.shape == "cross":
        for path in place("cross"):
            pen.line(path, line, width)
    else:
        (path,) = place(mark.shape)
        if mark.is_filled:
            pen.polygon(path, mark.colour)
        if width:
            pen.line([*path, path[0], path[1]], line, width, joint="curve")
    if mark.glyph is not None:
        thickness = GLYPH_PX * scale
        for path in place(mark.glyph):
            pen.line(path, PAPER, round(thickness), joint="curve")
            for x, y in (path[0], path[-1]):
                end = thickness / 2.0
                pen.ellipse((x - end, y - end, x + end, y + end), PAPER)
    buffer = io.BytesIO()
    image = image.reduce(_FINER)
    image.putalpha(image.getchannel("A").point([round(mark.opacity * value) for value in range(256)]))
    image.save(buffer, "PNG")
    return buffer.getvalue()


def _document(root: ET.Element) -> bytes:
    ET.register_namespace("", _NS)
    ET.indent(root, " ")
    content: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return content


def _tag(name: str) -> str:
    return f"{{{_NS}}}{name}"


def _element(name: str, text: str) -> ET.Element:
    element = ET.Element(_tag(name))
    element.text = text
    return element


def _abgr(colour: str, opacity: float) -> str:
    red, green, blue = colour[1:3], colour[3:5], colour[5:7]
    return f"{round(255 * opacity):02x}{blue}{green}{red}"
