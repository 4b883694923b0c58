"""Roads from a public Overpass server.

osmnx asks. This module makes it polite, and never silent: a user agent of its own, one request at a time over all
threads and processes, answers kept on disk, every wait announced, every refusal explained.
"""

import hashlib
import json
import logging
import math
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from platformdirs import user_cache_path

from interloc.errors import MapError, NetworkError, OutputError
from interloc.osm.graph import KEPT_TAGS, Bounds, RoadGraph, Ways, layer_of

logger = logging.getLogger(__name__)

OVERPASS_URL = "https://overpass-api.de/api"
REQUEST_TIMEOUT_S = 90
MAX_WAIT_S = 300.0
DEFAULT_PAUSE_S = 30.0
MAX_AREA_KM2 = 2_000.0

OnWait = Callable[[str, float], None]
"""Called once per second of waiting with the reason and the seconds left; may raise to give up."""

_ONE_AT_A_TIME = threading.Lock()
_INSTEAD = "Give the map as a file (--osm), or try again later."


class _BusyError(Exception):
    """The server has no free slot now."""

    def __init__(self, status: int, pause_s: float) -> None:
        super().__init__(status)
        self.status = status
        self.pause_s = pause_s


def download_roads(
    bounds: Bounds,
    *,
    cache_dir: Path | None = None,
    on_wait: OnWait | None = None,
    url: str = OVERPASS_URL,
    max_wait_s: float = MAX_WAIT_S,
    timeout_s: int = REQUEST_TIMEOUT_S,
) -> RoadGraph:
    """Fetch all highways within bounds (degrees) from an Overpass server, or from the cache.

    Answers are kept in `cache_dir`, by default the cache folder of the user, one folder per answer, until somebody
    deletes them. `on_wait` is called at every wait, and before the server is asked (with the seconds that it may take);
    `max_wait_s` limits all waits for a free slot and for another process that asks, `timeout_s` that for an answer.
    Bounds that are no area, too large a one, or without highways are a MapError; what the server refuses a
    NetworkError; a cache that cannot be written an OutputError.
    """
    _check(bounds)
    wait = _Waiting(on_wait, max_wait_s)
    cache_dir = cache_dir or user_cache_path("interloc") / "overpass"
    # osmnx finds its answers by the text of its query, which another version may write differently.
    key = f"osmnx {version('osmnx')} {url} {bounds}"
    answer = cache_dir / hashlib.sha256(key.encode()).hexdigest()[:32]
    try:
        cache_dir.mkdir(parents=True, exist_ok=True)
        graph = None
        with _ONE_AT_A_TIME:
            if not answer.is_dir():
                with _lock(cache_dir / "overpass.lock", wait):
                    if not answer.is_dir():  # the process that held the lock may have asked the same
                        graph = _fetch(bounds, url, answer, timeout_s, wait)
            if graph is None:
                graph = _ask(bounds, url, answer, timeout_s)
            heads = [json.loads(path.read_bytes()).get("osm3s", {}) for path in answer.glob("*.json")]
    except OSError as error:
        raise OutputError(f"{cache_dir}: the cache of map downloads cannot be used ({error}).") from error
    dates = [each["timestamp_osm_base"] for each in heads if each.get("timestamp_osm_base")]
    return _road_graph(graph, bounds, url, min(dates, default=None))


def _check(bounds: Bounds) -> None:
    west, south, east, north = bounds
    if west - east > 180.0:
        raise MapError(
            "the area crosses the 180th meridian, for which Overpass has no box. Give the map as a file (--osm)."
        )
    if not (all(map(math.isfinite, bounds)) and -180 <= west < east <= 180 and -90 <= south < north <= 90):
        raise MapError(f"bounds {bounds} are not an area. Expected west < east and south < north, in degrees.")
    area_km2 = (north - south) * 111.2 * (east - west) * 111.3 * math.cos(math.radians((north + south) / 2))
    if area_km2 > MAX_AREA_KM2:
        raise MapError(
            f"the area is {area_km2:,.0f} km2, too large to ask a public server for (at most {MAX_AREA_KM2:,.0f}). "
            "Give the map as a file: an extract of the region as .osm.pbf."
        )


