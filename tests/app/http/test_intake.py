"""Files of drives and of maps are put in one way: whole, one after the other, within the quota, or not at all."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import httpx
import pytest

from app.store.tokens import add_token
from app.upkeep.backup import back_up
from tests.app.conftest import Serve, bearer, opened
from tests.app.processes import API

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
