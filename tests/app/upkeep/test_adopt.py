"""A database that is lost: adopt makes its rows anew from what lies in the folder, and the service serves it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.context import Context
from app.settings import Settings
from app.store.installation import InstallationError, id_of_folder
from app.upkeep.adopt import Adoption, adopt
from app.upkeep.check import check
from app.upkeep.cleanup import sweep
from interloc.errors import ConfigError
from tests.app.conftest import client_of, running_server
from tests.app.processes import ended, submit, upload
from tests.app.street import write_street

API = "/api/v1"

Serve = Callable[..., httpx.Client]


@pytest.fixture(scope="module")
def lost(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A data folder whose database is gone, and what the service said before. Shared: work on a copy."""
    root = tmp_path_factory.mktemp("lost")
    street = write_street(root / "street", 24)
    with client_of(root / "data") as client:
        ready, raw = upload(client, street), upload(client, street, keep_raw=True)
        job = submit(client, ready, osm={"file": "map.osm"}, name="mine")
        assert ended(client, job)["state"] == "successful"
        for thing in (f"drives/{ready}", f"jobs/{job}"):
            client.patch(f"{API}/{thing}", json={"name": "renamed", "note": "Wet road."}).raise_for_status()
        begun = client.post(f"{API}/drives", json={"name": "Straße", "options": {"label_scheme": "40"}}).json()["id"]
        client.put(f"{API}/drives/{begun}/files/poses.txt", content=b"1 0 0 0 0 1 0 0 0 0 1 0\n")
        said = {address: client.get(address).json() for address in addresses(ready, raw, begun, job)}
    for path in (root / "data").glob("interloc.sqlite3*"):
        path.unlink()
    return root / "data", {"ready": ready, "raw": raw, "begun": begun, "job": job, "said": said}


def addresses(ready: str, raw: str, begun: str, job: str) -> list[str]:
    drives = [f"{API}/drives/{drive}" for drive in (ready, raw, begun)]
    results = [f"{API}/jobs/{job}{part}" for part in ("", "/report", "/intersections", "/run", "/files")]
    return [
        *drives,
        *results,
        f"{API}/drives/{begun}/files",
        f"{API}/drives/{raw}/files",
        f"{API}/drives/{ready}/trajectory",
    ]


@pytest.fixture
def data(lost: tuple[Path, dict[str, Any]], tmp_path: Path) -> Path:
    shutil.copytree(lost[0], tmp_path / "data")
    return tmp_path / "data"


def adopted(data: Path, *, dry_run: bool = False) -> list[Adoption]:
    context = Context.open(Settings(data_dir=data), bound=False)
    try:
        return adopt(context, dry_run=dry_run)
    finally:
        context.close()


def found(data: Path) -> list[str]:
    context = Context.open(Settings(data_dir=data))
    try:
        return [f"{each.place}: {each.message}" for each in check(context)]
    finally:
        context.close()


def test_all_is_served_as_before(lost: tuple[Path, dict[str, Any]], data: Path, serve: Serve) -> None:
    known = lost[1]
    with pytest.raises(InstallationError):
        Context.open(Settings(data_dir=data))
    before = {path for path in data.rglob("*") if ".sqlite3" not in path.name}
    plan = adopted(data, dry_run=True)
    with pytest.raises(InstallationError):  # nothing was done
        Context.open(Settings(data_dir=data))
    assert adopted(data) == plan
    assert [each.is_adopted for each in plan] == [True] * 4
    assert f"drives/{known['ready']}" in {each.place for each in plan}
    assert {path for path in data.rglob("*") if ".sqlite3" not in path.name} >= before
    assert found(data) == []

    client = serve(data)
    changing = {"expires_at", "version"}
    for address, said in known["said"].items():
        now = client.get(address).raise_for_status().json()
        left_out = set(changing)
        if address == f"{API}/drives/{known['ready']}":  # which raw files there were is not known any more
            assert now["files"] == 1
            left_out |= {"files", "size_bytes"}
        now, said_ = ({name: value for name, value in each.items() if name not in left_out} for each in (now, said))
        assert now == said_, address
    assert ended(client, submit(client, known["ready"], osm={"file": "map.osm"}))["state"] == "successful"
    assert client.put(f"{API}/drives/{known['begun']}/files/times.txt", content=b"0\n").status_code == 201
    assert adopted(data) == []  # also while a server runs


