"""Archives: whatever is in them, either all files of one drive come out or nothing does."""

import gzip
import hashlib
import io
import stat
import struct
import tarfile
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import pytest
import zstandard

from app.drives.work.unpack import ArchiveError, members
from tests.app.conftest import Serve, client_of, make_drive
from tests.app.processes import files_below, wait_until

FILES = {
    "poses.txt": b"1 0 0 0 0 1 0 0 0 0 1 0\n",
    "velodyne/000000.bin": bytes(range(256)) * 4096,
    "velodyne/000001.bin": b"",
    "labels/000000.label": b"\x28\0\0\0",
}


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("archives")


@pytest.fixture(scope="module")
def client(home: Path) -> Iterator[httpx.Client]:
    """One server for all tests of this module: its workers start only once."""
    with client_of(home / "data") as client:
        yield client


def zipped(
    files: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED, *, is_zip64: bool = False, mode: int = 0
) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", compression) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name)
            info.compress_type, info.create_system, info.external_attr = compression, 3, mode << 16
            with archive.open(info, "w", force_zip64=is_zip64) as file:
                file.write(content)
    return data.getvalue()


def tarred(files: dict[str, bytes], *more: tarfile.TarInfo, **options: object) -> bytes:
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w", **options) as archive:  # type: ignore[call-overload]
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
        for info in more:
            archive.addfile(info)
    return data.getvalue()


def in_folder(folder: str, files: dict[str, bytes]) -> dict[str, bytes]:
    return {f"{folder}/{name}": data for name, data in files.items()}


def listed(client: httpx.Client, drive: str) -> dict[str, str]:
    return {file["path"]: file["sha256"] for file in client.get(f"{drive}/files").json()["files"]}


