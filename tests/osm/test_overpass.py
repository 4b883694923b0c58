"""Against a real HTTP server on this machine that serves a made-up town."""

import fcntl
import json
import logging
import socket
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import osmnx
import pytest

from interloc.errors import MapError, NetworkError, OutputError
from interloc.osm import overpass
from interloc.osm.intersections import intersection_nodes
from interloc.osm.overpass import download_roads

BOUNDS = (8.395, 48.995, 8.405, 49.005)


def node(number: int, lon: float, lat: float) -> dict[str, Any]:
    return {"type": "node", "id": number, "lon": lon, "lat": lat}


def way(number: int, nodes: list[int], **tags: str) -> dict[str, Any]:
    return {"type": "way", "id": number, "nodes": nodes, "tags": tags}


TOWN = {
    "version": 0.6,
    "osm3s": {"timestamp_osm_base": "2026-03-01T12:00:00Z"},
    "elements": [
        node(1, 8.400, 49.000),
        node(2, 8.403, 49.000),
        node(3, 8.397, 49.000),
        node(4, 8.400, 49.003),
        node(5, 8.4049, 49.000),
        node(6, 8.4060, 49.000),
        node(7, 8.4049, 49.002),
        way(10, [3, 1, 2, 5, 6], highway="residential", name="Made-up Street"),
        way(11, [1, 4], highway="residential", oneway="yes"),
        way(12, [5, 7], highway="service"),
        way(13, [1, 2, 4, 1], highway="pedestrian", area="yes"),
    ],
}


