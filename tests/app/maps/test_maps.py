"""Maps of many drives: what belongs to them is merged, whatever stops in between; the queue of their findings."""

import json
import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import delete, event, select
from sqlalchemy.orm import Session

from app.context import Context
from app.http.problems import Problem
from app.maps import routes
from app.maps.records import SERVER_MAP, Standing, find_map, make_server_map, standings_of
from app.ogc.collections import OF_MAP
from app.ogc.index import Query, Source, find_page, write_map_rows
from app.ogc.work import rows_of_map
from app.store.database import Database
from app.store.models import OF_MAPS, CityMap, Drive, FeatureLayer, Job, MapDrive, MapVerdict
from app.store.tokens import add_token
from app.upkeep.backup import back_up
from interloc.output.layers import CITY_LAYERS
from tests.app.conftest import Serve, bearer, database_of, opened, running_server
from tests.app.kills import killed, put_map
from tests.app.processes import API, every, wait_until
from tests.app.results.conftest import add_drive, add_job, work
from tests.app.street import in_a_town, write_street

EAST_DEG = 1.37e-4  # 10 m
CROSSING = 'lon="8.400821'  # of the street at 60 m


@dataclass(frozen=True)
class Street:
    """Two drives along a street that have ended, and an OSM file with one of its crossings 10 m to the east."""

    root: Path
    osm: bytes

    def fill(self, data: Path, database: Database) -> None:
        for drive, job in (("monday", "first"), ("tuesday", "second")):
            add_drive(database, data, drive, self.root / drive)
            add_job(database, data, job, drive, self.root / job, finished_at=1.0, summary={"georeferenced": True})


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Street:
    root = tmp_path_factory.mktemp("street")
    for name, scans, job in (("monday", 62, "first"), ("tuesday", 63, "second")):
        work(write_street(root / name, scans), root / job, scored=False)
    osm = in_a_town((root / "monday" / "map.osm").read_text())
    moved = re.sub(r'(<node id="[789]" .*lon=)"([^"]*)"', lambda node: f'{node[1]}"{float(node[2]) + EAST_DEG}"', osm)
    return Street(root, moved.encode())


@dataclass(frozen=True)
class Served:
    client: httpx.Client
    data: Path

    def get(self, path: str, **options: Any) -> Any:
        answer = self.client.get(f"{API}{path}", **options)
        answer.raise_for_status()
        return answer.json()

    def until(self, path: str, is_so: Callable[[Any], bool]) -> Any:
        def look() -> Any:
            found = self.client.get(f"{API}{path}")
            return found.json() if found.is_success and is_so(found.json()) else None

        return wait_until(look, path, every_s=0.05)


