"""What pipelines need: filters and pages of lists, ETags, keys, other origins; on both kinds of database."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any

import httpx
import pytest
from pydantic import ValidationError

from app.settings import Settings
from app.store.database import Database
from app.store.models import Drive, Job
from tests.app.conftest import running_server
from tests.app.postgres import new_database
from tests.app.processes import API, every

SITE = "https://maps.example"
NAMES = ("Öhringen 1", "town 50%", "town_5", "Town 5")


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def client(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A server with the drives `NAMES`: the first lies at 8.4 E, the second across the 180th meridian and has a job."""
    folder = tmp_path_factory.mktemp("lists")
    of_sqlite = nullcontext(Settings(data_dir=folder).sqlalchemy_url)
    with (
        new_database() if request.param == "postgresql" else of_sqlite as url,
        running_server(folder, database_url=url, cors_origins=f"{SITE}, http://localhost:3000") as address,
        httpx.Client(base_url=f"{address}{API}", timeout=60) as client,
    ):
        database = Database(url)
        with database.writing() as session:
            for number, name in enumerate(NAMES, 1):
                session.add(Drive(id=f"d{number}", name=name, owner="me", created_at=100.0 * number, touched_at=4e9))
            here, there = session.get_one(Drive, "d1"), session.get_one(Drive, "d2")
            here.west, here.south, here.east, here.north = 8.4, 49.0, 8.5, 49.1
            there.west, there.south, there.east, there.north = 179.0, -17.0, 179.9, -16.0
            here.state = there.state = "ready"
            session.flush()
            work: dict[str, Any] = {"kind": "intersections", "drive_id": "d2", "owner": "me", "state": "failed"}
            error = {"type": "about:blank", "title": "Disk full", "status": 507, "detail": "Full."}
            session.add(Job(id="j1", name="coarse ÄPFEL", request={}, error=error, created_at=150.0, **work))
            session.add(Job(id="j2", request={"labels": "predictions"}, created_at=250.0, **work))
        database.close()
        yield client


@pytest.mark.parametrize(("params", "found"), [
    ({}, "4321"),
    ({"state": "ready"}, "21"),
    ({"name": "öhr"}, "1"),
    ({"name": "TOWN"}, "432"),
    ({"name": "town_"}, "3"),
    ({"name": "0%"}, "2"),
    ({"name": "\\"}, ""),
])  # fmt: skip
def test_drives_are_filtered(client: httpx.Client, params: dict[str, str], found: str) -> None:
    drives = client.get("/drives", params=params).raise_for_status().json()["drives"]
    assert "".join(drive["id"].removeprefix("d") for drive in drives if drive["owner"] == "me") == found


@pytest.mark.parametrize(("params", "found"), [({"name": "äpfel"}, ["j1"]), ({"name": "town 50"}, ["j2", "j1"])])
def test_jobs_are_filtered(client: httpx.Client, params: dict[str, str], found: list[str]) -> None:
    jobs = client.get("/jobs", params=params).raise_for_status().json()["jobs"]
    assert [job["id"] for job in jobs] == found


@pytest.mark.parametrize(("address", "status", "path", "words"), [
    ("/drives?state=broken", 422, "query.state", "uploading"),
    ("/drives?limt=3", 400, "query.limt", "Expected one of after, limit"),
    ("/drives/d1?full=1", 400, "query.full", "Expected none"),
    ("/jobs?state=failed&state=successful", 400, "query.state", "It comes twice"),
    ("/jobs/j1?x", 400, "query.x", "Expected none"),
    ("/presets?a=1", 400, "query.a", "Expected none"),
])  # fmt: skip
def test_a_parameter_that_is_not_taken_is_named(
    client: httpx.Client, address: str, status: int, path: str, words: str
) -> None:
    answer = client.get(address)
    assert answer.status_code == status, answer.text
    problem = answer.json()
    assert problem["type"] == ("/problems/request-not-valid" if status == 422 else "/problems/unknown-parameter")
    assert problem["problems"][0]["path"] == path
    assert words in problem["detail"]


def test_deleting_with_an_unknown_parameter_deletes_nothing(client: httpx.Client) -> None:
    assert client.delete("/drives/d3?purg=true").status_code == 400
    assert client.get("/drives/d3").status_code == 200


def test_lists_come_in_pages(client: httpx.Client) -> None:
    found = every(client, "/drives", "drives", limit=1, name="town")
    assert [drive["name"] for drive in found] == ["Town 5", "town_5", "town 50%"]


def test_what_has_not_changed_is_not_sent_again(client: httpx.Client) -> None:
    drive = client.post("/drives", json={"name": "changing"}).json()["id"]
    lists = "/drives?limit=1", "/jobs", "/trash", f"/drives/{drive}/files", "/presets", "/models", "/live"
    plain = {"Accept-Encoding": "identity"}
    for address in (f"/drives/{drive}", "/jobs/j1", *lists):
        first = client.get(address, headers=plain).raise_for_status()
        assert first.headers["cache-control"] == "private, no-cache"
        known = plain | {"If-None-Match": first.headers["etag"]}
        same = client.get(address, headers=known)
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", first.headers["etag"])
        head = client.head(address, headers=plain)
        assert (head.status_code, head.content, head.headers["etag"]) == (200, b"", first.headers["etag"])
    known = {"If-None-Match": client.get(f"/drives/{drive}").headers["etag"]}
    client.put(f"/drives/{drive}/files/poses.txt", content=b"1").raise_for_status()
    assert client.get(f"/drives/{drive}", headers=known).json()["files"] == 1
    head = client.head(f"/drives/{drive}/files/poses.txt").raise_for_status()
    known = {"If-None-Match": head.headers["etag"]}
    assert client.get(f"/drives/{drive}/files/poses.txt", headers=known).status_code == 304


