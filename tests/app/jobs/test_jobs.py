"""Jobs over HTTP, from submission to results; also those that place a drive without GNSS on the map."""

import gzip
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.jobs import executors, processes
from app.jobs.processes import memory_of
from app.settings import Settings
from app.store.models import Drive, Job
from app.store.tokens import add_token
from interloc.cli.main import run
from tests.app.conftest import Serve, bearer, client_of, database_of
from tests.app.jobs.test_executors import NothingStarts, executing, pid_of
from tests.app.processes import (
    API,
    Gate,
    archive_of,
    assert_as_by_command,
    ended,
    every,
    half_way,
    job_of,
    submit,
    upload,
    wait_until,
)
from tests.app.street import write_street
from tests.localization.town import LAT_DEG, LON_DEG, MadeDrive, write_town_drive, write_town_map
from tests.osm.test_overpass import Town, town

__all__ = ["town"]

SCANS = 40
MIDDLE = 25
BY_MAP = {"georeference": "map", "osm": {"file": "map.osm"}}
NEAR = {"lat_deg": LAT_DEG, "lon_deg": LON_DEG, "radius_km": 0.6}


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def client(data_dir: Path) -> Iterator[httpx.Client]:
    with client_of(data_dir, workers=2) as client:
        yield client


@pytest.fixture(scope="module")
def drive(client: httpx.Client, street: Path) -> str:
    """A committed drive with a map."""
    return upload(client, street)


@pytest.fixture(scope="module")
def scored(client: httpx.Client, street: Path) -> dict[str, Any]:
    """A job scored against the map of its drive, at its end; the only job of that drive, thus its newest result."""
    return ended(client, submit(client, upload(client, street), osm={"file": "map.osm"}))


def set_state(data_dir: Path, drive_id: str, state: str) -> None:
    """Bring a drive into a state that is hard to catch."""
    with database_of(data_dir) as database, database.writing() as session:
        session.get_one(Drive, drive_id).state = state


def problem(answer: httpx.Response, status: int) -> str:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    detail: str = answer.json()["detail"]
    return detail


