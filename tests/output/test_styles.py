"""Styles for GIS: the signs of the page, a rule for each outcome; and the page of the attributes."""

import re
from pathlib import Path
from typing import Any, Literal, get_args, get_origin
from xml.etree import ElementTree as ET

import pytest

from interloc.output import styles
from interloc.output.layers import DERIVED, LAYERS
from interloc.output.qgis import qml
from interloc.output.styles import GROUPS, OUTLINES, STYLES, Mark, Symbol
from interloc.output.vector_files import EXPORTS

STATIC = Path(__file__).resolve().parents[2] / "static"


def page_colours() -> dict[str, str]:
    """The colours of the page on a light ground."""
    tokens = (STATIC / "css/tokens.css").read_text()
    return dict(re.findall(r"(--[\w-]+): (?:light-dark\()?(#[0-9a-f]{6})", tokens))


def page_signs() -> dict[str, dict[str, str]]:
    text = (STATIC / "js/map/symbols.js").read_text()
    rows = re.findall(r"^  (\w+): \{ (colour: .*) \},$", text, re.MULTILINE)
    return {name: dict(re.findall(r'(\w+): "?([\w.-]+)"?', row)) for name, row in rows}


def symbol(layer: str, value: str | None) -> Symbol:
    return next(rule.symbol for rule in STYLES[layer].rules if rule.value == value)


@pytest.mark.parametrize(("sign", "layer", "value"), [
    *((each, "intersections", each) for each in ("right", "wrong", "unscored")),
    *((each, "osm_nodes", each) for each in ("found", "missed", "outside")),
    ("tp", "detections", "right"), ("fp", "detections", "wrong"), ("detections", "detections", "unscored"),
])  # fmt: skip
def test_signs_are_those_of_the_page(sign: str, layer: str, value: str) -> None:
    colours, there, mark = page_colours(), page_signs()[sign], symbol(layer, value)
    assert isinstance(mark, Mark)
    assert (mark.colour, mark.shape) == (colours[there["colour"]], there["shape"])
    assert mark.is_filled == (there["filled"] == "true")
    assert mark.edge == (colours[there["edge"]] if "edge" in there else None)
    assert mark.glyph == there.get("glyph")


def test_shapes_and_other_colours_are_those_of_the_page() -> None:
    text = (STATIC / "js/map/symbols.js").read_text()
    drawn = dict(re.findall(r'^  (\w+): lines\("(.*)"\),$', text, re.MULTILINE))
    for shape, paths in OUTLINES.items():
        lines = [[float(each) for each in line.split()] for line in drawn[shape].split(",")]
        assert [[value for point in path for value in point] for path in paths] == lines, shape
    colours = page_colours()
    for name in ("RIGHT", "WRONG", "FOUND", "MISSED", "OUTSIDE", "FUSED", "TRACK", "BUILDING", "INK"):
        assert getattr(styles, name) == colours[f"--{name.lower().replace('_', '-')}"]
    assert (colours["--tp"], colours["--fp"]) == (styles.TRUE, styles.FALSE)


def test_every_outcome_of_every_layer_is_drawn() -> None:
    assert STYLES.keys() == EXPORTS.keys()
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(EXPORTS)
    for name, style in STYLES.items():
        values = {rule.value for rule in style.rules}
        annotation: Any = None if style.field is None else EXPORTS[name].properties.model_fields[style.field].annotation
        expected = get_args(annotation) if get_origin(annotation) is Literal else [None]
        assert values == ({True, False} if annotation is bool else set(expected)), name
        known = EXPORTS[name].fields.keys()
        assert style.label is None or style.label.field in known


def test_qml_names_no_address_but_namespaces() -> None:
    for layer in EXPORTS.values():
        text = qml(layer)
        ET.fromstring(text.removeprefix("<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"))  # noqa: S314
        assert set(re.findall(r"https?://[\w.]+", text)) <= {"http://www.opengis.net", "http://mrcc.com"}


PAGE = (Path(__file__).resolve().parents[2] / "docs/attributes.md").read_text()


def test_the_page_names_every_layer_and_property() -> None:
    for layer in (LAYERS | DERIVED).values():
        assert [name for name in (layer.name, *layer.fields) if f"`{name}`" not in PAGE] == []
