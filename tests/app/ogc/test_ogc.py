"""OGC API - Features: what the standard asks for, what filters find, what GDAL reads, and that it stays bounded."""

import base64
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import cql2
import httpx
import numpy as np
import pytest
from sqlalchemy import update

from app.context import Context
from app.http.parameters import Box
from app.ogc.collections import OF_ALL
from app.ogc.filters import MAX_CHARACTERS, Language, read_filter
from app.ogc.index import Query, Source, extents, find_page, index_missing, write_job_rows
from app.ogc.work import rows_of
from app.store.models import OF_RESULTS, Drive, FeatureLayer, Job
from app.trash import deletion as trash
from interloc.arrays import FloatArray
from interloc.output.credits import ODBL, map_credit
from interloc.output.geojson import write_collection
from interloc.output.layers import LAYERS
from interloc.output.properties import Origin, attributes_of
from tests.app.conftest import bearer, opened, running_server
from tests.app.processes import NO_TLS
from tests.qgis import ask_qgis, require_qgis

TOKEN = "a-token-for-a-gis"  # noqa: S105 - of no service
BASIC = {"Authorization": "Basic " + base64.b64encode(f"anybody:{TOKEN}".encode()).decode()}
COUNT = 1124
"""Detections of the drive in town."""
TOWN = (8.4, 49.0)
HOUR = "2026-03-01T12:"


def line(start: tuple[float, float], count: int) -> FloatArray:
    """Positions from west to east, 1 m apart; across the 180th meridian where it lies there."""
    lonlat = np.array(start) + np.arange(count)[:, None] * np.array([1e-5, 0.0])
    lonlat[:, 0] = (lonlat[:, 0] + 180.0) % 360.0 - 180.0
    return np.round(lonlat, 7)


def write_layer(folder: Path, name: str, geometries: list[Any], **columns: Any) -> None:
    layer, zero = LAYERS[name], {"int": 0, "float": 0.0}
    every = (*layer.attributes, *attributes_of(layer.details))
    nothing: dict[str, Any] = {each.name: [zero.get(each.kind)] * len(geometries) for each in every}
    credit = {"credit": map_credit(is_made_up=False)} if layer.is_osm or name == "matches" else {}
    features = layer.features(geometries, **(nothing | columns))
    write_collection(folder / f"{name}.geojson", features, local=False, **credit)


