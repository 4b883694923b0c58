"""Files: any bytes under any sound name, whole or not at all, whoever else does what at the same time; batches."""

import base64
import hashlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import update

from app.drives import records
from app.drives.models import DriveOptionsModel
from app.paths import BadNameError, check_path
from app.settings import Settings
from app.store.models import DriveFile
from tests.app.conftest import Serve, database_of, make_drive
from tests.app.processes import connected, every, files_below, heard, wait_until

BIG = os.urandom(3 * 1024 * 1024 + 17)  # more than a piece


def digest(data: bytes) -> str:
    return f"sha-256=:{base64.b64encode(hashlib.sha256(data).digest()).decode()}:"


def stored(data: Path, drive: str) -> list[str]:
    """All files of a drive, and what is on its way into any."""
    places = (data / "incoming", data / "drives" / drive.rpartition("/")[2] / "files")
    return sorted(path.relative_to(data).as_posix() for place in places for path in files_below(place))


@pytest.mark.parametrize("data", [b"", b"one", BIG], ids=["empty", "small", "big"])
def test_a_file_comes_back_as_it_went(client: httpx.Client, drive: str, data: bytes) -> None:
    address = f"{drive}/files/velodyne/000000.bin"
    answer = client.put(address, content=data, headers={"Content-Digest": digest(data)})
    assert answer.status_code == 201
    file = {"path": "velodyne/000000.bin", "size_bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    assert answer.json() == file
    assert client.put(address, content=data).status_code == 200
    assert client.get(f"{drive}/files").json() == {"files": [file], "next": None}
    got = client.get(address)
    assert got.content == data
    assert got.headers["content-type"] == "application/octet-stream"
    shown = client.get(drive).json()
    assert (shown["files"], shown["size_bytes"], shown["stored_bytes"]) == (1, len(data), len(data))


def test_a_file_is_deleted(client: httpx.Client, drive: str, shared_data: Path) -> None:
    assert client.put(f"{drive}/files/a/b/c.txt", content=b"1234").status_code == 201
    assert client.delete(f"{drive}/files/a/b/c.txt").status_code == 204
    assert client.delete(f"{drive}/files/a/b/c.txt").status_code == 404
    assert client.get(drive).json()["size_bytes"] == 0
    assert stored(shared_data, drive) == []
    assert client.put(f"{drive}/files/a", content=b"now a file").status_code == 201


def test_files_are_listed_in_order_page_by_page(client: httpx.Client, drive: str) -> None:
    names = ["velodyne/000001.bin", "Z.txt", "a.txt", "velodyne/000000.bin", "\u00e9t\u00e9.txt", "b/c"]
    for name in names:
        assert client.put(f"{drive}/files/{name}", content=name.encode()).status_code == 201
    assert [file["path"] for file in every(client, f"{drive}/files", "files", limit=2)] == sorted(names)
    assert client.get(f"{drive}/files/{names[4]}").content == names[4].encode()


BAD_NAMES = {
    "lead elsewhere": ["../a.txt", "velodyne/../../../b", "%2e%2e/%2e%2e/a", "a/./b"],
    "absolute": ["/etc/passwd", "C:/windows"],
    "empty name": ["a//b", "velodyne/"],
    "backslash": ["a%5Cb"],
    "control character": ["a%00b", "a%1Fb", "a%7Fb", "a%C2%85b"],
    "not shown": ["a%E2%80%AEb", "a%E2%80%8Bb"],
    "device of Windows": ["CON", "a/nul.bin", "com1.tar.gz/b", "Lpt9%20.x"],
    "ends with a dot or a blank": ["a.", "a%20/b"],
    "not UTF-8": ["a%FFb", "%ED%A0%80"],
    "hidden": [".DS_Store", "a/.git/config"],
    "255 bytes": ["a" * 256, "%C3%A9" * 128],
    "deep": ["a/" * 16 + "b"],
    "512": ["/".join(["a" * 100] * 6)],
}


@pytest.mark.parametrize(("raw", "reason"), [(raw, reason) for reason, names in BAD_NAMES.items() for raw in names])
def test_a_bad_name_is_refused(client: httpx.Client, drive: str, shared_data: Path, raw: str, reason: str) -> None:
    """By a raw request: clients tidy such addresses up."""
    for method in ("PUT", "GET", "DELETE"):
        body = "1" if method == "PUT" else ""
        with connected(client) as link:
            head = f"Host: localhost\r\nContent-Length: {len(body)}\r\nConnection: close"
            link.sendall(f"{method} {drive}/files/{raw} HTTP/1.1\r\n{head}\r\n\r\n{body}".encode())
            answer = heard(link).decode()
        assert answer.startswith("HTTP/1.1 422 "), answer
        assert "Bad file name" in answer
        assert reason in answer
    assert stored(shared_data, drive) == []


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(st.text(max_size=40))
def test_no_accepted_name_leaves_the_folder(name: str) -> None:
    try:
        check_path(name)
    except BadNameError:
        return
    root = Path("/data/drives/1/files")
    resolved = Path(os.path.normpath(root / name))
    assert resolved.is_relative_to(root)
    assert resolved != root
    assert resolved.relative_to(root).as_posix() == name


def test_names_in_conflict(client: httpx.Client, drive: str) -> None:
    assert client.put(f"{drive}/files/a/b", content=b"1").status_code == 201
    for name in ("a", "a/b/c", "a/b/c/d"):
        answer = client.put(f"{drive}/files/{name}", content=b"2")
        assert (answer.status_code, answer.json()["title"]) == (409, "Names in conflict")
    assert client.get(f"{drive}/files/a/b").content == b"1"
    assert client.get(drive).json()["files"] == 1


@pytest.mark.parametrize("value", [
    digest(b"other"),
    "sha-256=:" + "0" * 44 + ":",
    "sha-256=" + hashlib.sha256(b"data").hexdigest(),
    "sha-256=:!!!:",
    "sha-256=:abcd:",
    "md5=:jXd/OF09/siBXSD3SWAm3A==:",
    "nonsense",
    "",
])  # fmt: skip
def test_a_wrong_digest_is_refused(client: httpx.Client, drive: str, shared_data: Path, value: str) -> None:
    address = f"{drive}/files/poses.txt"
    answer = client.put(address, content=b"data", headers={"Content-Digest": value})
    assert answer.status_code == 422
    assert answer.json()["title"] in {"Wrong digest", "Bad digest"}
    assert stored(shared_data, drive) == []
    good = {"Content-Digest": f"sha-512=:AAAA:, {digest(b'data')}"}  # one that is checked, among others
    assert client.put(address, content=b"data", headers=good).status_code == 201


@pytest.mark.parametrize("coding", ["gzip", "deflate", "br"])
def test_compressed_bodies_are_refused(client: httpx.Client, drive: str, coding: str) -> None:
    answer = client.put(f"{drive}/files/a", content=b"data", headers={"Content-Encoding": coding})
    assert (answer.status_code, answer.json()["title"]) == (415, "Compressed body")


def test_a_part_of_a_file_is_not_taken_for_the_whole(client: httpx.Client, drive: str) -> None:
    assert client.put(f"{drive}/files/a", content=b"data").status_code == 201
    answer = client.put(f"{drive}/files/a", content=b"ta", headers={"Content-Range": "bytes 2-3/4"})
    assert (answer.status_code, answer.json()["title"]) == (400, "Part of a file")
    assert client.get(f"{drive}/files/a").content == b"data"


def test_a_body_that_is_compressed_on_its_way_is_refused(client: httpx.Client, drive: str) -> None:
    with connected(client) as link:
        head = "Host: localhost\r\nTransfer-Encoding: gzip, chunked"
        link.sendall(f"PUT {drive}/files/a HTTP/1.1\r\n{head}\r\n\r\n1\r\nx\r\n0\r\n\r\n".encode())
        assert heard(link).startswith(b"HTTP/1.1 415 ")
    assert client.get(f"{drive}/files").json()["files"] == []


@pytest.mark.parametrize(("asked", "status", "found"), [
    ("bytes=1-2", 206, b"at"),
    ("bytes=-2", 206, b"ta"),
    ("bytes=3-1", 200, b"data"),
    ("lines=1-2", 200, b"data"),
    ("bytes=x", 200, b"data"),
    ("bytes=" + ",".join(["0-0"] * 5000), 200, b"data"),
])  # fmt: skip
def test_ranges_of_a_file(client: httpx.Client, drive: str, asked: str, status: int, found: bytes) -> None:
    client.put(f"{drive}/files/a", content=b"data")
    answer = client.get(f"{drive}/files/a", headers={"Range": asked})
    assert (answer.status_code, answer.content) == (status, found)
    beyond = client.get(f"{drive}/files/a", headers={"Range": "bytes=4-"})
    assert (beyond.status_code, beyond.headers["content-range"]) == (416, "bytes */4")
    assert beyond.json()["title"] == "No such range"


def test_ten_gigabytes_are_refused_before_they_are_sent(client: httpx.Client, drive: str) -> None:
    with connected(client) as link:
        link.sendall(f"PUT {drive}/files/a HTTP/1.1\r\nHost: localhost\r\nContent-Length: 10000000000\r\n\r\n".encode())
        answer = heard(link)
    assert answer.startswith(b"HTTP/1.1 413 ")
    assert b"a may have 256 MB at most" in answer


def test_a_body_in_chunks_is_counted(serve: Serve, tmp_path: Path) -> None:
    client = serve(max_file_bytes=2_000_000)
    drive = make_drive(client)

    def pieces(count: int) -> Iterator[bytes]:
        for _ in range(count):
            yield bytes(100_000)

    assert client.put(f"{drive}/files/a", content=pieces(20)).status_code == 201
    assert client.put(f"{drive}/files/b", content=pieces(21)).status_code == 413
    assert [Path(name).name for name in stored(tmp_path / "data", drive)] == ["a"]


@pytest.mark.parametrize("sent", [0, 10, 2_500_000])
def test_a_client_that_vanishes_leaves_nothing(client: httpx.Client, drive: str, shared_data: Path, sent: int) -> None:
    for head in ("Content-Length: 3000000", "Transfer-Encoding: chunked"):
        with connected(client) as link:
            link.sendall(f"PUT {drive}/files/a HTTP/1.1\r\nHost: localhost\r\n{head}\r\n\r\n".encode())
            link.sendall(f"{sent:x}\r\n".encode() if "chunked" in head and sent else b"")
            link.sendall(bytes(sent))
            if sent > 1_000_000:
                wait_until(lambda: files_below(shared_data / "incoming"), "its beginning")
    wait_until(lambda: not stored(shared_data, drive), "it to go")
    assert client.get(f"{drive}/files").json()["files"] == []


def test_limits_of_a_drive(serve: Serve) -> None:
    client = serve(max_drive_bytes=3_000_000, max_drive_files=3)
    drive = make_drive(client)
    assert client.put(f"{drive}/files/a", content=bytes(2_000_000)).status_code == 201
    for size in (1_000_001, 1_500_000):
        answer = client.put(f"{drive}/files/b", content=bytes(size))
        assert (answer.status_code, answer.json()["title"]) == (413, "Too large")
    assert client.put(f"{drive}/files/a", content=bytes(100)).status_code == 200
    assert client.put(f"{drive}/files/b", content=bytes(2_900_000)).status_code == 201
    assert client.put(f"{drive}/files/c", content=b"").status_code == 201
    answer = client.put(f"{drive}/files/d", content=b"")
    assert (answer.status_code, answer.json()["title"]) == (413, "Too many files")
    assert client.get(drive).json()["size_bytes"] == 2_900_100


def test_puts_of_one_file_at_once(client: httpx.Client, drive: str) -> None:
    bodies = [bytes([n]) * (1_500_000 + n) for n in range(8)]
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda body: client.put(f"{drive}/files/a", content=body), bodies))
    assert sorted(answer.status_code for answer in answers) == [200] * 7 + [201]
    (listed,) = client.get(f"{drive}/files").json()["files"]
    kept = client.get(f"{drive}/files/a").content
    assert kept in bodies
    assert listed["sha256"] == hashlib.sha256(kept).hexdigest()
    shown = client.get(drive).json()
    assert (shown["files"], shown["size_bytes"]) == (1, len(kept))


