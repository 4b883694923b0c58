"""Other GIS formats say what the GeoJSON says, position for position and property for property."""

import csv
import json
import math
import resource
import shutil
import subprocess
import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely

from interloc.errors import ConfigError, GeoreferenceError, OutputError
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.osm.reader import read_osm
from interloc.output.credits import ODBL, OSM_ATTRIBUTION
from interloc.output.layers import LAYERS
from interloc.output.vector_files import EXPORTS, write_vector_file
from interloc.output.write import write_results
from interloc.results import DriveResult
from tests.output.small import small_result

FILES = ["intersections", "detections", "trajectory", "keyframes", "osm_nodes", "matches", "osm_roads"]
DERIVED = ["branches", "uncertainty"]
TIME_S = np.array([1317386459.1234, 1317386461.0])

MAP = """<osm version="0.6"><bounds minlat="49.0" minlon="8.41" maxlat="49.03" maxlon="8.44"/>
<node id="9000000001" lat="49.0110001" lon="8.4205001"/><node id="2" lat="49.012" lon="8.4205"/>
<node id="3" lat="49.011" lon="8.422"/><node id="4" lat="49.011" lon="8.419"/>
<way id="10"><nd ref="4"/><nd ref="9000000001"/><nd ref="3"/><tag k="highway" v="residential"/></way>
<way id="11"><nd ref="9000000001"/><nd ref="2"/><tag k="highway" v="tertiary"/>
<tag k="name" v="Straße &amp; Weg"/></way>
</osm>"""


