"""Other GIS formats say what the GeoJSON says, position for position and property for property."""

import csv
import io
import json
import math
import resource
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import geopandas
import numpy as np
import pandas as pd
import pyarrow.parquet
import pyogrio
import pyproj
import pytest
import shapely

from interloc.errors import ConfigError, GeoreferenceError, OutputError
from interloc.output.credits import ODBL, OSM_ATTRIBUTION
from interloc.output.geojson import write_collection
from interloc.output.layers import LAYERS
from interloc.output.road_files import ROAD_FORMATS
from interloc.output.vector_files import EXPORTS, write_vector_file
from tests.output.small import MAP, small_result, with_roads, write_folder
from tests.output.test_road import gdal

MAIN = ["intersections", "roads", "trajectory", "osm_nodes"]
OTHERS = ["detections", "keyframes", "junctions", "road_surface", "matches", "osm_roads"]
FILES = MAIN + OTHERS
DERIVED = ["branches", "uncertainty"]


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


def test_a_geopackage_holds_the_main_layers_or_all(scored: Path, tmp_path: Path) -> None:
    assert write_vector_file(scored, tmp_path / "a.gpkg") == MAIN
    assert write_vector_file(scored, tmp_path / "a.gpkg", layer="all") == [*FILES, *DERIVED]
    assert pyogrio.list_layers(tmp_path / "a.gpkg")[:, 0].tolist() == [*FILES, *DERIVED, "layer_styles"]
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
    whole = json.loads((scored / f"{layer}.geojson").read_text())
    for each in whole["features"]:
        each.pop("details", None)
    assert json.loads(path.read_text()) == whole


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
        assert_same(properties, row)
        assert shapely.force_2d(geometry).wkt == shapely.geometry.shape(feature["geometry"]).wkt


@pytest.mark.parametrize("name", ["A & B", "]]>", "<img src=x onerror=alert(1)> ]]> &amp; ]]]]>", "<![CDATA[a]]>"])
def test_markup_in_names_of_streets_is_text(name: str, scored: Path, tmp_path: Path) -> None:
    result = shutil.copytree(scored, tmp_path / "result")
    for path in (result / "osm_roads.geojson", result / "intersections.geojson"):
        collection = json.loads(path.read_text())
        for feature in collection["features"]:
            feature["properties"]["name" if "osm_roads" in path.name else "names"] = name
        path.write_text(json.dumps(collection))
    for file in (tmp_path / "a.kml", tmp_path / "a.kmz"):
        write_vector_file(result, file, layer=None if file.suffix == ".kmz" else "osm_roads")
        content = file.read_bytes() if file.suffix == ".kml" else zipfile.ZipFile(file).read("doc.kml")
        assert b"<img" not in content
        texts = [each.text for each in ET.fromstring(content).iter() if "SimpleData" in each.tag]  # noqa: S314 - our own
        assert name in texts


@pytest.mark.parametrize("name", ["a.gpkg", "a.fgb", "a.kml", "a.csv", "a.geojson"])
def test_openstreetmap_is_named_where_its_data_is_inside(name: str, scored: Path, tmp_path: Path) -> None:
    for layer in ("osm_nodes", "matches", "detections", "trajectory", "branches"):
        write_vector_file(scored, tmp_path / name, layer=layer)
        of_map = layer not in {"trajectory", "branches"}  # detections have a verdict, with ids of nodes
        assert (OSM_ATTRIBUTION.encode() in (tmp_path / name).read_bytes()) == of_map


def test_nothing_found_gives_layers_with_their_fields(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "out", small_result(empty=True), scored=False)
    assert write_vector_file(folder, tmp_path / "a.gpkg") == MAIN[:3]
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
    assert pyogrio.list_layers(tmp_path / "a.gpkg")[:, 0].tolist() == ["osm_nodes", "layer_styles"]
    assert [path.name for path in tmp_path.iterdir()] == ["a.gpkg"]


