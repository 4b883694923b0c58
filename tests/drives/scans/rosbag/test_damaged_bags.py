"""Damaged, truncated and hostile bags are refused in words that name the cure."""

import bz2
import shutil
import sqlite3
import struct
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode

from interloc.drives.findings import Findings
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scans.rosbag.open import open_rosbag
from interloc.errors import DriveError, InterLocError
from tests.bags import FORMATS, BagWriter, write_bag
from tests.drives.scans.rosbag.test_open import IN_ALL_FORMS, opened, straight
from tests.small_drives import refusal_of

START = 1.6e9
ZSTD = (CompressionMode.STORAGE, CompressionFormat.ZSTD)


def small_bag(path: Path, form: str, compression: Any = None, count: int = 8) -> Path:
    """Write a small bag; return its one file."""
    rng = np.random.default_rng(1)
    scans = [rng.normal(size=(40, 4)).astype(np.float32) for _ in range(count)]
    times = [START + 0.1 * row for row in range(count)]
    fixes = [(each, (49.0 + 2.7e-5 * row, 8.0, 100.0)) for row, each in enumerate(times)]
    written = write_bag(path, form, scans, times, poses=straight(count, 3.0), fixes=fixes, compression=compression)
    return written if written.is_file() else next(written.glob(f"*.{form}"))


def read_all(path: Path) -> int:
    """Read everything of a bag; return how many scans there are."""
    findings = Findings(stop_at_first=True)
    recording = open_rosbag(path, DriveOptions(), findings)
    recording.read_trajectory(recording.frames, DriveOptions(), findings)
    for frame in recording.frames:
        recording.points.read(int(frame))
    return len(recording.frames)


refusal = partial(refusal_of, read_all)