class _Waiting:
    """Waits where the user can see it, and not for ever."""

    def __init__(self, on_wait: OnWait | None, max_wait_s: float) -> None:
        self._on_wait = on_wait
        self._left_s = max_wait_s

    def announce(self, reason: str, seconds: float) -> None:
        logger.info("%s (up to %.0f s)", reason, seconds)
        if self._on_wait is not None:
            self._on_wait(reason, seconds)

    def sleep(self, reason: str, seconds: float) -> None:
        """Wait for some seconds; raise NetworkError where that would be longer than allowed in total."""
        if seconds > self._left_s:
            raise NetworkError(f"{reason}; waited as long as allowed. {_INSTEAD}")
        self._left_s -= seconds
        logger.info("%s: waiting %.0f s", reason, seconds)
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0:
            if self._on_wait is not None:
                self._on_wait(reason, remaining)
            time.sleep(min(1.0, remaining))


def _fetch(bounds: Bounds, url: str, answer: Path, timeout_s: int, wait: _Waiting) -> Any:  # noqa: ANN401 - networkx
    """Ask until the server has a free slot, and keep its answer, too; a folder that exists is complete."""
    with tempfile.TemporaryDirectory(prefix="asking-", dir=answer.parent, ignore_cleanup_errors=True) as folder:
        while True:
            wait.announce(f"Asking {url} for the roads", timeout_s)
            try:
                graph = _ask(bounds, url, Path(folder), timeout_s)
                break
            except _BusyError as busy:
                wait.sleep(f"{url} is busy (status {busy.status})", busy.pause_s)
        if any(Path(folder).iterdir()):  # osmnx keeps no answer with a remark
            Path(folder).rename(answer)
    return graph


def _ask(bounds: Bounds, url: str, folder: Path, timeout_s: int) -> Any:  # noqa: ANN401 - networkx has no types
    """Let osmnx fetch and build the graph of all highways, with a cache folder for this query alone."""
    import osmnx  # noqa: PLC0415 - takes seconds to import
    import requests  # noqa: PLC0415

    try:
        with _settings(url, folder, timeout_s):
            # By edge: a node within the bounds keeps its neighbours beyond them, hence its degree.
            return osmnx.graph_from_bbox(
                bounds, custom_filter='["highway"]', simplify=False, retain_all=True, truncate_by_edge=True
            )
    except requests.exceptions.Timeout as error:
        raise NetworkError(f"{url} did not answer within {timeout_s} s. {_INSTEAD}") from error
    except requests.exceptions.RequestException as error:
        raise NetworkError(
            f"{url} cannot be reached ({type(error).__name__}). Check the network connection and proxy. {_INSTEAD}"
        ) from error
    except ValueError as error:  # osmnx's words for: no elements, nothing within the bounds, a way without its nodes
        if "missing nodes" in str(error):
            raise NetworkError(
                f"{url} left out nodes of its roads. Usual cause: a server filled from an extract. {_INSTEAD}"
            ) from error
        west, south, east, north = bounds
        raise MapError(
            f"OpenStreetMap holds no highways within lon {west:.4f}..{east:.4f}, lat {south:.4f}..{north:.4f}. "
            "Usual mistake: longitude and latitude swapped in the georeference."
        ) from error


