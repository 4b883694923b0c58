"""Object storage: what is fetched from it, and refused."""

import itertools
from collections.abc import Iterator
from contextlib import suppress
from functools import partialmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from interloc import open_drive, storage
from interloc.errors import DriveError, NetworkError, OutputError
from interloc.files import atomic_folder
from interloc.reduction.listing import fetch_drive
from interloc.storage import is_within
from tests.small_drives import write_kitti_raw

obstore = pytest.importorskip("obstore", reason="obstore is not installed")


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A store in memory instead of that of every bucket."""
    from obstore.store import MemoryStore  # noqa: PLC0415 - see above

    memory = MemoryStore()
    monkeypatch.setattr(storage, "_open", lambda _: memory)
    yield memory
    storage.clear()


def put(store: Any, folder: Path, key: str) -> None:
    for path in filter(Path.is_file, folder.rglob("*")):
        obstore.put(store, f"{key}/{path.relative_to(folder).as_posix()}", path.read_bytes())


def test_objects_are_fetched_whole_in_pieces_once(store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = np.random.default_rng(1).bytes(100_000)
    for name, data in (("a.mcap", content), ("empty", b""), ("poses/07.txt", b"1 2 3")):
        obstore.put(store, f"drive/{name}", data)
    monkeypatch.setattr(storage, "_PIECE_BYTES", 30_000)
    bucket = storage.Bucket("s3://bucket")
    objects = {each.key: each for each in bucket.below("drive")}
    told: list[tuple[int, int]] = []
    for _ in range(2):  # the second time there is nothing to do
        storage.fetch(bucket, objects, tmp_path, lambda *count: told.append(count))
        assert (tmp_path / "drive/a.mcap").read_bytes() == content
    assert told[-1] == (100_005, 100_005)
    assert len(told) == 6
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} == {"a.mcap", "empty", "07.txt"}


def test_what_does_not_fit_on_disk_is_not_fetched(store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    obstore.put(store, "a.mcap", bytes(1000))
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=999))
    with pytest.raises(OutputError, match=r"0.0 GB are to be fetched .* Set TMPDIR to a larger disk"):
        fetch_drive("s3://bucket/a.mcap", tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_lies_beside_a_drive_is_taken_with_it(store: Any, tmp_path: Path) -> None:
    write_kitti_raw(tmp_path / "day" / "drive_sync")
    (tmp_path / "day/drive_sync/calib_imu_to_velo.txt").rename(tmp_path / "day/calib_imu_to_velo.txt")
    put(store, tmp_path, "raw")
    place = fetch_drive("s3://bucket/raw/day/drive_sync")
    assert open_drive(place).georeference is not None
    assert list(place.glob("calib*"))
    alone = "s3://bucket/raw/day/drive_sync"
    assert not list(fetch_drive(alone, within=[alone]).glob("calib*"))


def test_an_object_that_changes_is_not_read(store: Any, tmp_path: Path) -> None:
    obstore.put(store, "d/velodyne/000000.bin", bytes(16))
    bucket = storage.Bucket("s3://bucket")
    (listed,) = bucket.below("d")
    obstore.put(store, "d/velodyne/000000.bin", bytes(32))
    with pytest.raises(DriveError, match=r"s3://bucket/d/velodyne/000000.bin was changed while it was read"):
        storage.fetch(bucket, {"000000.bin": listed}, tmp_path)


@pytest.mark.parametrize("name", ["a\0b", "line\nbreak", "dir\u202ection", "back\\slash", "x" * 300, "..", ""])
def test_hostile_names_are_refused(name: str, tmp_path: Path) -> None:
    wanted = storage.StoredObject(f"d/{name}", 1, None, 0.0)
    with pytest.raises(DriveError, match="cannot be a file"):
        storage.fetch(storage.Bucket("s3://b"), {f"d/{name}/f": wanted}, tmp_path)
    with pytest.raises(DriveError, match="as an object and as the prefix of others"):
        storage.fetch(storage.Bucket("s3://b"), {"d": wanted, "d/f": wanted}, tmp_path)
    assert not list(tmp_path.iterdir())


def test_too_many_objects_are_refused(store: Any) -> None:
    for number in range(5):
        obstore.put(store, f"d/{number}", b"")
    with pytest.raises(DriveError, match="more than 4 objects"):
        storage.Bucket("s3://bucket").below("d", 4)


def test_prefixes_end_at_slashes() -> None:
    inside = ["s3://a/b", "s3://a/b/", "s3://a/b/c"]
    for address, prefix in itertools.product(inside, ("s3://a/b", "s3://a/b/")):
        assert is_within(address, [prefix])
    assert not is_within("s3://a/bc", ["s3://a/b"])
    assert not is_within("s3://a/b", [])


def test_what_a_stop_left_of_a_result_is_replaced(store: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for refused in ("run.json", "nothing"):
        with atomic_folder(storage.result_place("s3://bucket/out"), marker="run.json") as folder:
            (folder / "run.json").write_text("{}")
            (folder / f"without-{refused}").touch()
        with monkeypatch.context() as patched, suppress(NetworkError):
            patched.setattr(storage.Bucket, "put", partialmethod(put_all_but, refused))
            storage.send_results()
        storage.clear()
    names = {entry["path"] for batch in obstore.list(store) for entry in batch}
    assert names == {"out/run.json", "out/without-nothing", "out/without-run.json"}


def put_all_but(bucket: storage.Bucket, refused: str, key: str, content: Path | bytes) -> None:
    if key.endswith(f"/{refused}"):
        raise NetworkError("the connection was lost")
    obstore.put(bucket.store, key, content)
