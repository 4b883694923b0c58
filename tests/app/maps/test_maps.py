"""Maps of many drives: what belongs to them is merged, whatever stops in between; the queue of their findings."""

import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import delete

from app.maps import routes
from app.store.database import Database
from app.store.models import CityMap, FeatureLayer
from tests.app.conftest import database_of, running_server
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
    assert served.client.put(f"{API}{address}/drives/nobody").status_code == 404
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
    missing = served.client.get(f"{API}/maps/{made}/ogc/collections/cities/items")
    assert missing.status_code == 404
    assert "There are city, " in missing.json()["detail"]
    assert served.client.delete(f"{API}/maps/{made}").status_code == 204


def test_maps_come_in_pages_and_a_client_has_no_more_than_it_may(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    for each in answers[:3]:
        served.client.delete(each.headers["location"]).raise_for_status()


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


def test_what_is_lost_is_made_anew_with_the_same_names(street: Street, served: Served) -> None:
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
