"""Commit: a drive that was uploaded gives the very results that the command line gives on its folder."""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from app.jobs import executors
from interloc.cli.main import run
from interloc.config import KeyframeConfig
from interloc.reduction.reduce import reduce_drive
from tests.app import processes
from tests.app.conftest import client_of
from tests.app.processes import as_by_command, ended, suspended, wait_until, workers_of
from tests.app.street import write_street

RESULTS = ("detections", "keyframes", "intersections", "trajectory")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("commit")


@pytest.fixture(scope="module")
def client(home: Path) -> Iterator[httpx.Client]:
    """One server for all tests of this module; all its workers run from the start, so that tests can suspend them."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(executors, "compile_kernels", int)
        with client_of(home / "data", workers=2) as client:
            yield client


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A street of 40 scans with labels and predictions, to be read only."""
    root = write_street(tmp_path_factory.mktemp("street") / "07", 40)
    (root / "predictions").mkdir()
    for file in (root / "labels").iterdir():
        labels = np.fromfile(file, "<u4")
        labels[::7] = 48  # a network that takes some road for sidewalk
        labels.tofile(root / "predictions" / file.name)
    return root


@pytest.fixture
def drive(street: Path, tmp_path: Path) -> Path:
    """The street, to be damaged."""
    shutil.copytree(street, tmp_path / "07")
    return tmp_path / "07"


def upload(client: httpx.Client, root: Path, **new: Any) -> str:
    """Make a drive and send all files of a folder."""
    drive = str(client.post("/api/v1/drives", json={"name": root.name, **new}).headers["location"])
    files = [(file.relative_to(root).as_posix(), file.read_bytes()) for file in root.rglob("*") if file.is_file()]
    answer = client.post(f"{drive}/scans", files=[("files", file) for file in files])
    assert answer.status_code == 200, answer.text
    return drive


def commit(client: httpx.Client, drive: str, **options: Any) -> dict[str, Any]:
    answer = client.post(f"{drive}/commit", json=options)
    assert answer.status_code == 200, answer.text
    shown: dict[str, Any] = answer.json()
    assert shown["state"] == "ready"
    return shown


def refused(client: httpx.Client, drive: str, **options: Any) -> list[dict[str, str]]:
    """Commit a drive that is not; return its errors."""
    answer = client.post(f"{drive}/commit", json=options)
    assert answer.status_code == 422, answer.text
    problem = answer.json()
    assert problem["title"] == "Drive not usable"
    assert problem["report"]["ok"] is False
    assert "/drives/" not in json.dumps({**problem, "instance": None})  # no path of the server
    shown = client.get(drive).json()
    assert shown["state"] == "uploading"
    assert shown["report"]["problems"] == problem["problems"]
    return [each for each in problem["problems"] if each["severity"] == "error"]


def results(client: httpx.Client, drive: str, **job: Any) -> dict[str, str]:
    """Run a job to its end; return the tables of its result, as text."""
    answer = client.post("/api/v1/jobs", json={"drive_id": drive.rsplit("/", maxsplit=1)[-1], **job})
    assert answer.status_code == 202, answer.text
    address = answer.headers["location"]
    shown = ended(client, answer.json()["id"])
    assert shown["state"] == "successful", shown["error"]
    tables = {}
    for table in RESULTS:
        files = (client.get(f"{address}/files/{table}.{ending}") for ending in ("geojson", "local.json"))
        tables[table] = next(as_by_command(file).decode() for file in files if file.status_code == 200)
    return tables


def by_command_line(root: Path, out: Path, *options: object) -> dict[str, str]:
    """Return what `interloc run` writes for a folder."""
    assert run([str(part) for part in ("run", root, "-o", out, "--quiet", *options)]) == 0
    return {
        table: next(
            path for ending in ("geojson", "local.json") if (path := out / f"{table}.{ending}").is_file()
        ).read_text()
        for table in RESULTS
    }


