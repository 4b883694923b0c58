"""The reserve of disk space: made where there is room, given up where there is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.store import reserve as module
from app.store.reserve import Reserve

SIZE = 300_000


def test_it_is_made_of_blocks_and_made_once(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path, SIZE, keep_free=0)
    reserve.fill()
    (file,) = tmp_path.iterdir()
    assert (file.name, file.stat().st_size) == ("reserve", SIZE)
    assert file.stat().st_blocks * 512 >= SIZE
    before = file.stat()
    reserve.fill()
    assert file.stat().st_ino == before.st_ino
    Reserve(tmp_path, 2 * SIZE, keep_free=0).fill()  # another setting
    assert file.stat().st_size == 2 * SIZE


def test_it_is_written_where_the_file_system_keeps_only_the_number_of_zeros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module.os, "posix_fallocate", lambda *_: None)
    Reserve(tmp_path, SIZE, keep_free=0).fill()
    content = (tmp_path / "reserve").read_bytes()
    assert len(content) == SIZE
    assert len(set(content)) == 256


def test_it_is_not_made_of_the_last_space(tmp_path: Path) -> None:
    Reserve(tmp_path, SIZE, keep_free=1 << 60).fill()
    Reserve(tmp_path, 0, keep_free=0).fill()
    assert list(tmp_path.iterdir()) == []


def test_it_is_given_up_only_when_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reserve = Reserve(tmp_path, SIZE, keep_free=0)
    reserve.fill()
    reserve.give_up_if_full()
    assert (tmp_path / "reserve").is_file()
    monkeypatch.setattr(module, "_NEARLY_FULL_BYTES", 1 << 60)
    reserve.give_up_if_full()
    assert list(tmp_path.iterdir()) == []
    reserve.give_up()  # there is nothing left to give up
