"""Drives without labels, labelled by a network of the service; and drives in files that only the service reads."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.reduction.reduce import reduce_drive
from tests.app.conftest import Serve, client_of
from tests.app.drives.test_commit import commit, refused, upload
from tests.app.processes import ended
from tests.app.street import write_street
from tests.bags import write_bag
from tests.drives.scans.test_pcd import as_pcd
from tests.las_files import write_mapping
from tests.networks import write_model


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two networks, one of them damaged, and a folder that is none."""
    root = tmp_path_factory.mktemp("models")
    write_model(root / "flat", height=32, width=256, road_half_width_m=5.0)
    write_model(root / "torn", height=32, width=256)
    (root / "torn" / "model.onnx").write_bytes(b"not a graph")
    (root / "notes").mkdir()
    return root


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory, models: Path) -> Iterator[httpx.Client]:
    """One server for all tests of this module."""
    home = tmp_path_factory.mktemp("models-server")
    with client_of(home / "data", workers=2, models=models) as client:
        yield client


@pytest.fixture(scope="module")
def unlabelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A street of 24 scans without labels, to be read only."""
    root = write_street(tmp_path_factory.mktemp("unlabelled") / "07", 24)
    shutil.rmtree(root / "labels")
    return root


def test_a_drive_without_labels_is_labelled(
    client: httpx.Client, unlabelled: Path, models: Path, tmp_path: Path
) -> None:
    drive = upload(client, unlabelled)
    problems = refused(client, drive, options={"labels": "labels"})
    assert any(each["path"] == "labels" and "is missing" in each["message"] for each in problems)
    shown = commit(client, drive, options={"model": "flat", "labels": "auto"})
    assert shown["options"]["model"] == "flat"
    assert shown["report"]["label_folder"] == "network flat"
    assert 0.01 < shown["report"]["road_share"] < 0.9
    job = ended(
        client, client.post("/api/v1/jobs", json={"drive_id": shown["id"], "labels": "predictions"}).json()["id"]
    )
    assert job["state"] == "successful"

    here = tmp_path / "here"  # the same network on this machine keeps the same points
    options = DriveOptions.of(model=models / "flat", name="07")
    manifest = reduce_drive(unlabelled, here, options, keyframes=None)
    summary = client.get(f"/api/v1/jobs/{job['id']}").json()["summary"]
    assert summary["keyframes"] <= len(manifest.frames)
    detections = client.get(f"/api/v1/jobs/{job['id']}/layers/keyframes").json()["features"]
    assert len(detections) == summary["keyframes"]


def test_the_networks_are_listed(client: httpx.Client) -> None:
    found = {each["name"]: each for each in client.get("/api/v1/models").json()["models"]}
    assert set(found) == {"flat", "torn"}
    assert (found["flat"]["height"], found["flat"]["width"], found["flat"]["problem"]) == (32, 256, None)
    assert found["flat"]["size_bytes"] > 500


def test_a_network_that_is_not_there_or_damaged(client: httpx.Client, unlabelled: Path) -> None:
    drive = upload(client, unlabelled)
    answer = client.post(f"{drive}/commit", json={"options": {"model": "salsanext"}})
    assert answer.status_code == 422
    assert "no such network. There are: flat, torn" in answer.json()["detail"]
    for wrong in ("../flat", "a/b", ".hidden", "", "a\nb"):
        assert client.post(f"{drive}/commit", json={"options": {"model": wrong}}).status_code == 422
    problems = refused(client, drive, options={"model": "torn"})
    assert any("model.onnx" in each["path"] + each["message"] for each in problems)


def test_a_server_without_networks(serve: Serve, unlabelled: Path) -> None:
    client = serve()
    assert client.get("/api/v1/models").json() == {"models": []}
    drive = upload(client, unlabelled)
    answer = client.post(f"{drive}/commit", json={"options": {"model": "flat"}})
    assert answer.status_code == 422
    assert "INTERLOC_MODELS" in answer.json()["detail"]


@pytest.mark.parametrize("form", ["bag", "db3", "mcap", "laz"])
def test_bags_and_las_files_are_read_by_the_service(client: httpx.Client, tmp_path: Path, form: str) -> None:
    street = open_drive(write_street(tmp_path / "07", 20))
    folder = tmp_path / "recorded"
    folder.mkdir()
    points = [street.ground_points(index) for index in range(20)]
    if form == "laz":
        write_mapping(street, folder)
    else:
        scans = [np.column_stack([each.xyz, np.zeros(len(each.xyz))]).astype(np.float32) for each in points]
        labels = [np.where(each.is_road, 40, 48).astype(np.uint32) for each in points]
        times = (1.7e9 + 0.1 * np.arange(20)).tolist()
        path = write_bag(folder / "drive", form, scans, times, labels=labels, poses=list(street.T_world_lidar))
        assert path.exists()
    report = commit(client, upload(client, folder))["report"]
    assert report["layout"] == ("las" if form == "laz" else "rosbag")
    if form != "laz":
        assert report["scans"] == 20
        share = sum(each.road_count for each in points) / sum(len(each.xyz) for each in points)
        assert report["road_share"] == pytest.approx(share, abs=0.02)
        assert {each["name"]: each["role"] for each in report["topics"]} == {"/points": "points", "/odom": "poses"}


@pytest.mark.parametrize("poses", ["/etc/passwd", "/etc/hostname"])
def test_the_name_of_a_topic_is_no_path_of_the_server(client: httpx.Client, tmp_path: Path, poses: str) -> None:
    root = as_pcd(write_street(tmp_path / "07", 4), tmp_path / "pcd-street")
    problems = refused(client, upload(client, root), options={"poses": poses})
    assert all("root:" not in each["message"] and poses not in each["path"] for each in problems)
    assert any(".mcap" in each["message"] for each in problems)


def test_poses_among_the_files(client: httpx.Client, tmp_path: Path) -> None:
    root = as_pcd(write_street(tmp_path / "07", 20), tmp_path / "pcd-street")
    (root / "slam").mkdir()
    (root / "poses.txt").rename(root / "slam" / "poses.txt")
    drive = upload(client, root)
    assert any("give poses" in each["message"] for each in refused(client, drive))  # they cannot be computed
    assert commit(client, drive, options={"poses": "slam/poses.txt"})["report"]["poses"] == 20
    np.testing.assert_equal(client.post(f"{drive}/commit", json={"options": {"poses": "../x"}}).status_code, 422)