def test_puts_of_many_files_at_once_are_counted_right(client: httpx.Client, drive: str) -> None:
    def put(number: int) -> int:
        return client.put(f"{drive}/files/labels/{number:06d}.label", content=bytes(number)).status_code

    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(put, range(200))) == {201}
    shown = client.get(drive).json()
    assert (shown["files"], shown["size_bytes"]) == (200, sum(range(200)))


def test_a_drive_that_is_deleted_during_a_put(client: httpx.Client, drive: str, shared_data: Path) -> None:
    with connected(client) as link:
        head = ["Host: localhost", "Content-Length: 4000000", "Connection: close"]
        link.sendall("\r\n".join([f"PUT {drive}/files/a HTTP/1.1", *head, "", ""]).encode())
        link.sendall(bytes(3_000_000))
        wait_until(lambda: stored(shared_data, drive), "its beginning")
        assert client.delete(drive).status_code == 204
        link.sendall(bytes(1_000_000))
        answer = heard(link)
    assert answer.startswith(b"HTTP/1.1 404 ")
    assert b"Drive not found" in answer
    assert stored(shared_data, drive) == []


@pytest.mark.parametrize("size", [10, 3 * 2**20])
def test_what_is_read_is_one_version(client: httpx.Client, drive: str, size: int) -> None:
    """While a file is replaced and deleted again and again no answer is cut."""
    address = f"{drive}/files/velodyne/000000.bin"

    def write() -> None:
        for number in range(10):
            content = bytes([number]) * (size + number)
            assert client.put(address, content=content).status_code in {200, 201}
            if number % 7 == 6:
                assert client.delete(address).status_code == 204

    def read() -> set[int]:
        seen = set()
        while not writing.done():
            answer = client.get(address)
            seen.add(answer.status_code)
            if answer.status_code == 200:
                assert len(set(answer.content)) == 1
                assert answer.headers["content-length"] == str(len(answer.content))
        return seen

    with ThreadPoolExecutor(3) as pool:
        writing = pool.submit(write)
        for readers in [pool.submit(read) for _ in range(2)]:
            assert readers.result() <= {200, 404, 410}
        writing.result()


