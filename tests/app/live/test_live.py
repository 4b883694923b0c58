"""A live session of a real server: what is sent, answered, watched, broken off, refused."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from app.live import routes, sessions
from app.live.sessions import LiveEntry
from app.settings import MB, Settings
from app.store import tokens
from interloc.client.live import LiveSender
from interloc.config import DetectorConfig
from interloc.drives.folder import FolderDrive
from interloc.errors import DriveError, NetworkError
from interloc.live.scan import LiveScan, live_scan, play
from interloc.live.wire import encode_scan
from interloc.live.worker import LiveWorker
from interloc.pipeline import detect
from tests.app.conftest import Serve, alone, bearer, database_of
from tests.app.processes import API, ended, started, wait_until
from tests.crossing import paused

Said = list[dict[str, Any]]


@contextmanager
def opened(client: httpx.Client, **headers: str) -> Iterator[ClientConnection]:
    url = f"ws://127.0.0.1:{client.base_url.port}{API}/live"
    with connect(url, additional_headers=headers, compression=None, max_size=None) as connection:
        yield connection


def say(connection: ClientConnection, **word: Any) -> dict[str, Any]:
    connection.send(json.dumps(word))
    answer = json.loads(connection.recv(timeout=60))
    assert isinstance(answer, dict)
    return answer


def listed(client: httpx.Client, session: str) -> dict[str, Any]:
    (found,) = (each for each in client.get(f"{API}/live").json()["sessions"] if each["id"] == session)
    assert isinstance(found, dict)
    return found


@contextmanager
def begun(client: httpx.Client, name: str = "live", **more: Any) -> Iterator[tuple[ClientConnection, str]]:
    """A session that is ended afterwards, however the test ends."""
    with opened(client) as connection:
        answer = say(connection, type="begin", name=name, **more)
        try:
            yield connection, answer["id"]
        finally:
            client.delete(f"{API}/live/{answer['id']}")


class Sender(LiveSender):  # whose cable can be cut
    def _connect(self) -> ClientConnection:
        self.connection = super()._connect()
        return self.connection

    def cut(self, _: int = 0) -> Iterator[LiveScan]:
        with suppress(OSError):  # it is cut already
            self.connection.socket.shutdown(socket.SHUT_RDWR)
        return iter(())


def sender_to(client: httpx.Client, config: DetectorConfig, said: Said, hear: Any = None, **more: Any) -> Sender:
    hear, begin = hear or said.append, {"name": "street", "config": config.model_dump(mode="json"), **more}
    return Sender(str(client.base_url), None, begin, hear, keeps_all=True, patience_s=1.0)


def assert_same_as_offline(said: Said, drive: FolderDrive, config: DetectorConfig) -> None:
    expected = detect(drive, config)
    keyframes = [each["keyframe"] for each in said if each["type"] == "scan" and each["keyframe"]]
    assert [each["frame"] for each in keyframes] == expected.keyframes.frame.tolist()
    found = [each for keyframe in keyframes for each in keyframe["detections"]]
    for names, column in ((("world_x_m", "world_y_m"), "world_xy"), (("lon_deg", "lat_deg"), "lonlat")):
        sent = [[each[name] for name in names] for each in found]
        np.testing.assert_array_equal(sent, getattr(expected.detections, column))


@pytest.mark.parametrize("breaks", ["never", "under way", "at the end"])
def test_a_drive_that_is_sent_is_answered_as_detect_would_also_where_the_connection_breaks(
    client: httpx.Client, crossing: FolderDrive, config: DetectorConfig, breaks: str
) -> None:
    said: Said = []
    connections = 0

    def scans(after: int) -> Iterator[LiveScan]:
        nonlocal connections
        connections += 1
        for scan in play(crossing, config, after=after):
            if scan.frame == 20 and breaks == "under way" and connections == 1:
                sender.cut()
            yield scan

    def hear(document: dict[str, Any]) -> None:
        said.append(document)
        if breaks == "at the end" and document.get("vehicle", 0) is None and connections == 1:
            sender.cut()

    sender = sender_to(client, config, said, hear)
    sender.run(scans)
    assert connections >= 1 + (breaks == "under way")
    with opened(client) as connection:  # the last keyframes have all the last number
        say(connection, type="continue", session=said[0]["id"], answered=47)
        assert [json.loads(text)["type"] for text in connection] == ["scan"] * 6 + ["end"]
    assert_same_as_offline(said, crossing, config)
    assert said[-1]["type"] == "end"
    assert [each["confirmed"] for each in said[-1]["intersections"]] == [True]
    listed = client.get(f"{API}/live").json()["sessions"][0]
    assert (listed["id"], listed["state"]) == (said[0]["id"], "ended")
    assert (listed["keyframes"], listed["dropped"], listed["intersections"]) == (48, 0, 1)


def test_whoever_watches_sees_it_grow(client: httpx.Client, crossing: FolderDrive, config: DetectorConfig) -> None:
    watched: Said = []
    is_watched = threading.Event()

    def watch(session: str) -> None:
        with client.stream("GET", f"{API}/live/{session}/events") as response:
            for line in response.iter_lines():
                if line.startswith("data:"):
                    watched.append(json.loads(line.removeprefix("data:")))
                    is_watched.set()

    said: Said = []
    watcher = threading.Thread(target=lambda: watch(said[0]["id"]))
    scans = partial(paused, crossing, config, 30, lambda: (watcher.start(), is_watched.wait(30)))
    sender_to(client, config, said).run(scans)
    watcher.join(30)
    first, last = watched[0], watched[-1]
    assert (first["type"], first["session"]["state"], last["type"]) == ("state", "driving", "end")
    assert len(first["track"]) in range(25, 31)
    assert first["intersections"][0]["id"] == last["intersections"][0]["id"]
    (lon, lat), *_ = first["roads"][0][0][0]
    assert (round(lon, 2), round(lat, 2)) == (8.4, 49.0)
    assert client.get(f"{API}/live/{first['session']['id']}/events").text.count("data:") == 1  # all is over


@pytest.mark.parametrize(("data", "reason"), [
    (b"\x16\x03\x01\x02\x00\x01\x00", "does not begin with ILS1"),
    (b"ILS1\xfc\xff\xff\xff", "4,294,967,292 bytes"),
    ('{"type": "begin", "name": "again"}', "has begun already"),
    ('{"type": "no"}', "not known"),
    ("{", "not known"),
    ("nan", "not finite"),
])  # fmt: skip
def test_what_is_no_scan_ends_the_session_and_nothing_else(
    client: httpx.Client, crossing: FolderDrive, data: bytes | str, reason: str
) -> None:
    scan = encode_scan(live_scan(crossing, 0))
    with begun(client, "other") as (other, _), begun(client) as (connection, session):
        connection.send(scan.replace(b"[1.0,", b"[NaN,") if data == "nan" else data)
        refused = json.loads(connection.recv(timeout=30))
        assert refused["type"] == "refused"
        if data != "nan":
            assert reason in refused["reason"]
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(timeout=30)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        assert listed(client, session)["state"] == "ended"
        other.send(scan)
        assert json.loads(other.recv(timeout=30))["frame"] == 0


def test_a_message_of_a_gigabyte_is_not_waited_for(client: httpx.Client) -> None:
    with begun(client) as (connection, _):
        connection.socket.sendall(b"\x82\xff" + (1 << 30).to_bytes(8) + bytes(4))  # a head that announces it
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(timeout=30)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009


def test_a_scan_that_is_too_large_is_not_sent_again_and_again(client: httpx.Client, config: DetectorConfig) -> None:
    scan = LiveScan(0, np.eye(4), np.zeros((800_000, 3), np.float32), road_count=0)
    with pytest.raises(NetworkError, match="larger than it takes"):
        sender_to(client, config, []).run(lambda _: iter([scan]))


def test_a_scan_that_is_refused_does_not_count(
    client: httpx.Client, crossing: FolderDrive, config: DetectorConfig
) -> None:
    said: Said = []
    scans = [
        replace(each, T_world_lidar=np.zeros((4, 4))) if each.frame == 9 else each for each in play(crossing, config)
    ]
    sender_to(client, config, said).run(lambda _: iter(scans))
    assert [each["frame"] for each in said if each["type"] == "refused"] == [9]
    assert said[-1]["type"] == "end"


def test_what_arrived_is_repeated_and_what_comes_too_late_is_lost(client: httpx.Client, crossing: FolderDrive) -> None:
    with begun(client, keep=True) as (connection, _):
        said = []
        for row in (0, 1, 3, 2, 3, 1, 2, 4):
            connection.send(encode_scan(live_scan(crossing, row)))
            said.append(json.loads(connection.recv()))  # none is dropped for want of time
        connection.send('{"type": "end"}')
        said += [json.loads(text) for text in connection]
    kinds = [(each["type"], each["frame"]) for each in said if each["type"] in {"repeated", "refused"}]
    assert sorted(kinds) == [("refused", 2), ("repeated", 1), ("repeated", 2), ("repeated", 3)]
    lost = client.get(f"{API}/drives/{said[-1]['drive_id']}/files/dropped.csv").text
    assert lost.splitlines() == ["after_frame,scans", "1,1"]
    with begun(client, keep=True) as (connection, _):
        assert "no keyframe came" in say(connection, type="end")["problem"]


def test_a_sender_gives_up(client: httpx.Client, crossing: FolderDrive, config: DetectorConfig) -> None:
    with pytest.raises(BrokenPipeError):
        sender_to(client, config, [], Mock(side_effect=BrokenPipeError)).run(lambda _: play(crossing, config))
    sender = sender_to(client, config, [])
    with pytest.raises(NetworkError, match="no scan is answered"):
        sender.run(sender.cut)


@pytest.mark.parametrize(("word", "reason"), [
    ({"type": "end"}, "has not begun"),
    ({"type": "begin"}, "name"),
    ({"type": "begin", "name": "a", "config": {"bev": {"resolution_m": 99}}}, "bev.resolution_m"),
    ({"type": "continue", "session": "0123456789abcdef"}, "no live session"),
])  # fmt: skip
def test_a_session_begins_properly_or_not_at_all(client: httpx.Client, word: dict[str, Any], reason: str) -> None:
    with opened(client) as connection:
        answer = say(connection, **word)
        assert answer["type"] == "refused"
        assert reason in answer["reason"]


def test_a_client_has_so_many_sessions(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Settings, "max_live_sessions", 1)
    client = serve()
    with begun(client), opened(client) as connection:
        assert "1 live sessions at a time" in say(connection, type="begin", name="one more")["reason"]
    with begun(client):
        pass


def test_sessions_that_are_refused_make_no_drives(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Settings, "max_live_sessions", 2)
    client = serve()

    def begin(number: int) -> str:
        with opened(client) as connection:
            kind = say(connection, type="begin", name=f"drive {number}", keep=True)["type"]
            all_have_begun.wait(60)
            return str(kind)

    all_have_begun = threading.Barrier(8)
    with ThreadPoolExecutor(8) as pool:
        said = list(pool.map(begin, range(8)))
    assert sorted(said) == ["refused"] * 6 + ["session"] * 2
    assert len(client.get(f"{API}/drives").json()["drives"]) == 2


def test_memory_is_asked_for_before_a_scan_is_taken(
    client: httpx.Client, crossing: FolderDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans = [encode_scan(live_scan(crossing, row)) for row in range(48)]
    fine = {"bev": {"resolution_m": 0.05, "size_m": 100}}
    monkeypatch.setattr(sessions, "_OF_SESSION", 6 * MB)  # more is needed for those cells further on
    with begun(client, "other") as (other, _), begun(client, config=fine) as (connection, session):
        for scan in scans:
            connection.send(scan)
            refused = json.loads(connection.recv(timeout=30))
            if refused["type"] == "refused":
                break
        assert "may hold 6 MB. Send the points of the ground only" in refused["reason"]
        assert 0 < listed(client, session)["keyframes"] < 48
        other.send(scans[0])
        assert json.loads(other.recv(timeout=30))["type"] == "scan"


def test_a_silent_sender_whose_token_is_revoked_is_sent_away(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tokens, "_BELIEVED_S", 0.0)
    monkeypatch.setattr(routes, "_SILENCE_S", 0.1)
    client = serve()
    with database_of(tmp_path / "data") as database:
        tokens.add_token(database, "other")
        with opened(client, **bearer(tokens.add_token(database, "ann"))) as connection:
            say(connection, type="begin", name="a")
            tokens.revoke_token(database, "ann")
            assert json.loads(connection.recv(timeout=30))["reason"] == "its token was revoked."


def test_a_client_watches_so_many_times(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "_MAX_WATCHING", 1)
    with begun(client) as (_, session):
        for _ in range(2):  # one that has gone does not count
            with client.stream("GET", f"{API}/live/{session}/events"):
                wait_until(lambda: "interloc_event_listeners 1.0" in client.get("/metrics").text, "it to listen")
                with client.stream("GET", f"{API}/live/{session}/events") as second:
                    assert second.status_code == 429
            wait_until(lambda: "interloc_event_listeners 0.0" in client.get("/metrics").text, "it to have gone")


def test_a_token_is_needed_as_everywhere(serve: Serve) -> None:
    client = serve(token="a-token-that-is-long-enough")  # noqa: S106
    with pytest.raises(InvalidStatus) as refused, opened(client):
        pass
    assert refused.value.response.status_code == 401
    assert json.loads(refused.value.response.body or b"")["type"] == "/problems/token-needed"
    with opened(client, **bearer("a-token-that-is-long-enough")) as connection:
        assert say(connection, type="begin", name="a")["type"] == "session"
    sender = LiveSender(str(client.base_url), None, {"name": "a"}, lambda _: None)
    with pytest.raises(NetworkError, match="needs an API token"):
        sender.run(lambda _: iter(()))


def test_a_page_of_another_site_cannot_send(client: httpx.Client) -> None:
    with pytest.raises(InvalidStatus) as refused, opened(client, Origin="https://elsewhere.example"):
        pass
    assert refused.value.response.status_code == 403


def test_the_sender_goes_on_when_the_server_is_back(
    crossing: FolderDrive, config: DetectorConfig, tmp_path: Path
) -> None:
    said: Said = []
    with started(tmp_path / "data", tmp_path / "log") as first:

        def scans(after: int) -> Iterator[LiveScan]:
            for scan in play(crossing, config, after=after):
                if scan.frame == 24 and first.process.is_alive():
                    first.kill()
                    servers.enter_context(started(tmp_path / "data", tmp_path / "log", port=port))
                yield scan

        port = int(first.address.rpartition(":")[2])
        with ExitStack() as servers:
            sender_to(first.client, config, said).run(scans)
    assert [each["type"] for each in said if each["type"] in {"session", "end"}] == ["session", "session", "end"]
    frames = [each["frame"] for each in said if each["type"] == "scan" and each["is_keyframe"]]
    assert frames[:20] == list(range(20))
    assert frames[-24:] == list(range(24, 48))


def test_a_drive_that_is_kept_tells_what_was_lost(
    client: httpx.Client, crossing: FolderDrive, config: DetectorConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert crossing.georeference is not None
    known = replace(crossing.georeference, position_std_m=np.full(48, 0.25))
    # Without times, poses that are far apart are taken for a jump.
    timed = replace(crossing, times_s=np.arange(48.0), georeference=known)
    frames = iter(range(48))

    def hold(_: LiveEntry, what: str, size: int) -> None:
        if what == "scans" and size and next(frames) in range(20, 30):
            raise DriveError("too many")

    monkeypatch.setattr(LiveEntry, "hold", hold)
    monkeypatch.setattr(LiveWorker, "held_bytes", 0)
    said: Said = []
    sender_to(client, config, said, keep=True).run(lambda after: play(timed, config, after=after))
    assert [each["frame"] for each in said if each["type"] == "dropped"] == list(range(20, 30))
    job = ended(client, said[-1]["job_id"])
    assert (job["summary"]["keyframes"], said[-1]["dropped"]) == (38, 10)
    assert job["summary"]["dropped"] | {"stretches_m": 0} == {"scans": 10, "of": 48, "stretches_m": 0}
    ((start, stop),) = job["summary"]["dropped"]["stretches_m"]
    assert stop - start == pytest.approx(27.5, abs=1.5)
    assert client.get(job["links"]["run"]).json()["dropped"] == job["summary"]["dropped"]
    drive = f"{API}/drives/{said[-1]['drive_id']}"
    problems = client.get(drive).json()["report"]["problems"]
    assert [each["path"] for each in problems if "10 of 48 scans were lost" in each["message"]] == ["dropped.csv"]
    fixes = client.get(f"{drive}/files/geo.csv").text.splitlines()
    assert (len(fixes), {row.rpartition(",")[2] for row in fixes}) == (39, {"position_std_m", "0.25"})


@alone
async def test_who_joins_hears_of_each_keyframe_once(config: DetectorConfig, crossing: FolderDrive) -> None:
    entry = LiveEntry(sessions.Begin(type="begin", name="a"), "me", config, lambda: None)
    entry.take(encode_scan(live_scan(crossing, 0)))
    while not entry._worker.session.keyframes:
        time.sleep(0.01)  # noqa: ASYNC251 - what it tells waits for this loop
    said = entry.watch()
    begun, told = [json.loads(await anext(said) or "") for _ in range(2)]
    entry.refuse("enough")
    assert begun["session"]["keyframes"] + told["is_keyframe"] == 1