def test_a_job_finds_what_the_command_line_finds(
    client: httpx.Client, scored: dict[str, Any], street: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert run(["run", str(street), "-o", str(out), "--osm", str(street / "map.osm"), "--quiet"]) == 0
    job = scored
    assert_as_by_command(client, job, out, "osm_nodes", "matches")
    report = client.get(job["links"]["report"], headers={"Accept": "application/json"}).json()
    assert report == json.loads((out / "report.json").read_text())
    record = client.get(job["links"]["run"]).json()
    ours = json.loads((out / "run.json").read_text())
    changing = {"seconds", "stage_seconds", "peak_memory_bytes", "workers", "job"}
    assert {k: v for k, v in record.items() if k not in changing} == {
        k: v for k, v in ours.items() if k not in changing
    }
    summary = job["summary"]
    assert summary["keyframes"] == SCANS
    assert summary["intersections"] == len(json.loads((out / "intersections.geojson").read_text())["features"])
    assert summary["report"]["f1_at_5"] == report["f1"]["5.0"]
    assert summary["report"]["nodes_found"] == report["nodes_found"] > 0
    live = client.get("/ogc/collections/intersections/items", params={"filter": f"job = '{job['id']}'"}).json()
    assert live["numberMatched"] == summary["intersections"], "a GIS sees it at once"
    assert job["progress"] == {"done": SCANS, "total": SCANS, "fraction": 1.0, "seconds_left": None}
    assert (job["attempts"], job["error"], job["stage"]) == (1, None, "finished")


def nested(depth: int) -> dict[str, Any]:
    inner: dict[str, Any] = {}
    for _ in range(depth):
        inner = {"a": inner}
    return inner


def test_a_request_can_wait_for_its_job(client: httpx.Client, drive: str, data_dir: Path) -> None:
    job = {"drive_id": drive}
    done = client.post(f"{API}/jobs", json=job, headers={"Prefer": "wait=120"})
    assert (done.status_code, done.json()["state"]) == (200, "successful")
    assert done.headers["preference-applied"] == "wait=120"
    gate = Gate(data_dir, drive, MIDDLE)
    try:
        short = client.post(f"{API}/jobs", json=job, headers={"Prefer": "wait=1"})
        at_once = client.post(f"{API}/jobs", json=job)
        for answer in (short, at_once):
            assert answer.status_code == 202
            assert answer.json()["state"] in {"accepted", "running"}
        assert "preference-applied" not in at_once.headers
    finally:
        gate.open()
    for answer in (short, at_once):
        assert ended(client, answer.json()["id"])["state"] == "successful"


@pytest.mark.parametrize(("request_", "status", "words"), [
    ({"drive_id": "nowhere"}, 404, "There is no drive nowhere"),
    ({"config": {"bev": {"resolution": 1}}}, 422, "bev.resolution: there is no such setting"),
    ({"config": {"bev": {"resolution_m": 0.001}}}, 422, "bev.resolution_m"),
    ({"config": {"keyframes": 3}}, 422, "keyframes"),
    ({"config": {"candidates": {"kind": ["harris"]}}}, 422, "candidates"),
    ({"config": {"bev": nested(400)}}, 422, "bev.a: there is no such setting"),
    ({"config": {"preset": "paper"}}, 422, "config.preset: found 'paper' beside 'default'"),
    ({"osm": {"file": "other.osm"}}, 422, "no 'other.osm' among the files"),
    ({"osm": {"file": "../../x.osm"}}, 422, "no '../../x.osm' among the files"),
    ({"osm": {"file": "poses.txt"}}, 422, "expected a name that ends in .osm"),
    ({"osm": {"overpass": False}}, 422, "osm"),
    ({"preset": "best"}, 422, "preset"),
    ({"policy": "bicycle"}, 422, "policy"),
    ({"labels": "predictions"}, 422, "has no 'predictions'. Expected one of its label_folders: labels"),
    ({"speed": 3}, 422, "speed"),
    ({"georeference": "map"}, 422, "osm names none"),
    ({"georeference": "map", "osm": {"overpass": True}}, 422, "Say roughly where"),
    ({"near": NEAR}, 422, "give both"),
    ({**BY_MAP, "near": {"lat_deg": 91, "lon_deg": 0}}, 422, "near.lat_deg"),
    ({**BY_MAP, "near": {"lat_deg": 49, "lon_deg": 8, "radius_km": 1e9}}, 422, "near.radius_km"),
    ({**BY_MAP, "georeference": "sun"}, 422, "georeference"),
])  # fmt: skip
def test_a_request_that_cannot_be_done_is_refused_at_once(
    client: httpx.Client, drive: str, request_: dict[str, Any], status: int, words: str
) -> None:
    detail = problem(client.post(f"{API}/jobs", json={"drive_id": drive, **request_}), status)
    assert words in detail
    assert len(detail) < 1000


def test_overpass_can_be_switched_off(serve: Serve) -> None:
    own = serve(overpass_url="")
    drive_id = own.post(f"{API}/drives", json={"name": "new"}).json()["id"]
    answer = own.post(f"{API}/jobs", json={"drive_id": drive_id, "osm": {"overpass": True}})
    assert "Upload the map as a file" in problem(answer, 422)


def test_jobs_are_listed_page_by_page(serve: Serve, street: Path, tmp_path: Path) -> None:
    own = serve(max_queued_jobs=4)
    drive_id, other = upload(own, street), upload(own, street)
    gates = [Gate(tmp_path / "data", each, MIDDLE) for each in (drive_id, other)]
    ids = [submit(own, drive_id, name=str(number)) for number in range(3)]
    ids.append(submit(own, other))
    too_many = own.post(f"{API}/jobs", json={"drive_id": drive_id})
    assert "that is the limit" in problem(too_many, 429)
    assert int(too_many.headers["Retry-After"]) > 0

    assert [job["id"] for job in every(own, f"{API}/jobs", "jobs", limit=3)] == ids[::-1]
    assert [job["id"] for job in own.get(f"{API}/jobs", params={"drive": other}).json()["jobs"]] == ids[3:]
    assert own.get(f"{API}/jobs", params={"state": "failed"}).json()["jobs"] == []
    kinds = {job["kind"] for job in own.get(f"{API}/jobs", params={"kind": "all"}).json()["jobs"]}
    assert kinds == {"intersections", "commit", "unpack"}
    assert "is not the `next`" in problem(own.get(f"{API}/jobs", params={"after": "x"}), 422)
    for job_id in ids:
        own.delete(f"{API}/jobs/{job_id}")
    for gate in gates:
        gate.open()


def test_a_job_that_runs_is_cancelled(client: httpx.Client, drive: str, street: Path, data_dir: Path) -> None:
    gate = Gate(data_dir, drive, MIDDLE)
    map_ = f"{API}/drives/{drive}/files/map-2.osm"
    client.put(map_, content=(street / "map.osm").read_bytes()).raise_for_status()
    job_id = submit(client, drive, osm={"file": "map-2.osm"})
    half_way(client, job_id)
    for answer in (client.delete(map_), client.put(map_, content=b"<osm/>")):
        assert f"Job {job_id} is running and needs map-2.osm" in problem(answer, 409)
    client.put(map_, content=(street / "map.osm").read_bytes()).raise_for_status()  # the same
    answer = client.delete(f"{API}/jobs/{job_id}")
    assert answer.status_code == 202
    job = ended(client, job_id)  # though its worker hears nothing
    assert client.delete(map_).status_code == 204
    assert (job["state"], job["error"]["title"]) == ("dismissed", "Cancelled")
    assert not (data_dir / "jobs" / job_id).exists()
    gate.open()
    assert client.delete(f"{API}/jobs/{job_id}").status_code == 200
    assert problem(client.get(f"{API}/jobs/{job_id}/layers/intersections"), 409)
    assert client.delete(f"{API}/jobs/{job_id}?purge=true").status_code == 204
    assert problem(client.get(f"{API}/jobs/{job_id}"), 404)


def test_what_takes_too_long_fails(serve: Serve, street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = tmp_path / "data"
    with client_of(data) as patient:
        drive_id = upload(patient, street)
        done = ended(patient, submit(patient, drive_id))
        gate = Gate(data, drive_id, MIDDLE)
        with monkeypatch.context() as patched:
            patched.setattr(Settings, "job_s", 0.5)
            job = ended(patient, submit(patient, drive_id))
    assert (job["state"], job["error"]["limit"]) == ("failed", "job_s")
    assert "The job took longer than the 0.5 seconds that a job may take" in job["error"]["detail"]
    own = serve(data, job_stage_s=1.0)
    job = ended(own, submit(own, drive_id))
    assert (job["state"], job["attempts"]) == ("failed", 1)
    error = job["error"]
    assert (error["title"], error["status"]) == ("Limit reached", 422)
    assert (error["limit"], error["bound"]) == ("job_stage_s", 1)
    assert "Part 1 of 1 took longer than the 1 seconds" in error["detail"]
    assert "INTERLOC_JOB_STAGE_S" in error["detail"]
    monkeypatch.setattr(Settings, "request_work_s", 0.5)  # the picture of a keyframe is bounded too
    answer = own.get(f"{API}/jobs/{done['id']}/keyframes/{MIDDLE}/bev.png")
    gate.open()
    assert "The work for this request took longer than the 0.5 seconds" in problem(answer, 422)
    assert answer.json()["limit"] == "request_work_s"


def test_a_job_that_needs_too_much_memory_fails(serve: Serve, street: Path) -> None:
    with executing(1) as executor:
        size = memory_of(executor.submit(pid_of).result(60))
    own = serve(worker_memory_bytes=size + 90 * 2**20)  # a worker needs up to 60 of them when it commits
    drive_id = upload(own, street)
    config = {"bev": {"resolution_m": 0.05, "size_m": 200}}  # images of 4000 x 4000 cells
    job = ended(own, submit(own, drive_id, preset="paper", config=config))
    assert (job["state"], job["attempts"], job["error"]["limit"]) == ("failed", 1, "worker_memory_bytes")
    assert re.search(r"needed [\d.]+ GB of memory, more than the [\d.]+ GB that a worker", job["error"]["detail"])
    assert upload(own, street) != drive_id  # another worker has taken its place, and commits


def test_a_client_has_its_turn_while_another_holds_every_worker(serve: Serve, street: Path, tmp_path: Path) -> None:
    own = serve(workers=1, jobs_at_once=1)
    with database_of(tmp_path / "data") as database:
        ann, eve = [bearer(add_token(database, name)) for name in ("ann", "eve")]
    own.headers.update(eve)
    held = upload(own, street)
    gate = Gate(tmp_path / "data", held, MIDDLE)
    many = [submit(own, held) for _ in range(3)]
    half_way(own, many[0])
    own.headers.update(ann)
    job = ended(own, submit(own, upload(own, street)))
    assert job["state"] == "successful"
    assert own.get(f"{API}/jobs/{job['id']}/keyframes/{MIDDLE}/bev.png").status_code == 200
    assert [job_of(own, each)["state"] for each in many] == ["running", "accepted", "accepted"]
    gate.open()
    for each in many:
        assert ended(own, each)["state"] == "successful"


def test_a_drive_without_georeference_is_mapped_but_not_scored(
    client: httpx.Client, data_dir: Path, tmp_path: Path
) -> None:
    folder = write_street(tmp_path / "local", SCANS)
    (folder / "geo.csv").unlink()
    drive_id = upload(client, folder)
    order = {"drive_id": drive_id, "osm": {"file": "map.osm"}}
    assert "has no georeference" in problem(client.post(f"{API}/jobs", json=order), 422)
    set_state(data_dir, drive_id, "checking")  # whether it has one is not known yet
    waiting = submit(client, drive_id, osm={"file": "map.osm"})
    set_state(data_dir, drive_id, "ready")
    failed = ended(client, waiting)
    assert (failed["state"], failed["attempts"], failed["progress"]["done"]) == ("failed", 1, 0)
    assert "has no georeference" in failed["error"]["detail"]

    job = ended(client, submit(client, drive_id))
    assert job["summary"]["georeferenced"] is False
    assert client.get(job["links"]["intersections"]).json()["local"] is True
    assert client.get(job["links"]["export"], params={"f": "gpkg"}).status_code == 200


def test_a_job_of_another_version_that_cannot_be_read_fails_and_the_next_one_is_done(
    client: httpx.Client, data_dir: Path, drive: str
) -> None:
    set_state(data_dir, drive, "checking")
    waiting = submit(client, drive)
    with database_of(data_dir) as database, database.writing() as session:
        job = session.get_one(Job, waiting)
        job.request = {**job.request, "config": {"of_another_version": 1}}
    set_state(data_dir, drive, "ready")
    failed = ended(client, waiting)
    assert (failed["state"], failed["error"]["status"]) == ("failed", 500)
    assert ended(client, submit(client, drive))["state"] == "successful"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("broken.osm", lambda: b'<osm version="0.6"><way>', "broken.osm: is damaged"),
        (
            "bomb.osm.gz",
            lambda: gzip.compress(b"<osm>" + b"<!-- nothing -->\n" * 8_000_000),
            "bomb.osm.gz: unpacks to more than 0.1 GB",
        ),
    ],
)
def test_a_bad_map_is_told_before_the_long_work(
    client: httpx.Client, data_dir: Path, drive: str, name: str, content: Callable[[], bytes], says: str
) -> None:
    client.put(f"{API}/drives/{drive}/files/{name}", content=content()).raise_for_status()
    job = ended(client, submit(client, drive, osm={"file": name}))
    assert (job["state"], job["attempts"], job["error"]["status"]) == ("failed", 1, 422)
    assert says in job["error"]["detail"]
    assert str(data_dir) not in job["error"]["detail"]
    assert job["progress"]["done"] == 0