def test_names_that_an_older_version_took_can_be_read_and_deleted(
    client: httpx.Client, drive: str, shared_data: Path
) -> None:
    drive_id = drive.rsplit("/", 1)[-1]
    assert client.put(f"{drive}/files/poses.txt", content=b"1").status_code == 201
    folder = shared_data / "drives" / drive_id / "files"
    (folder / "poses.txt").rename(folder / "con.txt")
    with database_of(shared_data) as database, database.writing() as session:
        session.execute(update(DriveFile).where(DriveFile.drive_id == drive_id).values(path="con.txt"))
    assert client.get(f"{drive}/files/con.txt").content == b"1"
    assert client.delete(f"{drive}/files/con.txt").status_code == 204
    assert client.get(f"{drive}/files/con.txt").status_code == 422  # it is no name that a file can have


def test_a_new_drive_is_open_for_files(client: httpx.Client) -> None:
    answer = client.post("/api/v1/drives", json={"name": " town ", "options": {"label_scheme": "40,60"}})
    assert answer.status_code == 201
    drive = answer.json()
    assert answer.headers["location"] == f"/api/v1/drives/{drive['id']}"
    assert (drive["name"], drive["state"], drive["files"], drive["size_bytes"]) == ("town", "uploading", 0, 0)
    assert drive["options"] == DriveOptionsModel(label_scheme="40,60").model_dump(mode="json")
    assert drive["expires_at"] > drive["created_at"]
    assert client.get(answer.headers["location"]).json() == drive


