"""`interloc push`: what is refused before any server is asked (the rest: tests/client)."""

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["-o", "out"], "-o, --overpass, --locate and --near need --run"),
        (["--run", "--osm", "map.osm", "--overpass"], "one of --osm FILE and --overpass"),
        (["--near", "49,8"], "-o, --overpass, --locate and --near need --run"),
        (["--run", "--locate"], "place the drive on a map: give it by --osm FILE or --overpass"),
        (["--run", "--locate", "--overpass"], "Say it by --near LAT,LON"),
        (["--osm", "map.txt"], "is not an OpenStreetMap file by its name"),
        (["--name", "a/b"], "without slashes"),
        (["--server", "localhost:8000"], "expected an address such as http://127.0.0.1:8000"),
        (["--run", "--set", "bev.resolution_m=cats"], "bev.resolution_m"),
    ],
)
def test_wrong_usage(arguments: list[str], says: str, interloc: Callable) -> None:
    outcome = interloc("push", "drive", *arguments)
    assert outcome.code == 2
    assert says in outcome.err


def test_the_token_is_not_shown(interloc: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("INTERLOC_TOKEN", "a b-secret")
    outcome = interloc("push", "--fetch", "9b1e44f00c7a2d53", "-o", tmp_path / "out")
    assert outcome.code == 2
    assert outcome.complaint.startswith("interloc: token: ")
    assert "secret" not in outcome.err
    assert "secret" not in interloc("push", "--help").out