def test_a_job_fails_when_the_check_of_its_drive_does(client: httpx.Client, data_dir: Path, drive: str) -> None:
    set_state(data_dir, drive, "checking")
    waiting = submit(client, drive)
    set_state(data_dir, drive, "uploading")
    job = ended(client, waiting)
    set_state(data_dir, drive, "ready")
    assert (job["state"], job["error"]["status"]) == ("failed", 409)
    assert "Commit it first" in job["error"]["detail"]


def test_waiting_for_overpass_is_told(serve: Serve, street: Path, town: Town, tmp_path: Path) -> None:
    town.first = [(429, {"Retry-After": "3"}, b"")]
    own = serve(overpass_url=town.url)
    drive_id = upload(own, street)
    job_id = submit(own, drive_id, osm={"overpass": True})

    def look() -> str | None:
        job = job_of(own, job_id)
        return job["message"] if job["stage"] == "waiting for the map" and "busy" in (job["message"] or "") else None

    assert "is busy (status 429)" in wait_until(look, "the wait to be told", every_s=0.1)
    job = ended(own, job_id)
    assert job["state"] == "successful", job
    assert own.get(job["links"]["report"]).json()["osm"]["source"] == f"Overpass ({town.url})"
    assert list((tmp_path / "data/cache/overpass").iterdir()), "it is kept for the next job"