def test_what_is_large_is_compressed_for_those_who_take_it(client: httpx.Client) -> None:
    client.patch("/jobs/j1", json={"note": "large " * 300}).raise_for_status()
    packed = client.get("/jobs/j1", headers={"Accept-Encoding": "gzip"})
    plain = client.get("/jobs/j1", headers={"Accept-Encoding": "identity"})
    assert [each.headers.get("content-encoding") for each in (packed, plain)] == ["gzip", None]
    assert packed.content == plain.content
    assert packed.headers["etag"] != plain.headers["etag"]
    for first in (packed, plain):
        assert "Accept-Encoding" in first.headers["vary"]
        etag = first.headers["etag"]
        again = {"Accept-Encoding": first.request.headers["accept-encoding"], "If-None-Match": etag}
        assert client.get("/jobs/j1", headers=again).status_code == 304


def test_drives_and_jobs_are_renamed(client: httpx.Client) -> None:
    for address in ("/drives/d4", "/jobs/j2"):
        before = client.get(address)
        named = client.patch(address, json={"name": " mine ", "note": "a\nb"})
        assert (named.status_code, named.json()) == (200, client.get(address).json())
        assert (named.json()["name"], named.json()["note"]) == ("mine", "a\nb")
        after = client.get(address, headers={"Accept-Encoding": "identity"}).headers["etag"]
        assert named.headers["etag"] == after != before.headers["etag"].removeprefix("W/")
        for refused in ({"name": "a\x07b"}, {"name": " "}, {"name": "x" * 201}, {"note": "x" * 2001}, {"nane": "x"}):
            assert client.patch(address, json=refused).status_code == 422, refused
        assert client.patch(address, json={}).json() == named.json()
        assert client.patch(address, json={"note": " "}).json()["note"] is None
        assert client.patch(f"{address[:-2]}none", json={}).status_code == 404
    assert client.patch("/drives/d4", json={"name": None}).status_code == 422
    assert client.get("/jobs?name=MINE").json()["jobs"][0]["title"] == "mine"
    assert client.patch("/jobs/j2", json={"name": None}).json()["title"] == "default, no map"
    client.patch("/drives/d4", json={"name": NAMES[3]}).raise_for_status()


def test_a_key_makes_one_drive(client: httpx.Client) -> None:
    def make(name: str = "keyed") -> httpx.Response:
        return client.post("/drives", json={"name": name}, headers={"Idempotency-Key": "one drive"})

    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda _: make(), range(6)))
    assert sorted(answer.status_code for answer in answers) == [200] * 5 + [201]
    (drive,) = {answer.json()["id"] for answer in answers}
    assert {answer.headers["location"] for answer in answers} == {f"{API}/drives/{drive}"}
    other = make("another")
    assert (other.status_code, other.json()["type"]) == (422, "/problems/idempotency-key-used-before")
    assert drive in other.json()["detail"]
    client.delete(f"/drives/{drive}").raise_for_status()
    assert make().status_code == 201  # the key means another drive now
    client.post(f"/trash/drives/{drive}/restore").raise_for_status()


def test_pages_of_listed_origins_may_read(client: httpx.Client) -> None:
    asked = {"Origin": SITE, "Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "authorization"}
    allowed = client.options("/drives", headers=asked)
    assert allowed.status_code == 200
    assert allowed.headers["access-control-allow-origin"] == SITE
    assert allowed.headers["access-control-allow-methods"] == "GET, HEAD"
    for answer in (client.get("/drives", headers={"Origin": SITE}), client.get("/drives/no", headers={"Origin": SITE})):
        assert answer.headers["access-control-allow-origin"] == SITE
        assert "Origin" in answer.headers["vary"]
        assert {"ETag", "Location"} <= set(answer.headers["access-control-expose-headers"].split(", "))
        assert "access-control-allow-credentials" not in answer.headers


def test_other_origins_and_other_methods_are_not_let_in(client: httpx.Client) -> None:
    def preflight(origin: str, method: str) -> httpx.Response:
        return client.options("/drives", headers={"Origin": origin, "Access-Control-Request-Method": method})

    foreign = preflight("https://evil.example", "GET")
    assert foreign.status_code == 400
    assert "access-control-allow-origin" not in foreign.headers
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        assert preflight(SITE, method).status_code == 400
    assert "access-control-allow-origin" not in client.get("/drives", headers={"Origin": "null"}).headers
    sent = client.post("/drives", json={"name": "a"}, headers={"Origin": SITE})
    assert (sent.status_code, sent.json()["type"]) == (403, "/problems/request-of-another-site")


@pytest.mark.parametrize(
    "origins", ["*", "maps.example", "https://maps.example/", "https://*.example", "https://a, file://b", "null"]
)
def test_what_is_no_origin_is_refused(origins: str) -> None:
    with pytest.raises(ValidationError, match="is not an origin"):
        Settings(cors_origins=origins)