def test_what_was_in_the_trash_is_there_again(serve: Serve, tmp_path: Path) -> None:
    client = serve()
    ids = {}
    for name in ("deleted", "restored"):
        ids[name] = client.post(f"{API}/drives", json={"name": name}).json()["id"]
        client.put(f"{API}/drives/{ids[name]}/files/poses.txt", content=b"1").raise_for_status()
        client.delete(f"{API}/drives/{ids[name]}").raise_for_status()
    client.post(f"{API}/trash/drives/{ids['restored']}/restore").raise_for_status()
    copy = tmp_path / "copy"
    shutil.copytree(tmp_path / "data", copy, ignore=shutil.ignore_patterns("interloc.sqlite3*", "incoming"))
    assert [each.text.rpartition(", ")[2] for each in adopted(copy)].count("in the trash") == 1
    again = serve(copy)
    assert [each["name"] for each in again.get(f"{API}/drives").json()["drives"]] == ["restored"]
    assert [each["id"] for each in again.get(f"{API}/trash").json()["items"]] == [ids["deleted"]]


def test_what_was_set_aside_comes_back(lost: tuple[Path, dict[str, Any]], data: Path, serve: Serve) -> None:
    known = lost[1]
    (data / "installation").unlink()
    for kind, name in (("drives", "ready"), ("jobs", "job")):
        target = data / "lost+found" / kind / f"{known[name]}-2"
        target.parent.mkdir(parents=True)
        shutil.move(data / kind / known[name], target)
    assert len([each for each in adopted(data) if each.is_adopted]) == 4
    client = serve(data)
    address = f"{API}/jobs/{known['job']}/report"
    assert client.get(address).json() == known["said"][address]


def test_data_of_an_older_version_has_no_names(lost: tuple[Path, dict[str, Any]], data: Path, serve: Serve) -> None:
    known = lost[1]
    for path in [*data.glob("drives/*/drive.json"), *data.glob("jobs/*/job.json")]:
        path.unlink()
    outcomes = {each.place: each for each in adopted(data)}
    job = outcomes[f"jobs/{known['job']}"]
    assert not job.is_adopted
    assert "no job.json says of which drive it is; left where it is" in job.text
    assert (data / f"jobs/{known['job']}/result/run.json").is_file()
    client = serve(data)
    drives = {drive["id"]: drive for drive in client.get(f"{API}/drives").json()["drives"]}
    assert {drive["name"] for drive in drives.values()} == {f"recovered {id_[:8]}" for id_ in drives}
    states = {name: drives[known[name]]["state"] for name in ("ready", "raw", "begun")}
    assert states == {"ready": "ready", "raw": "ready", "begun": "uploading"}
    assert drives[known["raw"]]["keep_raw"]  # else its scans would be removed
    assert (data / f"drives/{known['raw']}/files/velodyne/000000.bin").is_file()
    assert ended(client, submit(client, known["ready"]))["state"] == "successful"


def test_sidecars_are_not_believed_blindly(lost: tuple[Path, dict[str, Any]], data: Path) -> None:
    known = lost[1]

    def change(path: Path, **fields: Any) -> None:
        path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))

    change(data / f"drives/{known['ready']}/drive.json", options={"oxts": "../../etc/passwd"}, report={"nonsense": 1})
    change(data / f"drives/{known['raw']}/drive.json", name="a\nb", created_at=1e300)
    change(data / f"jobs/{known['job']}/job.json", drive_id="nobody")
    shutil.rmtree(data / f"drives/{known['raw']}/reduced")
    (data / "drives/notes").mkdir()
    (data / "drives/00000000000000ff").mkdir()
    (data / "drives/notes/text").write_bytes(b"1")
    (data / "drives/00000000000000ff/text").write_bytes(b"1")
    outcomes = {each.place: each for each in adopted(data)}
    assert "its drive nobody is not there" in outcomes[f"jobs/{known['job']}"].text
    assert "its name is not the id" in outcomes["drives/notes"].text
    assert "it holds nothing of a drive" in outcomes["drives/00000000000000ff"].text
    assert "open for files" in outcomes[f"drives/{known['raw']}"].text
    context = Context.open(Settings(data_dir=data))
    sweep(context)
    context.close()
    assert [path.name for path in data.rglob("run.json")] == ["run.json"]
    assert (data / f"drives/{known['raw']}/files/velodyne/000000.bin").is_file()


def test_a_folder_that_another_server_works_in_is_left_alone(
    lost: tuple[Path, dict[str, Any]], data: Path, tmp_path: Path
) -> None:
    adopted(data)
    before = id_of_folder(data)
    other = Settings(data_dir=data, database_url=f"sqlite:///{tmp_path / 'other.sqlite3'}")
    with running_server(data):
        context = Context.open(other, bound=False)
        with pytest.raises(ConfigError, match="a server is at work in the data folder"):
            adopt(context)
        context.close()
    assert id_of_folder(data) == before
    context = Context.open(other, bound=False)  # now it has stopped: the folder changes its database
    assert len(adopt(context)) == 4
    context.close()
    Context.open(other).close()
    with pytest.raises(InstallationError):
        Context.open(Settings(data_dir=data))
