"""`interloc merge` and `interloc audit`."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.output.small import MAP, small_result, write_folder


def test_drives_become_one_map_that_grows(tmp_path: Path, interloc: Callable) -> None:
    result = small_result()
    for name, confidence in (("a", 0.7), ("b", 0.8), ("c", 0.9)):
        sure = replace(result.intersections, confidence=np.array([confidence]))
        write_folder(tmp_path / name, replace(result, intersections=sure), scored=False)
    city = tmp_path / "city"
    told = interloc("merge", f"monday={tmp_path / 'a'}", f"tuesday={tmp_path / 'b'}", "-o", city, "--json").json
    assert (told["intersections"], told["seen_by_several"], told["added"]) == (1, 1, ["monday", "tuesday"])
    told = interloc("merge", tmp_path / "c", "-o", city, "--json").json
    assert [each["drive"] for each in told["drives"]] == ["07", "monday", "tuesday"]
    again = interloc("merge", tmp_path / "a", "-o", city)
    assert "07 is on the map already, as monday" in again.out
    assert interloc("merge", "--remove", "monday", "-o", city, "--json").json["added"] == []
    (place,) = json.loads((city / "city.geojson").read_text())["features"]
    assert place["properties"]["drive_names"] == "07, tuesday"


def test_what_cannot_be_merged_is_refused_and_the_map_stays(tmp_path: Path, interloc: Callable) -> None:
    one = write_folder(tmp_path / "one", small_result(), scored=False)
    other = write_folder(tmp_path / "other", small_result(empty=True), scored=False)
    local = write_folder(tmp_path / "local", small_result(local=True), scored=False)
    city = tmp_path / "city"
    interloc("merge", one, "-o", city)
    before = {path.name: path.read_bytes() for path in city.iterdir() if path.is_file()}
    clash = interloc("merge", other, "-o", city)
    assert clash.code == 2
    assert "drive '07' is on the map" in clash.err
    assert "--replace" in clash.err
    assert "07: it has no georeference" in interloc("merge", local, "-o", city).err
    assert "give one or more result folders" in interloc("merge", "-o", city).err
    assert "'x' is not on the map" in interloc("merge", "--remove", "x", "-o", city).err
    assert {path.name: path.read_bytes() for path in city.iterdir() if path.is_file()} == before
    assert interloc("merge", other, "--replace", "-o", city, "--json").json["intersections"] == 0


def test_a_map_of_drives_is_compared_with_openstreetmap(tmp_path: Path, interloc: Callable) -> None:
    (tmp_path / "map.osm").write_text(MAP)
    interloc("merge", write_folder(tmp_path / "a", small_result(), scored=False), "-o", tmp_path / "city")
    arguments = ("audit", tmp_path / "city", "--osm", tmp_path / "map.osm", "-o", tmp_path / "audit")
    told = interloc(*arguments, "--passes", 1, "--json").json
    assert (told["findings"], set(told["by_kind"].values())) == (0, {0})
    assert json.loads((tmp_path / "audit" / "audit.json").read_text())["osm"] == "map.osm"
    assert interloc(*arguments, "--kind", "moved").out.startswith("findings   0 moved")
    assert "is not a map of many drives" in interloc("audit", tmp_path / "a", *arguments[2:]).complaint
