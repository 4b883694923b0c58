"""From a drive to a result by way of a server: the same bytes as without one, whole or not at all."""

import json
import shutil
import signal
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.app.processes import Gate, ServerProcess, wait_until, without_job
from tests.client.conftest import Here, answer

API = "/api/v1"
LAYERS = {"intersections", "detections", "keyframes", "trajectory", "roads", "junctions", "road_surface"}


def layers(folder: Path) -> dict[str, bytes]:
    """All layers of a result, as bytes, without the id of a job."""
    found = [path for path in folder.iterdir() if path.name.endswith((".geojson", ".local.json"))]
    return {path.name: without_job(path.read_bytes()) for path in found}


@pytest.fixture(scope="session")
def scored(server: ServerProcess, street: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A drive pushed, run and fetched, with the outcome."""
    folder = tmp_path_factory.mktemp("scored")
    here = Here(server.address, folder / "cache")
    arguments = ["--osm", street / "map.osm", "--run", "-o", folder / "out", "--json"]
    return {**here("push", street, *arguments).json, "out": folder / "out"}


def test_a_result_fetched_is_a_result_made_here(here: Any, scored: Any, street: Path, tmp_path: Path) -> None:
    assert here("run", street, "-o", tmp_path / "local", "--osm", street / "map.osm").code == 0
    ours, theirs = layers(tmp_path / "local"), layers(scored["out"])
    assert {f"{layer}.geojson" for layer in LAYERS} <= ours.keys()
    assert {name: theirs[name] for name in ours} == ours
    reports = [json.loads((folder / "report.json").read_bytes()) for folder in (tmp_path / "local", scored["out"])]
    assert reports[0]["ace_m"] == reports[1]["ace_m"]
    assert reports[0]["f1"] == reports[1]["f1"]
    assert reports[0]["nodes_found"] == scored["report"]["nodes_found"] > 0


def test_fetched_again_every_byte_is_that_of_the_server(
    here: Any, scored: Any, server: ServerProcess, tmp_path: Path
) -> None:
    outcome = here("push", "--fetch", scored["job"], "-o", tmp_path / "out")
    assert outcome.code == 0
    assert "nodes found" in outcome.out
    listed = server.client.get(f"{API}/jobs/{scored['job']}/files").json()["files"]
    found = {p.relative_to(tmp_path / "out").as_posix(): p for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert found.keys() == {file["name"] for file in listed}
    for name, path in found.items():
        assert path.read_bytes() == server.client.get(f"{API}/jobs/{scored['job']}/files/{name}").content


def test_a_job_that_fails_says_why(here: Any, street: Path, tmp_path: Path) -> None:
    (tmp_path / "broken.osm").write_text("<osm")
    outcome = here("push", street, "--osm", tmp_path / "broken.osm", "--run", "-o", tmp_path / "out")
    assert outcome.code == 1
    assert "failed: " in outcome.err
    assert "broken.osm" in outcome.err
    assert not (tmp_path / "out").exists()


def test_a_job_that_was_cancelled(here: Any, server: ServerProcess, street: Path, tmp_path: Path) -> None:
    drive = here("push", street, "--json").json["drive_id"]
    gate = Gate(server.log.parent / "data", drive, 30)  # else the job may be done before it hears of it
    job = server.client.post(f"{API}/jobs", json={"drive_id": drive}).json()["id"]
    server.client.delete(f"{API}/jobs/{job}").raise_for_status()
    outcome = here("push", "--fetch", job, "-o", tmp_path / "out")
    gate.open()
    state = server.client.get(f"{API}/jobs/{job}").json()["state"]
    assert state == "dismissed"
    assert outcome.code == 1
    # Where it had begun, its end is waited for, with a line of progress.
    assert outcome.err.splitlines()[-1] == f"interloc: job {job} was cancelled."


def test_an_older_result_stays_until_the_new_one_is_whole(here: Any, scored: Any, tmp_path: Path) -> None:
    out = Path(shutil.copytree(scored["out"], tmp_path / "out"))
    (out / "mine.txt").write_text("notes")
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    nowhere = here("push", "--fetch", "0123456789abcdef", "-o", out)
    assert (nowhere.code, "0123456789abcdef" in nowhere.err) == (1, True)
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before
    assert here("push", "--fetch", scored["job"], "-o", out).code == 0
    assert (out / "mine.txt").read_text() == "notes"


def test_stopped_while_it_waits_the_job_goes_on(here: Any, server: ServerProcess, street: Path, tmp_path: Path) -> None:
    drive = here("push", street, "--name", "waits", "--json").json["drive_id"]
    with here.start(
        "push", street, "--name", "waits", "--run", "--set", "keyframes.window=40", "-o", tmp_path / "out"
    ) as process:
        jobs = partial(server.client.get, f"{API}/jobs", params={"drive": drive})
        wait_until(lambda: process.exitcode is not None or bool(jobs().json()["jobs"]), "its job")
        process.send(signal.SIGINT)
        code, _, err = process.ended()
    (job,) = server.client.get(f"{API}/jobs", params={"drive": drive}).json()["jobs"]
    if code:  # else the job was quicker than the signal
        assert f"interrupted; the job goes on: interloc push --fetch {job['id']} -o OUT --server " in err
        assert not (tmp_path / "out").exists()
    assert here("push", "--fetch", job["id"], "-o", tmp_path / "fetched").code == 0


@pytest.mark.parametrize("name", ["../../evil", "/etc/evil", "a\\b", "c:evil", "figures/../../evil"])
def test_names_that_lead_elsewhere_are_not_written(name: str, faulty: Any, tmp_path: Path) -> None:
    job = {"id": "j1", "drive_id": "d1", "state": "successful"}
    files = [{"name": "run.json", "size_bytes": 2}, {"name": name, "size_bytes": 2}]
    faulty.script = [answer(200, job), answer(200, {"files": files}), answer(200, b"{}")]
    outcome = Here(faulty.address, tmp_path / "cache")("push", "--fetch", "j1", "-o", tmp_path / "out")
    assert outcome.code == 1
    assert "which was not written" in outcome.err
    assert not list(tmp_path.rglob("*evil*"))


def test_a_file_that_does_not_fit_its_size_is_not_kept(faulty: Any, tmp_path: Path) -> None:
    job = {"id": "j1", "drive_id": "d1", "state": "successful"}
    files = {"files": [{"name": "run.json", "size_bytes": 1000}]}
    faulty.script = [answer(200, job), answer(200, files), answer(200, b"{}")]
    outcome = Here(faulty.address, tmp_path / "cache")("push", "--fetch", "j1", "-o", tmp_path / "out")
    assert outcome.code == 1
    assert "run.json came with 2 bytes, but is listed with 1,000" in outcome.err
    assert not (tmp_path / "out").exists()


def test_a_job_is_followed_to_its_end(faulty: Any, tmp_path: Path) -> None:
    states, answers = iter(["accepted", "running", "successful"]), iter([503, 200])
    run = json.dumps({"scans": 1, "keyframes": 1, "georeference": None}).encode()

    def reply(handler: Any) -> None:
        if handler.path.endswith("/files"):
            answer(200, {"files": [{"name": "run.json", "size_bytes": len(run)}]})(handler)
        elif handler.path.endswith("run.json"):
            answer(next(answers), run)(handler)  # what fails once is asked for again
        else:
            answer(200, {"id": "j1", "drive_id": "d1", "state": next(states)})(handler)

    faulty.script = [reply]
    outcome = Here(faulty.address, tmp_path / "cache")("push", "--fetch", "j1", "-o", tmp_path / "out", "--quiet")
    assert (outcome.code, outcome.err) == (0, "")
    assert next(states, None) is None