def test_presets_can_be_read(client: httpx.Client) -> None:
    found = client.get(f"{API}/presets").json()
    assert [preset["name"] for preset in found["presets"]] == ["default", "paper"]
    assert "KeyframeConfig" in found["config_schema"]["$defs"]
    assert found["presets"][1]["config"]["candidates"]["kind"] == "harris"


def test_a_job_that_waits_for_a_worker_says_so(serve: Serve, street: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(processes, "_context", NothingStarts)
        patched.setattr(executors, "compile_kernels", int)  # workers are to start at once
        client = serve()
        drive_id = client.post(f"{API}/drives", json={"name": "street"}).json()["id"]
        client.post(
            f"{API}/drives/{drive_id}/archive", content=archive_of(street), headers={"Prefer": "wait=0"}
        ).raise_for_status()
        wait_until(lambda: client.get("/readyz").json()["reasons"].get("workers"), "it to be seen that none starts")

        def look() -> dict[str, Any]:
            (job,) = client.get(f"{API}/jobs", params={"kind": "unpack"}).json()["jobs"]
            return job

        wait_until(lambda: "waits for a worker" in (look()["message"] or ""), "the job to say what it waits for")
        assert look()["state"] == "accepted"
    assert ended(client, look()["id"])["state"] == "successful"


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, MadeDrive]:
    root = tmp_path_factory.mktemp("drives") / "town"
    drive = write_town_drive(root, every_m=8)
    write_town_map(root / "map.osm")
    return root, drive