@IN_ALL_FORMS
def test_nothing_but_words_comes_out_of_a_damaged_bag(tmp_path: Path, form: str, compression: Any) -> None:
    file = small_bag(tmp_path / "sound", form, compression)
    valid, rng = file.read_bytes(), np.random.default_rng(11)
    damaged = tmp_path / f"damaged.{form}"
    for trial in range(30):
        data = bytearray(valid)
        if trial % 3 == 0:
            del data[int(rng.integers(0, len(data))) :]
        elif trial % 3 == 1:
            for at in rng.integers(0, len(data), 4):
                data[int(at)] = int(rng.integers(0, 256))
        else:
            at = int(rng.integers(0, len(data) - 8))
            data[at : at + 8] = b"\xff" * 8
        damaged.write_bytes(data)
        started = time.monotonic()
        try:
            read_all(damaged)
        except InterLocError as error:
            assert len(str(error)) > 30  # noqa: PT017
        assert time.monotonic() - started < 10


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("content", [b"", b"\0", b"PK\3\4" + b"x" * 1000, b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"])
def test_other_files_under_the_name_of_a_bag_are_refused(tmp_path: Path, form: str, content: bytes) -> None:
    file = tmp_path / f"other.{form}"
    file.write_bytes(content)
    assert refusal(file).startswith(f"other.{form}: ")


def cut_off(data: bytes) -> bytes:
    return data[: int(0.6 * len(data))]


def without_a_summary(data: bytes) -> bytes:
    return data[:-28] + bytes(8) + data[-20:]


def without_an_index(data: bytes) -> bytes:
    at = data.index(b"index_pos=") + len(b"index_pos=")
    return data[:at] + bytes(8) + data[at + 8 :]


@pytest.mark.parametrize(("form", "damage", "cure"), [
    ("bag", cut_off, "`rosbag reindex drive.bag`"),
    ("db3", cut_off, "`ros2 bag reindex`"),
    ("mcap", cut_off, "`mcap recover drive.mcap"),
    ("mcap", without_a_summary, "it has no summary, and with it no index"),
    ("bag", without_an_index, "rosbag reindex"),
])  # fmt: skip
def test_a_bag_that_was_not_finished_is_refused_with_the_cure(
    tmp_path: Path, form: str, damage: Callable[[bytes], bytes], cure: str
) -> None:
    file = small_bag(tmp_path / "drive", form)
    file.write_bytes(damage(file.read_bytes()))
    assert cure in refusal(file)


def rewritten(file: Path, target: Path, **settings: Any) -> Path:
    """Write an MCAP file again, with other settings of the official writer."""
    with file.open("rb") as source, target.open("wb") as sink:
        writer, numbers = Writer(sink, **settings), {}
        writer.start()
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in numbers:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(numbers[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    return target


@pytest.mark.parametrize("settings", [
    {"compression": CompressionType.LZ4, "chunk_size": 3000},
    {"use_chunking": False},  # as the preset "fastwrite" of ros2 bag record does
    {"use_chunking": False, "use_statistics": False},
    {"use_statistics": False},
])  # fmt: skip
def test_an_mcap_may_be_written_in_any_way(tmp_path: Path, settings: dict[str, Any]) -> None:
    file = small_bag(tmp_path / "drive", "mcap")
    (recording, *_), (again, *_) = opened(file), opened(rewritten(file, tmp_path / "again.mcap", **settings))
    assert again.topics == recording.topics
    for frame in range(8):
        assert np.array_equal(again.points.read(frame).values, recording.points.read(frame).values)


@pytest.mark.parametrize("settings", [{"index_types": IndexType.CHUNK}, {"repeat_channels": False}])
def test_an_mcap_whose_summary_is_not_enough_is_refused(tmp_path: Path, settings: dict[str, Any]) -> None:
    file = small_bag(tmp_path / "drive", "mcap")
    assert "mcap recover" in refusal(rewritten(file, tmp_path / "again.mcap", **settings))


@pytest.mark.parametrize("form", ["db3", "mcap"])
def test_a_bag_that_is_compressed_as_a_whole_is_refused_with_the_command(tmp_path: Path, form: str) -> None:
    file = small_bag(tmp_path / "drive", form)
    packed = file.rename(file.with_name(file.name + ".zstd"))
    for path in (packed, file.parent):
        with pytest.raises(DriveError, match=r"unpack.* first.*zstd -d"):
            open_drive(path)


def test_several_bags_in_a_folder_are_refused(tmp_path: Path) -> None:
    first = small_bag(tmp_path / "first", "bag")
    shutil.copy(first, tmp_path / "second.bag")
    assert "holds several bags (first.bag, second.bag)" in refusal(tmp_path)


def test_a_bag_in_the_folder_of_a_drive_is_found(tmp_path: Path) -> None:
    small_bag(tmp_path / "drive" / "recording", "mcap")
    assert read_all(tmp_path / "drive") == 8


@pytest.mark.parametrize("name", ["velodyne", "velodyne_points/data"])
def test_a_drive_of_another_layout_is_left_to_its_reader(tmp_path: Path, name: str) -> None:
    small_bag(tmp_path / "drive", "bag")
    (tmp_path / name).mkdir(parents=True)
    assert open_rosbag(tmp_path, DriveOptions(), Findings(stop_at_first=True)) is None
    assert open_rosbag(tmp_path, DriveOptions(layout="rosbag"), Findings(stop_at_first=True)) is not None
    assert open_rosbag(tmp_path / name, DriveOptions(), Findings(stop_at_first=True)) is None


NEVER_ENDS = (
    "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
    "SELECT id, 1 AS topic_id, 2 AS timestamp, 3 AS data FROM n"
)


@pytest.mark.parametrize(("table", "view"), [("notes", ""), ("topics", NEVER_ENDS)])
def test_a_database_without_messages_is_refused(tmp_path: Path, table: str, view: str) -> None:
    with sqlite3.connect(tmp_path / "other.db3") as database:
        database.executescript(f"CREATE TABLE {table} (id, name, type, serialization_format); {view}")
    database.close()
    assert f"without the tables of a bag (it has {table})" in refusal(tmp_path / "other.db3")


def test_a_bag_of_before_ros_2_iron_has_no_definitions_and_is_read(tmp_path: Path) -> None:
    file = small_bag(tmp_path / "drive", "db3")
    with sqlite3.connect(file) as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("DROP TABLE schema")
    database.close()
    assert read_all(file) == 8


def test_a_chunk_that_unpacks_to_much_more_is_refused(tmp_path: Path) -> None:
    file = small_bag(tmp_path / "drive", "bag", (Writer1.CompressionFormat.BZ2,))
    data = bytearray(file.read_bytes())
    bomb = bz2.compress(bytes(75_000_000), 1)
    chunk = data.index(b"BZh")
    (size,) = struct.unpack_from("<I", data, chunk - 4)
    assert len(bomb) < size
    data[chunk : chunk + len(bomb)] = bomb
    file.write_bytes(data)
    started = time.monotonic()
    assert "is damaged" in refusal(file)
    assert time.monotonic() - started < 5


def test_sizes_that_a_chunk_cannot_have_are_refused(tmp_path: Path) -> None:
    file = small_bag(tmp_path / "drive", "mcap", ZSTD)
    data = bytearray(file.read_bytes())
    (summary,) = struct.unpack_from("<Q", data, len(data) - 28)
    size_at = data.index(b"\x04\0\0\0zstd", summary) + 16  # of the chunk when unpacked, after its size in the file
    struct.pack_into("<Q", data, size_at, 2**60)
    file.write_bytes(data)
    assert "is said to unpack to 1,152,921,504,606,846,976 bytes" in refusal(file)


def test_an_empty_topic_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive.bag", "bag") as bag:
        bag.odometry("/odom", START, np.eye(4))
        bag.writer.add_connection("/points", "sensor_msgs/msg/PointCloud2", typestore=bag.store)
    assert "/points: no messages. Expected one per scan" in refusal(tmp_path / "drive.bag")


def test_a_file_that_is_no_bag_is_left_to_others(tmp_path: Path) -> None:
    (tmp_path / "cloud.las").write_bytes(b"LASF")
    assert open_rosbag(tmp_path / "cloud.las", DriveOptions(), Findings(stop_at_first=True)) is None
    assert open_rosbag(tmp_path, DriveOptions(), Findings(stop_at_first=True)) is None
    assert open_rosbag(tmp_path / "nothing", DriveOptions(), Findings(stop_at_first=True)) is None
    with pytest.raises(DriveError, match="a ROS bag or a LAS file"):
        open_drive(tmp_path / "cloud.las", layout="rosbag")
