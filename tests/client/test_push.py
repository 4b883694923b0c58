"""A drive on its way to a server: stopped at any point, it goes on; what is wrong with it is said before it is sent."""

import http.server
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.app.processes import ServerProcess, started
from tests.bags import write_bag
from tests.client.conftest import Here, Valve, answer, hang_up
from tests.networks import write_model
from tests.small_drives import lidar_poses, scan_at

API = "/api/v1"
RIGHT = "the-right-one-for-this-server"


def files_on(server: ServerProcess, drive_id: str) -> dict[str, str]:
    """Paths and digests of what a server has of a drive."""
    answer = server.client.get(f"{API}/drives/{drive_id}/files", params={"limit": 10_000}).raise_for_status().json()
    return {file["path"]: file["sha256"] for file in answer["files"]}


def drives_on(server: ServerProcess) -> list[dict[str, Any]]:
    drives: list[dict[str, Any]] = server.client.get(f"{API}/drives").raise_for_status().json()["drives"]
    return drives


def copy_of(drive: Path, folder: Path) -> Path:
    return Path(shutil.copytree(drive, folder))


Narrow = Callable[[str, int], tuple[Any, Any]]


@pytest.fixture
def narrow(tmp_path: Path) -> Iterator[Narrow]:
    """The command line for a server on the way to which so many bundles pass, and the valve that is there."""
    with ExitStack() as stack:

        def way(server: str, bundles: int) -> tuple[Any, Any]:
            valve = stack.enter_context(closing(Valve(server, bundles)))
            return Here(valve.address, tmp_path / "cache"), valve

        yield way


