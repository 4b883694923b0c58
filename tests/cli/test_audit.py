"""`interloc audit`."""

import json
from collections.abc import Callable
from pathlib import Path

from tests.output.small import MAP, small_result, write_folder


def test_a_map_of_drives_is_compared_with_openstreetmap(tmp_path: Path, interloc: Callable) -> None:
    (tmp_path / "map.osm").write_text(MAP)
    interloc("merge", write_folder(tmp_path / "a", small_result(), scored=False), "-o", tmp_path / "city")
    arguments = ("audit", tmp_path / "city", "--osm", tmp_path / "map.osm", "-o", tmp_path / "audit")
    told = interloc(*arguments, "--passes", 1, "--json").json
    assert (told["findings"], set(told["by_kind"].values())) == (0, {0})
    assert json.loads((tmp_path / "audit" / "audit.json").read_text())["osm"] == "map.osm"
    assert interloc(*arguments, "--kind", "moved").out.startswith("findings   0 moved")
    assert "is not a map of many drives" in interloc("audit", tmp_path / "a", *arguments[2:]).complaint