def write_result(folder: Path, lonlat: FloatArray, *, with_times: bool = False, scored: bool = True) -> None:
    """Write a result whose detections are at these places; of four, the last one is wrong."""
    folder.mkdir(parents=True)
    n = len(lonlat)
    rows = np.arange(n)
    wrong = (rows % 4 == 3) & scored
    times = [f"{HOUR}{i // 60 % 60:02}:{i % 60:02}.000Z" if with_times else None for i in range(n)]
    # First of old nodes, then of new ones, whose ids 32 bits do not hold: maps are sorted by id.
    nodes = np.where(rows < 80, 24_546_294 + rows // 8, 4_000_000_000 + rows // 8).tolist()
    found = {
        "branch_count": rows % 3 + 3,
        "branch_bearings_deg": [[0.0, 90.0, 180.5]] * n,
        "branch_widths_m": [[7.0, 6.5, None]] * n,
        "outcome": np.where(wrong, "wrong", "right" if scored else "unscored").tolist(),
        "osm_id": nodes if scored else [None] * n,
        "error_m": np.where(wrong, 7.5, rows / n) if scored else [None] * n,
        "reason": [f"Müller's 100% {i}" if w else None for i, w in enumerate(wrong.tolist())],
    }
    own = {"frame": rows, "id": [f"{i}-1" for i in range(n)], "time": times, "score": rows / n}
    belongs = [None if i % 2 else i // 100 + 1 for i in range(n)]
    write_layer(folder, "detections", lonlat.tolist(), **own, **found, intersection=belongs)
    write_layer(folder, "keyframes", lonlat.tolist(), frame=rows, heading_deg=np.zeros(n), time=times)
    few = slice(None, None, 100)
    seen = rows[few] + 1
    write_layer(
        folder,
        "intersections",
        lonlat[few].tolist(),
        id=seen,
        uid=[f"u{i}" for i in seen],
        observations=seen,
        position_std_m=np.full(len(seen), 0.5),
        position_cov_m2=[[0.25, 0.0, 0.25]] * len(seen),
        first_time=times[few],
        last_time=times[few],
        **{name: values[few] for name, values in found.items()},
    )
    write_layer(folder, "trajectory", [lonlat.tolist()], scans=[n])
    if scored:
        links = [[[lon, lat], [lon, lat + 1e-4]] for lon, lat in lonlat[:9].tolist()]
        of = {"outcome": ["TP"] * 9, "frame": rows[:9], "osm_id": nodes[:9], "detection": [f"{i}-1" for i in range(9)]}
        write_layer(folder, "matches", links[:n], **{name: values[:n] for name, values in of.items()})
        across = [[[lon, lat - 5e-4], [lon, lat + 5e-4]] for lon, lat in lonlat[:1].tolist()]
        write_layer(folder, "osm_roads", across, osm_id=[7], highway=["service"], is_drivable=[True])
    spans = {"georeferenced": True, "first_time": times[0], "last_time": times[-1]}
    (folder / "run.json").write_text(json.dumps({"labels": "predictions", **spans}))


def job(name: str, drive: str, **values: Any) -> Job:
    request = {"preset": "paper"}
    return Job(id=name, drive_id=drive, kind="intersections", owner="me", request=request, summary={}, **values)


def add_drive(context: Context, name: str, lonlat: FloatArray, **options: Any) -> str:
    """A drive with an older result (of two detections) and a newer one; the id of the newer job."""
    with context.database.writing() as session:
        drive = Drive(id=name, name=f"Straße {name}", owner="me", state="uploading", created_at=1.0, touched_at=4e9)
        session.add(drive)
        session.flush()
        for number, age in enumerate(("old", "new")):
            session.add(job(f"{name}-{age}", name, state="successful", created_at=1.0 + number, finished_at=9.0))
    write_result(context.storage.folder(f"jobs/{name}-old/result"), line((8.4, 49.0), 2))
    write_result(context.storage.folder(f"jobs/{name}-new/result"), lonlat, **options)
    return f"{name}-new"


def fill(context: Context) -> None:
    """Three drives: in town, with times and without a map, and across the 180th meridian."""
    add_drive(context, "town", line(TOWN, COUNT))
    add_drive(context, "timed", line((9.4, 50.0), 120), with_times=True, scored=False)
    add_drive(context, "fiji", line((179.9995, -17.0), 100))
    assert index_missing(context) == 6
    assert index_missing(context) == 0


@dataclass(frozen=True)
class Gis:
    """A server that needs a token, as a GIS sees it."""

    client: httpx.Client
    address: str
    asked: list[str]

    def get(self, path: str, **query: Any) -> httpx.Response:
        return self.client.get(path, params=query or None, headers={"Accept": "application/json"})

    def json(self, path: str, **query: Any) -> Any:
        return self.get(path, **query).raise_for_status().json()

    def items(self, collection: str = "detections", **query: Any) -> dict[str, Any]:
        found: dict[str, Any] = self.json(f"/ogc/collections/{collection}/items", **query)
        return found

    def refuses(self, collection: str = "detections", **query: Any) -> bool:
        return self.get(f"/ogc/collections/{collection}/items", **query).status_code == 400

    def matched(self, collection: str = "detections", **query: Any) -> int:
        return int(self.items(collection, limit=1, **query)["numberMatched"])

    def links(self, document: dict[str, Any]) -> dict[str, str]:
        return {link["rel"]: link["href"] for link in reversed(document["links"])}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    with opened(folder) as context:
        fill(context)
    return folder


@pytest.fixture(scope="module")
def gis(data: Path) -> Iterator[Gis]:
    asked: list[str] = []
    with (
        running_server(data, asked=asked, token=TOKEN) as address,
        httpx.Client(base_url=address, headers=bearer(TOKEN), timeout=60, verify=NO_TLS) as client,
    ):
        yield Gis(client, address, asked)


def test_landing_page(gis: Gis) -> None:
    for root in ("/ogc", "/api/v1/jobs/town-new/ogc"):
        links = gis.links(gis.json(root))
        assert {"self", "service-desc", "service-doc", "conformance", "data"} <= links.keys()
        assert all(href.startswith(f"{gis.address}/") for href in links.values())
        assert gis.json(links["self"]) == gis.json(root)


def test_api_definition(gis: Gis) -> None:
    for root in ("/ogc", "/api/v1/jobs/timed-new/ogc"):
        answer = gis.get(gis.links(gis.json(root))["service-desc"])
        assert answer.headers["content-type"] == "application/vnd.oai.openapi+json;version=3.0"
        api = answer.json()
        assert api["servers"] == [{"url": f"{gis.address}{root}"}]
        listed = [each["id"] for each in gis.json(f"{root}/collections")["collections"]]
        assert [each.split("/")[2] for each in api["paths"]] == listed
        operation = api["paths"]["/collections/detections/items"]["get"]
        named = {each["name"]: each["schema"] for each in operation["parameters"] if "name" in each}
        assert named["frame"] == {"type": "integer"}
        assert api["components"]["parameters"]["limit"]["schema"]["maximum"] == 10_000
        assert "cql-text" in named["filter-lang"]["enum"]


def test_conformance_classes(gis: Gis) -> None:
    classes = gis.json("/ogc/conformance")["conformsTo"]
    for name in ("1/1.0/conf/core", "3/1.0/conf/filter", "3/1.0/conf/queryables"):
        assert f"http://www.opengis.net/spec/ogcapi-features-{name}" in classes
    assert "http://www.opengis.net/spec/cql2/1.0/conf/basic-cql2" in classes


def test_collections(gis: Gis) -> None:
    listed = {each["id"]: each for each in gis.json("/ogc/collections")["collections"]}
    assert list(listed) == list(OF_ALL)
    assert not any("." in name for name in listed)
    town = listed["detections"]
    assert town["extent"]["spatial"]["bbox"] == [[-180.0, -17.0, 179.99999, 50.0]]
    assert town["extent"]["temporal"]["interval"] == [["2026-03-01T12:00:00Z", "2026-03-01T12:01:59Z"]]
    assert gis.links(town)["items"] == f"{gis.address}/ogc/collections/detections/items"
    assert gis.links(listed["matches"])["license"] == ODBL
    assert "license" not in gis.links(listed["keyframes"])
    of_job = [each["id"] for each in gis.json("/api/v1/jobs/timed-new/ogc/collections")["collections"]]
    own = ["intersections", "trajectory", "detections", "keyframes", "branches", "uncertainty"]
    assert of_job == own, "no map, no layers of one"


def test_one_collection(gis: Gis) -> None:
    links = gis.links(gis.json("/ogc/collections/detections"))
    assert {"self", "items", "describedBy", "http://www.opengis.net/def/rel/ogc/1.0/queryables"} <= links.keys()
    assert gis.get("/ogc/collections/nothing").status_code == 404
    assert gis.get("/api/v1/jobs/timed-new/ogc/collections/matches").status_code == 404


def test_items(gis: Gis) -> None:
    answer = gis.get("/ogc/collections/detections/items", limit=3, filter="job = 'town-new'")
    assert answer.headers["content-type"] == "application/geo+json"
    first = answer.json()["features"][0]
    of_result = {"drive": "Straße town", "job": "town-new", "preset": "paper", "labels": "predictions"}
    assert {name: first["properties"][name] for name in of_result} == of_result
    assert first["geometry"] == {"type": "Point", "coordinates": [8.4, 49.0]}
    assert gis.json(f"/ogc/collections/detections/items/{first['id']}")["properties"] == first["properties"]
    assert gis.get("/ogc/collections/detections/items/town-new.nothing").status_code == 404
    assert "JOB.ID" in gis.get("/ogc/collections/detections/items/0-1").json()["detail"]
    assert "id" not in first["properties"], "GDAL would have two fields of this name"
    assert gis.get("/ogc/collections/detections/items/town-old.0-1").status_code == 404, "not the newest"
    own = gis.json("/api/v1/jobs/town-old/ogc/collections/detections/items")
    assert [each["id"] for each in own["features"]] == ["0-1", "1-1"]
    assert "etag" in answer.headers


def test_limit(gis: Gis) -> None:
    assert gis.items(limit=7)["numberReturned"] == 7
    assert gis.items()["numberReturned"] == 1000
    assert gis.items(limit=100_000)["numberReturned"] == gis.matched() == COUNT + 220
    assert all(gis.refuses(limit=each) for each in (0, -1, "x", ""))


def test_bbox(gis: Gis) -> None:
    assert gis.matched(bbox="8.3999,48.9,8.400095,49.1") == 10
    assert gis.matched(bbox="8.3999,48.9,0,8.400095,49.1,9") == 10
    assert gis.matched(bbox="179,-18,-179,-16") == 100
    assert gis.matched(bbox="179,-18,180,-16") == 50
    assert gis.matched(bbox="-180,-18,-179,-16") == 50
    assert gis.matched("trajectory", bbox="-180,-18,-179,-16") == 1
    assert gis.matched("matches", bbox="8.39,49.00005,8.40003,49.01") == 4
    assert gis.matched(bbox="+8.3999, 4.89e1, 8.400095, 49.1") == 10
    assert gis.matched(bbox="179,-18,180,-16", drive="Straße town") == 0
    assert gis.matched(bbox="179,-18,180,-16", preset="paper") == 50
    for wrong in ("1,2,3", "1,2,3,x", "0,10,1,5", "0,0,200,1", "nan,0,1,1", ""):
        assert gis.refuses(bbox=wrong), wrong


def test_datetime(gis: Gis) -> None:
    timeless = gis.matched() - 120  # match every time (OGC 17-069r4, /req/core/fc-time-response)
    for datetime, expected in (
        (f"{HOUR}00:05Z", 1),
        (f"{HOUR}00:05Z/{HOUR}00:09Z", 5),
        (f"../{HOUR}00:09Z", 10),
        (f"{HOUR}01:50Z/", 10),
        ("2026-03-01", 120),
        ("2026-03-01/2026-03-02", 120),
        ("2026-02-28", 0),
    ):
        assert gis.matched(datetime=datetime) == expected + timeless, datetime
    assert gis.matched("trajectory", datetime=f"{HOUR}00:05Z") == gis.matched("trajectory")
    for wrong in ("..", "../..x", "2026-13-01", "tomorrow", f"{HOUR}01:50Z/{HOUR}01:00Z", "1/2/3", ""):
        assert gis.refuses(datetime=wrong), wrong
    assert gis.matched(datetime="../..") == gis.matched()


def test_links_to_next_pages(gis: Gis) -> None:
    query: dict[str, Any] = {"limit": 300, "filter": "outcome = 'right'"}
    document = gis.items(**query)
    ids = [[each["id"] for each in document["features"]]]
    while "next" in gis.links(document):
        document = gis.json(gis.links(document)["next"])
        ids.append([each["id"] for each in document["features"]])
    every = [each for page in ids for each in page]
    assert len(every) == len(set(every)) == document["numberMatched"] == (COUNT + 100) * 3 // 4
    assert gis.refuses(after="x")


def test_parameters_that_are_unknown_or_not_valid(gis: Gis) -> None:
    for path in ("", "/conformance", "/collections", "/collections/detections", "/collections/detections/items"):
        answer = gis.get(f"/ogc{path}", nonsense="1")
        assert (answer.status_code, answer.headers["content-type"]) == (400, "application/problem+json")
    for name, value in (
        ("f", "html"),
        ("offset", "3"),
        ("bbox-crs", "EPSG:3857"),
        ("filter-crs", "x"),
        ("filter-lang", "sql"),
    ):
        assert gis.refuses(**{name: value})
    for path, form in (("", "json"), ("/collections", "json"), ("/collections/detections/items", "geojson")):
        assert gis.get(f"/ogc{path}", f=form).status_code == 200


def test_filters_by_properties(gis: Gis) -> None:
    assert gis.matched(outcome="wrong") == gis.matched(filter="outcome = 'wrong'") == 306
    assert gis.matched(outcome="wrong", frame="3", filter="score < 1") == 2
    assert gis.matched(outcome=["right", "wrong"]) == gis.matched(outcome=["wrong", "right"]) == 0
    assert gis.matched("roads", is_driven="true") == 0
    assert gis.matched(time=f"{HOUR}00:05Z") == 1
    next_ = gis.links(gis.items(outcome="wrong", limit=5))["next"]
    assert {each["properties"]["outcome"] for each in gis.json(next_)["features"]} == {"wrong"}
    for name, value in (("frame", "x"), ("frame", "true"), ("score", "NaN"), ("frame", "9" * 400), ("geometry", "1")):
        assert gis.refuses(**{name: value}), name
    assert gis.refuses("roads", is_driven="1")
    for language in ("cql-text", "cql2-text"):  # GDAL writes 1 for true
        gis.items("roads", filter="is_driven = 1 AND is_driven <> 0", **{"filter-lang": language})


def test_queryables_and_schema(gis: Gis) -> None:
    schema = gis.json("/ogc/collections/detections/queryables")["properties"]
    assert schema["error_m"].items() >= {"type": "number", "x-ogc-unit": "m", "title": "Error"}.items()
    assert schema["time"].items() >= {"type": "string", "format": "date-time"}.items()
    assert schema["geometry"]["format"] == "geometry-point"
    assert set(Origin.model_fields) <= schema.keys()
    features = gis.json("/ogc/collections/detections/feature-schema")["properties"]["properties"]["properties"]
    assert schema.keys() - features.keys() == {"geometry"}
    assert features["osm_id"]["type"] == "string"
    lists = {"branch_bearings_deg", "branch_widths_m"}
    assert {*features, *lists} == gis.items(limit=1)["features"][0]["properties"].keys()


def test_the_token_by_header_and_as_a_password(gis: Gis) -> None:
    for source in ("", "/api/v1/jobs/town-new", "/api/v1/maps/default"):
        closed = gis.client.get(f"{source}/ogc", headers={"Authorization": "Bearer nonsense-nonsense"})
        assert closed.status_code == 401
        assert closed.headers["www-authenticate"].startswith('Basic realm="interloc", charset="UTF-8", Bearer')
    assert gis.client.get("/ogc", headers=BASIC).status_code == 200
    assert gis.client.get("/api/v1/jobs/town-new/ogc/collections", headers=BASIC).status_code == 200
    assert gis.client.get("/api/v1/drives", headers=BASIC).status_code == 200
    wrong = gis.client.get("/api/v1/drives", headers={"Authorization": "Basic !"})
    assert wrong.headers["www-authenticate"].startswith("Bearer"), "the page opens no dialogue of the browser"
    changes = gis.client.post("/api/v1/drives", json={"name": "a"}, headers=BASIC)
    assert changes.status_code == 401, "a browser repeats a password by itself, also for pages of other sites"


FILTERS = [
    *("outcome = 'wrong'", "error_m > 0.5 AND score <= 0.75", "0.5 < error_m OR branch_count = 4"),
    *("NOT (outcome = 'right')", "frame BETWEEN 10 AND 19", "frame IN (1, 2, 3, 5000)"),
    *("frame NOT IN (1, 2, 3)", "outcome IN ('right', 'nonsense')", "intersection IS NULL"),
    *("intersection IS NOT NULL AND frame < 7", "reason LIKE 'M%ller_s%3%'", "osm_id = '4000000013'"),
    *("osm_id IN ('24546294', '4000000013')", "osm_id LIKE '40%3'", "drive = 'Straße fiji' AND score > 0.5"),
    "S_INTERSECTS(geometry, BBOX(8.4001, 48.9, 8.4003, 49.1))",
    "NOT S_INTERSECTS(geometry, BBOX(8.4001, 48.9, 8.4003, 49.1)) AND frame > 3",
    "S_INTERSECTS(POINT(8.4 49.0), geometry)",
    *("frame < 3 OR S_INTERSECTS(geometry, BBOX(8.4001, 48.9, 8.4003, 49.1))", "TRUE"),
]


def holds(expression: cql2.Expr, feature: dict[str, Any]) -> bool:
    try:
        return bool(expression.matches(feature))
    except Exception as error:
        if "reduce" not in str(error):
            raise
        return False  # null is neither true nor false


def test_filters_find_what_the_package_finds_one_by_one(gis: Gis) -> None:
    features = gis.items(limit=10_000)["features"]
    for text in FILTERS:
        expression = cql2.parse_text(text)
        expected = [each["id"] for each in features if holds(expression, each)]
        assert len(expected) < len(features) or text == "TRUE"
        assert expected, text
        as_json = json.dumps(expression.to_json())
        for language, content in (("cql2-text", text), ("cql2-json", as_json)):
            found = gis.items(limit=10_000, filter=content, **{"filter-lang": language})["features"]
            assert [each["id"] for each in found] == expected, text


@pytest.mark.parametrize(("text", "expected"), [
    ("NOT (error_m > 1)", (COUNT + 100) * 3 // 4),  # neither true nor false of null
    ("error_m > 1 OR NOT (error_m > 1)", COUNT + 100),
    ("CASEI(drive) = CASEI('STRAßE TOWN')", COUNT),
    ("outcome LIKE 'W%'", 0),
    (r"reason LIKE '%100\% 7'", 2),
    ("reason LIKE '%%%%%%%%%%%%%%%%x'", 0),
    ("outcome = reason", 0),
    ("drive <> 7", COUNT + 220),
    ("osm_id = 4000000013", 8),
    ("osm_id = 'nowhere'", 0),
    ("preset = 'paper' AND job <> 'town-new'", 220),
    (f"time > TIMESTAMP('{HOUR}01:49Z')", 10),
    ("time BETWEEN DATE('2026-03-01') AND DATE('2026-03-02')", 120),
    (f"time < '{HOUR}00:10Z'", 10),
    ("time IS NULL", COUNT + 100),
    ("S_INTERSECTS(geometry, BBOX(179, -18, -179, -16))", 100),
])  # fmt: skip
def test_what_else_filters_find(gis: Gis, text: str, expected: int) -> None:
    assert gis.matched(filter=text) == expected


def deep(count: int) -> str:
    return '{"op":"not","args":[' * count + "true" + "]}" * count


HOSTILE = [
    *("((((", "outcome =", "nothing = 1", "geometry = 1", "frame = 'x'", "frame + 1 = 2"),
    *("ACCENTI(reason) = 'x'", "S_WITHIN(geometry, POINT(1 1))", "frame", "sleep(10) = 1"),
    *("branch_bearings_deg = 1", "time > 'tomorrow'", "outcome LIKE outcome", "outcome ILIKE 'a"),
    *("score > 1e999", "1; DROP TABLE jobs"),
    "(" * 5000 + "TRUE" + ")" * 5000,
    "NOT " * 3000 + "TRUE",
    " AND ".join(["frame > 1"] * 500),
    "frame IN (" + ",".join(["1"] * 500) + ")",
    "outcome = '" + "x" * MAX_CHARACTERS + "'",
    " OR ".join(["S_INTERSECTS(geometry, POINT(1 1))"] * 200),
    "S_INTERSECTS(geometry, LINESTRING(" + ",".join(f"{i % 90} {i % 7}" for i in range(2100)) + "))",
    "S_INTERSECTS(geometry, POLYGON((0 0, 1 0, 1 1, 0 0)))",
    "S_INTERSECTS(geometry, BBOX(1, 2, 3, 1))",
    "S_INTERSECTS(geometry, POINT(1e300 1))",
    "S_INTERSECTS(geometry, geometry)",
    deep(100),
    deep(20_000),
    '{"op": "=", "args": [{"property": "frame"}]}',
    '{"op": ["="], "args": []}',
    '{"op": "and", "args": []}',
    '{"op": "s_intersects", "args": [{"property": "geometry"}, {"type": "Point", "coordinates": [[["x"]]]}]}',
    f"T_AFTER(time, TIMESTAMP('{HOUR}01:49Z'))",
    '{"op": ">", "args": [{"property": "score"}, NaN]}',
    '{"op": "s_intersects", "args": [{"property": "geometry"}, {"bbox": [NaN, 1, 2, 3]}]}',
    '{"op": "s_intersects", "args": [{"property": "geometry"}, {"type": "Point", "coordinates": [NaN, 1]}]}',
    "{",
]


def test_hostile_filters_are_refused_soon(gis: Gis) -> None:
    for text in HOSTILE:
        for language in get_args(Language):
            began = time.process_time()
            answer = gis.get("/ogc/collections/detections/items", filter=text[:20_000], **{"filter-lang": language})
            assert answer.status_code == 400, (text[:80], language, answer.text[:200])
            assert answer.json()["type"] in {"/problems/filter-not-valid", "/problems/request-not-valid"}
            assert time.process_time() - began < 2.0, text[:80]


READ_BY_GDAL = """
import json, sys
import pyogrio

address, token, sql = sys.argv[1:]
of_all, of_job = f"OAPIF:{address}/ogc", f"OAPIF:{address}/api/v1/jobs/fiji-new/ogc"
found = {"tracks": pyogrio.read_info(of_all, layer="trajectory", USERPWD=f"qgis:{token}")["features"]}
pyogrio.set_gdal_config_options({"GDAL_HTTP_AUTH": "BEARER", "GDAL_HTTP_BEARER": token})
found["layers"] = [name for name, _ in pyogrio.list_layers(of_all)]
info = pyogrio.read_info(of_all, layer="detections")
found["types"] = dict(zip(info["fields"], info["dtypes"]))
found["count"] = info["features"]
every = pyogrio.read_dataframe(of_all, layer="detections")
found["every"] = [len(every), str(every.crs), every[every.job == "town-new"].geometry.iloc[0].coords[0]]
found["box"] = len(pyogrio.read_dataframe(of_all, layer="detections", bbox=(8.3999, 48.9, 8.400095, 49.1)))
found["where"] = len(pyogrio.read_dataframe(of_all, layer="detections", where=sql))
matches = pyogrio.read_dataframe(of_job, layer="matches")
found["matches"] = len(matches)
ids = [sorted({*layer.osm_id.dropna()}, key=int) for layer in (every, matches)]
found["nodes"] = [[each[0], each[-1]] for each in ids]
print(json.dumps(found))
"""

IN_SQL = "outcome = 'wrong' AND frame < 100 AND (reason ILIKE 'm%' OR time IS NOT NULL)"
IN_CQL = "((outcome = 'wrong') AND (frame < 100)) AND ((reason ILIKE 'm%') OR (NOT ((time IS NULL))))"


def test_gdal_reads_all_layers_by_a_password_and_by_a_header(gis: Gis) -> None:
    gis.asked.clear()
    # In a process of its own: GDAL would stop the threads of this one.
    command = [sys.executable, "-c", READ_BY_GDAL, gis.address, TOKEN, IN_SQL]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, timeout=120).stdout)
    types = found.pop("types")
    assert types["time"].startswith("datetime64"), "though the first page has none"
    assert (types["error_m"], types["frame"], types["osm_id"]) == ("float64", "int32", "object")
    assert found == {
        "tracks": 3,
        "layers": list(OF_ALL),
        "count": COUNT + 220,
        "every": [COUNT + 220, "EPSG:4326", list(TOWN)],
        "box": 10,
        "where": 50,
        "matches": 9,
        "nodes": [["24546294", f"{4_000_000_000 + (COUNT - 1) // 8}"], ["24546294", "24546295"]],
    }
    items = "/ogc/collections/detections/items?limit="
    assert f"{items}10000&filter={IN_CQL}&filter-lang=cql-text" in gis.asked
    assert any("bbox=8.3999" in each for each in gis.asked)


READ_BY_QGIS = """
address, token, *names = sys.argv[1:]

def layer_of(root, name, options=""):
    return QgsVectorLayer(f"url='{address}{root}' typename='{name}' {options}", name, "OAPIF")

def count(layer, *request):
    return sum(1 for _ in layer.getFeatures(*request))

password = f"username='anybody' password='{token}'"
told["closed"] = layer_of("/ogc", "detections").isValid()
log.clear()
told["layers"] = {name: describe(layer_of("/ogc", name, password)) for name in names}
pages = layer_of("/ogc", "detections", f"{password} pagingEnabled='true' pageSize='400'")
told["pages"] = [count(pages), len({each["job"] + each["id"] for each in pages.getFeatures()})]
near = layer_of("/ogc", "detections", f"{password} restrictToRequestBBOX='1'")
told["box"] = count(near, QgsFeatureRequest(QgsRectangle(8.3999, 48.9, 8.400095, 49.1)))
timed = layer_of("/api/v1/jobs/timed-new/ogc", "detections", password)
timed.setSubsetString("time >= '2026-03-01T12:01:50Z'")
told["since"] = [count(timed), types_of(timed)["time"]]
"""


def test_qgis_reads_all_layers(gis: Gis, tmp_path: Path) -> None:
    require_qgis()
    gis.asked.clear()
    told = ask_qgis(READ_BY_QGIS, gis.address, TOKEN, *OF_ALL, home=tmp_path)
    assert told["log"] == []
    assert told["closed"] is False
    layers = told["layers"]
    assert {name: layer["features"] for name, layer in layers.items()} == {name: gis.matched(name) for name in OF_ALL}
    types = layers["detections"]["types"]
    expected = {"frame": "Integer", "osm_id": "String", "error_m": "Real", "reason": "String"}
    assert {name: types[name] for name in expected} == expected, "though the first features have no reason"
    assert told["pages"] == [COUNT + 220] * 2
    assert sum("limit=400" in each for each in gis.asked) >= 4
    assert told["box"] == 10
    assert any("&bbox=8.3999" in each for each in gis.asked)
    assert told["since"] == [10, "DateTime"]
    assert any("datetime=2026-03-01T12:01:50" in each for each in gis.asked)


def test_the_rows_follow_trash_and_purge(tmp_path: Path) -> None:
    with opened(tmp_path) as context:
        newest = add_drive(context, "street", line(TOWN, 20))
        index_missing(context)

        def shown() -> int:
            with context.database.reading() as session:
                return extents(session, Source())["detections"].count

        assert shown() == 20
        for pinned, count in (("street-old", 2), (None, 20)):
            with context.database.writing() as session:
                session.execute(update(Drive).values(pinned_job=pinned))
            assert shown() == count
        trash.delete_drive(context, "street", "me")
        assert shown() == 0
        trash.restore(context, "street")
        assert shown() == 20
        trash.delete_job(context, newest, "me")
        assert shown() == 2, "of the job before"
        trash.delete_drive(context, "street", "me")
        trash.empty_trash(context)
        with context.database.reading() as session:
            assert session.query(FeatureLayer).count() == session.query(OF_RESULTS["detections"]).count() == 0


def test_postgresql_finds_the_same(data: Path, tmp_path: Path, postgres_url: str) -> None:
    text = "outcome = 'wrong' AND S_INTERSECTS(geometry, BBOX(8, 48, 9, 50))"
    queries = [
        Query(),
        Query(area=Box(179, -18, -179, -16)),
        Query(filter=read_filter(text, "cql2-text")),
        Query(filter=read_filter("CASEI(reason) LIKE CASEI('mÜller_s 100\\% 7%')", "cql2-text")),
        Query(interval=(0.0, 2e9), limit=7),
    ]
    found = []
    for folder, url in ((data, None), (tmp_path, postgres_url)):
        with opened(folder, database_url=url) as context:
            if url is not None:
                fill(context)
                layers = list(rows_of(context.storage.folder("jobs/town-new/result")))
                with context.database.writing() as session:  # again: in its own place
                    write_job_rows(session, session.get_one(Job, "town-new"), layers)
            with context.database.reading() as session:
                pages = [find_page(session, Source(), OF_ALL["detections"], query) for query in queries]
                matches = [(page.matched, sorted(page.features)) for page in pages[1:]]
                found.append((matches, extents(session, Source())))
    assert found[0] == found[1]
