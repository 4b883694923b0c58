"""Nothing half-written stays, whatever goes wrong; what was there before does."""

import errno
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from interloc import files
from interloc.errors import DriveError, OutputError
from interloc.files import atomic_write, finish_replacing
from tests import forks

atomic_folder = partial(files.atomic_folder, marker="run.json", names={"run.json", "report.json", "figures"})

is_root = hasattr(os, "geteuid") and os.geteuid() == 0


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def make_result(folder: Path, run: bytes = b"old") -> None:
    folder.mkdir()
    (folder / "run.json").write_bytes(run)
    (folder / "report.json").write_bytes(b"old report")


# one file ------------------------------------------------------------------------------------------------------------


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    with atomic_write(path) as handle:
        handle.write(b"new")
        assert not path.exists()
    assert contents(tmp_path) == {"a.json": b"new"}


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit, ValueError, DriveError, GeneratorExit])
def test_a_stopped_write_leaves_the_old_file(tmp_path: Path, stop: type[BaseException]) -> None:
    (tmp_path / "a.json").write_bytes(b"old")
    with pytest.raises(stop), atomic_write(tmp_path / "a.json") as handle:  # noqa: PT012
        handle.write(b"half")
        raise stop
    assert contents(tmp_path) == {"a.json": b"old"}


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none" / "a.json"
    with pytest.raises(OutputError) as caught, atomic_write(path):
        pass
    assert str(caught.value) == f"{path} could not be written: no such file or directory."


def test_an_error_about_another_file_stays_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic_write(tmp_path / "a.json"):
        (tmp_path / "input").read_bytes()
    with pytest.raises(BrokenPipeError), atomic_folder(tmp_path / "out"):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")
    assert contents(tmp_path) == {}


