"""Styles are those of the page; what QGIS makes of the exports. One QGIS answers all tests."""

import re
import sqlite3
from pathlib import Path
from typing import Any, Literal, get_args, get_origin
from xml.etree import ElementTree as ET

import pytest

from interloc.output import styles
from interloc.output.credits import ODBL, OSM_ATTRIBUTION
from interloc.output.layers import DERIVED, LAYERS
from interloc.output.qgis import qml
from interloc.output.styles import FOUND, FUSED, GLYPHS, GROUPS, RIGHT, ROAD, STYLES, Mark, Symbol
from interloc.output.vector_files import EXPORTS, write_vector_file
from tests.output.small import small_result, with_roads, write_folder
from tests.qgis import ask_qgis, pixels_of, require_qgis

NAMES = [name for name in EXPORTS if name not in {"places", "osm_buildings"}]

IN_QGIS = """
folder, *names = sys.argv[1:]
told |= {"layers": {}, "qml": {}}
for name in names:
    told["layers"][name] = describe(QgsVectorLayer(f"{folder}/a.gpkg|layername={name}", name, "ogr"))
    told["qml"][name] = describe(QgsVectorLayer(f"{folder}/{name}.geojson", name, "ogr"))
for name in ("local", "project"):
    told[name] = read_project(f"{folder}/{name}.qgz")
draw_project(f"{folder}/map.png")
"""


@pytest.fixture(scope="module")
def exported(scored: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The exports of a scored result, and a picture of its project."""
    require_qgis()
    folder = tmp_path_factory.mktemp("qgis")
    local = write_folder(folder / "local", with_roads(small_result(local=True)), scored=False)
    for path, source in (("a.gpkg", scored), ("project.qgz", scored), ("local.qgz", local)):
        write_vector_file(source, folder / path, layer="all" if path == "a.gpkg" else None)
    database = sqlite3.connect(folder / "a.gpkg")
    styles = database.execute("SELECT f_table_name, useAsDefault FROM layer_styles").fetchall()
    database.close()
    assert [name for name, *_ in styles] == NAMES
    for name, is_default in styles:
        assert is_default
        write_vector_file(scored, folder / f"{name}.geojson", layer=name)
        (folder / f"{name}.qml").write_text(qml(EXPORTS[name]))
    return folder


@pytest.fixture(scope="module")
def told(exported: Path) -> dict[str, Any]:
    """What QGIS says of them."""
    return ask_qgis(IN_QGIS, exported, *NAMES, home=exported)


def titles_of(layer: str) -> list[str]:
    """The legend of a layer in QGIS; one sign has no title."""
    style = STYLES[layer]
    return [""] if style.field is None else [rule.title for rule in style.rules]


def test_it_reads_layers_and_fields(told: dict[str, Any]) -> None:
    layers = told["layers"]
    for name, layer in layers.items():
        assert (layer["valid"], layer["crs"], layer["features"] > 0) == (True, "EPSG:4326", True)
        assert set(EXPORTS[name].fields) <= set(layer["types"])
    types = layers["detections"]["types"]
    assert (types["time"], types["osm_id"], types["error_m"]) == ("DateTime", "String", "Real")


@pytest.mark.parametrize("source", ["layers", "qml"])
def test_it_takes_the_style_of_a_geopackage_and_that_beside_geojson(source: str, told: dict[str, Any]) -> None:
    for name, layer in told[source].items():
        assert layer["legend"] == titles_of(name)
        assert layer["labels"] == (STYLES[name].label is not None)
        titles = {each.name: each.title for each in EXPORTS[name].attributes}
        assert {field: layer["aliases"][field] for field in titles} == titles


def test_it_opens_the_project(told: dict[str, Any]) -> None:
    project = told["project"]
    assert (project["read"], project["title"], project["crs"]) == (True, "straße & <b>Co</b>", "EPSG:32632")
    assert project["groups"] == {
        "Verdict": ["Intersections", "OSM intersections", "Branches", "Uncertainty, 95 %"],
        "Evidence": ["Detections", "Matches", "Keyframes", "Trajectory"],
        "Roads seen by LiDAR": ["Roads seen", "Junctions", "Road surface", "Road seen by LiDAR"],
        "Map of OpenStreetMap": ["OSM roads"],
    }
    assert project["hidden"] == ["Keyframes"]
    assert project["rasters"] == {"Road seen by LiDAR": [True, "EPSG:32632", "singlebandpseudocolor"]}
    layers = project["layers"]
    assert all(layer["valid"] and layer["crs"] == "EPSG:4326" for layer in layers.values())
    assert layers["OSM intersections"]["legend"] == ["Found", "Missed", "Out of reach"]
    about, whose = layers["Intersections"], layers["OSM roads"]
    assert (about["title"], about["abstract"]) == (EXPORTS["intersections"].title, EXPORTS["intersections"].description)
    assert OSM_ATTRIBUTION in whose["rights"][0]
    assert (about["rights"], whose["licenses"], layers["Trajectory"]["licenses"]) == (whose["rights"], [ODBL], [])
    assert project["credit"] == "© OpenStreetMap contributors, ODbL 1.0"
    assert told["log"] == []


def test_it_opens_the_project_of_a_drive_in_metres(told: dict[str, Any]) -> None:
    local = told["local"]
    assert local["groups"] == {
        "Verdict": ["Intersections"],
        "Evidence": ["Detections", "Keyframes", "Trajectory"],
        "Roads seen by LiDAR": ["Roads seen", "Junctions", "Road surface", "Road seen by LiDAR"],
    }
    assert all(layer["valid"] and layer["features"] for layer in local["layers"].values())
    assert (local["crs"], local["credit"], local["extent"]) == ("", "", "-50,-51 : 52,50")
    assert local["shown"].endswith(",50")  # wider, as the window is


def test_the_map_shows_each_outcome_in_its_colour(told: dict[str, Any], exported: Path) -> None:
    for colour in (RIGHT, FOUND, FUSED, ROAD):
        assert pixels_of(exported / "map.png", colour) > 20, colour


STATIC = Path(__file__).resolve().parents[2] / "static"


def page_colours() -> dict[str, str]:
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


def test_glyphs_and_other_colours_are_those_of_the_page() -> None:
    text = (STATIC / "js/map/symbols.js").read_text()
    drawn = dict(re.findall(r'^  (\w+): lines\("(.*)"\),$', text, re.MULTILINE))
    for glyph, paths in GLYPHS.items():
        lines = [[float(each) for each in line.split()] for line in drawn[glyph].split(",")]
        assert [[value for point in path for value in point] for path in paths] == lines, glyph
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