@pytest.fixture(scope="module")
def expected(street: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    out = tmp_path_factory.mktemp("expected")
    return {labels: by_command_line(street, out / labels, "--labels", labels) for labels in ("labels", "predictions")}


def files_below(home: Path, drive: str) -> list[str]:
    root = home / "data" / "drives" / drive.rsplit("/", maxsplit=1)[-1]
    names = (path.relative_to(root).as_posix() for path in processes.files_below(root))
    return sorted(name for name in names if "drive.json" not in name)


def test_results_are_those_of_the_command_line(
    client: httpx.Client, street: Path, expected: dict[str, dict[str, str]]
) -> None:
    drive = upload(client, street)
    shown = commit(client, drive)
    assert (shown["report"]["layout"], shown["report"]["scans"], shown["files"]) == ("semantickitti", 40, 124)
    assert shown["report"]["path"] == "07"
    for labels, theirs in expected.items():
        ours = results(client, drive, labels=labels)
        assert len(json.loads(ours["intersections"])["features"]) >= 1
        assert ours == theirs
    assert line_of(client.get(f"{drive}/trajectory").text) == line_of(ours["trajectory"])


def line_of(trajectory: str) -> Any:
    """Return the line of a layer; that of a drive is of no job."""
    return json.loads(trajectory)["features"][0]["geometry"]


def test_an_upload_that_is_reduced(
    client: httpx.Client, street: Path, expected: dict[str, dict[str, str]], home: Path, tmp_path: Path
) -> None:
    reduce_drive(street, tmp_path / "07", keyframes=KeyframeConfig())
    drive = upload(client, tmp_path / "07")
    shown = commit(client, drive)
    assert shown["report"]["reduced"]["kept_scans"] == 40
    for labels, theirs in expected.items():
        assert results(client, drive, labels=labels) == theirs
    wait_until(lambda: not any(name.startswith("files/") for name in files_below(home, drive)), "the raw files to go")
    sent = {path.relative_to(tmp_path / "07").as_posix() for path in (tmp_path / "07").rglob("*") if path.is_file()}
    assert {f"reduced/{name}" for name in sent} == set(files_below(home, drive)) - {"trajectory.geojson"}
    name = "ground/labels/000000.ground"
    assert client.get(f"{drive}/files/{name}").content == (tmp_path / "07" / name).read_bytes()


def test_raw_scans_go_maps_stay(client: httpx.Client, drive: Path, home: Path) -> None:
    (drive / "image_2").mkdir()
    (drive / "image_2" / "000000.png").write_bytes(b"1")
    (drive / "README.md").write_text("hello")
    address = upload(client, drive)
    before = client.get(address).json()
    shown = commit(client, address)
    wait_until(
        lambda: [name for name in files_below(home, address) if name.startswith("files/")] == ["files/map.osm"],
        "the raw files to go",
    )
    assert (shown["files"], shown["size_bytes"]) == (before["files"], before["size_bytes"])
    assert shown["stored_bytes"] < shown["size_bytes"] / 2
    root = home / "data" / "drives" / shown["id"]
    stored = sum((root / name).stat().st_size for name in files_below(home, address) if "trajectory" not in name)
    assert shown["stored_bytes"] == stored
    gone = client.get(f"{address}/files/velodyne/000000.bin")
    assert (gone.status_code, gone.json()["title"]) == (410, "File not kept")
    assert client.get(f"{address}/files/poses.txt").content == (drive / "poses.txt").read_bytes()
    assert len(client.get(f"{address}/files").json()["files"]) == before["files"]


def test_what_a_part_was_cut_to_is_not_what_was_sent(client: httpx.Client, drive: Path) -> None:
    address = upload(client, drive)
    commit(client, address, options={"frames": "5:25"})
    wait_until(lambda: client.get(f"{address}/files/poses.txt").status_code == 410, "the raw files to go")


def test_raw_scans_are_kept_on_request(client: httpx.Client, drive: Path, home: Path) -> None:
    address = upload(client, drive, keep_raw=True)
    shown = commit(client, address)
    assert shown["keep_raw"]
    sent = {f"files/{path.relative_to(drive).as_posix()}" for path in drive.rglob("*") if path.is_file()}
    assert {name for name in files_below(home, address) if name.startswith("files/")} == sent
    assert shown["stored_bytes"] > shown["size_bytes"]


def test_every_problem_is_told_with_its_path(client: httpx.Client, drive: Path) -> None:
    (drive / "velodyne/000003.bin").write_bytes(b"123")
    (drive / "labels/000004.label").unlink()
    (drive / "predictions/000005.label").write_bytes(bytes(40))
    (drive / "poses.txt").write_text("1 0 0\n")
    address = upload(client, drive)
    paths = {error["path"] for error in refused(client, address)}
    assert paths == {"velodyne/000003.bin", "labels/000004.label", "predictions/000005.label", "poses.txt"}


def test_a_drive_is_mended_and_committed_again(client: httpx.Client, street: Path, drive: Path) -> None:
    (drive / "labels/000004.label").unlink()
    address = upload(client, drive)
    (error,) = refused(client, address)
    assert error["path"] == "labels/000004.label"
    label = (street / "labels/000004.label").read_bytes()
    assert client.put(f"{address}/files/labels/000004.label", content=label).status_code == 201
    assert commit(client, address)["report"]["scans"] == 40


def test_points_that_only_the_reduction_sees(client: httpx.Client, drive: Path) -> None:
    """A scan between those that the check looks into."""
    for number in (7, 8):
        points = np.fromfile(drive / f"velodyne/{number:06d}.bin", "<f4").reshape(-1, 4)
        points[:, 2] = np.nan
        points.tofile(drive / f"velodyne/{number:06d}.bin")
    errors = refused(client, upload(client, drive))
    assert {error["path"] for error in errors} == {"velodyne/000007.bin", "velodyne/000008.bin"}
    assert "not finite" in errors[0]["message"]


def test_a_manifest_cannot_reach_out_of_its_drive(client: httpx.Client, street: Path, tmp_path: Path) -> None:
    reduce_drive(street, tmp_path / "07", keyframes=KeyframeConfig())
    path = tmp_path / "07/reduced.json"
    content = json.loads(path.read_text())
    content["files"]["poses"] = "../../../interloc.sqlite3"
    path.write_text(json.dumps(content))
    (error,) = refused(client, upload(client, tmp_path / "07"))
    assert error["path"] == "reduced.json"


def test_wrong_options_are_told(client: httpx.Client, street: Path) -> None:
    address = upload(client, street)
    assert client.post(f"{address}/commit", json={"options": {"layout": "nonsense"}}).status_code == 422
    assert client.post(f"{address}/commit", json={"options": {"oxts": "../07.txt"}}).status_code == 422
    (error,) = refused(client, address, options={"layout": "kitti_raw"})
    assert "is not of layout kitti_raw" in error["message"]
    errors = refused(client, address, options={"layout": "auto", "oxts": "nowhere.txt"})
    assert {error["path"] for error in errors} == {"nowhere.txt"}
    assert client.get(address).json()["options"]["layout"] == "auto"
    commit(client, address, options={"oxts": None})


def test_commit_twice_is_commit_once(client: httpx.Client, street: Path) -> None:
    address = upload(client, street)
    first = client.post(f"{address}/commit", headers={"Prefer": "respond-async"})
    assert first.status_code == 202
    assert (first.headers["location"], first.json()["state"]) == (address, "checking")
    put = client.put(f"{address}/files/poses.txt", content=b"1")
    assert put.status_code == 409
    assert put.json()["title"] in {"Drive is being checked", "Drive is closed"}
    second = client.post(f"{address}/commit")
    assert (second.status_code, second.json()["state"]) == (200, "ready")
    third = client.post(f"{address}/commit")
    assert third.json() == second.json()
    same = {"options": third.json()["options"], "keep_raw": False}
    assert client.post(f"{address}/commit", json=same).json() == second.json()
    other = {"options": {"label_scheme": "learning", "pose_frame": "auto"}, "keep_raw": True}
    refused_ = client.post(f"{address}/commit", json=other)
    assert (refused_.status_code, refused_.json()["title"]) == (409, "Drive is closed")
    assert "options: label_scheme is 'auto', not 'learning'; keep_raw is False, not True." in refused_.json()["detail"]
    jobs = client.get("/api/v1/jobs", params={"drive": second.json()["id"], "kind": "commit"}).json()["jobs"]
    assert len(jobs) == 1


def test_a_ready_drive_takes_maps_only(client: httpx.Client, street: Path) -> None:
    address = upload(client, street)
    commit(client, address)
    for name in ("velodyne/000000.bin", "poses.txt", "notes.txt"):
        answer = client.put(f"{address}/files/{name}", content=b"1")
        assert (answer.status_code, answer.json()["title"]) == (409, "Drive is closed")
    assert client.post(f"{address}/scans", files={"files": ("poses.txt", b"1")}).status_code == 409
    assert client.post(f"{address}/archive", content=b"PK\x05\x06" + bytes(18)).status_code == 409
    assert client.delete(f"{address}/files/poses.txt").status_code == 409
    before = client.get(address).json()
    client.put(f"{address}/files/city/new.osm", content=b"<osm/>").raise_for_status()
    client.post(f"{address}/scans", files={"files": ("city/new.osm", b"<osm />")}).raise_for_status()
    assert client.delete(f"{address}/files/city/new.osm").status_code == 204
    assert client.get(address).json() == before
    other = (street / "map.osm").read_bytes()
    for name in ("map.osm", "other.osm"):
        assert client.put(f"{address}/files/{name}", content=other).status_code in {200, 201}
        assert client.get(f"{address}/files/{name}").content == other
    run_ = results(client, address, osm={"file": "other.osm"})
    assert len(json.loads(run_["intersections"])["features"]) >= 1


def test_the_trajectory_needs_a_commit(client: httpx.Client) -> None:
    drive = client.post("/api/v1/drives", json={"name": "a/b"}).headers["location"]
    assert client.get(f"{drive}/trajectory").status_code == 409
    assert client.get("/api/v1/drives/0123456789abcdef/trajectory").status_code == 404
    assert client.post("/api/v1/drives/0123456789abcdef/commit").status_code == 404


def test_a_check_under_way_is_joined_only_by_who_asks_for_the_same(client: httpx.Client, street: Path) -> None:
    def says(**other: Any) -> str:
        answer = client.post(f"{address}/commit", json=other)
        assert (answer.status_code, answer.json()["title"]) == (409, "Drive is being checked")
        return str(answer.json()["detail"])

    address = upload(client, street)
    at_once = {"Prefer": "wait=0"}
    with suspended(workers_of(os.getpid())):
        assert client.post(f"{address}/commit", headers=at_once).status_code == 202
        assert client.post(f"{address}/commit", headers=at_once).status_code == 202
        assert "pose_frame is 'auto', not 'lidar'. Send this" in says(options={"pose_frame": "lidar"})
        assert "keep_raw is False, not True" in says(keep_raw=True)
    commit(client, address)


def test_a_drive_that_is_deleted_while_it_is_checked(client: httpx.Client, street: Path, home: Path) -> None:
    address = upload(client, street)
    assert client.post(f"{address}/commit", headers={"Prefer": "wait=0"}).status_code == 202
    assert client.delete(f"{address}?purge=true").status_code == 204
    assert client.get(address).status_code == 404
    assert client.post(f"{address}/commit").status_code == 404
    wait_until(lambda: not files_below(home, address), "all files to go")
