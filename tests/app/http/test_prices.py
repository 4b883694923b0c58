"""Prices: every operation declares its own, and whoever asks for much waits for himself only and holds no thread."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi.routing import APIRoute, APIWebSocketRoute

from app.http import prices
from app.http.prices import MAX_JSON_BYTES, Turns, price_of, priced
from app.http.problems import Problem
from app.http.routing import Router
from app.main import ROUTES
from app.ogc import routes
from app.states import Scope
from app.store.tokens import add_token
from tests.app.conftest import Serve, alone, bearer, opened
from tests.app.processes import API, wait_until


def asked_by(name: str, host: str = "192.0.2.1") -> Any:
    """A request, as far as turns look at it."""
    return SimpleNamespace(state=SimpleNamespace(holder=SimpleNamespace(name=name)), client=SimpleNamespace(host=host))


class Readers:
    """Requests that read until they are let go; who has a turn is noted in order."""

    def __init__(self) -> None:
        self.turns = Turns()
        self.begun: list[str] = []
        self._ends: list[asyncio.Event] = []

    async def ask(self, *names: str) -> list[asyncio.Task[None]]:
        """Let clients ask one after the other."""
        tasks = []
        for name in names:
            tasks.append(asyncio.create_task(self._read(name)))
            await self.rest()
        return tasks

    async def end(self, number: int = 0) -> None:
        """End what has begun as this one."""
        self._ends[number].set()
        await self.rest()

    async def rest(self) -> None:
        for _ in range(10):
            await asyncio.sleep(0)

    async def _read(self, name: str) -> None:
        async with self.turns.of(asked_by(name)):
            end = asyncio.Event()
            self.begun.append(name)
            self._ends.append(end)
            await end.wait()


def test_every_operation_declares_what_it_costs() -> None:
    own = [route.endpoint for route in ROUTES if isinstance(route, APIRoute | APIWebSocketRoute)]
    assert len(own) > 120
    assert [each.__name__ for each in own if price_of(each) is None] == []
    with pytest.raises(TypeError, match="does not say what it costs"):
        Router().get("/things")(lambda: None)


def test_an_operation_that_gives_much_has_pages_or_says_what_bounds_it() -> None:
    @priced("cheap")
    def list_things() -> None: ...

    def read_thing(limit: int = 100) -> None: ...

    for endpoint in (list_things, priced("heavy")(lambda: None)):
        with pytest.raises(TypeError, match="gives no pages"):
            price_of(endpoint)
    assert price_of(priced("heavy")(read_thing)).kind == "heavy"
    assert price_of(priced("heavy", bound="ten things")(list_things)).bound == "ten things"


def test_what_a_body_may_have_follows_from_the_price(client: httpx.Client) -> None:
    new = {"name": "a", "options": {}, "padding": "x" * MAX_JSON_BYTES}
    assert client.post(f"{API}/drives", json=new).status_code == 413
    made = client.post(f"{API}/maps", json={"name": "town"}).json()["id"]
    larger = b"<osm>" + b" " * 2 * MAX_JSON_BYTES + b"</osm>"
    assert client.put(f"{API}/maps/{made}/osm/town.osm", content=larger).status_code == 204
    assert client.delete(f"{API}/maps/{made}").status_code == 204


@alone
async def test_who_asks_for_much_waits_for_himself_only() -> None:
    readers = Readers()
    await readers.ask(*["bob"] * 10, "alice", "carol")
    assert readers.begun == ["bob", "bob", "alice"]
    await readers.end(0)
    assert readers.begun[3:] == ["carol"]  # she has none; bob has one
    await readers.end(1)
    assert readers.begun[4:] == ["bob"]


@alone
async def test_who_gives_up_takes_no_turn() -> None:
    readers = Readers()
    tasks = await readers.ask("bob", "bob", "bob", "bob")
    tasks[2].cancel()
    await readers.end(0)
    assert readers.begun == ["bob"] * 3
    readers._ends[1].set()
    readers._ends[2].set()
    await asyncio.gather(*tasks[:2], tasks[3])
    assert not readers.turns._asked


@alone
async def test_clients_without_a_token_are_told_apart_by_their_address() -> None:
    turns = Turns()
    one, other = asked_by("anonymous"), asked_by("anonymous", "192.0.2.2")
    async with turns.of(one), turns.of(one), asyncio.timeout(60), turns.of(other):
        pass


@alone
async def test_a_line_does_not_grow_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prices, "_MAX_WAITING", 2)
    readers = Readers()
    *_, refused = await readers.ask(*["bob"] * 5)
    with pytest.raises(Problem) as caught:
        await refused
    assert (caught.value.status, dict(caught.value.headers or {})) == (503, {"Retry-After": "5"})


@alone
async def test_nobody_waits_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prices, "_PATIENCE_S", 0.01)
    readers = Readers()
    *_, refused = await readers.ask(*["bob"] * 3)
    with pytest.raises(Problem, match="Send fewer at a time"):
        await refused
    await readers.end(0)
    await readers.ask("bob")
    assert len(readers.begun) == 3


def test_heavy_filters_of_a_client_hold_no_other(serve: Serve, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """100 filters that take as long as the test wants, of a token that may only read: more than there are threads."""
    scopes = (("eve", Scope.READ), ("ann", Scope.WRITE))
    with opened(tmp_path / "data") as context:
        eve, ann = [bearer(add_token(context.database, name, scope=scope)) for name, scope in scopes]
    begun, let_go = threading.Semaphore(0), threading.Event()
    find_page = routes.find_page

    def find_slowly(*arguments: Any) -> Any:
        begun.release()
        assert let_go.wait(120)
        return find_page(*arguments)

    monkeypatch.setattr(routes, "find_page", find_slowly)
    client = serve()
    asked = "/ogc/collections/detections/items?filter=score>0.5"
    connections = httpx.Client(base_url=client.base_url, limits=httpx.Limits(max_connections=100), timeout=120)
    with ThreadPoolExecutor(101) as pool, connections as many:
        answers = [pool.submit(many.get, asked, headers=eve) for _ in range(100)]
        try:
            assert begun.acquire(timeout=60)
            assert begun.acquire(timeout=60)
            wait_until(lambda: sum(each.done() for each in answers) >= 34, "those that are too many to be refused")
            for path in ("/", f"{API}/drives", "/ogc/collections", f"{API}/jobs"):
                assert client.get(path, headers=ann).status_code == 200, path
            made = client.post(f"{API}/drives", json={"name": "a"}, headers=ann)
            assert made.status_code == 201
            address = f"{API}/drives/{made.json()['id']}/files/times.txt"
            assert client.put(address, content=b"0\n", headers=ann).status_code == 201
            hers = pool.submit(client.get, asked, headers=ann)
            assert begun.acquire(timeout=60)
        finally:
            let_go.set()
        assert hers.result().status_code == 200
        found = [each.result() for each in answers]
    assert {answer.status_code for answer in found} == {200, 503}
    assert all(answer.headers["retry-after"] == "5" for answer in found if answer.status_code == 503)