def test_what_cannot_be_is_said(scored: Path, tmp_path: Path) -> None:
    plain = write_folder(tmp_path / "plain", small_result(), scored=False)
    for result, out, layer, said in (
        (scored, "a.shp", None, rf"\.shp.*one of \.gpkg, .*{', '.join(ROAD_FORMATS)}.*by LiDAR is .*road\.tif"),
        (scored, "a.fgb", "streets", r"'streets' is not a layer.*uncertainty, all"),
        (scored, "a.fgb", "osm_buildings", r"no osm_buildings\.geojson. The map .* has no buildings near the drive"),
        (scored, "nowhere/a.fgb", None, "no such file or directory"),
        (tmp_path, "a.fgb", None, r"run\.json is missing"),
        (scored, "a.csv", "all", r"A \.csv file holds one layer"),
        (scored, "a.qgz", "matches", r"leave --layer out"),
        (plain, "a.fgb", "matches", r"no matches\.geojson.*interloc evaluate"),
    ):
        with pytest.raises((ConfigError, OutputError), match=said):
            write_vector_file(result, tmp_path / out, layer=layer)
    detections = (plain / "detections.geojson").read_bytes()
    with pytest.raises(ConfigError, match=r"detections\.geojson is a file of the result .*, and was not touched"):
        write_vector_file(scored, plain / "detections.geojson")
    assert (plain / "detections.geojson").read_bytes() == detections
    local = write_folder(tmp_path / "local", small_result(local=True), scored=False)
    for suffix, title in ((".kml", "KML"), (".pmtiles", "PMTiles")):
        with pytest.raises(GeoreferenceError, match=rf"{title} knows longitude and latitude only.*`interloc locate"):
            write_vector_file(local, tmp_path / f"a{suffix}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["local", "plain"]


def test_branches_and_uncertainty_are_as_large_as_they_say(scored: Path, tmp_path: Path) -> None:
    branches, (ellipse,) = (features(scored, layer, tmp_path) for layer in DERIVED)
    assert [each["properties"]["bearing_deg"] for each in branches] == [0.5, 90.75, 180.5]
    assert [each["properties"]["width_m"] for each in branches] == [6.5, None, 3.25]
    (lon, lat), (_, north) = branches[0]["geometry"]["coordinates"]
    assert (lon, lat) == (8.4205, 49.011)
    assert (north - lat) * 111.2e3 == pytest.approx(20.0, abs=0.05)
    assert ellipse["properties"] == {
        "intersection": 1, "position_std_m": 0.25, "radius_m": 0.6119,
        "semi_major_m": 0.7444, "semi_minor_m": 0.4413, "bearing_deg": 45.0,
    }  # fmt: skip
    ring = shapely.geometry.shape(ellipse["geometry"])
    assert ring.exterior.is_ccw
    assert (ring.bounds[3] - ring.bounds[1]) * 111.2e3 == pytest.approx(2 * 0.6119, abs=0.03)
    assert ring.area * 111.2e3**2 * math.cos(math.radians(lat)) == pytest.approx(math.pi * 0.7445 * 0.4413, rel=0.1)


def test_the_road_seen_lies_in_a_project(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "out", with_roads(small_result()), scored=False)
    archive = zipfile.ZipFile(io.BytesIO(qgz_of(folder, tmp_path)))
    assert archive.read("road.tif") == (folder / "road.tif").read_bytes()
    (folder / "road.tif").unlink()  # as of an older version
    assert zipfile.ZipFile(io.BytesIO(qgz_of(folder, tmp_path))).namelist() == ["project.qgs", "result.gpkg"]


def qgz_of(folder: Path, tmp_path: Path) -> bytes:
    write_vector_file(folder, tmp_path / "a.qgz")
    return (tmp_path / "a.qgz").read_bytes()


def test_csv_is_safe_to_open_in_a_spreadsheet(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "out", small_result(), scored=False)
    content = (folder / "intersections.geojson").read_text()
    (folder / "intersections.geojson").write_text(content.replace('"names":null', '"names":"=1+cmd|\'x\'!A1"'))
    write_vector_file(folder, tmp_path / "a.csv")
    (row,) = csv.DictReader((tmp_path / "a.csv").read_text("utf-8-sig").splitlines())
    assert (row["lon"], row["lat"], row["branch_bearings_deg"]) == ("8.4205", "49.011", "[0.5,90.75,180.5]")
    assert (row["names"], row["osm_id"]) == ("'=1+cmd|'x'!A1", "")
    assert "attribution" not in row
    write_vector_file(folder, tmp_path / "a.csv", layer="uncertainty")
    (row,) = csv.DictReader((tmp_path / "a.csv").read_text("utf-8-sig").splitlines())
    assert shapely.from_wkt(row["wkt"]).geom_type == "Polygon"


def test_kmz_holds_several_layers(scored: Path, tmp_path: Path) -> None:
    assert write_vector_file(scored, tmp_path / "a.kmz", layer="all") == [*FILES, *DERIVED]
    titles = [EXPORTS[layer].title for layer in [*FILES, *DERIVED]]
    assert pyogrio.list_layers(tmp_path / "a.kmz")[:, 0].tolist() == titles
    for layer in [*FILES, *DERIVED]:
        rows, _ = rows_of(tmp_path / "a.kmz", EXPORTS[layer].title)
        assert len(rows) == len(features(scored, layer, tmp_path)) > 0


@pytest.mark.parametrize("layer", ["intersections", "trajectory", "osm_nodes", "uncertainty"])
def test_pmtiles_hold_one_layer_for_web_maps(layer: str, scored: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.pmtiles"
    assert write_vector_file(scored, path, layer=None if layer == "intersections" else layer) == [layer]
    rows, (place, *_) = rows_of(path, layer)
    feature, *others = features(scored, layer, tmp_path)
    assert len(rows) >= 1 + len(others)  # what lies on two tiles counts twice
    told = pyogrio.read_info(path)["dataset_metadata"]
    assert (told["name"], told["minzoom"], told["maxzoom"]) == ("straße & <b>Co</b>", "0", "15")
    assert (OSM_ATTRIBUTION in told["description"]) == (layer in {"intersections", "osm_nodes"})
    if layer == "intersections":
        assert_same({name: value for name, value in feature["properties"].items() if value is not None}, rows[0])
        to_web = pyproj.Transformer.from_crs(4326, 3857, always_xy=True)
        expected = to_web.transform(*feature["geometry"]["coordinates"])
        (place,) = shapely.get_parts(place)
        assert np.hypot(place.x - expected[0], place.y - expected[1]) < 0.15
    bare = write_folder(tmp_path / "out", small_result(empty=True), scored=False)
    with pytest.raises(ConfigError, match=r"has no detections; PMTiles needs at least one"):
        write_vector_file(bare, path, layer="detections")


def test_geoparquet_holds_one_layer(scored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for layer in ("detections", "osm_roads", "uncertainty"):
        write_vector_file(scored, tmp_path / "a.parquet", layer=layer)
        table = geopandas.read_parquet(tmp_path / "a.parquet")
        assert table.crs == "EPSG:4326"
        rows = table.drop(columns="geometry").to_dict("records")
        for feature, row, place in zip(features(scored, layer, tmp_path), rows, table.geometry, strict=True):
            assert_same(feature["properties"], {name: None if each is pd.NA else each for name, each in row.items()})
            assert shapely.equals_exact(place, shapely.geometry.shape(feature["geometry"]), 0)
        told = pyarrow.parquet.read_schema(tmp_path / "a.parquet").metadata
        assert (told.get(b"license") == ODBL.encode()) == (layer != "uncertainty")
        assert told[b"description"].decode() == EXPORTS[layer].description
    local = write_folder(tmp_path / "local", small_result(local=True), scored=False)
    write_vector_file(local, tmp_path / "a.parquet")
    assert geopandas.read_parquet(tmp_path / "a.parquet").crs is None
    assert pyarrow.types.is_large_string(pyarrow.parquet.read_schema(tmp_path / "a.parquet").field("reason").type)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match=r"pip install \"pyarrow>="):
        write_vector_file(scored, tmp_path / "b.parquet")


def test_what_crosses_the_antimeridian_is_cut_in_every_format(scored: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shutil.copytree(scored, folder)
    road, *_ = features_of(scored / "osm_roads.geojson")
    road["geometry"]["coordinates"] = [[179.999, -16.5], [-179.999, -16.5]]
    write_collection(folder / "osm_roads.geojson", [road], local=False)
    expected = "MULTILINESTRING ((179.999 -16.5, 180 -16.5), (-180 -16.5, -179.999 -16.5))"
    for name, title in (("a.gpkg", "osm_roads"), ("a.fgb", "osm_roads"), ("a.kml", EXPORTS["osm_roads"].title)):
        write_vector_file(folder, tmp_path / name, layer="osm_roads")
        _, (line,) = rows_of(tmp_path / name, title)
        assert shapely.force_2d(line).wkt == expected
    (feature,) = features(folder, "osm_roads", tmp_path)
    assert shapely.geometry.shape(feature["geometry"]).wkt == expected
    write_vector_file(folder, tmp_path / "a.csv", layer="osm_roads")
    (row,) = csv.DictReader((tmp_path / "a.csv").read_text("utf-8-sig").splitlines())
    assert shapely.from_wkt(row["wkt"]).wkt == expected
    write_vector_file(folder, tmp_path / "a.pmtiles", layer="osm_roads")
    lines, lengths = rows_of(tmp_path / "a.pmtiles", "osm_roads")
    assert len(lines) == 2  # one on each side of the world
    # and a little over the edge
    assert sum(each.length for each in lengths) == pytest.approx(0.002 * 111319.5, rel=0.5)


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result of a job that was scored against a made-up map. Shared: do not change it."""
    text = MAP.replace('version="0.6"', 'version="0.6" generator="interloc simulate"')
    made = replace(small_result(), run=small_result().run | {"job": "9b1e", "labels": "predictions"})
    return write_folder(tmp_path_factory.mktemp("made_up") / "out", made, scored=True, osm=text)


def test_a_made_up_map_is_not_of_openstreetmap(made_up: Path, tmp_path: Path) -> None:
    report = json.loads((made_up / "report.json").read_text())
    assert report["osm"]["made_up"] is True
    assert "license" not in report
    page = (made_up / "report.html").read_text()
    assert "openstreetmap.org" not in page
    assert "made up by a simulator" in page
    for path in made_up.glob("*.geojson"):
        assert "contributors" not in path.read_text()
        assert ("made up" in path.read_text()) == (
            path.stem not in {"trajectory", "keyframes", "roads", "junctions", "road_surface"}
        )
    with zipfile.ZipFile(io.BytesIO(qgz_of(made_up, tmp_path))) as archive:
        project = archive.read("project.qgs")
        assert b"contributors" not in archive.read("result.gpkg")
    assert b"made up by a simulator" in project
    assert b"contributors" not in project


def test_files_say_of_which_result_they_are(made_up: Path, tmp_path: Path) -> None:
    own = {"drive": "07", "job": "9b1e", "preset": "paper", "labels": "predictions"}
    for path in made_up.glob("*.geojson"):
        assert own.items() <= json.loads(path.read_text()).items(), path
    for name in ("a.geojson", "a.gpkg", "a.fgb", "a.kml", "a.parquet"):
        write_vector_file(made_up, tmp_path / name)
        assert b"9b1e" in (tmp_path / name).read_bytes(), name


# other programs ------------------------------------------------------------------------------------------------------


def test_gdal_of_the_system_reads_it_without_a_warning(scored: Path, tmp_path: Path) -> None:
    if shutil.which("ogrinfo") is None:
        pytest.skip("ogrinfo (Debian: gdal-bin) is not installed")
    for name in ("a.gpkg", "a.fgb", "a.kml", "a.geojson"):
        write_vector_file(scored, tmp_path / name)
        outcome = subprocess.run(["ogrinfo", "-ro", "-al", tmp_path / name], check=True, capture_output=True, text=True)
        assert "Warning" not in outcome.stdout + outcome.stderr
        assert "outcome (String) = right" in outcome.stdout
        assert (OSM_ATTRIBUTION in outcome.stdout) == (name == "a.gpkg")
    assert "first_time: DateTime" in gdal("ogrinfo", "-ro", "-so", tmp_path / "a.gpkg", "intersections")


def test_a_full_disk_leaves_nothing_behind(scored: Path, tmp_path: Path) -> None:
    code = (
        "import resource, signal, sys; from pathlib import Path\n"
        "from interloc.output.vector_files import write_vector_file\n"
        "import pyogrio.raw\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))\n"
        "from interloc.errors import OutputError\n"
        "for name in sys.argv[2:]:\n"
        "    try: write_vector_file(Path(sys.argv[1]), Path(name))\n"
        "    except OutputError: print('refused')\n"
    )
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    names = [tmp_path / f"a{suffix}" for suffix in (".gpkg", ".fgb", ".kml", ".kmz", ".csv", ".pmtiles")]
    command = [sys.executable, "-c", code, scored, *names]
    outcome = subprocess.run(command, check=False, capture_output=True, text=True)
    assert outcome.stdout.split() == ["refused"] * len(names), outcome.stderr
    assert list(tmp_path.iterdir()) == []