def test_a_client_may_have_some_uploads_at_once(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "MAX_UPLOADS", 2)
    client = serve()
    answers = [client.post("/api/v1/drives", json={"name": "a"}) for _ in range(3)]
    assert [answer.status_code for answer in answers] == [201, 201, 429]
    assert answers[2].json()["type"] == "/problems/too-many-uploads"
    client.delete(answers[0].headers["location"]).raise_for_status()
    assert client.post("/api/v1/drives", json={"name": "a"}).status_code == 201


Parts = list[tuple[str, tuple[str | None, bytes]]]


def send(client: httpx.Client, drive: str, parts: Parts) -> httpx.Response:
    return client.post(f"{drive}/scans", files=[(field, (name or "", data)) for field, (name, data) in parts])


def raw(client: httpx.Client, drive: str, body: bytes, **headers: str) -> httpx.Response:
    """Send a body as it stands; its boundary is B."""
    return client.post(
        f"{drive}/scans", content=body, headers={"Content-Type": "multipart/form-data; boundary=B", **headers}
    )


def listed(client: httpx.Client, drive: str) -> list[str]:
    return [file["path"] for file in client.get(f"{drive}/files").json()["files"]]


def test_every_part_goes_to_its_place(client: httpx.Client, drive: str) -> None:
    scan = bytes(range(256)) * 9000  # several pieces
    places = {
        "velodyne/000000.bin": scan,
        "velodyne/000001.bin": b"\r\n--B\r\n",
        "poses.txt": b"3",
        "oxts/data/0000000000.txt": b"7",
        "Straße.osm": b"",
    }
    parts: Parts = [("files", place) for place in places.items()]
    answer = send(client, drive, parts)
    assert answer.status_code == 200
    assert {file["path"]: file["sha256"] for file in answer.json()["files"]} == {
        path: hashlib.sha256(data).hexdigest() for path, data in places.items()
    }
    assert listed(client, drive) == sorted(places)
    for path, data in places.items():
        assert client.get(f"{drive}/files/{path}").content == data
    assert client.get(drive).json()["size_bytes"] == sum(map(len, places.values()))
    assert send(client, drive, parts).status_code == 200
    assert client.get(drive).json()["files"] == len(places)


