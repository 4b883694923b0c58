"""Object storage: what is laid out of it, and that no more of it is fetched than is read."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc import open_drive, storage
from interloc.errors import DriveError
from interloc.reduction.elsewhere import lay_out
from interloc.storage import is_within
from tests.bags import write_bag
from tests.small_drives import lidar_poses, write_kitti_raw

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


def test_only_blocks_that_are_read_are_fetched_and_each_once(store: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    content = np.random.default_rng(1).bytes(3_000_000)
    obstore.put(store, "drive/a.mcap", content)
    path = lay_out("s3://bucket/drive/a.mcap")
    counts: list[int] = []
    get = storage.Bucket.get
    monkeypatch.setattr(storage.Bucket, "get", lambda *given: counts.append(given[3] - given[2]) or get(*given))
    for _ in range(2):  # the second time, as another process would: nothing
        with storage.open_binary(path) as file:
            storage.want(file, [(100, 200), (150, 40_000), (2_000_000, 2_000_001)])
            file.seek(150)
            assert file.read(30_000) == content[150:30_150]
            assert file.seek(-10, 2) == len(content) - 10
            assert file.read(100) == content[-10:]
    assert sum(counts) == 4 * 16_384 + len(content) % 16_384
    assert storage.present(path).read_bytes() == content
    assert sum(counts) == len(content)


def test_a_bag_is_read_by_ranges(store: Any, tmp_path: Path) -> None:
    poses = lidar_poses(8)
    scans = [np.random.default_rng(n).normal(size=(4000, 4)).astype(np.float32) for n in range(8)]
    labels = [np.full(4000, 40, np.uint32) for _ in scans]
    bag = write_bag(tmp_path / "bag", "mcap", scans, [0.1 * n for n in range(8)], labels=labels, poses=poses)
    put(store, bag, "bags/bag")
    here, there = (open_drive(place, check=False) for place in (bag, lay_out("s3://bucket/bags/bag")))
    assert (there.T_world_lidar == here.T_world_lidar).all()
    assert (there.ground_points(5).xyz == here.ground_points(5).xyz).all()


def test_what_lies_beside_a_drive_is_taken_with_it(store: Any, tmp_path: Path) -> None:
    write_kitti_raw(tmp_path / "day" / "drive_sync")
    (tmp_path / "day/drive_sync/calib_imu_to_velo.txt").rename(tmp_path / "day/calib_imu_to_velo.txt")
    put(store, tmp_path, "raw")
    place = lay_out("s3://bucket/raw/day/drive_sync")
    assert open_drive(place).georeference is not None
    assert list(place.glob("calib*"))
    alone = "s3://bucket/raw/day/drive_sync"
    assert not list(lay_out(alone, within=[alone]).glob("calib*"))


def test_an_object_that_changes_is_not_read(store: Any) -> None:
    obstore.put(store, "map.osm.pbf", b"before")
    obstore.put(store, "d/velodyne/000000.bin", bytes(16))
    obstore.put(store, "d/poses.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n")
    place = lay_out("s3://bucket/d")
    obstore.put(store, "d/velodyne/000000.bin", bytes(32))
    with pytest.raises(DriveError, match=r"s3://bucket/d/velodyne/000000.bin was changed while it was read"):
        storage.present(place / "velodyne/000000.bin")


@pytest.mark.parametrize("name", ["a\0b", "line\nbreak", "dir\u202ection", "back\\slash", "x" * 300, "..", ""])
def test_hostile_names_are_refused(name: str, tmp_path: Path) -> None:
    wanted = storage.StoredObject(f"d/{name}", 1, None, 0.0)
    with pytest.raises(DriveError, match="cannot be a file"):
        storage.LaidOut.make(tmp_path / storage.FOLDER, storage.Bucket("s3://b"), {f"d/{name}/f": wanted})
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
