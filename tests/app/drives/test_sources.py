"""Drives that the service reads from object storage itself."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from app.context import Context
from app.drives.commit import begin_commit, finish_drive
from app.drives.models import CommitRequest, NewDrive
from app.drives.records import create_drive
from app.settings import Settings
from app.states import JobState
from app.store.tokens import add_token
from app.work.requests import CommitOutcome
from interloc import storage
from interloc.reduction.reduce import reduce_drive
from tests.app.processes import ServerProcess, started, wait_until
from tests.app.street import write_street
from tests.stores import BUCKET, put, s3  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("s3")

API = "/api/v1"
SETTINGS = {"workers": 1, "sources": f"s3://{BUCKET}/open", "max_drive_files": 100, "lease_s": 1}


@pytest.fixture(scope="module")
def street(s3: str, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: F811 - the fixture
    """A street of 30 scans, also in the bucket."""
    root = write_street(tmp_path_factory.mktemp("street") / "07", 30)
    put(root, "open/07")
    put(root, "open-not/07")
    return root


@pytest.fixture(scope="module")
def server(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    home = tmp_path_factory.mktemp("sources")
    with started(home / "data", home / "log", **SETTINGS) as server:
        yield server


def make(client: httpx.Client, source: str) -> httpx.Response:
    return client.post(f"{API}/drives", json={"name": "07", "source": source})


def test_a_drive_is_read_where_it_lies_and_goes_on_after_a_kill(street: Path, tmp_path: Path) -> None:
    with started(tmp_path / "data", tmp_path / "1.log", **SETTINGS) as server:
        made = make(server.client, f"s3://{BUCKET}/open/07").json()
        drive = f"{API}/drives/{made['id']}"
        assert server.client.put(f"{drive}/files/poses.txt", content=b"my own").status_code == 409
        assert server.client.post(f"{drive}/commit", headers={"Prefer": "wait=0"}).status_code in {200, 202}
        wait_until(lambda: list((tmp_path / "data/jobs").rglob("*.bin")), "the first scans")
        server.kill()
    with started(tmp_path / "data", tmp_path / "2.log", **SETTINGS) as server:
        wait_until(lambda: server.client.get(drive).json()["state"] != "checking", "the end of the commit")
        shown = server.client.get(drive).json()
        assert (shown["state"], shown["source"], shown["size_bytes"]) == ("ready", made["source"], 0)
        assert shown["report"]["path"] == "07"
        wait_until(lambda: not list((tmp_path / "data/jobs").rglob("*.bin")), "the clean-up")
    reduce_drive(street, tmp_path / "07", keyframes=None)
    kept = tmp_path / "data/drives" / made["id"] / "reduced"
    for file in sorted((tmp_path / "07/ground").rglob("*.ground")):
        assert (kept / file.relative_to(tmp_path / "07")).read_bytes() == file.read_bytes()


@pytest.mark.parametrize(("source", "said"), [
    (f"s3://{BUCKET}/open-not/07", "lies below none of the prefixes"),
    (f"s3://{BUCKET}/open/../open-not/07", "holds an empty part"),
    ("file:///etc", "is not an address in object storage"),
    (f"s3://a:b@{BUCKET}/open", "credentials and signatures do not belong"),
])  # fmt: skip
def test_other_sources_are_refused_when_the_drive_is_made(server: ServerProcess, source: str, said: str) -> None:
    answer = make(server.client, source)
    assert (answer.status_code, answer.json()["type"]) == (422, "/problems/source-refused")
    assert said in answer.json()["detail"]


def test_what_a_bucket_holds_is_not_trusted(server: ServerProcess, street: Path, tmp_path: Path) -> None:
    for number in range(101):
        storage.Bucket(f"s3://{BUCKET}").put(f"open/many/{number}", b"")
    shutil.copytree(street, tmp_path / "bad")
    (tmp_path / "bad/labels/000003.label").write_bytes(b"x")
    put(tmp_path / "bad", "open/bad")
    for name, said in (("many", "more than 100 objects"), ("nothing", "holds no objects"), ("bad", "000003.label")):
        made = make(server.client, f"s3://{BUCKET}/open/{name}").json()
        answer = server.client.post(f"{API}/drives/{made['id']}/commit")
        assert answer.status_code == 422
        assert said in answer.json()["detail"]
        assert "in-storage" not in answer.text
        assert "a-secret" not in answer.text


def test_what_was_reduced_counts_for_the_quota_of_the_owner(tmp_path: Path) -> None:
    context = Context.open(Settings(data_dir=tmp_path, min_free_bytes=0, sources="s3://open"))
    add_token(context.database, "small", max_bytes=1000)
    drive = create_drive(context, "small", NewDrive(name="07", source="s3://open/07"))[0]
    job = begin_commit(context, drive.id, "small", CommitRequest())
    assert job is not None
    with context.database.writing() as session:
        session.add(job)
        job.state = JobState.SUCCESSFUL
        finish_drive(session, context, job, CommitOutcome(ok=True, reduced_bytes=1001))
        assert job.state == JobState.FAILED
        assert (job.error or {})["type"] == "/problems/quota-used-up"
    assert not (tmp_path / "drives" / drive.id / "reduced").exists()
    context.close()