def write_folder(folder: Path, result: DriveResult, *, scored: bool, osm: str = MAP) -> Path:
    write_results(result, folder)
    if scored:
        (folder.parent / "map.osm").write_text(osm)
        graph = read_osm(folder.parent / "map.osm")
        write_report(evaluate(result, graph), folder)
    return folder


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder with an evaluation. Shared: do not change it."""
    result = small_result()
    result = replace(result, drive="straße & Co", keyframes=replace(result.keyframes, time_s=TIME_S))
    return write_folder(tmp_path_factory.mktemp("scored") / "out", result, scored=True)


def features(result: Path, layer: str, tmp_path: Path) -> list[dict[str, Any]]:
    """Return the features of a layer of a result, or of one that is made of it."""
    write_vector_file(result, tmp_path / "a.geojson", layer=layer)
    return features_of(tmp_path / "a.geojson")


def features_of(path: Path) -> list[dict[str, Any]]:
    return json.loads(path.read_text())["features"]


def rows_of(path: Path, layer: str) -> tuple[list[dict[str, Any]], list[Any]]:
    """Read a layer with GDAL: properties and geometries, in the order of the file."""
    meta, _, wkb, columns = pyogrio.raw.read(path, layer=layer)
    names = meta["fields"].tolist()
    rows = [dict(zip(names, values, strict=True)) for values in zip(*(c.tolist() for c in columns), strict=True)]
    return rows, list(shapely.from_wkb(wkb))


def assert_same(properties: dict[str, Any], row: dict[str, Any]) -> None:
    for name, value in properties.items():
        got = row[name]
        if isinstance(value, list):
            assert json.loads(got) == value
        elif value is None:
            assert got is None or got != got
        elif isinstance(got, datetime):
            assert f"{got.replace(tzinfo=None).isoformat(timespec='milliseconds')}Z" == value
        else:
            assert got == value, name


def test_a_geopackage_holds_all_layers_of_the_result(scored: Path, tmp_path: Path) -> None:
    assert write_vector_file(scored, tmp_path / "a.gpkg") == [*FILES, *DERIVED]
    assert pyogrio.list_layers(tmp_path / "a.gpkg")[:, 0].tolist() == [*FILES, *DERIVED]
    for layer in FILES:
        assert pyogrio.read_info(tmp_path / "a.gpkg", layer=layer)["crs"] == "EPSG:4326"
        rows, geometries = rows_of(tmp_path / "a.gpkg", layer)
        features = features_of(scored / f"{layer}.geojson")
        assert len(rows) == len(features) > 0
        for feature, row, geometry in zip(features, rows, geometries, strict=True):
            assert set(row) == set(feature["properties"]) == set(LAYERS[layer].fields)
            assert_same(feature["properties"], row)
            assert shapely.equals_exact(geometry, shapely.geometry.shape(feature["geometry"]), 0)


@pytest.mark.parametrize("layer", [*FILES, *DERIVED])
def test_flatgeobuf_holds_one_layer(layer: str, scored: Path, tmp_path: Path) -> None:
    assert write_vector_file(scored, tmp_path / "a.fgb", layer=layer) == [layer]
    rows, geometries = rows_of(tmp_path / "a.fgb", layer)
    written = {g.wkt: row for row, g in zip(rows, geometries, strict=True)}  # sorted for its spatial index
    for feature in features(scored, layer, tmp_path):
        assert_same(feature["properties"], written[shapely.geometry.shape(feature["geometry"]).wkt])


@pytest.mark.parametrize("layer", [each for each in FILES if each != "trajectory"])  # it has a member more
def test_geojson_is_the_layer_itself(layer: str, scored: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    write_vector_file(scored, path, layer=layer)
    assert json.loads(path.read_text()) == json.loads((scored / f"{layer}.geojson").read_text())


@pytest.mark.parametrize("layer", [*FILES, *DERIVED])
def test_kml_names_its_features_and_keeps_their_properties(layer: str, scored: Path, tmp_path: Path) -> None:
    write_vector_file(scored, tmp_path / "a.kml", layer=layer)
    rows, geometries = rows_of(tmp_path / "a.kml", EXPORTS[layer].title)
    for feature, row, geometry in zip(features(scored, layer, tmp_path), rows, geometries, strict=True):
        properties = dict(feature["properties"])
        assert row["Name"] == EXPORTS[layer].label.format(**properties)
        names = {"id": "number", "name": "street", "time": "timestamp", "first_time": "begin", "last_time": "end"}
        for name, there in names.items():
            if name in properties:
                properties[there] = properties.pop(name)
        if "osm_id" in properties:
            properties["osm_id"] = str(properties["osm_id"])
        assert_same(properties, row)
        assert shapely.force_2d(geometry).wkt == shapely.geometry.shape(feature["geometry"]).wkt


@pytest.mark.parametrize("name", ["a.gpkg", "a.fgb", "a.kml", "a.csv", "a.geojson"])
def test_openstreetmap_is_named_where_its_data_is_inside(name: str, scored: Path, tmp_path: Path) -> None:
    for layer in ("osm_nodes", "matches", "detections", "trajectory", "branches"):
        write_vector_file(scored, tmp_path / name, layer=layer)
        of_map = layer not in {"trajectory", "branches"}  # detections have a verdict, with ids of nodes
        assert (OSM_ATTRIBUTION.encode() in (tmp_path / name).read_bytes()) == of_map


def test_nothing_found_gives_layers_with_their_fields(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "out", small_result(empty=True), scored=False)
    assert write_vector_file(folder, tmp_path / "a.gpkg") == [*FILES[:4], *DERIVED]
    info = pyogrio.read_info(tmp_path / "a.gpkg", layer="intersections")
    assert info["features"] == 0
    assert info["geometry_type"] == "Point"
    assert set(info["fields"]) == set(LAYERS["intersections"].fields)
    for name in ("a.fgb", "a.kml"):
        write_vector_file(folder, tmp_path / name)
        assert rows_of(tmp_path / name, pyogrio.list_layers(tmp_path / name)[0, 0]) == ([], [])


def test_a_name_may_use_hyphens_and_an_older_file_is_replaced(scored: Path, tmp_path: Path) -> None:
    (tmp_path / "a.gpkg").write_text("something else")
    assert write_vector_file(scored, tmp_path / "a.gpkg", layer="osm-nodes") == ["osm_nodes"]
    assert pyogrio.list_layers(tmp_path / "a.gpkg")[:, 0].tolist() == ["osm_nodes"]
    assert [path.name for path in tmp_path.iterdir()] == ["a.gpkg"]


def test_what_cannot_be_is_said(scored: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\.shp.*Expected one of \.gpkg, \.fgb, \.kml, \.csv"):
        write_vector_file(scored, tmp_path / "a.shp")
    with pytest.raises(ConfigError, match="'streets' is not a layer"):
        write_vector_file(scored, tmp_path / "a.fgb", layer="streets")
    with pytest.raises(OutputError, match="no such file or directory"):
        write_vector_file(scored, tmp_path / "nowhere" / "a.fgb")
    with pytest.raises(OutputError, match=r"run\.json is missing"):
        write_vector_file(tmp_path, tmp_path / "a.fgb")
    plain = write_folder(tmp_path / "plain", small_result(), scored=False)
    with pytest.raises(ConfigError, match=r"no matches\.geojson.*interloc evaluate"):
        write_vector_file(plain, tmp_path / "a.fgb", layer="matches")
    local = write_folder(tmp_path / "local", small_result(local=True), scored=False)
    with pytest.raises(GeoreferenceError, match=r"KML knows longitude and latitude only.*`interloc locate"):
        write_vector_file(local, tmp_path / "a.kml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["local", "plain"]


def test_branches_and_uncertainty_are_as_large_as_they_say(scored: Path, tmp_path: Path) -> None:
    branches, (ellipse,) = (features(scored, layer, tmp_path) for layer in DERIVED)
    assert [each["properties"]["bearing_deg"] for each in branches] == [0.5, 90.75, 180.5]
    (lon, lat), (_, north) = branches[0]["geometry"]["coordinates"]
    assert (lon, lat) == (8.4205, 49.011)
    assert (north - lat) * 111.2e3 == pytest.approx(20.0, abs=0.05)
    assert ellipse["properties"] | {"drive": ""} == {
        "intersection": 1, "position_std_m": 0.25, "radius_m": 0.6119, "drive": "",
        "semi_major_m": 0.7444, "semi_minor_m": 0.4413, "bearing_deg": 45.0,
    }  # fmt: skip
    ring = shapely.geometry.shape(ellipse["geometry"])
    assert ring.exterior.is_ccw
    assert (ring.bounds[3] - ring.bounds[1]) * 111.2e3 == pytest.approx(2 * 0.6119, abs=0.03)
    assert ring.area * 111.2e3**2 * math.cos(math.radians(lat)) == pytest.approx(math.pi * 0.7445 * 0.4413, rel=0.1)


def test_csv_is_safe_to_open_in_a_spreadsheet(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "out", replace(small_result(), drive="=1+cmd|'x'!A1"), scored=False)
    write_vector_file(folder, tmp_path / "a.csv")
    (row,) = csv.DictReader((tmp_path / "a.csv").read_text().splitlines())
    assert (row["lon"], row["lat"], row["branch_bearings_deg"]) == ("8.4205", "49.011", "[0.5,90.75,180.5]")
    assert (row["drive"], row["osm_id"], row["uid"]) == ("'=1+cmd|'x'!A1", "", "49.01110,8.42063")
    assert "attribution" not in row
    write_vector_file(folder, tmp_path / "a.csv", layer="uncertainty")
    (row,) = csv.DictReader((tmp_path / "a.csv").read_text().splitlines())
    assert shapely.from_wkt(row["wkt"]).geom_type == "Polygon"


def test_titles_are_unique_within_a_layer() -> None:
    for layer in EXPORTS.values():
        titles = [each.title for each in layer.attributes]
        assert len(set(titles)) == len(titles), layer.name


def test_a_layer_of_an_older_version_says_whose_data_it_is(scored: Path, tmp_path: Path) -> None:
    for layer, own in (("intersections", False), ("trajectory", True), ("osm_nodes", False)):
        content = json.loads((scored / f"{layer}.geojson").read_text())
        told = content.pop("attribution"), content.pop("license", None)
        (tmp_path / "old.geojson").write_text(json.dumps(content))
        credit = LAYERS[layer].read(tmp_path / "old.geojson").credit
        assert (credit.attribution, credit.license) == told
        assert (credit.license is None) == own


def test_a_made_up_map_is_not_of_openstreetmap(tmp_path: Path) -> None:
    made_up = MAP.replace('version="0.6"', 'version="0.6" generator="interloc simulate"')
    folder = write_folder(tmp_path / "out", small_result(), scored=True, osm=made_up)
    report = json.loads((folder / "report.json").read_text())
    assert report["osm"]["made_up"] is True
    assert "license" not in report
    page = (folder / "report.html").read_text()
    assert "openstreetmap.org" not in page
    assert "made up by a simulator" in page
    for path in folder.glob("*.geojson"):
        assert "contributors" not in path.read_text()
        assert ("made up" in path.read_text()) == (path.stem not in {"trajectory", "keyframes"})
    write_vector_file(folder, tmp_path / "a.gpkg")
    assert b"contributors" not in (tmp_path / "a.gpkg").read_bytes()


# other programs ------------------------------------------------------------------------------------------------------


def test_gdal_of_the_system_reads_it_without_a_warning(scored: Path, tmp_path: Path) -> None:
    if shutil.which("ogrinfo") is None:
        pytest.skip("ogrinfo (Debian: gdal-bin) is not installed")
    write_vector_file(scored, tmp_path / "a.gpkg")
    for name in ("a.gpkg", "a.fgb", "a.kml", "a.geojson"):
        write_vector_file(scored, tmp_path / name)
        outcome = subprocess.run(["ogrinfo", "-ro", "-al", tmp_path / name], check=True, capture_output=True, text=True)
        assert "Warning" not in outcome.stdout + outcome.stderr
        assert "outcome (String) = right" in outcome.stdout
        assert (OSM_ATTRIBUTION in outcome.stdout) == (name == "a.gpkg")
    assert (
        "first_time: DateTime"
        in subprocess.run(
            ["ogrinfo", "-ro", "-so", tmp_path / "a.gpkg", "intersections"], check=True, capture_output=True, text=True
        ).stdout
    )


_IN_QGIS = """
import json, os, sys
from qgis.core import QgsApplication, QgsVectorLayer
app = QgsApplication([], False)
app.initQgis()
told = {}
for name in sys.argv[2:]:
    layer = QgsVectorLayer(f"{sys.argv[1]}|layername={name}", name, "ogr")
    about = layer.metadata()
    told[name] = {
        "valid": layer.isValid(), "features": layer.featureCount(), "crs": layer.crs().authid(),
        "title": about.title(), "abstract": about.abstract(), "rights": about.rights(), "licenses": about.licenses(),
        "types": {field.name(): field.typeName() for field in layer.fields()},
    }