@pytest.mark.skipif(is_root, reason="root may write everywhere")
def test_permission_denied_is_said(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="permission denied"), atomic_write(tmp_path / "a.json"):
            pass
        with pytest.raises(OutputError, match="permission denied"), atomic_folder(tmp_path / "out"):
            pass
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize(
    ("out", "name", "write"),
    [("out", "detections.geojson", "atomic_write(path)"), ("deep/er/out", "", "path.open('wb')")],
)
def test_a_file_over_the_size_limit_leaves_what_was_there(tmp_path: Path, out: str, name: str, write: str) -> None:
    make_result(tmp_path / "out")
    before = contents(tmp_path)
    code = f"""
import resource
from pathlib import Path
from interloc.errors import OutputError
from interloc.files import atomic_folder, atomic_write
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    with atomic_folder(Path({out!r}), marker="run.json") as folder:
        (folder / "small.png").write_bytes(b"small")
        path = folder / "detections.geojson"
        with {write} as handle:
            handle.write(b"x" * 100_000)
except OutputError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{Path(out, name)} could not be written: file too large")
    assert contents(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]  # folders made on the way are gone as well


def test_a_small_disk_leaves_the_old_results(small_disk: Path) -> None:
    make_result(small_disk / "out")
    before = contents(small_disk)
    with pytest.raises(OutputError, match=r"out/detections.geojson could not be written: no space left"):  # noqa: SIM117
        with atomic_folder(small_disk / "out") as folder, atomic_write(folder / "detections.geojson") as handle:
            handle.write(bytes(70_000_000))
    assert contents(small_disk) == before


def test_a_mounted_folder_is_filled(small_disk: Path) -> None:
    with atomic_folder(small_disk) as folder:
        (folder / "run.json").write_bytes(b"1")
        (folder / "report.json").write_bytes(b"1")
    (small_disk / "notes.txt").write_bytes(b"mine")
    before = contents(small_disk)
    with pytest.raises(KeyboardInterrupt), atomic_folder(small_disk) as folder:  # noqa: PT012
        (folder / "run.json").write_bytes(b"2")
        raise KeyboardInterrupt
    with pytest.raises(OutputError, match="no space left"), atomic_folder(small_disk) as folder:
        (folder / "run.json").write_bytes(bytes(70_000_000))
    assert contents(small_disk) == before == {"run.json": b"1", "report.json": b"1", "notes.txt": b"mine"}
    with atomic_folder(small_disk) as folder:
        (folder / "run.json").write_bytes(b"2")
    assert contents(small_disk) == {"run.json": b"2", "notes.txt": b"mine"}


# a folder ------------------------------------------------------------------------------------------------------------


def test_a_folder_appears_when_it_is_complete(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with atomic_folder(out) as folder:
        (folder / "run.json").write_bytes(b"{}")
        assert not out.exists()
        assert folder.parent == out.parent  # the same file system, so that the renaming is one step
    assert contents(tmp_path) == {"new/out/run.json": b"{}"}


def test_a_new_result_replaces_the_old_one_and_its_report_but_no_file_of_the_user(tmp_path: Path) -> None:
    out = tmp_path / "out"
    make_result(out)
    (out / "figures").mkdir()
    (out / "figures" / "map.png").write_bytes(b"old")
    (out / "my map.qgz").write_bytes(b"mine")
    with atomic_folder(out) as folder:
        (folder / "run.json").write_bytes(b"new")
        assert (out / "run.json").read_bytes() == b"old"
    assert contents(tmp_path) == {"out/run.json": b"new", "out/my map.qgz": b"mine"}


def test_a_folder_of_something_else_is_not_touched(tmp_path: Path) -> None:
    out = tmp_path / "photos"
    out.mkdir()
    (out / "a.jpg").write_bytes(b"mine")
    with (
        pytest.raises(OutputError, match=r"photos exists and is not an InterLoc result: it holds a.jpg but no run"),
        atomic_folder(out),
    ):
        pytest.fail("refused before the work starts, not after")
    assert contents(tmp_path) == {"photos/a.jpg": b"mine"}


def test_a_file_in_the_way_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "out").write_bytes(b"mine")
    with pytest.raises(OutputError, match="is a file"), atomic_folder(tmp_path / "out"):
        pass
    assert contents(tmp_path) == {"out": b"mine"}
    with pytest.raises(OutputError, match="not a directory"), atomic_folder(tmp_path / "out" / "deeper"):
        pass


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit, ValueError, DriveError])
@pytest.mark.parametrize("exists", [False, True])
def test_a_stopped_run_leaves_nothing_new(tmp_path: Path, stop: type[BaseException], exists: bool) -> None:
    if exists:
        make_result(tmp_path / "out")
    before = contents(tmp_path)
    with pytest.raises(stop), atomic_folder(tmp_path / "out") as folder:  # noqa: PT012
        (folder / "run.json").write_bytes(b"half")
        raise stop
    assert contents(tmp_path) == before


MINE = {"notes.txt": b"mine", "photos/a.jpg": b"mine", "photos/deep/b.jpg": b"mine"}


def make_mine(out: Path) -> None:
    """An old result, and what its user keeps beside it."""
    make_result(out)
    for name, content in MINE.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(content)
    (out / "link").symlink_to("notes.txt")


def mine_of(out: Path) -> dict[str, bytes]:
    assert (out / "link").readlink() == Path("notes.txt")
    return {name: content for name, content in contents(out).items() if name in MINE}


def replace_result(out: Path, run: bytes) -> None:
    with atomic_folder(out) as folder:
        (folder / "run.json").write_bytes(run)
        (folder / "report.json").write_bytes(run)


def replace_until_killed(out: Path, steps: int) -> None:
    """Be killed before the given change of a folder."""
    left = [steps]

    def kill(event: str, _arguments: tuple[object, ...]) -> None:
        if event in {"os.rename", "os.mkdir", "os.remove", "os.rmdir", "shutil.rmtree"}:
            left[0] -= 1
            if left[0] < 0:
                os._exit(9)

    sys.addaudithook(kill)
    replace_result(out, b"new")


def test_whenever_a_run_is_killed_no_file_of_the_user_is_out_of_its_place(tmp_path: Path) -> None:
    """And what is half replaced can be finished; what the run has left goes a week later."""
    for steps in range(100):
        out = tmp_path / f"{steps}" / "out"
        out.parent.mkdir()
        make_mine(out)
        process = forks.context.Process(target=replace_until_killed, args=(out, steps))
        process.start()
        process.join()
        assert mine_of(out) == MINE, steps
        finish_replacing(out, marker="run.json", names={"run.json", "report.json", "figures"})
        assert (out / "run.json").read_bytes() == (out / "report.json").read_bytes().removesuffix(b" report"), steps
        for left in out.glob(".partial-*"):
            os.utime(left, (0, 0))
        replace_result(out, b"newer")
        assert mine_of(out) == MINE, steps
        assert contents(out).keys() == {*MINE, "link", "run.json", "report.json"}, steps
        assert [entry.name for entry in out.parent.iterdir()] == ["out"], steps
        if process.exitcode == 0:
            break
    assert 3 < steps < 99


def test_runs_into_one_folder_come_one_after_the_other(tmp_path: Path) -> None:
    out = tmp_path / "out"
    make_mine(out)
    processes = [forks.context.Process(target=replace_result, args=(out, bytes([n]))) for n in range(6)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * 6
    assert mine_of(out) == MINE
    assert (out / "run.json").read_bytes() == (out / "report.json").read_bytes()
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    make_result(tmp_path / "real")
    (tmp_path / "out").symlink_to(tmp_path / "real")
    with atomic_folder(tmp_path / "out") as folder:
        (folder / "run.json").write_bytes(b"new")
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "real" / "run.json").read_bytes() == b"new"