@contextmanager
def _settings(url: str, folder: Path, timeout_s: int) -> Iterator[None]:
    """Configure osmnx, which knows only global settings, and restore them afterwards."""
    import osmnx  # noqa: PLC0415

    ours = {
        "overpass_url": url,
        "cache_folder": folder,
        "use_cache": True,
        "http_user_agent": f"InterLoc/{version('interloc')} (+interloc: road intersections from LiDAR)",
        "http_referer": "interloc",
        "requests_timeout": timeout_s,
        # osmnx would sleep silently and try again for ever: the hook raises at every refusal instead.
        "overpass_rate_limit": False,
        "requests_kwargs": {"hooks": {"response": _inspect}},
        "doh_url_template": None,  # no look-ups at a third party when the name does not resolve
        "all_oneway": True,  # keeps the tag oneway as it is
        "useful_tags_way": ["area", "highway", "layer", "name", "ref", *KEPT_TAGS],
        "log_console": False,
        "log_file": False,
    }
    before = {name: getattr(osmnx.settings, name) for name in ours}
    resolve = socket.getaddrinfo  # osmnx replaces it and does not put it back
    try:
        for name, value in ours.items():
            setattr(osmnx.settings, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(osmnx.settings, name, value)
        socket.getaddrinfo = resolve


def _inspect(response: Any, *_: object, **__: object) -> None:  # noqa: ANN401 - requests.Response
    """Look at an answer before osmnx does, and raise an error that explains what is wrong with it."""
    status = int(response.status_code)
    if status in {429, 503, 504}:
        retry_after = response.headers.get("Retry-After", "")
        raise _BusyError(status, float(retry_after) if retry_after.isdigit() else DEFAULT_PAUSE_S)
    if status == 406:
        raise NetworkError(
            f"{response.url} refused the request (406 Not Acceptable): the server turns away clients whose name it "
            f"does not know, perhaps this version of InterLoc. {_INSTEAD}"
        )
    if status >= 400:
        raise NetworkError(f"{response.url} answered {status} {response.reason}. {_INSTEAD}")
    if status == 200:
        try:
            answer = response.json()
            _, remark = answer["elements"], answer.get("remark") or ""
        except (ValueError, TypeError, KeyError) as error:
            raise NetworkError(f"{response.url} did not answer with a map, so it is not an Overpass server.") from error
        if "error" in remark:  # a query that ran out of time or memory comes back half-full with status 200
            raise NetworkError(f"{response.url} gave up on the query ({remark.strip()}). {_INSTEAD}")


@contextmanager
def _lock(path: Path, wait: _Waiting) -> Iterator[None]:
    """Hold a lock that other processes with the same cache respect, and that ends with the process."""
    lock = FileLock(path)
    while True:
        try:
            lock.acquire(blocking=False)
            break
        except Timeout:
            wait.sleep("Another process is asking the Overpass server", 1.0)
    try:
        yield
    finally:
        lock.release()


def _road_graph(graph: Any, bounds: Bounds, url: str, date: str | None) -> RoadGraph:  # noqa: ANN401
    node_id = np.array(sorted(graph.nodes), dtype=np.int64)
    row = {node: index for index, node in enumerate(node_id.tolist())}
    tags: dict[int, dict[str, Any]] = {}
    pieces: set[tuple[int, int, int]] = set()
    for start, end, data in graph.edges(data=True):
        tag = data.get("oneway")
        tags[data["osmid"]] = {**data, "oneway": "yes" if tag in {"-1", "reverse"} else tag}  # osmnx turned its nodes
        pieces.add((data["osmid"], row[start], row[end]))
    ways = sorted(tags)
    way_row = {way: index for index, way in enumerate(ways)}
    table = np.array([(a, b, way_row[way]) for way, a, b in sorted(pieces)], dtype=np.int64).reshape(-1, 3)
    return RoadGraph(
        node_id=node_id,
        lonlat=np.array([(graph.nodes[n]["x"], graph.nodes[n]["y"]) for n in node_id.tolist()]).reshape(-1, 2),
        edges=table[:, :2],
        edge_way=table[:, 2],
        ways=Ways(
            id=np.array(ways, dtype=np.int64),
            highway=tuple(str(tags[way].get("highway", "")) for way in ways),
            name=tuple(str(tags[way].get("name") or tags[way].get("ref") or "") for way in ways),
            is_area=np.array([tags[way].get("area") == "yes" for way in ways], dtype=np.bool_),
            layer=np.array([layer_of(tags[way]) for way in ways], dtype=np.int64),
            tags=tuple({key: str(tags[way][key]) for key in KEPT_TAGS if tags[way].get(key)} for way in ways),
        ),
        source=f"Overpass ({url})",
        date=date,
        areas=(bounds,),
    )
