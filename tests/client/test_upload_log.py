"""The log of a push survives whatever stops the process, and is never mistaken for that of another."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from interloc.client.upload import Sent, UploadFile, UploadLog
from interloc.errors import OutputError

IDENTITY = {"server": "http://127.0.0.1:8000", "drive": "/data/07"}


def the_file(folder: Path) -> Path:
    (path,) = folder.glob("*.jsonl")
    return path


def test_a_new_drive_begins_from_nothing(tmp_path: Path) -> None:
    with UploadLog(tmp_path, IDENTITY) as log:
        log.begin("d1")
        log.add("poses.txt", Sent("16:1", "aa"))
        log.begin("d2")
        assert log.sent("poses.txt") is None
    with UploadLog(tmp_path, IDENTITY) as log:
        assert (log.drive_id, log.sent("poses.txt")) == ("d2", None)


@pytest.mark.parametrize("cut", range(2, 46, 7))
def test_a_line_cut_short_costs_that_line_only(cut: int, tmp_path: Path) -> None:
    with UploadLog(tmp_path, IDENTITY) as log:
        log.begin("d1")
        log.add("a", Sent("1:1", "aa"))
        log.add("b", Sent("2:2", "bb"))
    os.truncate(the_file(tmp_path), the_file(tmp_path).stat().st_size - cut)
    with UploadLog(tmp_path, IDENTITY) as log:
        assert (log.drive_id, log.sent("a"), log.sent("b")) == ("d1", Sent("1:1", "aa"), None)
        log.add("c", Sent("3:3", "cc"))
    with UploadLog(tmp_path, IDENTITY) as log:
        assert (log.sent("a"), log.sent("c")) == (Sent("1:1", "aa"), Sent("3:3", "cc"))


def test_rubbish_is_no_memory(tmp_path: Path) -> None:
    with UploadLog(tmp_path, IDENTITY) as log:
        log.begin("d1")
    the_file(tmp_path).write_text('[1]\n"text"\n{"path": "a"}\nnull\n{"drive": "d2"}\n')
    with UploadLog(tmp_path, IDENTITY) as log:
        assert (log.drive_id, log.sent("a")) == ("d2", None)


def test_the_same_push_twice_at_once_is_refused(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from interloc.client.upload import UploadLog;"
        f"log = UploadLog(Path({str(tmp_path)!r}), {IDENTITY!r}); print('holds', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "holds\n"
        with pytest.raises(OutputError, match="is being pushed to the same server by another process"):
            UploadLog(tmp_path, IDENTITY)
        other.kill()
    with UploadLog(tmp_path, IDENTITY) as log:  # the lock died with the process
        assert log.drive_id is None


def test_logs_that_nobody_comes_back_to_are_swept_up(tmp_path: Path) -> None:
    with UploadLog(tmp_path, IDENTITY) as log:
        log.begin("d1")
    long_ago = time.time() - 100 * 86400
    os.utime(the_file(tmp_path), (long_ago, long_ago))
    (tmp_path / "notes.jsonl").write_text("not ours")
    os.utime(tmp_path / "notes.jsonl", (long_ago, long_ago))
    with UploadLog(tmp_path, {"server": "another"}):
        assert (tmp_path / "notes.jsonl").exists()
    with UploadLog(tmp_path, IDENTITY) as log:
        assert log.drive_id is None


def test_a_folder_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="could not be used"):
        UploadLog(tmp_path / "file" / "logs", IDENTITY)


def test_signatures_change_with_the_file_and_how_it_is_made(tmp_path: Path) -> None:
    path = tmp_path / "000000.bin"
    path.write_bytes(b"1234")

    def signature(made_by: str) -> str:
        return UploadFile("ground/labels/000000.ground", lambda: b"", (path,), made_by).signature

    before = signature("40")
    assert signature("40") == before
    assert signature("9") != before
    path.write_bytes(b"5678")
    os.utime(path, ns=(1, 1))
    assert signature("40") != before