@pytest.mark.parametrize(
    ("digest", "status"),
    [(hashlib.sha256(b"1 0 0").digest(), 200), (hashlib.sha256(b"1 0 1").digest(), 422), (b"short", 422)],
)
def test_each_part_is_what_its_digest_says(client: httpx.Client, drive: str, digest: bytes, status: int) -> None:
    parts = [
        b'--B\r\nContent-Disposition: form-data; name="files"; filename="times.txt"\r\n\r\n0',
        b'\r\n--B\r\nContent-Disposition: form-data; name="files"; filename="poses.txt"\r\n',
        b"Content-Digest: sha-256=:" + base64.b64encode(digest) + b":\r\n\r\n1 0 0\r\n--B--\r\n",
    ]
    assert raw(client, drive, b"".join(parts)).status_code == status
    assert listed(client, drive) == (["poses.txt", "times.txt"] if status == 200 else [])


@pytest.mark.parametrize(("field", "filename", "reason"), [
    ("files", "../../etc/passwd", "lead elsewhere"),
    ("files", "/etc/passwd", "absolute"),
    ("files", "a\\b", "backslash"),
    ("files", ".bashrc", "hidden"),
    ("images", "000000.png", "A part 'images'; expected `files`"),
    ("", "a", "A part ''; expected"),
])  # fmt: skip
def test_one_bad_part_keeps_out_all(
    client: httpx.Client, drive: str, shared_data: Path, field: str, filename: str, reason: str
) -> None:
    answer = send(client, drive, [("files", ("000000.bin", b"good")), (field, (filename, b"bad"))])
    assert answer.status_code == 422
    assert reason in answer.json()["detail"]
    assert listed(client, drive) == []
    assert stored(shared_data, drive) == []


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"", 400),
        (b"--B--\r\n", 422),
        (b'--B\r\nContent-Disposition: form-data; name="files"; filename="000000.bin"\r\n\r\ndata', 400),
        (b'--B\r\nContent-Disposition: form-data; name="files"\r\n\r\n1\r\n--B--\r\n', 422),
        (b'--B\r\nContent-Disposition: form-data; name="files"; filename=""\r\n\r\n1\r\n--B--\r\n', 422),
        (b'--B\r\nContent-Disposition: form-data; name="files"; filename="\xff"\r\n\r\n1\r\n--B--\r\n', 422),
        (b"--B\r\nContent-Type: text/plain\r\n\r\n1\r\n--B--\r\n", 400),
        (b"--B\r\nX: " + b"a" * 10_000 + b"\r\n\r\n1\r\n--B--\r\n", 400),
        (
            (
                b'--B\r\nContent-Disposition: form-data; name="files"; filename="p"\r\n'
                b"Content-Transfer-Encoding: base64\r\n\r\nMQ==\r\n--B--\r\n"
            ),
            422,
        ),
    ],
)
def test_a_malformed_body_is_refused(
    client: httpx.Client, drive: str, shared_data: Path, body: bytes, status: int
) -> None:
    answer = raw(client, drive, body)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert stored(shared_data, drive) == []