def test_a_job_places_a_drive_as_the_command_line_does(
    client: httpx.Client, placed: tuple[Path, MadeDrive], tmp_path: Path
) -> None:
    root, truth = placed
    job = ended(client, submit(client, upload(client, root), near=NEAR, **BY_MAP))
    lon, lat = truth.true_lonlat[0]
    location = job["summary"]["location"]
    assert (location["lat_deg"], location["lon_deg"]) == pytest.approx((lat, lon), abs=3e-5)
    assert 0.0 < location["position_std_m"] < 3.0
    assert job["summary"]["georeferenced"] is True

    out = tmp_path / "out"
    near = ["--near", f"{LAT_DEG},{LON_DEG}", "--radius", "0.6"]
    assert run(["run", str(root), "-o", str(out), "--osm", str(root / "map.osm"), "--locate", *near, "--quiet"]) == 0
    assert_as_by_command(client, job, out, "osm_nodes", "places")
    assert client.get(f"{API}/jobs/{job['id']}/export?f=kml&layer=places").status_code == 200
    told = client.get(job["links"]["run"]).json()["location"]
    assert (told["source"], told["outcome"]) == ("map", "found")
    report = client.get(job["links"]["report"], headers={"Accept": "application/json"}).json()
    assert any("left this node out" in warning for warning in report["warnings"])

    other = ended(client, submit(client, job["drive_id"], near=NEAR | {"lon_deg": 9.0}, **BY_MAP))
    assert (other["state"], other["error"]["status"]) == ("failed", 422)
    assert "no road" in other["error"]["detail"] or "no highway" in other["error"]["detail"]


def test_what_cannot_be_placed_fails_with_the_places_and_what_would_help(client: httpx.Client, tmp_path: Path) -> None:
    street = write_street(tmp_path / "street", 60)
    drive = upload(client, street)
    job = ended(client, submit(client, drive, **BY_MAP))
    assert (job["state"], job["error"]["status"]) == ("failed", 422)
    assert "A longer drive" in job["error"]["detail"]
    assert "49.00" in job["error"]["detail"]
    assert "places" not in job["links"]
    scored = ended(client, submit(client, drive, osm={"file": "map.osm"}))  # by its GNSS all is as before
    assert scored["state"] == "successful"
    assert "places" not in scored["links"]
    assert client.get(f"{API}/jobs/{scored['id']}/layers/places").status_code == 404
