"""Drives and results in object storage, on a real S3 server of this machine."""

import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from interloc import storage
from tests.app.processes import Command
from tests.cli.test_batch import contents
from tests.client.conftest import Faulty, answer
from tests.stores import BUCKET, content_of, keys_below, put, s3  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("s3")


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    """What a command has fetched goes with its process; here that is the test."""
    yield
    storage.clear()


def test_a_drive_in_a_bucket_is_as_the_drive_in_a_folder(
    short_drive: Path, osm: Path, tmp_path: Path, interloc: Callable
) -> None:
    put(short_drive, "drives/short")
    put(osm, "drives/map.osm")
    address, result = f"s3://{BUCKET}/drives/short", f"s3://{BUCKET}/results/short"
    put(short_drive, "drives/größer")
    for each in (address, f"s3://{BUCKET}/drives/größer"):
        assert interloc("info", each, "--json").json["path"] == each
    outcome = interloc("run", address, "-o", result, "--osm", f"s3://{BUCKET}/drives/map.osm")
    assert f"{result}/report.html" in outcome.out
    storage.clear()
    for name in keys_below("results/short"):
        target = tmp_path / "fetched" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content_of(f"results/short/{name}"))
    assert interloc("run", short_drive, "-o", tmp_path / "alone", "--osm", osm).code == 0
    assert contents(tmp_path / "fetched") == contents(tmp_path / "alone")


def test_a_result_replaces_an_older_one_and_nothing_else(short_drive: Path, tmp_path: Path, interloc: Callable) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    put(tmp_path / "notes.txt", "foreign/notes.txt")
    refused = interloc("convert", short_drive, "-o", f"s3://{BUCKET}/foreign")
    assert f"s3://{BUCKET}/foreign is there already" in refused.complaint
    assert keys_below("foreign") == ["notes.txt"]
    place = f"s3://{BUCKET}/copies/short"
    assert interloc("convert", short_drive, "--reduce", "-o", place).code == 0
    put(tmp_path / "notes.txt", "copies/short/notes.txt")
    for path in sorted((short_drive / "velodyne").iterdir())[-2:]:
        path.unlink()
    assert interloc("convert", short_drive, "--reduce", "-o", place, "--quiet").code == 0
    assert "notes.txt" in keys_below("copies/short")
    assert f"{len(list((short_drive / 'velodyne').iterdir()))} scans" in interloc("info", place).out


def test_what_is_written_without_its_score_is_there(osm: Path, short_drive: Path, interloc: Callable) -> None:
    beside = short_drive / "beside.osm"
    beside.write_text(re.sub('lat="(.*?)"', lambda lat: f'lat="{float(lat[1]) + 0.003}"', osm.read_text()))
    said = interloc("run", short_drive, "-o", f"s3://{BUCKET}/unscored", "--osm", beside)
    assert said.code == 1
    assert "unscored was written without the score" in said.err
    assert "run.json" in keys_below("unscored")


def test_a_simulated_drive_is_written_there(interloc: Callable) -> None:
    place = f"s3://{BUCKET}/made"
    outcome = interloc("simulate", "town", "--part", "plain", "-o", place, "--max-scans", 2, "--columns", 90)
    assert f"{place}: 2 scans" in outcome.out
    assert {"map.osm", "poses.txt", "velodyne/000001.bin"} <= set(keys_below("made"))


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("s3://nobody/drive", r"there is no bucket s3://nobody \(404 NoSuchBucket\)"),
        (f"s3://{BUCKET}/nothing", "holds no objects"),
        ("s3://name:password@bucket/drive", "credentials and signatures do not belong"),
        ("ftp://bucket/drive", "is not an address in object storage"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(address: str, said: str, interloc: Callable) -> None:
    complaint = interloc("run", address, "-o", "never").complaint
    assert re.search(said, complaint)
    assert "password" not in complaint


def test_a_server_that_refuses_or_does_not_answer(interloc: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "_TRIES", 0)
    with closing(Faulty()) as server:
        server.script = [answer(403, b"<Error><Code>AccessDenied</Code><Message>Access Denied</Message></Error>")]
        nobody = "http://127.0.0.1:9"
        for address, said in ((server.address, r"no permission \(403"), (nobody, "does not answer as expected")):
            monkeypatch.setenv("AWS_ENDPOINT", address)
            storage._open.cache_clear()
            complaint = interloc("info", f"s3://{BUCKET}/drive").complaint
            assert re.search(said, complaint)
            assert "a-secret" not in complaint
    storage._open.cache_clear()


def test_drives_of_a_prefix_are_a_batch_whose_results_are_as_by_themselves(
    short_drive: Path, interloc: Callable, tmp_path: Path
) -> None:
    for name in ("one", "two"):
        put(short_drive, f"many/{name}/short")
    (tmp_path / "bad.label").write_bytes(b"x")
    put(tmp_path / "bad.label", "many/two/short/labels/000003.label")
    command = (f"s3://{BUCKET}/many", "-o", f"s3://{BUCKET}/batch", "--workers", "2")
    # By itself: the workers of this process may have been forked before the environment knew the server.
    process = Command(("batch", *command, "--json"), os.environ, tmp_path / "told", tmp_path / "err")
    code, told, err = process.ended()
    assert code == 1
    assert "1 of 2 drives failed, the first one two-short: labels/000003.label" in err
    assert [row["drive"] for row in json.loads(told)["drives"]] == [
        f"s3://{BUCKET}/many/{name}/short" for name in ("one", "two")
    ]
    storage.clear()
    assert interloc("run", short_drive, "-o", tmp_path / "alone").code == 0
    names = {f"one-short/{path.name}" for path in (tmp_path / "alone").iterdir()}
    assert names | {"batch.csv", ".batch/one-short.json"} <= set(keys_below("batch"))
    for path in (tmp_path / "alone").glob("*.geojson"):
        assert content_of(f"batch/one-short/{path.name}") == path.read_bytes()
    again = interloc("batch", *command)
    assert "1 drive of 2 done already" in again.err


def test_results_there_are_read_scored_and_exported_and_drives_pushed_on_from_there(
    finished: Path, osm: Path, interloc: Callable, short_drive: Path
) -> None:
    put(finished, "scored/crossing")
    put(short_drive, "short")
    place = f"s3://{BUCKET}/scored/crossing"
    assert interloc("evaluate", place, "--osm", osm, "--policy", "all").code == 0
    assert interloc("export", place, "-o", f"s3://{BUCKET}/exports/found.gpkg").code == 0
    assert interloc("merge", finished, "-o", f"s3://{BUCKET}/city").code == 0
    refused = interloc("export", place, "-o", f"{place}/intersections.geojson").complaint
    assert "is a file of the result" in refused
    assert {"found.gpkg"} == set(keys_below("exports"))
    assert "city.json" in keys_below("city")
    storage.clear()
    compared = interloc("compare", place, finished)
    assert f"only {place}: 0" in compared.out
    assert json.loads(content_of("scored/crossing/report.json"))["policy"] == "all"
    assert "-o" in interloc("label", f"s3://{BUCKET}/short", "--by", "geometry").err