print(json.dumps(told), flush=True)
os._exit(0)  # without a word to the layers, which would outlive what they are part of
"""


def test_qgis_reads_layers_fields_and_licence(scored: Path, tmp_path: Path) -> None:
    python = "/usr/bin/python3"
    if subprocess.run([python, "-c", "import qgis.core"], check=False, capture_output=True).returncode:
        pytest.skip("QGIS for Python (Debian: python3-qgis) is not installed")
    write_vector_file(scored, tmp_path / "a.gpkg")
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "QT_QPA_PLATFORM": "offscreen"}
    command = [python, "-c", _IN_QGIS, tmp_path / "a.gpkg", *FILES, *DERIVED]
    outcome = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert outcome.returncode == 0, outcome.stderr
    told = json.loads(outcome.stdout.splitlines()[-1])
    for name, layer in told.items():
        assert (layer["valid"], layer["crs"], layer["features"] > 0) == (True, "EPSG:4326", True)
        assert (layer["title"], layer["abstract"]) == (EXPORTS[name].title, EXPORTS[name].description)
        assert set(EXPORTS[name].fields) <= set(layer["types"])
    assert told["intersections"]["rights"] == told["osm_roads"]["rights"]
    assert OSM_ATTRIBUTION in told["osm_roads"]["rights"][0]
    assert told["osm_roads"]["licenses"] == [ODBL]
    assert told["trajectory"]["licenses"] == []
    types = told["detections"]["types"]
    assert (types["time"], types["osm_id"], types["error_m"]) == ("DateTime", "Integer64", "Real")


@pytest.mark.parametrize("suffix", [".gpkg", ".fgb", ".kml", ".csv"])
def test_a_full_disk_leaves_nothing_behind(suffix: str, scored: Path, tmp_path: Path) -> None:
    code = (
        "import resource, signal, sys; from pathlib import Path\n"
        "from interloc.output.vector_files import write_vector_file\n"
        "import pyogrio.raw\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))\n"
        "from interloc.errors import OutputError\n"
        "try: write_vector_file(Path(sys.argv[1]), Path(sys.argv[2]))\n"
        "except OutputError as error: sys.exit(7)\n"
    )
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    command = [sys.executable, "-c", code, scored, tmp_path / f"a{suffix}"]
    outcome = subprocess.run(command, check=False, capture_output=True, text=True)
    assert outcome.returncode == 7, outcome.stderr
    assert list(tmp_path.iterdir()) == []
