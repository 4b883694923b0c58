"""Text files and numbered files that are not what they should be."""

import gzip
import os
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.drives.files import MAX_ROWS, SourceFile, list_numbered
from interloc.drives.findings import Findings
from interloc.drives.open import open_drive, read_drive
from interloc.drives.options import DriveOptions
from interloc.errors import DriveError

WHOLE = gzip.compress(b"1 2 3 4 5 6" * 30)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("poses.txt", b"", "empty"),
        ("poses.txt", b" \n", "empty"),
        ("poses.txt", b"\xff\xfe\x00", "is UTF-16"),
        ("poses.txt", b"\xfa\x81", "not a text file"),
        ("poses.txt", b"1 0\0", "zero bytes"),
        *(("07.txt.gz", data, "gzip") for data in (WHOLE[:-6], b"1 2 3", WHOLE[:12] + b"\xff" * 20)),
        *(
            ("poses.txt", line * (MAX_ROWS + 1), r"poses\.txt: holds more than 1,000,000 lines; expected one per frame")
            for line in (b"no number\n", b"no number\r\n", b"no number\r")
        ),
        ("poses.txt", b"1 0 0\n" + b"0 " * 6000, r"line 2: 12,000 characters in one line; expected at most 10,000"),
    ],
    ids=range(12),
)
def test_text_that_is_none(tmp_path: Path, name: str, data: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(DriveError, match=words):
        SourceFile(tmp_path / name, tmp_path).lines()


def test_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "poses.txt")
    for name, words in (
        (".", "is a folder"),
        ("poses.txt", "is a pipe or device"),
        ("times.txt", r"times\.txt: cannot be read: no such file"),
    ):
        with pytest.raises(DriveError, match=words):
            SourceFile(tmp_path / name, tmp_path).text()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_permission_denied(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("1")
    path.chmod(0)
    with pytest.raises(DriveError, match="permission denied"):
        SourceFile(path, tmp_path).text()


def test_packed_text(tmp_path: Path) -> None:
    path = tmp_path / "07.txt.gz"
    path.write_bytes(gzip.compress(b"1 2 3"))
    assert SourceFile(path, tmp_path).text() == "1 2 3"


def test_a_gzip_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("interloc.drives.files.MAX_SMALL_BYTES", 1000)
    path = tmp_path / "07.txt.gz"
    path.write_bytes(gzip.compress(b"0" * 100_000))
    with pytest.raises(DriveError, match="larger than"):
        SourceFile(path, tmp_path).text()


def test_lines_end_as_on_any_system(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_bytes(b"1\r\n2\n\n3\r4\x0b5")
    assert SourceFile(path, tmp_path).lines() == ["1", "2", "", "3", "4\x0b5"]


def test_numbered_files_are_sorted_by_number(tmp_path: Path) -> None:
    for name in ("000010.bin", "000002.bin", "notes.txt", ".hidden.bin"):
        (tmp_path / name).write_bytes(b"1234")
    files = list_numbered(SourceFile(tmp_path, tmp_path), ".bin")
    assert files.numbers.tolist() == [2, 10]
    assert files.sizes.tolist() == [4, 4]
    assert files.path(2) == tmp_path / "000002.bin"


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ([], r"holds no \.bin file"),
        (["scan.bin"], "not named by its scan number"),
        (["000001.bin", "0000000002.bin"], "not numbered like its neighbours"),
        (["000001.bin", "1.bin"], "not numbered like its neighbours"),
        (["²³.bin"], "not named by its scan number"),
        (["9" * 30 + ".bin"], "not named by its scan number"),
    ],
)
def test_odd_names(tmp_path: Path, names: list[str], words: str) -> None:
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(DriveError, match=words):
        list_numbered(SourceFile(tmp_path, tmp_path), ".bin")


def test_what_is_no_scan_among_them(tmp_path: Path) -> None:
    (tmp_path / "000000.bin").mkdir()
    with pytest.raises(DriveError, match="is a folder"):
        list_numbered(SourceFile(tmp_path, tmp_path), ".bin")
    (tmp_path / "000000.bin").rmdir()
    (tmp_path / "000000.bin").symlink_to(tmp_path / "gone.bin")
    with pytest.raises(DriveError, match="cannot be read"):
        list_numbered(SourceFile(tmp_path, tmp_path), ".bin")


_counts: list[Counter[Path]] = []


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if _counts and event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
        _counts[-1][Path(os.fsdecode(arguments[0]))] += 1


@cache
def _listen() -> None:
    sys.addaudithook(_note)  # an audit hook stays until the process ends


@contextmanager
def counted_opens() -> Iterator[Counter[Path]]:
    """Count how often each file is opened meanwhile, by this process."""
    _listen()
    _counts.append(Counter())
    try:
        yield _counts[-1]
    finally:
        _counts.pop()


def texts_in(root: Path) -> list[Path]:
    return sorted(path for path in root.rglob("*.txt") if path.name != "calib.txt")


@pytest.fixture
def with_oxts(sequence: Path, make: ModuleType) -> Path:
    """The sequence with a fix per scan and a second folder of labels."""
    (sequence / "oxts").mkdir()
    for frame, row in enumerate(make.oxts_lines(make.lidar_poses(), T_lidar_imu=np.eye(4))):
        (sequence / "oxts" / f"{frame:010d}.txt").write_text(row + "\n")
    (sequence / "labels").rename(sequence / "predictions")
    make.write_semantickitti(sequence)
    return sequence


def test_both_label_folders(with_oxts: Path) -> None:
    with counted_opens() as opens:
        readings = read_drive(
            with_oxts, DriveOptions(), Findings(stop_at_first=True), label_folders=("labels", "predictions")
        )
    assert {path.name: opens[path] for path in texts_in(with_oxts)} == dict.fromkeys(
        ["poses.txt", "times.txt", *(f"{frame:010d}.txt" for frame in range(12))], 1
    )
    by_labels, by_predictions = (reading.drive for reading in readings.values())
    assert by_labels.T_world_lidar is by_predictions.T_world_lidar
    assert (by_labels.label_source, by_predictions.label_source) == ("labels", "predictions")


def test_a_reduced_drive(reduced: Path) -> None:
    with counted_opens() as opens:
        open_drive(reduced)
    assert {opens[path] for path in texts_in(reduced)} == {1}


def test_a_file_that_changed_is_read_anew(sequence: Path, make: ModuleType) -> None:
    open_drive(sequence)
    (sequence / "poses.txt").write_text(make.pose_text(make.camera_poses(make.lidar_poses(step_m=1.0))))
    assert np.linalg.norm(open_drive(sequence).T_world_lidar[1, :3, 3]) == pytest.approx(1.0)