@pytest.fixture(scope="session")
def complete(server: ServerProcess, street: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Paths and digests of the whole street as it arrives, reduced on the way."""
    here = Here(server.address, tmp_path_factory.mktemp("complete") / "cache")
    files = files_on(server, here("push", street, "--json").json["drive_id"])
    return {path: digest for path, digest in files.items() if not path.endswith(".osm")}  # maps of other tests


def test_a_drive_arrives_reduced_and_ready(here: Any, server: ServerProcess, street: Path) -> None:
    pushed = here("push", street, "--name", "arriving", "--json").json
    drive = server.client.get(f"{API}/drives/{pushed['drive_id']}").json()
    assert (drive["name"], drive["state"]) == ("arriving", "ready")
    assert (drive["report"]["scans"], drive["report"]["layout"]) == (40, "semantickitti")
    there = files_on(server, pushed["drive_id"])
    assert sorted(there) == sorted(
        ["calib.txt"] * (street / "calib.txt").exists()
        + ["geo.csv", "poses.txt", "reduced.json", "times.txt"]
        + [f"ground/labels/{frame:06d}.ground" for frame in range(40)]
    )
    assert (pushed["scans"], pushed["scans_sent"], pushed["files_sent"]) == (40, 40, len(there))
    assert pushed["bytes_sent"] == pushed["bytes_there"] < pushed["source_bytes"] / 2


def test_a_drive_is_the_same_however_sent(here: Any, server: ServerProcess, street: Path, tmp_path: Path) -> None:
    """Reduced on the way, as it is, in an archive, or file by file: the service keeps the same bytes."""
    archive = Path(shutil.make_archive(str(tmp_path / "street"), "gztar", street.parent, street.name))
    address = server.client.post(f"{API}/drives", json={"name": street.name}).headers["location"]
    server.client.post(f"{address}/archive", content=archive.read_bytes()).raise_for_status()
    assert server.client.post(f"{address}/commit").raise_for_status().json()["state"] == "ready"
    pushed = here("push", street, "--all-scans", "--json").json["drive_id"]
    single = server.client.post(f"{API}/drives", json={"name": street.name}).headers["location"]
    for path in (path for path in street.rglob("*") if path.is_file()):
        name = path.relative_to(street).as_posix()
        server.client.put(f"{single}/files/{name}", content=path.read_bytes()).raise_for_status()
    assert server.client.post(f"{single}/commit").raise_for_status().json()["state"] == "ready"
    drives = server.log.parent / "data" / "drives"
    first, *others = (
        {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}
        for root in (
            drives / each / "reduced" for each in (address.rpartition("/")[2], single.rpartition("/")[2], pushed)
        )
    )
    assert "reduced.json" in first
    for other in others:
        assert other == first


def test_only_keyframes_are_sent_unless_all_are_asked_for(here: Any, street: Path, tmp_path: Path) -> None:
    dense = copy_of(street, tmp_path / "dense")
    poses = [f"1 0 0 {0.5 * frame:.3f} 0 1 0 0 0 0 1 0" for frame in range(40)]
    (dense / "poses.txt").write_text("\n".join(poses) + "\n")
    (dense / "geo.csv").unlink()
    for label in (dense / "labels").iterdir():  # a straight road without crossings: its place tells nothing
        points = np.fromfile(dense / "velodyne" / f"{label.stem}.bin", np.float32).reshape(-1, 4)
        np.where(np.abs(points[:, 1]) < 5, 40, 72).astype(np.uint32).tofile(label)
    thinned = here("push", dense, "--json").json
    assert (thinned["scans"], thinned["scans_sent"]) == (40, 8)  # every fifth: more than 2 m
    assert here("push", dense, "--all-scans", "--json").json["scans_sent"] == 40
    finer = here("push", dense, "--run", "--set", "keyframes.distance_m=0.9", "--json").json
    assert finer["scans_sent"] == 20
    assert finer["summary"]["keyframes"] == 20


def test_pushed_again_nothing_is_sent(here: Any, street: Path) -> None:
    first, second = (here("push", street, "--name", "twice", "--json").json for _ in range(2))
    assert first["files_sent"] == 44
    assert (second["files_sent"], second["bytes_sent"]) == (0, 0)
    assert second["drive_id"] == first["drive_id"]
    assert "nothing: the server has all of it already" in here("push", street, "--name", "twice").out


def test_a_map_that_comes_later_is_added(here: Any, server: ServerProcess, street: Path) -> None:
    first = here("push", street, "--name", "mapped", "--json").json
    second = here("push", street, "--name", "mapped", "--osm", street / "map.osm", "--json").json
    assert second["drive_id"] == first["drive_id"]
    assert second["files_sent"] == 1
    assert "map.osm" in files_on(server, first["drive_id"])


def test_a_drive_that_changed_since_is_a_new_one(here: Any, street: Path, tmp_path: Path) -> None:
    drive = copy_of(street, tmp_path / "street")
    first = here("push", drive, "--json").json
    path = drive / "labels" / "000003.label"
    np.where(np.arange(path.stat().st_size // 4) < 50, 48, np.fromfile(path, np.uint32)).astype(np.uint32).tofile(path)
    second = here("push", drive, "--json").json
    assert second["drive_id"] != first["drive_id"]


@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_a_push_that_is_stopped_goes_on_where_it_was(
    stop: signal.Signals, narrow: Narrow, server: ServerProcess, street: Path, complete: dict[str, str], tmp_path: Path
) -> None:
    drive = copy_of(street, tmp_path / f"stopped-{stop.name}")
    here, valve = narrow(server.address, 1)
    with here.start("push", drive, "--jobs", "1") as process:
        assert valve.reached.wait(60)
        process.send(stop)
        code, _, err = process.ended()
    assert code != 0
    if stop == signal.SIGINT:
        assert "of 44 files are on the server; the same command sends the rest" in err
    valve.opened.set()
    (begun,) = [each for each in drives_on(server) if each["name"] == drive.name]
    before = files_on(server, begun["id"])
    assert 10 <= len(before) < 44
    pushed = here("push", drive, "--json").json
    assert pushed["drive_id"] == begun["id"]
    assert 0 <= 44 - len(before) - pushed["files_sent"] <= 11  # the bundle on its way may still have arrived
    after = files_on(server, begun["id"])
    assert {path: after[path] for path in before} == before
    assert {path: digest for path, digest in after.items() if path != "reduced.json"} == {
        path: digest for path, digest in complete.items() if path != "reduced.json"
    }


def test_the_server_restarts_in_the_middle(street: Path, tmp_path: Path, narrow: Narrow) -> None:
    drive = copy_of(street, tmp_path / "street")
    data, log = tmp_path / "data", tmp_path / "log"
    with started(data, log, workers=1) as first:
        here, valve = narrow(first.address, 2)
        with here.start("push", drive, "--jobs", "2", "--json") as process:
            assert valve.reached.wait(60)
            first.kill()
            valve.opened.set()
            assert process.is_alive()
            with started(data, log, workers=1, port=int(first.address.rpartition(":")[2])) as second:
                code, out, err = process.ended(120)
                assert code == 0, err
                (ready,) = drives_on(second)
                assert (ready["state"], ready["files"]) == ("ready", 44)
    assert "trying again for up to" in err
    assert ready["id"] in out


def test_a_bad_drive_is_explained_and_not_sent(here: Any, server: ServerProcess, street: Path, tmp_path: Path) -> None:
    drive = copy_of(street, tmp_path / "bad")
    (drive / "labels" / "000004.label").unlink()
    outcome = here("push", drive)
    assert outcome.code == 1
    assert "labels/000004.label: is missing" in outcome.err
    assert not [each for each in drives_on(server) if each["name"] == "bad"]


def test_a_fault_that_shows_while_reading_stops_the_push(
    here: Any, server: ServerProcess, street: Path, tmp_path: Path
) -> None:
    drive = copy_of(street, tmp_path / "nan")
    path = drive / "velodyne" / "000007.bin"  # not among those looked into first
    points = np.fromfile(path, np.float32).reshape(-1, 4)
    points[:, 2] = np.nan
    points.tofile(path)
    outcome = here("push", drive, "--jobs", "1")
    assert outcome.code == 1
    assert "velodyne/000007.bin: point" in outcome.err
    (begun,) = [each for each in drives_on(server) if each["name"] == "nan"]
    assert begun["state"] == "uploading"


def test_a_reduced_drive_is_sent_as_it_is(
    here: Any, server: ServerProcess, street: Path, complete: dict[str, str], tmp_path: Path
) -> None:
    small = tmp_path / "small"
    assert here("convert", "--reduce", street, "-o", small).code == 0
    pushed = here("push", small, "--json").json
    assert files_on(server, pushed["drive_id"]) == complete
    refused = here("push", small, "--all-scans")
    assert refused.code == 2
    assert "is a reduced drive" in refused.err


def test_tokens(street: Path, tmp_path: Path) -> None:
    with started(tmp_path / "data", tmp_path / "log", token=RIGHT, workers=1) as server:
        for variables in ({}, {"INTERLOC_TOKEN": "a-wrong-one-for-this-server"}):
            outcome = Here(server.address, tmp_path / "cache", **variables)("push", street)
            assert outcome.code == 1
            assert "Give a token of this server by INTERLOC_TOKEN or --token" in outcome.err
            assert "wrong-one" not in outcome.err + outcome.out
        here = Here(server.address, tmp_path / "cache", INTERLOC_TOKEN=RIGHT)
        assert here("push", street, "--json").json["files_sent"] == 44


def test_a_map_needs_a_georeference_or_a_place_to_search_before_anything_is_sent(
    here: Any, server: ServerProcess, street: Path, tmp_path: Path
) -> None:
    drive = copy_of(street, tmp_path / "nowhere")
    (drive / "geo.csv").unlink()
    outcome = here("push", drive, "--run", "--osm", street / "map.osm")
    assert outcome.code == 1
    assert "the drive has no georeference" in outcome.err
    assert not [each for each in drives_on(server) if each["name"] == "nowhere"]
    here("push", drive, "--run", "--osm", street / "map.osm", "--near", "49.01,8.43", "--radius", "2")
    (job,) = server.client.get(f"{API}/jobs?name=nowhere").json()["jobs"]  # whether it could be placed or not
    assert job["request"]["georeference"] == "map"
    assert job["request"]["near"] == {"lat_deg": 49.01, "lon_deg": 8.43, "radius_km": 2.0}


def takes_files(faulty: Any, take: Callable[..., None]) -> None:
    """Let the faulty server answer as one that has a drive, but files that are sent in this way."""
    shown = answer(200, {"drives": [], "files": [], "next": None})
    made = answer(201, {"id": "d1", "name": "street", "state": "uploading"})

    def reply(handler: Any) -> None:
        (shown if handler.command == "GET" else made if handler.path.endswith("/drives") else take)(handler)

    faulty.script = [reply]


def test_a_server_that_gives_other_bytes_than_it_got_is_not_trusted(faulty: Any, street: Path, tmp_path: Path) -> None:
    takes_files(faulty, answer(200, {"files": [{"path": "x", "size_bytes": 1, "sha256": "00" * 32}]}))
    outcome = Here(faulty.address, tmp_path / "cache")("push", street)
    assert outcome.code == 1
    assert "but with other content than was sent" in outcome.err


def test_stopping_does_not_wait_for_a_server_that_does_not_answer(faulty: Any, street: Path, tmp_path: Path) -> None:
    asked, over = threading.Event(), threading.Event()

    def hang(handler: http.server.BaseHTTPRequestHandler) -> None:
        asked.set()
        over.wait(60)
        hang_up(handler)

    takes_files(faulty, hang)
    with Here(faulty.address, tmp_path / "cache").start("push", street) as process:
        assert asked.wait(60)
        process.send(signal.SIGINT)
        _, _, err = process.ended(30)
    over.set()
    assert "the same command sends the rest" in err


def test_a_network_labels_what_is_pushed(here: Any, server: ServerProcess, street: Path, tmp_path: Path) -> None:
    unlabelled = tmp_path / "07"
    shutil.copytree(street, unlabelled, ignore=shutil.ignore_patterns("labels", "predictions"))
    model = write_model(tmp_path / "flat", height=32, width=256, road_half_width_m=4.0)
    pushed = here("push", unlabelled, "--model", model, "--json").json
    assert here("push", unlabelled, "--model", model, "--json").json["files_sent"] == 0
    files = files_on(server, pushed["drive_id"])
    assert {path.split("/")[1] for path in files if path.startswith("ground/")} == {"predictions"}
    other = write_model(tmp_path / "wide", height=32, width=256, road_half_width_m=8.0)
    assert here("push", unlabelled, "--model", other, "--json").json["drive_id"] != pushed["drive_id"]


def bag_along(path: Path, poses: np.ndarray) -> Path:
    scans, labels = zip(*(scan_at(pose, (40, 48, 70)) for pose in poses), strict=True)
    times = (1.7e9 + 0.1 * np.arange(12)).tolist()
    return write_bag(path, "bag", scans, times, labels=labels, poses=list(poses))


def test_a_bag_is_reduced_on_the_way_and_tells_what_was_odd(here: Any, server: ServerProcess, tmp_path: Path) -> None:
    """The reduced drive is whole again: only its manifest tells that the odometry jumped."""
    poses = lidar_poses()
    poses[9:, 1, 3] += 60.0
    bag = bag_along(tmp_path / "lost", poses)
    pushed = here("push", bag, "--json")
    assert "the poses of /odom jump" in pushed.err
    assert (pushed.json["name"], pushed.json["scans"]) == ("lost", 9)
    files = files_on(server, pushed.json["drive_id"])
    assert {"poses.txt", "times.txt", "reduced.json"} <= set(files)
    assert not [path for path in files if path.endswith(".bag")]
    shown = server.client.get(f"{API}/drives/{pushed.json['drive_id']}").raise_for_status().json()
    assert "the poses of /odom jump" in str(shown)