@pytest.fixture(scope="module")
def served(street: Street, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    data = tmp_path_factory.mktemp("data")
    with running_server(data) as address, httpx.Client(base_url=address, timeout=60) as client:
        server = Served(client, data)
        with database_of(data) as database:
            street.fill(data, database)
        client.put(f"{API}/maps/default/osm/town.osm", content=street.osm).raise_for_status()
        yield server


def ready(city: dict[str, Any]) -> bool:
    return city["revision"] > 0 and not city["is_waiting"]


def test_all_drives_become_the_map_of_the_server(served: Served) -> None:
    city = served.until("/maps/default", ready)
    assert (city["drives"], city["intersections"], city["seen_by_several"]) == (2, 3, 3)
    assert (city["findings"], city["osm"], city["problem"], city["is_made_up"]) == (1, "town.osm", None, False)
    assert city["bbox"][0] == pytest.approx(8.4, abs=1e-3)
    drives = served.get("/maps/default/drives", params={"limit": 1})
    assert [(each["drive_id"], each["label"], each["job_id"]) for each in drives["drives"]] == [
        ("monday", "Straße monday", "first")
    ]
    assert served.get("/maps/default/drives", params={"after": drives["next"]})["drives"][0]["job_id"] == "second"
    assert served.get("/maps")["maps"] == [city]
    assert served.client.delete(f"{API}/maps/default").status_code == 409
    tracks = served.get("/maps/default/files/drives.geojson")["features"]
    assert [each["id"] for each in tracks] == ["Straße monday", "Straße tuesday"]


def test_a_map_and_its_findings_are_layers_of_a_gis(served: Served) -> None:
    served.until("/maps/default", ready)
    listed = served.get("/maps/default/ogc/collections")["collections"]
    assert sorted(each["id"] for each in listed) == ["changes", "city", "drives", "findings", "roads"]
    items = "/maps/default/ogc/collections/city/items"
    page = served.get(items, params={"limit": 2, "filter": "passes >= 2", "bbox": "8.39,48.9,8.41,49.1"})
    assert (page["numberMatched"], page["numberReturned"]) == (3, 2)
    one = page["features"][0]
    assert one["properties"]["drive_names"] == "Straße monday, Straße tuesday"
    assert "job" not in one["properties"]
    assert served.get(f"{items}/{one['id']}")["properties"] == one["properties"]
    schema = served.get("/maps/default/ogc/collections/drives/queryables")
    assert {"drive", "offset_east_m"} < schema["properties"].keys()
    tracks = served.get("/maps/default/ogc/collections/drives/items")["features"]
    assert [each["properties"]["drive"] for each in tracks] == ["Straße monday", "Straße tuesday"]


def test_a_map_of_its_own_holds_what_was_put_into_it(street: Street, served: Served) -> None:
    made = served.client.post(f"{API}/maps", json={"name": "North", "drives": ["monday"]})
    assert made.status_code == 201
    address = made.headers["location"].removeprefix(API)
    one = served.until(address, lambda city: city["drives"] == 1)
    assert (one["name"], one["holds_all"], one["intersections"]) == ("North", False, 3)
    names = {each["properties"]["uid"] for each in served.get(f"{address}/files/city.geojson")["features"]}
    served.client.put(f"{API}{address}/drives/tuesday").raise_for_status()
    served.until(address, lambda city: city["drives"] == 2)
    made_up = street.osm.replace(b"<osm", b'<osm generator="interloc simulate"', 1)
    served.client.put(f"{API}{address}/osm/town.osm", content=made_up).raise_for_status()
    served.until(address, lambda city: city["is_made_up"])  # nobody is named for it
    served.client.put(f"{API}{address}/osm/town.osm", content=b"<osm><node").raise_for_status()
    assert "town.osm" in served.until(address, lambda city: city["problem"] and ready(city))["problem"]
    served.client.delete(f"{API}{address}/drives/monday").raise_for_status()
    served.until(address, lambda city: city["drives"] == 1)
    left = served.get(f"{address}/files/city.geojson")["features"]
    assert {each["properties"]["uid"] for each in left} == names
    assert {each["properties"]["drive_names"] for each in left} == {"Straße tuesday"}
    served.client.delete(f"{API}{address}/drives/tuesday").raise_for_status()
    emptied = served.until(address, lambda city: city["drives"] == 0)
    assert (emptied["findings"], emptied["problem"], emptied["bbox"]) == (None, None, None)
    for change in (served.client.put, served.client.delete):
        assert change(f"{API}{address}/drives/nobody").status_code == 404
    served.client.delete(f"{API}{address}").raise_for_status()
    assert served.client.get(f"{API}{address}").status_code == 404
    folder = served.data / address.removeprefix("/")
    wait_until(lambda: not folder.exists(), "its folder to go, whatever was under way")


def test_findings_are_looked_at_one_after_the_other(served: Served) -> None:
    served.until("/maps/default", ready)
    (entry,) = served.get("/maps/default/queue")["entries"]
    assert (entry["kind"], entry["verdict"]) == ("moved", None)
    picture = served.client.get(entry["picture"])
    assert picture.content.startswith(b"\x89PNG")
    assert f"{entry['lat']}" in entry["links"]["id"]
    deliveries = "/maps/default/deliveries"
    assert served.client.get(f"{API}{deliveries}/maproulette.geojson").text.count("\x1e") == 1
    address = f"{API}/maps/default/queue/{entry['id']}"
    assert served.client.put(f"{address}/verdict", json={"verdict": "maybe"}).status_code == 422
    judged = served.client.put(f"{address}/verdict", json={"verdict": "right", "note": "a street"}).json()
    assert (judged["verdict"]["by"], judged["verdict"]["note"], judged["next"]) == ("anonymous", "a street", None)
    page = served.get("/maps/default/queue")
    assert (page["entries"], page["open"], page["judged"]) == ([], 0, 1)
    assert page["precision"]["low"] == pytest.approx(0.2065, abs=1e-4)
    served.client.put(f"{address}/verdict", json={"verdict": "wrong"}).raise_for_status()
    assert served.client.get(f"{API}{deliveries}/maproulette.geojson").text == ""
    gone = served.until("/maps/default", lambda city: city["findings"] == 0)  # compared again without the place
    assert ready(gone)
    kept = served.get(f"/maps/default/queue/{entry['id']}")
    assert [each["verdict"] for each in kept["history"]] == ["right", "wrong"]
    assert kept["properties"] is None
    assert served.client.delete(f"{address}/verdict").status_code == 204  # it was a mistake
    served.until("/maps/default", lambda city: city["findings"] == 1)
    assert served.get(f"/maps/default/queue/{entry['id']}")["verdict"]["verdict"] == "right"
    served.client.delete(f"{address}/verdict").raise_for_status()
    assert served.client.delete(f"{address}/verdict").status_code == 404


def test_a_map_that_was_not_merged_yet_has_empty_collections(served: Served) -> None:
    made = served.client.post(f"{API}/maps", json={"name": "new", "drives": []}).json()["id"]
    assert served.get(f"/maps/{made}/ogc/collections/city/items")["features"] == []
    assert served.get(f"/maps/{made}/ogc/collections/city")["id"] == "city"
    assert served.client.post(f"{API}/maps", json={"name": "new", "drive_ids": []}).status_code == 422
    assert served.client.put(f"{API}/maps/{made}/osm/a.txt", content=b"").json()["type"] == "/problems/not-a-map"
    missing = served.client.get(f"{API}/maps/{made}/ogc/collections/cities/items")
    assert missing.status_code == 404
    assert "There are city, " in missing.json()["detail"]
    assert served.client.delete(f"{API}/maps/{made}").status_code == 204


def test_maps_come_in_pages_and_no_client_has_more_than_it_may(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routes, "MAX_MAPS", 3)
    answers = [served.client.post(f"{API}/maps", json={"name": f"map {number}"}) for number in range(4)]
    assert [each.status_code for each in answers] == [201, 201, 201, 429]
    assert answers[3].json()["type"] == "/problems/too-many-maps"
    assert [each["name"] for each in every(served.client, f"{API}/maps", "maps", limit=2)] == [
        "All drives",
        "map 0",
        "map 1",
        "map 2",
    ]
    page = served.get("/maps", params={"limit": 2})
    for each in answers[:3]:
        served.client.delete(each.headers["location"]).raise_for_status()
    assert served.get("/maps", params={"after": page["next"]}) == {"maps": [], "next": None}  # the last one has gone


def test_two_verdicts_at_once_are_both_kept(served: Served) -> None:
    served.until("/maps/default", ready)
    (entry,) = served.get("/maps/default/queue", params={"state": "all"})["entries"]
    address = f"{API}/maps/default/queue/{entry['id']}"
    with ThreadPoolExecutor(8) as threads:
        given = ["right", "cannot_tell"] * 4
        put = lambda verdict: served.client.put(f"{address}/verdict", json={"verdict": verdict})  # noqa: E731
        assert {each.status_code for each in threads.map(put, given)} == {200}
    kept = served.client.get(address).json()
    assert len(kept["history"]) == 8
    assert kept["verdict"] == kept["history"][-1]
    for _ in given:
        served.client.delete(f"{address}/verdict").raise_for_status()


def test_what_is_lost_is_made_anew_with_the_same_names(served: Served) -> None:
    before = served.until("/maps/default", ready)
    features = served.get("/maps/default/files/city.geojson")["features"]
    (served.data / "maps/default/city/state.npz").write_bytes(b"damaged")
    (served.data / "maps/default/city/city.json").unlink()
    with database_of(served.data) as database, database.writing() as session:
        session.execute(delete(FeatureLayer).where(FeatureLayer.map_id == "default"))
    after = served.until("/maps/default", lambda city: city["revision"] > before["revision"] and ready(city))
    assert served.get("/maps/default/files/city.geojson")["features"] == features
    assert after["findings"] == before["findings"]
    assert served.get("/maps/default/ogc/collections/city/items")["numberMatched"] == 3


@pytest.mark.parametrize("part", ["", "/audit"])
def test_a_map_that_cannot_be_written_says_why_until_it_can(part: str, served: Served, street: Street) -> None:
    made = served.client.post(f"{API}/maps", json={"name": "in the way"}).raise_for_status().json()
    address = f"/maps/{made['id']}"
    in_the_way = served.data / f"{address[1:]}{part}"
    in_the_way.parent.mkdir(exist_ok=True)
    in_the_way.write_text("no folder")
    if part:
        served.client.put(f"{API}{address}/osm/town.osm", content=street.osm).raise_for_status()
    served.client.put(f"{API}{address}/drives/monday").raise_for_status()
    told = served.until(address, lambda city: city["problem"])
    reason = f"{address[1:]}/audit is a file" if part else "The service failed at the map, once."
    assert told["problem"].startswith(reason)
    assert (told["is_waiting"], told["drives"]) == (True, int(bool(part)))
    in_the_way.unlink()
    after = served.until(address, ready)
    assert (after["problem"], after["drives"]) == (None, 1)
    served.client.delete(f"{API}{address}").raise_for_status()


@pytest.mark.parametrize("owner", ["killed", None])
def test_a_map_whose_server_ended_in_the_middle_is_made_anew(owner: str | None, served: Served) -> None:
    made = served.client.post("/api/v1/maps", json={"name": "left empty"}).raise_for_status().json()
    with database_of(served.data) as database, database.writing() as session:  # its worker may still have written
        city = session.get_one(CityMap, made["id"])
        city.lease_owner, city.lease_until = owner, database.clock(session) - 1.0
    address = f"/maps/{made['id']}"
    after = served.until(address, lambda city: city["revision"] == 1 and not city["is_at_work"])
    assert (after["drives"], after["is_waiting"]) == (0, False)
    served.client.delete(f"/api/v1{address}").raise_for_status()


@pytest.fixture
def context(tmp_path: Path) -> Iterator[Context]:
    """Two drives with a job that has ended each, and an older one of the first."""
    with opened(tmp_path) as context:
        make_server_map(context)
        with context.database.writing() as session:
            for name in ("monday", "tuesday"):
                session.add(Drive(id=name, name=name, owner="me", state="ready", created_at=1.0, touched_at=1.0))
            session.flush()
            for job, drive, at in (("old", "monday", 1.0), ("first", "monday", 2.0), ("second", "tuesday", 3.0)):
                end_job(session, job, drive, at)
        yield context


def end_job(session: Session, job: str, drive: str, at: float) -> None:
    values = {"owner": "me", "kind": "intersections", "state": "successful", "request": {"osm": {"file": "map.osm"}}}
    session.add(Job(id=job, drive_id=drive, created_at=at, finished_at=at, **values))


def judge(session: Session, number: str, verdict: str) -> None:
    at = f"2026-11-25T12:0{number}:00Z"
    judgement = {"finding": "moved-7", "kind": "moved", "verdict": verdict, "by": "Anna", "at": at, "lon": 8, "lat": 49}
    session.add(MapVerdict(id=number, map_id=SERVER_MAP, finding="moved-7", at=float(number), judgement=judgement))


def pin(session: Session, job: str) -> None:
    session.get_one(Drive, "monday").pinned_job = job


def trash(session: Session, kind: type[Drive | Job], name: str, at: float | None = 5.0) -> None:
    session.get_one(kind, name).deleted_at = at


def belong(session: Session, drive: str, is_member: bool | None) -> None:
    session.merge(MapDrive(map_id=SERVER_MAP, drive_id=drive, is_member=is_member))


def standing(context: Context) -> Standing:
    with context.database.reading() as session:
        return standings_of(session, context, [find_map(session, SERVER_MAP)])[SERVER_MAP]


def test_many_maps_cost_few_queries(context: Context) -> None:
    asked: list[str] = []
    event.listen(context.database.engine, "before_cursor_execute", lambda *of: asked.append(of[2]))
    with context.database.writing() as session:
        for number in range(300):
            session.add(CityMap(id=f"m{number}", name="m", owner="me", created_at=float(number)))
            session.flush()
            session.add(MapDrive(map_id=f"m{number}", drive_id="monday", is_member=True))
    asked.clear()
    with context.database.reading() as session:
        cities = session.scalars(select(CityMap)).all()
        found = standings_of(session, context, cities)
        assert [[job.id for job in found[name].jobs] for name in ("m0", "m299")] == [["first"]] * 2
        assert len(asked) < 10


def test_rows_of_a_map_take_the_place_of_those_before(context: Context) -> None:
    def place(number: int) -> dict[str, Any]:
        facts = {each.name: None for each in CITY_LAYERS["city"].attributes} | {"uid": f"p{number}", "passes": number}
        return {"id": f"p{number}", "geometry": {"type": "Point", "coordinates": [8.4, 49.0]}, "properties": facts}

    before = None
    for count in (7, 3):
        with context.database.writing() as session:
            write_map_rows(session, SERVER_MAP, rows_of_map({"city": [place(number) for number in range(count)]}))
            assert session.query(OF_MAPS["city"]).count() == count
            page = find_page(session, Source(map=SERVER_MAP), OF_MAP["city"], Query(limit=2))
            assert page.matched == count
            if before is not None:
                with pytest.raises(Problem, match="Begin with the first one again"):
                    find_page(session, Source(map=SERVER_MAP), OF_MAP["city"], Query(after=before))
            before = page.next


def test_a_track_across_180_degrees_comes_in_parts(context: Context) -> None:
    facts = dict.fromkeys([each.name for each in CITY_LAYERS["drives"].attributes]) | {"drive": "a"}
    line = {"type": "LineString", "coordinates": [[179.999, 40.0], [-179.999, 40.0]]}
    with context.database.writing() as session:
        rows = rows_of_map({"drives": [{"id": "a", "geometry": line, "properties": facts}]})
        write_map_rows(session, SERVER_MAP, rows)
        (feature,) = find_page(session, Source(map=SERVER_MAP), OF_MAP["drives"], Query()).features
    assert json.loads(feature)["geometry"]["type"] == "MultiLineString"


CHANGES: list[tuple[Callable[[Session], None], list[str], int]] = [
    (lambda session: end_job(session, "third", "tuesday", 4.0), ["first", "third"], 0),
    (lambda session: pin(session, "old"), ["old", "third"], 0),
    (lambda session: pin(session, "first"), ["first", "third"], 0),
    (lambda session: trash(session, Job, "third"), ["first", "second"], 0),
    (lambda session: trash(session, Drive, "monday"), ["second"], 0),
    (lambda session: trash(session, Drive, "monday", None), ["first", "second"], 0),
    (lambda session: belong(session, "tuesday", False), ["first"], 0),
    (lambda session: belong(session, "tuesday", None), ["first", "second"], 0),
    (lambda session: judge(session, "1", "wrong"), ["first", "second"], 1),
    (lambda session: judge(session, "2", "right"), ["first", "second"], 0),
    (lambda session: session.delete(session.get_one(MapVerdict, "2")), ["first", "second"], 1),
    (lambda session: session.delete(session.get_one(Job, "first")), ["old", "second"], 1),
]


def test_every_change_is_seen_at_once(context: Context) -> None:
    assert [(job.id, job.osm) for job in standing(context).jobs] == [("first", "map.osm"), ("second", "map.osm")]
    for change, jobs, wrong in CHANGES:
        with context.database.writing() as session:
            change(session)
        now = standing(context)
        assert ([job.id for job in now.jobs], len(now.wrong), now.is_stale) == (jobs, wrong, True)


SIZES = range(20_000, 20_008)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return tmp_path / "data"


def put(client: httpx.Client, address: str, size: int) -> int:
    return client.put(address, content=b"<osm>" + b" " * size).status_code


def osm_files(data: Path, map_id: str) -> list[int]:
    return [path.stat().st_size - 5 for path in (data / "maps" / map_id / "osm").glob("*")]


def test_a_map_that_is_deleted_while_files_come_is_gone_whole(serve: Serve, data: Path) -> None:
    client = serve(data)
    with ThreadPoolExecutor(len(SIZES) + 1) as pool:
        for _ in range(10):
            made = client.post(f"{API}/maps", json={"name": "town"}).json()["id"]
            puts = [pool.submit(partial(put, client, f"{API}/maps/{made}/osm/{n}.osm"), n) for n in SIZES]
            assert client.delete(f"{API}/maps/{made}").status_code == 204
            assert {each.result() for each in puts} <= {204, 404}
            assert not (data / "maps" / made).exists()


def test_a_server_that_is_killed_loses_no_file_of_a_map(serve: Serve, data: Path) -> None:
    client = serve(data)
    made = client.post(f"{API}/maps", json={"name": "town"}).json()["id"]
    assert put(client, f"{API}/maps/{made}/osm/a.osm", 10) == 204
    killed(put_map, data, made, "b.osm")
    assert (data / f"maps/{made}/osm/a.osm").stat().st_size == 15
    assert put(client, f"{API}/maps/{made}/osm/c.osm", 20) == 204
    assert osm_files(data, made) == [20]


def test_files_of_maps_count_for_their_owner_and_are_backed_up(serve: Serve, data: Path, tmp_path: Path) -> None:
    with opened(data) as context:
        ann, bob = [bearer(add_token(context.database, name, max_bytes=50_000)) for name in ("ann", "bob")]
    client = serve(data)
    one, other = (client.post(f"{API}/maps", json={"name": "a"}, headers=ann).json()["id"] for _ in range(2))

    def send(map_id: str, size: int, headers: dict[str, str]) -> int:
        address = f"{API}/maps/{map_id}/osm/town.osm"
        return client.put(address, content=b" " * size, headers=headers).status_code

    assert [send(one, 40_000, ann), send(one, 45_000, ann), send(other, 10_000, ann)] == [204, 204, 413]
    assert osm_files(data, other) == []
    assert [send(one, 20_000, bob), send(one, 20_000, ann), send(other, 30_000, ann)] == [413, 204, 204]
    wrong = {"Content-Digest": f"sha-256=:{'A' * 43}=:", **ann}
    assert send(one, 10_000, wrong) == 422
    assert osm_files(data, one) == [19_995]
    assert client.delete(f"{API}/maps/{one}", headers=bob).status_code == 204
    assert send(other, 45_000, ann) == 204
    with opened(data) as context:
        back_up(context, tmp_path / "backup", lambda *_: None)
    assert (tmp_path / f"backup/maps/{other}/osm/town.osm").stat().st_size == 45_000
