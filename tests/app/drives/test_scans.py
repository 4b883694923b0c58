"""Batches: several files in one request, all or none."""

import base64
import hashlib
from pathlib import Path

import httpx
import pytest

from app.settings import Settings
from tests.app.conftest import Serve, make_drive
from tests.app.processes import connected, files_below, wait_until

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


def left(data: Path, drive: str) -> list[str]:
    """Names of all files of a drive, and of what is on its way into any."""
    places = (data / "incoming", data / "drives" / drive.rpartition("/")[2] / "files")
    return [path.name for place in places for path in files_below(place)]


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
    [
        (hashlib.sha256(b"1 0 0").digest(), 200),
        (hashlib.sha256(b"1 0 1").digest(), 422),
        (b"short", 422),
    ],
)
def test_each_part_is_what_its_digest_says(client: httpx.Client, drive: str, digest: bytes, status: int) -> None:
    parts = [
        b'--B\r\nContent-Disposition: form-data; name="files"; filename="times.txt"\r\n\r\n0',
        b'\r\n--B\r\nContent-Disposition: form-data; name="files"; filename="poses.txt"\r\n',
        b"Content-Digest: sha-256=:" + base64.b64encode(digest) + b":\r\n\r\n1 0 0\r\n--B--\r\n",
    ]
    assert raw(client, drive, b"".join(parts)).status_code == status
    assert listed(client, drive) == (["poses.txt", "times.txt"] if status == 200 else [])


@pytest.mark.parametrize(
    ("field", "filename", "reason"),
    [
        ("files", "../../etc/passwd", "lead elsewhere"),
        ("files", "/etc/passwd", "absolute"),
        ("files", "a\\b", "backslash"),
        ("files", ".bashrc", "hidden"),
        ("images", "000000.png", "A part 'images'; expected `files`"),
        ("", "a", "A part ''; expected"),
    ],
)
def test_one_bad_part_keeps_out_all(
    client: httpx.Client, drive: str, shared_data: Path, field: str, filename: str, reason: str
) -> None:
    answer = send(client, drive, [("files", ("000000.bin", b"good")), (field, (filename, b"bad"))])
    assert answer.status_code == 422
    assert reason in answer.json()["detail"]
    assert listed(client, drive) == []
    assert left(shared_data, drive) == []


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
    assert left(shared_data, drive) == []


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
        wait_until(lambda: left(shared_data, drive), "the first bytes to arrive")
    wait_until(lambda: not left(shared_data, drive), "the server to see that the sender is gone")
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
    assert left(shared_data, drive) == []


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
    assert left(tmp_path / "data", drive) == []
    assert send(client, drive, scans(3, 130_000)).status_code == 200
