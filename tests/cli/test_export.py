"""`interloc export`."""

from collections.abc import Callable
from pathlib import Path

import pyogrio


def test_a_result_as_one_file_for_gis(finished: Path, tmp_path: Path, interloc: Callable) -> None:
    told = interloc("export", finished, "-o", tmp_path / "out.gpkg", "--json").json
    assert told["layers"] == ["intersections", "roads", "trajectory", "osm_nodes"]
    assert pyogrio.list_layers(tmp_path / "out.gpkg")[:, 0].tolist() == [*told["layers"], "layer_styles"]
    said = interloc("export", finished, "-o", tmp_path / "matches.kml", "--layer", "matches")
    assert (said.code, said.out.splitlines()[-1].split()) == (0, ["layers", "matches"])
    assert (tmp_path / "matches.kml").read_bytes().startswith(b"<?xml")


def test_complaints_in_one_line(local_result: Path, tmp_path: Path, interloc: Callable) -> None:
    out = local_result
    assert "no georeference. Place it: `interloc locate" in interloc("export", out, "-o", tmp_path / "o.kml").complaint
    outcome = interloc("export", out, "-o", tmp_path / "out.shp")
    assert outcome.code == 2
    assert "unknown format '.shp'" in outcome.complaint
    assert not list(tmp_path.iterdir())
    said = interloc("export", out, "-o", tmp_path / "out.gpkg")
    assert "none: metres in the frame of the first scan. Place it: " in said.out
    assert not said.err
    assert pyogrio.read_info(tmp_path / "out.gpkg", layer="roads")["crs"] in {None, 'LOCAL_CS["Undefined SRS"]'}
