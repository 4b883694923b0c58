"""Other GIS formats say what the GeoJSON says, position for position and property for property."""

import json
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyogrio
import pytest
import shapely

from interloc.errors import ConfigError, GeoreferenceError, OutputError
from interloc.evaluation.coverage import track_bounds
from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.osm.reader import read_osm
from interloc.output.layers import LAYERS, OSM_ATTRIBUTION
from interloc.output.osm_roads import write_roads
from interloc.output.vector_files import write_vector_file
from interloc.output.write import write_results
from interloc.results import DriveResult
from tests.output.small import small_result

SCORED = ["intersections", "detections", "trajectory", "keyframes", "osm_nodes", "matches", "osm_roads"]

MAP = """<osm version="0.6"><bounds minlat="49.0" minlon="8.41" maxlat="49.03" maxlon="8.44"/>
<node id="9000000001" lat="49.0110001" lon="8.4205001"/><node id="2" lat="49.012" lon="8.4205"/>
<node id="3" lat="49.011" lon="8.422"/><node id="4" lat="49.011" lon="8.419"/>
<way id="10"><nd ref="4"/><nd ref="9000000001"/><nd ref="3"/><tag k="highway" v="residential"/></way>
<way id="11"><nd ref="9000000001"/><nd ref="2"/><tag k="highway" v="tertiary"/>
<tag k="name" v="Straße &amp; Weg"/></way>
</osm>"""


def write_folder(folder: Path, result: DriveResult, *, scored: bool) -> Path:
    write_results(result, folder)
    if scored:
        (folder.parent / "map.osm").write_text(MAP)
        graph = read_osm(folder.parent / "map.osm")
        write_report(evaluate(result, graph), folder)
        write_roads(graph, track_bounds(result.keyframes.lonlat), folder)
    return folder


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder with an evaluation. Shared: do not change it."""
    return write_folder(
        tmp_path_factory.mktemp("scored") / "out", replace(small_result(), drive="straße & Co"), scored=True
    )


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
        else:
            assert got == value, name


def test_a_geopackage_holds_all_layers_of_the_result(scored: Path, tmp_path: Path) -> None:
    assert write_vector_file(scored, tmp_path / "a.gpkg") == SCORED
    assert pyogrio.list_layers(tmp_path / "a.gpkg")[:, 0].tolist() == SCORED
    for layer in SCORED:
        assert pyogrio.read_info(tmp_path / "a.gpkg", layer=layer)["crs"] == "EPSG:4326"
        rows, geometries = rows_of(tmp_path / "a.gpkg", layer)
        features = features_of(scored / f"{layer}.geojson")
        assert len(rows) == len(features) > 0
        for feature, row, geometry in zip(features, rows, geometries, strict=True):
            assert set(row) == set(feature["properties"]) == set(LAYERS[layer].fields)
            assert_same(feature["properties"], row)
            assert shapely.equals_exact(geometry, shapely.geometry.shape(feature["geometry"]), 0)


@pytest.mark.parametrize("layer", SCORED)
def test_flatgeobuf_holds_one_layer(layer: str, scored: Path, tmp_path: Path) -> None:
    assert write_vector_file(scored, tmp_path / "a.fgb", layer=layer) == [layer]
    rows, geometries = rows_of(tmp_path / "a.fgb", layer)
    written = {g.wkt: row for row, g in zip(rows, geometries, strict=True)}  # sorted for its spatial index
    for feature in features_of(scored / f"{layer}.geojson"):
        assert_same(feature["properties"], written[shapely.geometry.shape(feature["geometry"]).wkt])


@pytest.mark.parametrize("layer", SCORED)
def test_kml_names_its_features_and_keeps_their_properties(layer: str, scored: Path, tmp_path: Path) -> None:
    write_vector_file(scored, tmp_path / "a.kml", layer=layer)
    rows, geometries = rows_of(tmp_path / "a.kml", LAYERS[layer].title)
    features = features_of(scored / f"{layer}.geojson")
    for feature, row, geometry in zip(features, rows, geometries, strict=True):
        properties = dict(feature["properties"])
        assert row["Name"] == LAYERS[layer].label.format(**properties)
        for name, there in (("id", "number"), ("name", "street")):
            if name in properties:
                properties[there] = properties.pop(name)
        if "osm_id" in properties:
            properties["osm_id"] = str(properties["osm_id"])
        assert_same(properties, row)
        assert shapely.force_2d(geometry).wkt == shapely.geometry.shape(feature["geometry"]).wkt


@pytest.mark.parametrize("name", ["a.gpkg", "a.fgb", "a.kml"])
def test_openstreetmap_is_named_where_its_data_is_inside(name: str, scored: Path, tmp_path: Path) -> None:
    for layer in ("osm_nodes", "matches", "detections"):
        write_vector_file(scored, tmp_path / name, layer=layer)
        assert (OSM_ATTRIBUTION.encode() in (tmp_path / name).read_bytes()) == (layer != "detections")


def test_nothing_found_gives_layers_with_their_fields(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "out", small_result(empty=True), scored=False)
    assert write_vector_file(folder, tmp_path / "a.gpkg") == ["intersections", "detections", "trajectory", "keyframes"]
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
    with pytest.raises(ConfigError, match=r"\.shp.*Expected one of \.gpkg, \.fgb, \.kml"):
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


@pytest.mark.parametrize("suffix", [".gpkg", ".fgb", ".kml"])
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