def digests(files: dict[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


def left(home: Path, below: str = "data") -> list[str]:
    """All files, but the database and what it says once more beside the files of a drive."""
    names = (path.relative_to(home).as_posix() for path in files_below(home / below))
    return sorted(name for name in names if "sqlite" not in name and "drive.json" not in name)


def refuse(client: httpx.Client, tmp_path: Path, data: bytes, *reasons: str, status: int = 422) -> None:
    """Nothing of a bad archive is kept, and the drive takes a good one afterwards."""
    drive, before = make_drive(client), left(tmp_path)
    answer = client.post(f"{drive}/archive", content=data)
    assert answer.status_code == status, answer.text
    for reason in reasons:
        assert reason in answer.json()["detail"]
    assert str(tmp_path) not in answer.text
    assert listed(client, drive) == {}
    wait_until(lambda: left(tmp_path) == before, "what was unpacked to go")
    assert client.get(drive).json()["state"] == "uploading"


TARRED = tarred(in_folder("07", FILES))
KINDS = {
    "zip": zipped(in_folder("sequences/07", FILES)),
    "zip without a folder": zipped(FILES),
    "stored zip": zipped(in_folder("07", FILES), zipfile.ZIP_STORED),
    "zip64": zipped(FILES, is_zip64=True),
    "tar": TARRED,
    "tar with dots": tarred(in_folder("./07", FILES)),
    "old tar": tarred(in_folder("07", FILES), format=tarfile.GNU_FORMAT),
    "tar.gz": gzip.compress(TARRED),
    "tar.gz in two members": gzip.compress(TARRED[:1000]) + gzip.compress(TARRED[1000:]),
    "tar.zst": zstandard.compress(TARRED),
    "tar.zst in two frames": zstandard.compress(TARRED[:1000]) + zstandard.compress(TARRED[1000:]),
    "tar.zst with a frame that is none of it": (
        zstandard.compress(TARRED) + b"\x50\x2a\x4d\x18" + struct.pack("<I", 1000) + bytes(1000)
    ),
}


@pytest.mark.parametrize("data", KINDS.values(), ids=KINDS.keys())
def test_every_kind_of_archive(client: httpx.Client, drive: str, home: Path, data: bytes) -> None:
    answer = client.post(f"{drive}/archive", content=data)
    assert answer.status_code == 200, answer.text
    result = answer.json()
    assert (result["state"], result["files"], result["size_bytes"]) == ("successful", 4, sum(map(len, FILES.values())))
    assert listed(client, drive) == digests(FILES)
    for name, content in FILES.items():
        assert client.get(f"{drive}/files/{name}").content == content
    shown = client.get(drive).json()
    assert (shown["files"], shown["size_bytes"]) == (4, result["size_bytes"])
    root = f"data/drives/{drive.rsplit('/', maxsplit=1)[-1]}"
    wait_until(lambda: left(home, root) == sorted(f"{root}/files/{name}" for name in FILES), "the archive to go")


def test_an_archive_replaces_files(client: httpx.Client, drive: str) -> None:
    assert client.put(f"{drive}/files/poses.txt", content=b"an older one").status_code == 201
    assert client.put(f"{drive}/files/times.txt", content=b"0\n").status_code == 201
    assert client.post(f"{drive}/archive", content=KINDS["zip"]).status_code == 200
    assert listed(client, drive) == digests({**FILES, "times.txt": b"0\n"})
    assert client.get(drive).json()["size_bytes"] == sum(map(len, FILES.values())) + 2


def test_the_drive_is_found_in_its_archive(client: httpx.Client, drive: str) -> None:
    root = "2011_09_26/2011_09_26_drive_0001_sync"
    files = {
        f"{root}/velodyne_points/data/0000000000.bin": b"1",
        f"{root}/oxts/data/0000000000.txt": b"2",
        f"{root}/labels/0000000000.label": b"3",
        f"{root}/image_00/data/0000000000.png": b"4",
        "2011_09_26/calib_imu_to_velo.txt": b"5",
        "2011_09_26/readme.txt": b"6",
        "map.osm.gz": b"7",
        f"{root}/.DS_Store": b"8",
        "__MACOSX/._07": b"9",
    }
    answer = client.post(f"{drive}/archive", content=zipped(files))
    assert answer.status_code == 200, answer.text
    assert listed(client, drive) == digests(
        {
            "velodyne_points/data/0000000000.bin": b"1",
            "oxts/data/0000000000.txt": b"2",
            "labels/0000000000.label": b"3",
            "image_00/data/0000000000.png": b"4",
            "calib_imu_to_velo.txt": b"5",
            "map.osm.gz": b"7",
        }
    )


@pytest.mark.parametrize(("name", "reason"), [
    ("../evil.txt", "lead elsewhere"),
    ("velodyne/../../evil.txt", "lead elsewhere"),
    ("/etc/evil.txt", "absolute"),
    ("C:/evil.txt", "absolute"),
    ("a\\..\\evil.txt", "backslash"),
    ("a/\x07bell", "control character"),
    ("a" * 300, "255 bytes"),
])  # fmt: skip
def test_names_that_lead_elsewhere(client: httpx.Client, home: Path, name: str, reason: str) -> None:
    refuse(client, home, zipped({**FILES, name: b"evil"}), reason)
    refuse(client, home, tarred({**FILES, name: b"evil"}), reason)
    assert not list(home.rglob("evil*"))


def test_a_name_that_is_a_folder_in_the_archive_and_a_file_in_the_drive(
    client: httpx.Client, drive: str, home: Path
) -> None:
    assert client.put(f"{drive}/files/velodyne", content=b"a file").status_code == 201
    answer = client.post(f"{drive}/archive", content=KINDS["zip"])
    assert (answer.status_code, answer.json()["title"]) == (409, "Names in conflict")
    assert list(listed(client, drive)) == ["velodyne"]
    root = f"data/drives/{drive.rsplit('/', maxsplit=1)[-1]}"
    wait_until(lambda: left(home, root) == [f"{root}/files/velodyne"], "the archive to go")


def special(kind: bytes, name: str = "velodyne/000001.bin", size: int = 0) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.size, info.linkname = kind, size, "../../../etc/passwd"
    return info


def pax(kind: bytes, content: bytes) -> bytes:
    """An extended header."""
    info = special(kind, "pax", len(content))
    return info.tobuf(tarfile.USTAR_FORMAT) + content.ljust(-(-len(content) // 512) * 512, b"\0")


def record(key: bytes, value: bytes) -> bytes:
    length = len(key) + len(value) + 3
    length += len(str(length + len(str(length))))
    return b"%d %s=%s\n" % (length, key, value)


def headers_without_end() -> bytes:
    """Thousands of long names, none of which belongs to a file."""
    long = special(tarfile.GNUTYPE_LONGNAME, "long", 1)
    return (long.tobuf(tarfile.GNU_FORMAT) + b"a".ljust(512, b"\0")) * 3000


DAMAGED = {
    "zip": KINDS["zip"][:-30],
    "zip without its beginning": b"PK\x03\x04" + KINDS["zip"][2000:],
    "stored zip": KINDS["stored zip"].replace(b"1 0 0 0", b"1 0 0 7", 1),
    "tar": TARRED[: len(TARRED) // 2],
    "tar at a file's end": TARRED[: TARRED.index(b"07/velodyne/000000.bin")],
    "tar without its mark": TARRED.rstrip(b"\0") + bytes(-len(TARRED.rstrip(b"\0")) % 512),
    "tar.gz": gzip.compress(TARRED)[:-9],
    "tar.gz checksum": gzip.compress(TARRED)[:-8] + b"\0" * 8,
    "tar.zst": zstandard.compress(TARRED)[:-3],
    "tar.gz of text": gzip.compress(b"hello " * 1000),
    "empty tar.gz": gzip.compress(b""),
    "tar.zst of nothing": zstandard.compress(b""),
    "tar with a name of other bytes than its checksum": tarred(FILES).replace(b"poses.txt\0", b"pos\xffs.txt\0"),
    "tar of headers": gzip.compress(headers_without_end()),
    "zip of a later version": zipped({"poses.txt": b"1"}).replace(b"PK\x01\x02\x14\x03\x14", b"PK\x01\x02\x14\x03\xa4"),
    "zip with a name of zeros": zipped({"poses.txt": b"1"}).replace(b"poses.txt", bytes(9)),
    **{
        f"tar header of gigabytes {kind!r}": gzip.compress(
            special(kind, "long", 4_000_000_000).tobuf(tarfile.GNU_FORMAT) + bytes(100_000)
        )
        for kind in (tarfile.XHDTYPE, tarfile.GNUTYPE_LONGNAME)
    },
    **{  # that a reader would take for ever to read
        f"tar header of {name}": gzip.compress(pax(tarfile.XHDTYPE, content) + TARRED)
        for name, content in (
            ("a number", record(b"comment", b"1" * 60_000)),
            ("a megabyte", record(b"comment", b"1" * 1_000_000)),
            ("lengths", b"2 " * 30_000 + b"="),
            ("digits", b"1" * 60_000),
        )
    },
}


@pytest.mark.parametrize("data", DAMAGED.values(), ids=DAMAGED.keys())
def test_damaged_archives(client: httpx.Client, home: Path, data: bytes) -> None:
    refuse(client, home, data, "damaged or cut short")


def of_negative_size() -> bytes:
    info = tarfile.TarInfo("poses.txt")
    info.pax_headers = {"size": "-512"}
    return tarred({}, info, format=tarfile.PAX_FORMAT)


def encrypted() -> bytes:
    data = bytearray(zipped({"poses.txt": b"1"}))
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + offset] |= 1
    return bytes(data)


TWO = {**in_folder("sequences/00", FILES), **in_folder("sequences/07", FILES)}
LINKS = (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.FIFOTYPE)
REFUSED = [
    (zipped(TWO), "2 drives: sequences/00/ and sequences/07/"),
    (tarred({"07/a\u00fc.txt": b"1"}, format=tarfile.GNU_FORMAT, encoding="latin-1"), "not UTF-8"),
    *((tarred({"poses.txt": b"1"}, special(kind)), "is a link or a device") for kind in LINKS),
    *(
        (zipped({"velodyne/000000.bin": b"/etc/passwd"}, mode=kind | 0o777), "is a link or a device")
        for kind in (stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO)
    ),
    (encrypted(), "is encrypted"),
    (tarred(FILES, tarfile.TarInfo("poses.txt")), "comes twice"),
    (zipped({"poses.txt": b"1", "times.txt": b"2"}).replace(b"times.txt", b"poses.txt"), "comes twice"),
    (zipped({"07/a": b"1", "07/a/b": b"2"}), "file and a folder"),
    (of_negative_size(), "announces -512 bytes"),
    (zipped({}), "holds no files"),
    (tarred({}, special(tarfile.DIRTYPE, "07")), "holds no files"),
    *(
        (zipped({"poses.txt": b"1"}, method), "'poses.txt': is packed by a method that is not read here. Use deflate")
        for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    ),
]


@pytest.mark.parametrize(("data", "reason"), REFUSED, ids=[reason for _, reason in REFUSED])
def test_archives_refused_for_what_they_hold(client: httpx.Client, home: Path, data: bytes, reason: str) -> None:
    refuse(client, home, data, reason)


@pytest.mark.parametrize("data", [b"", b"Rar!\x1a\x07\x00", b"7z\xbc\xaf\x27\x1c", b"\x89PNG", bytes(1000)])
def test_what_is_no_archive(client: httpx.Client, home: Path, data: bytes) -> None:
    refuse(client, home, data, "neither .zip nor .tar", status=415)


ZEROS = {"velodyne/000000.bin": bytes(100_000_000)}


PACKED: dict[str, Callable[[dict[str, bytes]], bytes]] = {
    "zip": zipped,
    "tar.gz": lambda files: gzip.compress(tarred(files)),
    "tar.zst": lambda files: zstandard.compress(tarred(files)),
}


@pytest.mark.parametrize("kind", PACKED)
def test_bombs(client: httpx.Client, home: Path, kind: str) -> None:
    refuse(client, home, PACKED[kind](ZEROS), "unpacks to more than 64 MB", "200 times")


def test_a_zip_that_lies_about_its_size(client: httpx.Client, home: Path) -> None:
    data = zipped(ZEROS).replace(struct.pack("<I", 100_000_000), struct.pack("<I", 1000))
    refuse(client, home, data)


def test_a_zip_whose_files_overlap(client: httpx.Client, home: Path) -> None:
    """All names of the directory point to one piece of data."""
    data = zipped({f"velodyne/{n:06d}.bin": bytes(8_000_000) for n in range(20)})
    parts = data.split(b"PK\x01\x02")
    overlapping = b"PK\x01\x02".join([parts[0], *(part[:38] + bytes(4) + part[42:] for part in parts[1:])])
    refuse(client, home, overlapping)


def test_tar_headers_as_others_write_them(client: httpx.Client, drive: str) -> None:
    """A commit of git, attributes of macOS, times with fractions, a long name."""
    info = tarfile.TarInfo("07/velodyne/" + "a" * 150 + ".bin")
    info.pax_headers = {"mtime": "1764000000.123456789", "LIBARCHIVE.xattr.com.apple.FinderInfo": "QUJD" * 2000}
    data = pax(tarfile.XGLTYPE, record(b"comment", b"4ed264a" * 5)) + tarred({}, info, format=tarfile.PAX_FORMAT)
    assert client.post(f"{drive}/archive", content=data).status_code == 200
    assert list(listed(client, drive)) == ["velodyne/" + "a" * 150 + ".bin"]


def test_very_many_folders(client: httpx.Client, home: Path) -> None:
    folders = special(tarfile.DIRTYPE, "07").tobuf() * 20_001
    refuse(client, home, zstandard.compress(folders + TARRED), "more than 10,000 files")


def test_little_is_unpacked_at_a_time(tmp_path: Path) -> None:
    """However much comes of a few bytes: blocks of one byte again and again become 32,768 times as much."""
    path = tmp_path / "archive"
    block = ((128 * 1024) << 3 | 1 << 1).to_bytes(3, "little") + b"\0"
    path.write_bytes(b"\x28\xb5\x2f\xfd\x00\x38" + block * 2000)
    tracemalloc.start()
    try:
        with suppress(ArchiveError), members(path, lambda _: None, 10) as found:
            for member in found:
                with member.open() as file:
                    while file.read(1 << 20):
                        pass
        assert tracemalloc.get_traced_memory()[1] < 80 * 2**20
    finally:
        tracemalloc.stop()


def test_too_many_files(serve: Serve, tmp_path: Path) -> None:
    client = serve(max_drive_files=50)
    names = {f"velodyne/{n:06d}.bin": b"" for n in range(51)}
    refuse(client, tmp_path, zipped(names), "more than 50 files")
    refuse(client, tmp_path, tarred(names), "more than 50 files")
    drive = make_drive(client)
    assert client.put(f"{drive}/files/poses.txt", content=b"1").status_code == 201
    names.popitem()
    answer = client.post(f"{drive}/archive", content=zipped(names))
    assert (answer.status_code, answer.json()["title"]) == (413, "Too many files")
    assert list(listed(client, drive)) == ["poses.txt"]


def test_too_large_files_and_archives(serve: Serve, tmp_path: Path) -> None:
    client = serve(max_file_bytes=1_000_000, max_drive_bytes=1_500_000)
    refuse(client, tmp_path, zipped({"07/poses.txt": bytes(1_000_001)}), "larger than 1 MB")
    refuse(client, tmp_path, zipped({f"07/{n}": bytes(900_000) for n in range(2)}), "the limit for a drive")
    refuse(client, tmp_path, bytes(1_500_001), "An archive may have", status=413)


def test_a_full_disk(serve: Serve, tmp_path: Path) -> None:
    refuse(serve(min_free_bytes=1 << 60), tmp_path, KINDS["zip"], "no disk space left", status=507)