def test_a_bundle_that_breaks_off_leaves_nothing_and_comes_again(
    client: httpx.Client, drive: str, shared_data: Path
) -> None:
    part = (
        b'--B\r\nContent-Disposition: form-data; name="files"; filename="%d.txt"\r\n\r\n' + bytes(2_000_000) + b"\r\n"
    )
    body = part % 1 + part % 2 + b"--B--\r\n"
    head = f"Host: localhost\r\nContent-Length: {len(body)}\r\nContent-Type: multipart/form-data; boundary=B"
    with connected(client) as link:
        link.sendall(f"POST {drive}/scans HTTP/1.1\r\n{head}\r\n\r\n".encode() + body[:-1000])
        wait_until(lambda: stored(shared_data, drive), "the first bytes to arrive")
    wait_until(lambda: not stored(shared_data, drive), "the server to see that the sender is gone")
    assert listed(client, drive) == []
    assert raw(client, drive, body).status_code == 200
    assert listed(client, drive) == ["1.txt", "2.txt"]


@pytest.mark.parametrize("kind", ["application/json", "multipart/form-data", "multipart/mixed; boundary=B", ""])
def test_other_kinds_of_bodies_are_refused(client: httpx.Client, drive: str, kind: str) -> None:
    answer = client.post(f"{drive}/scans", content=b"{}", headers={"Content-Type": kind})
    assert (answer.status_code, answer.json()["title"]) == (415, "Not multipart/form-data")


def test_a_name_that_comes_twice(client: httpx.Client, drive: str, shared_data: Path) -> None:
    answer = send(client, drive, [("files", ("poses.txt", b"1")), ("files", ("poses.txt", b"2"))])
    assert answer.status_code == 422
    assert "poses.txt comes twice" in answer.json()["detail"]
    assert stored(shared_data, drive) == []


def test_a_refused_batch_leaves_no_folder_in_the_way(client: httpx.Client, drive: str) -> None:
    answer = send(client, drive, [("files", ("a/b/c", b"1")), ("files", ("a/b", b"2"))])
    assert (answer.status_code, answer.json()["title"]) == (409, "Names in conflict")
    assert listed(client, drive) == []
    assert client.put(f"{drive}/files/a", content=b"3").status_code == 201


def test_limits_of_a_batch(serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Settings, "max_batch_files", 3)
    client = serve(max_file_bytes=200_000)
    drive = make_drive(client)

    def scans(count: int, size: int) -> Parts:
        return [("files", (f"{number:06d}.bin", bytes(size))) for number in range(count)]

    for parts, title in (
        (scans(4, 10), "Too many files"),
        (scans(1, 200_001), "Too large"),
        (scans(3, 140_000), "Too large"),
    ):
        answer = send(client, drive, parts)
        assert (answer.status_code, answer.json()["title"]) == (413, title)
    assert stored(tmp_path / "data", drive) == []
    assert send(client, drive, scans(3, 130_000)).status_code == 200