class Town(ThreadingHTTPServer):
    """Answers what it was told to, then the town; remembers who asked for what."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answering)
        self.daemon_threads = True
        self.asked: list[tuple[str, str]] = []
        self.first: list[tuple[int, dict[str, str], bytes]] = []
        self.delay_s = 0.0
        self.at_once = self.most_at_once = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/api"


class Answering(BaseHTTPRequestHandler):
    server: Town

    def do_POST(self) -> None:
        server = self.server
        server.at_once += 1
        server.most_at_once = max(server.most_at_once, server.at_once)
        body = self.rfile.read(int(self.headers["Content-Length"])).decode()
        server.asked.append((self.headers["User-Agent"], parse_qs(body)["data"][0]))
        time.sleep(server.delay_s)
        ok = (200, {"Content-Type": "application/json"}, json.dumps(TOWN).encode())
        status, headers, content = server.first.pop(0) if server.first else ok
        server.at_once -= 1
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: Any) -> None:
        """Keep quiet."""


@pytest.fixture
def town() -> Iterator[Town]:
    with Town() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_the_answer_becomes_a_road_graph_and_is_asked_for_once(town: Town, tmp_path: Path) -> None:
    roads = download_roads(BOUNDS, cache_dir=tmp_path, url=town.url)
    assert roads.node_id.tolist() == [1, 2, 3, 4, 5, 6, 7]  # 6 is outside, but the neighbour of 5
    assert roads.lonlat[0].tolist() == [8.4, 49.0]
    assert roads.ways.id.tolist() == [10, 11, 12, 13]
    assert roads.ways.name == ("Made-up Street", "", "", "")
    assert roads.ways.is_area.tolist() == [False, False, False, True]
    assert roads.node_id[roads.edges[roads.edge_way == 0]].tolist() == [[1, 2], [2, 5], [3, 1], [5, 6]]  # along the way
    assert roads.ways.direction.tolist() == [0, 1, 0, 0]
    assert (roads.date, roads.bounds) == ("2026-03-01T12:00:00Z", BOUNDS)
    assert town.url in roads.source
    assert intersection_nodes(roads, "drive").osm_id.tolist() == [1]
    assert intersection_nodes(roads, "drive+service").osm_id.tolist() == [1, 5]
    again = download_roads(BOUNDS, cache_dir=tmp_path, url=town.url)
    assert (again.date, again.edges.tolist()) == (roads.date, roads.edges.tolist())
    ((agent, query),) = town.asked
    assert agent.startswith("InterLoc/")
    assert 'way["highway"]' in query
    assert not list(tmp_path.glob("asking-*"))


def test_directions_are_those_of_the_tags_and_an_answer_with_a_remark_is_not_kept(town: Town, tmp_path: Path) -> None:
    ways = [
        way(10, [3, 1, 2], highway="motorway", oneway="no"),
        way(11, [1, 4], highway="residential", oneway="-1"),
        way(12, [2, 5], highway="motorway"),
        way(13, [5, 7], highway="motorway", oneway="reversible"),
    ]
    answer = {"elements": [*TOWN["elements"][:7], *ways], "remark": "slow"}
    town.first = [(200, {}, json.dumps(answer).encode())] * 2
    for _ in range(2):
        roads = download_roads(BOUNDS, cache_dir=tmp_path, url=town.url)
    assert roads.ways.direction.tolist() == [0, 1, 1, 0]
    assert roads.node_id[roads.edges[roads.edge_way == 1]].tolist() == [[4, 1]]
    assert len(town.asked) == 2


def test_nothing_global_stays_changed(town: Town, tmp_path: Path) -> None:
    before = {name: value for name, value in vars(osmnx.settings).items() if not name.startswith("_")}
    resolve = socket.getaddrinfo
    town.first = [(500, {}, b"oops")]
    with pytest.raises(NetworkError):
        download_roads(BOUNDS, cache_dir=tmp_path, url=town.url)
    download_roads(BOUNDS, cache_dir=tmp_path, url=town.url)
    assert {name: value for name, value in vars(osmnx.settings).items() if not name.startswith("_")} == before
    assert socket.getaddrinfo is resolve


@pytest.mark.parametrize("status", [429, 504])
def test_a_busy_server_is_waited_for_in_sight(
    town: Town, tmp_path: Path, status: int, caplog: pytest.LogCaptureFixture
) -> None:
    town.first = [(status, {"Retry-After": "1"}, b"busy")]
    told: list[tuple[str, float]] = []
    with caplog.at_level(logging.INFO, logger="interloc"):
        download_roads(BOUNDS, cache_dir=tmp_path, url=town.url, on_wait=lambda *words: told.append(words))
    reasons = [reason for reason, _ in told]
    assert any("Asking" in reason for reason in reasons)
    assert any(f"busy (status {status})" in reason for reason in reasons)
    assert "busy" in caplog.text
    assert len(town.asked) == 2


def test_patience_ends(town: Town, tmp_path: Path) -> None:
    town.first = [(429, {"Retry-After": "1"}, b"")] * 9
    with pytest.raises(NetworkError, match=r"busy \(status 429\); waited as long as allowed.*--osm"):
        download_roads(BOUNDS, cache_dir=tmp_path, url=town.url, max_wait_s=1.5)
    assert len(town.asked) == 2


def test_waiting_can_be_given_up(town: Town, tmp_path: Path) -> None:
    class GaveUpError(Exception):
        pass

    def give_up(reason: str, remaining_s: float) -> None:
        if "busy" in reason:
            raise GaveUpError

    town.first = [(429, {"Retry-After": "100"}, b"")]
    with pytest.raises(GaveUpError):
        download_roads(BOUNDS, cache_dir=tmp_path, url=town.url, on_wait=give_up)
    assert len(download_roads(BOUNDS, cache_dir=tmp_path, url=town.url).node_id) == 7


REFUSALS = {
    "406": ((406, {}, b"<html>"), "406 Not Acceptable"),
    "500": ((500, {}, b"<html>"), "answered 500"),
    "page": ((200, {}, b"<html>hello</html>"), "not an Overpass server"),
    "list": ((200, {}, b"[]"), "not an Overpass server"),
    "no map": ((200, {}, b'{"status": "ok"}'), "not an Overpass server"),
    "cut": ((200, {}, json.dumps({**TOWN, "elements": TOWN["elements"][1:]}).encode()), "left out nodes of its roads"),
    "remark": (
        (200, {}, json.dumps({**TOWN, "remark": "runtime error: Query timed out in 'query' at line 1"}).encode()),
        "gave up on the query",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals_are_explained_and_not_kept(town: Town, tmp_path: Path, name: str) -> None:
    answer, words = REFUSALS[name]
    town.first = [answer]
    with pytest.raises(NetworkError, match=words):
        download_roads(BOUNDS, cache_dir=tmp_path, url=town.url)
    assert [path.name for path in tmp_path.iterdir()] == ["overpass.lock"]


def test_an_area_without_roads_is_an_error_of_the_map(town: Town, tmp_path: Path) -> None:
    town.first = [(200, {}, b'{"elements": []}')]
    with pytest.raises(MapError, match="no highways within"):
        download_roads(BOUNDS, cache_dir=tmp_path, url=town.url)


def test_a_silent_server_is_given_up(town: Town, tmp_path: Path) -> None:
    town.delay_s = 2.0
    with pytest.raises(NetworkError, match="did not answer within 1 s"):
        download_roads(BOUNDS, cache_dir=tmp_path, url=town.url, timeout_s=1)


def test_no_server_is_said_at_once(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    start = time.monotonic()
    with pytest.raises(NetworkError, match="cannot be reached"):
        download_roads(BOUNDS, cache_dir=tmp_path, url=f"http://127.0.0.1:{port}/api")
    assert time.monotonic() - start < 20


def test_threads_ask_one_after_the_other(town: Town, tmp_path: Path) -> None:
    town.delay_s = 0.1
    areas = [(8.395, 48.995, 8.405, 49.005 + i / 1000) for i in range(3)]
    threads = [
        threading.Thread(target=download_roads, args=(area,), kwargs={"cache_dir": tmp_path, "url": town.url})
        for area in areas
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(town.asked), town.most_at_once) == (3, 1)


def test_another_process_is_waited_for_in_sight(town: Town, tmp_path: Path) -> None:
    told: list[str] = []
    with (tmp_path / "overpass.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(NetworkError, match="Another process is asking"):
            download_roads(
                BOUNDS, cache_dir=tmp_path, url=town.url, max_wait_s=1.5, on_wait=lambda reason, _: told.append(reason)
            )
    assert told
    assert town.asked == []


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ((8.5, 49.0, 8.4, 49.1), "not an area"),
        ((8.4, 49.0, 8.5, float("nan")), "not an area"),
        ((179.9, -16.9, -179.9, -16.7), "crosses the 180th meridian"),
        ((5.0, 45.0, 15.0, 55.0), "too large"),
    ],
)
def test_bounds_are_checked(tmp_path: Path, bounds: overpass.Bounds, words: str) -> None:
    with pytest.raises(MapError, match=words):
        download_roads(bounds, cache_dir=tmp_path)


def test_a_cache_that_is_a_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cache"
    path.write_text("")
    with pytest.raises(OutputError, match="cache of map downloads"):
        download_roads(BOUNDS, cache_dir=path)
