"""Workers: one that dies or uses too much takes only its own work with it, and is replaced."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children, forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numba
import psutil
import pytest

from app.jobs import processes
from app.jobs.executors import DaskExecutor, open_executor
from app.jobs.processes import (
    EXTRA_SLOTS,
    ProcessExecutor,
    WorkerLimitError,
    WorkerLostError,
    _cgroup_limits,
    memory_of,
)
from app.settings import Settings
from interloc.errors import ConfigError, DriveError
from tests import forks
from tests.app.processes import wait_until


def pid_of(delay_s: float = 0.0) -> int:
    time.sleep(delay_s)
    return os.getpid()


def wait_for_file(path: Path) -> int:
    """Say that the work has begun, and go on until the file is there."""
    path.with_name(f"{path.name}.began-{os.getpid()}").touch()
    while not path.exists():
        time.sleep(0.01)
    return os.getpid()


def fail() -> None:
    raise DriveError("labels/000010.label: is missing")


class _NeverBackError(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def fail_without_return() -> None:
    raise _NeverBackError(1, 2)


def return_a_lock() -> object:
    return threading.Lock()


def sleep_for_ever(path: Path) -> None:
    path.write_text(str(os.getpid()))
    time.sleep(3600)


@numba.njit
def compiled_loop() -> int:
    """A loop that no signal and no thread of Python interrupts."""
    number = 1
    while number:
        number = (number * 3 + 1) % 1_000_003 or 1
    return number


def compute_for_ever(path: Path) -> None:
    path.write_text(str(os.getpid()))
    compiled_loop()


def fill_memory(size: int) -> None:
    """Take memory, a little at a time, and keep it."""
    kept = []
    for _ in range(size // 2**20):
        kept.append(bytearray(os.urandom(16)) * 2**16)
        time.sleep(0.001)


def keep_memory(size: int) -> int:
    """Leave a worker large."""
    globals()["_kept"] = bytearray(b"1") * size
    return os.getpid()


@contextmanager
def executing(*arguments: Any, **options: Any) -> Iterator[ProcessExecutor]:
    executor = ProcessExecutor(*arguments, **options)
    try:
        yield executor
    finally:
        executor.stop()


@pytest.fixture
def executor() -> Iterator[ProcessExecutor]:
    """An executor whose processes all start at once."""
    with executing(2, ahead=int) as executor:
        yield executor


@pytest.fixture
def one() -> Iterator[ProcessExecutor]:
    """An executor that does one piece of work at a time."""
    with executing(1) as executor:
        yield executor


def pids_of(executor: ProcessExecutor) -> list[int]:
    return [worker[0].pid for slot in executor._slots if (worker := slot._worker) is not None]


def is_gone(pid: int) -> bool:
    """Whether a process has ended: all of its threads, of which any keeps its connections open."""
    try:
        process = psutil.Process(pid)
        return process.status() == psutil.STATUS_ZOMBIE and process.num_threads() <= 1
    except psutil.Error:
        return True


def pid_in(path: Path) -> int:
    """Wait until a piece of work has written the id of its process."""
    return int(wait_until(lambda: path.exists() and path.read_text(), "the work to begin"))


def begun(path: Path) -> list[int]:
    return [int(each.name.rpartition("-")[2]) for each in path.parent.glob(f"{path.name}.began-*")]


def test_a_killed_worker_takes_only_its_own_work_with_it(tmp_path: Path) -> None:
    lost: list[int] = []
    with executing(2, lambda: lost.append(1)) as executor:
        first, second = tmp_path / "first", tmp_path / "second"
        doomed, other = executor.submit(wait_for_file, first), executor.submit(wait_for_file, second)
        waiting = executor.submit(pid_of)
        wait_until(lambda: begun(first) and begun(second), "both workers to be at work")
        os.kill(begun(first)[0], signal.SIGKILL)
        with pytest.raises(WorkerLostError, match="SIGKILL"):
            doomed.result(60)
        assert waiting.result(60) not in begun(first)  # done by the worker that took its place
        second.touch()
        assert other.result(60) == begun(second)[0]
        assert lost == [1]
        assert executor.alive == 2 + EXTRA_SLOTS


def test_an_idle_worker_that_was_killed_is_replaced(executor: ProcessExecutor) -> None:
    before = wait_until(lambda: len(pids_of(executor)) == executor.alive and pids_of(executor), "all workers to run")
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    wait_until(lambda: all(map(is_gone, before)), "the workers to be gone", 10)
    assert executor.submit(pid_of).result(60) not in before


def test_errors_come_back_with_their_words(executor: ProcessExecutor) -> None:
    with pytest.raises(DriveError) as caught:
        executor.submit(fail).result(60)
    assert str(caught.value) == "labels/000010.label: is missing"
    with pytest.raises(RuntimeError, match="_NeverBackError: 1 and 2"):
        executor.submit(fail_without_return).result(60)
    with pytest.raises(TypeError, match="cannot pickle"):
        executor.submit(return_a_lock).result(60)
    with pytest.raises(TypeError, match="cannot pickle"):
        executor.submit(pid_of, threading.Lock()).result(60)  # type: ignore[arg-type]
    assert executor.submit(pid_of).result(60) in pids_of(executor)


def test_a_stop_ends_what_runs(tmp_path: Path) -> None:
    executor = ProcessExecutor(1)
    running = executor.submit(sleep_for_ever, tmp_path / "pid")
    waiting = executor.submit(pid_of)
    pid = pid_in(tmp_path / "pid")
    executor.stop()
    assert isinstance(running.exception(10), WorkerLostError)
    assert waiting.cancelled()
    wait_until(lambda: is_gone(pid), "the worker to be gone", 10)
    with pytest.raises(RuntimeError, match="stopped"):
        executor.submit(pid_of)


def sleep_as_a_server(path: Path) -> None:
    forks.begin()
    executor = ProcessExecutor(1)
    executor.submit(sleep_for_ever, path)
    time.sleep(3600)


def test_workers_end_with_their_server(tmp_path: Path) -> None:
    server = forks.context.Process(target=sleep_as_a_server, args=(tmp_path / "pid",))
    server.start()
    try:
        pid = pid_in(tmp_path / "pid")
    finally:
        server.kill()
        server.join()
    wait_until(lambda: is_gone(pid), "the worker to be gone", 20)


def test_work_in_a_compiled_loop_is_killed_and_its_place_goes_on(tmp_path: Path) -> None:
    lost: list[int] = []
    with executing(1, lambda: lost.append(1)) as executor:
        endless = executor.submit(compute_for_ever, tmp_path / "pid")
        pid = pid_in(tmp_path / "pid")
        executor.kill(endless)
        assert isinstance(endless.exception(10), WorkerLostError)
        assert is_gone(pid)
        assert executor.submit(pid_of).result(60) != pid
        assert lost == []  # nobody has lost anything


def test_what_waits_is_given_up_and_what_has_ended_is_left_alone(one: ProcessExecutor, tmp_path: Path) -> None:
    done = one.submit(pid_of)
    pid = done.result(60)
    running = one.submit(wait_for_file, tmp_path / "gate")
    waiting = one.submit(wait_for_file, tmp_path / "never")
    one.kill(done)
    one.kill(waiting)
    (tmp_path / "gate").touch()
    assert running.result(60) == pid
    assert waiting.cancelled()


def test_work_that_takes_too_long_is_ended_and_its_place_goes_on(one: ProcessExecutor, tmp_path: Path) -> None:
    one.submit(pid_of).result(60)
    endless = one.submit(compute_for_ever, tmp_path / "pid", seconds=0.5)
    with pytest.raises(WorkerLimitError) as caught:
        endless.result(60)
    assert (caught.value.limit, caught.value.bound) == ("time", 0.5)
    assert caught.value.used > 0.5
    assert one.submit(pid_of).result(60) != int((tmp_path / "pid").read_text())


def hang_at_the_start(_connection: Connection) -> None:
    """Begin as a worker that waits for a lock that nobody will open."""
    threading.Event().wait()


def test_a_worker_that_hangs_as_it_starts_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(processes, "_START_S", 0.5)
        patched.setattr(processes, "_work", hang_at_the_start)
        with executing(1) as executor:
            with pytest.raises(WorkerLostError, match=r"was not ready within 0\.5 s"):
                executor.submit(pid_of).result(60)
            patched.undo()
            assert executor.submit(pid_of).result(60) in pids_of(executor)


@pytest.mark.skipif(not memory_of(os.getpid()), reason="this system does not tell the memory of processes")
def test_work_that_fills_the_memory_is_ended_and_its_place_goes_on() -> None:
    bound = memory_of(os.getpid()) + 300 * 2**20  # a forked worker shares what this process has
    with executing(1, memory_bytes=bound) as executor:
        with pytest.raises(WorkerLimitError) as caught:
            executor.submit(fill_memory, 8 * 2**30).result(60)
        assert (caught.value.limit, caught.value.bound) == ("memory", bound)
        assert bound < caught.value.used < 2 * bound
        assert executor.submit(pid_of).result(60)


@pytest.mark.skipif(not memory_of(os.getpid()), reason="this system does not tell the memory of processes")
def test_a_worker_that_is_left_large_is_replaced(one: ProcessExecutor) -> None:
    small = one.submit(pid_of).result(60)
    size = memory_of(small)
    one.memory_bytes = 4 * size
    assert one.submit(pid_of).result(60) == small
    assert one.submit(keep_memory, round(1.5 * size)).result(60) == small
    assert one.submit(pid_of).result(60) != small


@pytest.mark.parametrize(("groups", "files", "limits"), [
    ("0::/\n", {"memory.max": "2000000\n"}, [2_000_000]),
    ("0::/a/b\n", {"a/b/memory.max": "max\n", "a/memory.max": "3000\n"}, [3000]),
    ("4:memory:/docker/x\n2:cpu:/\n", {"memory/memory.limit_in_bytes": "5000\n"}, [5000]),
    ("0::/\n", {}, []),
])  # fmt: skip
def test_the_limits_of_a_container_are_found(
    tmp_path: Path, groups: str, files: dict[str, str], limits: list[int]
) -> None:
    (tmp_path / "self").mkdir()
    (tmp_path / "self/cgroup").write_text(groups)
    for name, content in files.items():
        path = tmp_path / "groups" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    assert list(_cgroup_limits(tmp_path, tmp_path / "groups")) == limits


def outlive_what_forks(path: Path) -> None:
    """Do work while the process that forks the workers is killed; the id of the worker that went with it is left."""
    forks.begin()
    executor = ProcessExecutor(1)
    pid = executor.submit(pid_of).result(60)
    endless = executor.submit(compute_for_ever, path.with_name("begun"))
    pid_in(path.with_name("begun"))
    parent = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    os.kill(parent, signal.SIGKILL)
    os.waitid(os.P_PID, parent, os.WEXITED | os.WNOWAIT)
    assert not [child for child in active_children() if child.pid == pid]  # as far as can be told
    executor.kill(endless)
    assert isinstance(endless.exception(60), WorkerLostError)
    assert executor.submit(pid_of).result(60) != pid
    executor.stop()
    path.write_text(str(pid))


def test_the_process_that_forks_the_workers_may_be_killed_at_any_time(tmp_path: Path) -> None:
    server = forks.context.Process(target=outlive_what_forks, args=(tmp_path / "pid",))
    server.start()
    server.join()
    assert server.exitcode == 0
    wait_until(lambda: is_gone(pid_in(tmp_path / "pid")), "the worker to be gone", 20)


class NothingStarts:
    """A context whose processes do not start, as where there is no memory for one more."""

    Pipe = processes._context.Pipe

    @staticmethod
    def get_start_method() -> str:
        return "none"

    class Process:
        def __init__(self, **_: object) -> None:
            pass

        def start(self) -> None:
            raise EOFError("unexpected EOF")


def test_work_waits_while_no_worker_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(processes, "_context", NothingStarts)
        with executing(1, ahead=int) as executor:
            waiting = executor.submit(pid_of)
            hopeless = executor.submit(pid_of, client="other", seconds=0.0)
            with pytest.raises(WorkerLostError, match="could not be started"):
                hopeless.result(60)
            assert executor.alive == 0
            patched.undo()
            assert waiting.result(60) in pids_of(executor)


def test_no_dask_scheduler_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("interloc.processes._PATIENCE_S", 0.5)
    settings = Settings(data_dir=tmp_path, dask="tcp://127.0.0.1:9")
    with pytest.raises(ConfigError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        open_executor(settings, lambda: None)
    with pytest.raises(ConfigError, match="no Dask scheduler answers at nonsense://"):
        DaskExecutor("nonsense://", lambda: None)
