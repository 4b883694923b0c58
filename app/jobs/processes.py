"""Worker processes of this machine: one that dies, or uses too much, loses nothing but its own piece of work."""

import logging
import os
import pickle
import queue
import signal
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, TypeVar, TypeVarTuple

from app.work.kinds import WARM
from interloc.processes import end_with_parent, interrupts_held_back

EXTRA_SLOTS = 2
"""Number of worker processes beside those that are asked for; `HandOut` says what for."""

_MEMORY_SHARE = 0.75  # of the memory of the machine; the rest is for the server, the database and the page cache
_MIN_MEMORY_BYTES = 1024**3
_PROC, _CGROUPS = Path("/proc"), Path("/sys/fs/cgroup")
_UNKNOWN = 255  # code of a process whose end nobody can tell, because the process that forked it is dead
_LOOK_S = 0.2  # interval at which time and memory of a piece of work are looked at
_START_S = 120.0  # within which a process is ready, however busy the machine: one that hangs is replaced
_PAUSE_S = 0.5  # before the start of a process is tried again
_log = logging.getLogger(__name__)
# A worker inherits none of the threads, locks and connections of the server. Forked from a process that has imported
# everything, and does nothing else, it is there at once, also in the place of one that was killed.
_context: Any = get_context("forkserver" if "forkserver" in get_all_start_methods() else "spawn")

Given = TypeVarTuple("Given")
Result = TypeVar("Result")


class WorkerLostError(Exception):
    """The worker that did a piece of work died, and the work is lost; it can be tried again."""


class NoWorkersError(WorkerLostError):
    """Work can be handed to nobody for now: the cluster is away."""


class WorkerLimitError(Exception):
    """A piece of work used more than it may, in seconds or bytes, and was ended; another try would end the same way."""

    def __init__(self, limit: Literal["time", "memory"], bound: float, used: float) -> None:
        unit = "s" if limit == "time" else "bytes"
        super().__init__(f"it used {used:.0f} {unit}, and may use {bound:.0f}")
        self.limit = limit
        self.bound = bound
        self.used = used


@dataclass(eq=False)
class Work:
    """A piece of work."""

    call: tuple[Callable[..., Any], tuple[Any, ...]]
    """Function, arguments."""
    client: str = ""
    """For whom it is done."""
    seconds: float = float("inf")
    """How long it may take."""
    urgent: bool = False
    """Somebody waits for it."""
    is_given_up: bool = False
    """Nobody wants it any more."""
    future: Future[Any] = field(default_factory=Future)


class HandOut:
    """Which piece of work is begun next: quick work does not wait for long work, nor one client for another.

    `slots` pieces of work are done at a time. One more is begun if it is urgent, and one more, whatever it is, for a
    client that has nothing at work: whoever holds all the others keeps only himself waiting. Urgent work comes first;
    then the client with the fewest pieces at work; then the order of submission. The caller holds a lock.
    """

    def __init__(self, slots: int) -> None:
        self._slots = slots
        self._waiting: list[Work] = []
        self._at_work: Counter[str] = Counter()

    def add(self, work: Work) -> None:
        """Let a piece of work wait."""
        self._waiting.append(work)

    def take(self) -> Work | None:
        """Return the piece of work to begin now; None where none waits that may begin."""
        while True:
            free = self._slots - self._at_work.total()
            room = [free + (work.urgent if self._at_work[work.client] else EXTRA_SLOTS) for work in self._waiting]
            admitted = [work for work, places in zip(self._waiting, room, strict=True) if places > 0]
            if not admitted:
                return None
            work = min(admitted, key=lambda work: (not work.urgent, self._at_work[work.client]))
            self._waiting.remove(work)
            if work.future.set_running_or_notify_cancel():
                self._at_work[work.client] += 1
                return work

    def done(self, work: Work) -> None:
        """Note that a piece of work that was taken has ended."""
        self._at_work[work.client] -= 1
        self._at_work += Counter()  # forgets the clients that have none

    def clear(self) -> None:
        """Cancel all that waits."""
        for work in self._waiting:
            work.future.cancel()
            work.future.set_running_or_notify_cancel()  # otherwise whoever waits for it would wait for ever
        self._waiting.clear()


class ProcessExecutor:
    """Worker processes that do pieces of work, each within limits of time and memory.

    So many pieces as there are slots are done at a time; there are `EXTRA_SLOTS` more processes (`HandOut` says what
    for). One that dies or is killed is counted and replaced. The resident memory of each is by default an equal share
    of that of the machine, and known on Linux only. What is to be done ahead of all work is done once, while all
    processes start; with None each starts when there is work for it.
    """

    def __init__(
        self,
        slots: int,
        count_loss: Callable[[], None] = lambda: None,
        memory_bytes: int | None = None,
        ahead: Callable[[], object] | None = None,
    ) -> None:
        self.slots = slots
        self.count_loss = count_loss
        self.memory_bytes = memory_bytes or memory_share(slots + EXTRA_SLOTS)
        if _context.get_start_method() == "forkserver":
            _context.set_forkserver_preload([WARM])
        self._lock = threading.Lock()
        self._hand_out = HandOut(slots)
        self.stopping = threading.Event()
        self.starts_ahead = ahead is not None
        self._slots = [_Slot(self, number) for number in range(slots + EXTRA_SLOTS)]
        self._idle = list(self._slots)
        for slot in self._slots:
            slot.thread.start()
        if ahead is not None:
            self.submit(ahead)

    def submit(
        self,
        fn: Callable[[*Given], Result],
        /,
        *args: *Given,
        client: str = "",
        seconds: float = float("inf"),
        urgent: bool = False,
    ) -> Future[Result]:
        """Do a piece of work: a function of a module with its arguments.

        No client waits because of what another one has at work; what is urgent goes before all that has not begun. The
        future raises `WorkerLostError` when its worker dies, `WorkerLimitError` when it takes more time or memory than
        it may, and whatever the function raises.
        """
        work = Work((fn, args), client, seconds, urgent)
        with self._lock:
            if self.stopping.is_set():
                raise RuntimeError("the executor was stopped")
            self._hand_out.add(work)
            self._begin_what_may()
        return work.future

    def kill(self, future: Future[Any]) -> None:
        """End a piece of work at once, and its process with it; one that waits is never begun."""
        if not future.cancel():
            for slot in self._slots:
                slot.kill(future)

    @property
    def alive(self) -> int:
        """Number of slots that can work; a process that died is replaced when there is work for it."""
        return sum(slot.can_start and slot.thread.is_alive() for slot in self._slots)

    def stop(self) -> None:
        """End all workers at once; running work is lost, waiting work is cancelled."""
        with self._lock:
            self.stopping.set()
            self._hand_out.clear()
        for slot in self._slots:
            slot.inbox.put(None)
            slot.kill()
        for slot in self._slots:
            slot.thread.join(10)

    def done(self, slot: "_Slot", work: Work) -> None:
        """Note that a slot has ended a piece of work, and can take another one."""
        with self._lock:
            self._hand_out.done(work)
            self._idle.append(slot)
            self._begin_what_may()

    def _begin_what_may(self) -> None:
        if self.stopping.is_set():
            return
        while self._idle and (work := self._hand_out.take()) is not None:
            slot = min(self._idle, key=lambda slot: slot.number)  # the first ones have their drives open already
            self._idle.remove(slot)
            slot.inbox.put(work)


class _Slot:
    """A thread that hands work to one worker process, watches it, and replaces it where it is of no use any more."""

    def __init__(self, executor: ProcessExecutor, number: int) -> None:
        self.number = number
        self.can_start = True
        self.inbox: queue.SimpleQueue[Work | None] = queue.SimpleQueue()
        self._executor = executor
        self._worker: tuple[Any, Connection] | None = None
        self._work: Work | None = None
        self._is_ready = False
        self._is_killed = False
        self._lock = threading.Lock()
        self.thread = threading.Thread(target=self._serve, name=f"worker-{number}", daemon=True)

    def kill(self, future: Future[Any] | None = None) -> None:
        """Kill the process, where it works for this future or none is named."""
        with self._lock:
            if future is not None:
                if self._work is None or self._work.future is not future:
                    return
                self._work.is_given_up = True
            if self._worker is not None:
                self._is_killed = True
                _kill(*self._worker)

    def _serve(self) -> None:
        with suppress(WorkerLostError):
            if self._executor.starts_ahead:  # importing everything takes some seconds
                self._start(self.inbox.empty)
        while (work := self.inbox.get()) is not None:
            with self._lock:
                self._work = work
            try:
                result = self._do(work)
            except BaseException as error:  # noqa: BLE001 - no piece of work may end a slot
                outcome: Callable[[], None] = partial(work.future.set_exception, error)
            else:
                outcome = partial(work.future.set_result, result)
            with self._lock:
                self._work = None
            self._executor.done(self, work)
            outcome()
        self._end()

    def _do(self, work: Work) -> Any:  # noqa: ANN401 - whatever the work returns
        content = pickle.dumps(work.call)
        process, connection = self._usable_worker(work)
        if work.is_given_up:
            raise WorkerLostError("nobody waits for it any more")
        try:
            if not self._is_ready:
                if not connection.poll(_START_S):
                    raise TimeoutError
                connection.recv_bytes()
                self._is_ready = True
            connection.send_bytes(content)
            self._watch(work, process.pid, connection)
            good, value = pickle.loads(connection.recv_bytes())  # noqa: S301 - from our own process
        except (EOFError, OSError) as error:
            self._end()
            late = isinstance(error, TimeoutError)
            reason = f"was not ready within {_START_S:g} s" if late else _reason(process.exitcode)
            if not (work.is_given_up or self._executor.stopping.is_set()):
                self._executor.count_loss()
                _log.warning("a worker process (%s) died: %s", process.pid, reason)
            raise WorkerLostError(f"its worker process {reason}") from error
        except WorkerLimitError as error:
            self.kill()
            self._end()
            _log.warning("a worker process (%s) was ended: %s", process.pid, error)
            raise
        if good:
            return value
        raise value

    def _watch(self, work: Work, pid: int, connection: Connection) -> None:
        """Wait for the answer of the worker or its death, and see meanwhile that it keeps to its limits."""
        began = time.monotonic()
        while not connection.poll(_LOOK_S):
            seconds = time.monotonic() - began
            if seconds > work.seconds:
                raise WorkerLimitError("time", work.seconds, seconds)
            memory = memory_of(pid)
            if memory > self._executor.memory_bytes:
                raise WorkerLimitError("memory", self._executor.memory_bytes, memory)

    def _usable_worker(self, work: Work) -> tuple[Any, Connection]:
        """Return the worker, or a new one where it was killed, has died, or is left large by earlier work."""
        if self._worker is not None and not self._is_killed:
            process, connection = self._worker
            has_hung_up = self._is_ready and connection.poll()  # as its death does; it sends nothing else unasked
            is_large = memory_of(process.pid) > self._executor.memory_bytes / 2  # at the cost of the next piece of work
            if process.is_alive() and not has_hung_up and not is_large:
                return self._worker
        self._end()
        until = time.monotonic() + work.seconds
        return self._start(lambda: not work.is_given_up and time.monotonic() < until)

    def _start(self, is_wanted: Callable[[], bool]) -> tuple[Any, Connection]:
        """Start a worker, as often as it takes: the process that forks them may be killed too, and is replaced then.

        A `WorkerLostError` says that it is not wanted any more, or that the executor is being stopped.
        """
        while True:
            try:
                worker = self._try_to_start()
            except Exception as error:  # whatever it is: the slot goes on
                if self.can_start:
                    _log.warning("no worker process could be started, and it is tried again: %r", error)
                self.can_start = False
                if self._executor.stopping.wait(_PAUSE_S) or not is_wanted():
                    raise WorkerLostError(f"could not be started ({error})") from error
            else:
                self.can_start = True
                return worker

    def _try_to_start(self) -> tuple[Any, Connection]:
        with self._lock:
            if self._executor.stopping.is_set():
                raise WorkerLostError("the service is being stopped")
            ours, theirs = _context.Pipe()
            process = _context.Process(target=_work, args=(theirs,), daemon=True)
            with interrupts_held_back():
                process.start()
            theirs.close()  # so that the end of the process is noticed here
            self._worker = process, ours
            self._is_ready = self._is_killed = False
            return self._worker

    def _end(self) -> None:
        with self._lock:
            worker, self._worker = self._worker, None
        if worker is not None:
            process, connection = worker
            if process.exitcode == _UNKNOWN:
                _kill(process, connection)
            connection.close()
            process.join(1)
            if process.is_alive():
                process.kill()
                process.join()


def _kill(process: Any, connection: Connection) -> None:  # noqa: ANN401 - contexts have no common type
    """Kill a worker, also one that outlived the process that forked it and told us of its end."""
    process.kill()
    if process.exitcode == _UNKNOWN and not connection.poll():  # it has not hung up
        with suppress(OSError):
            os.kill(process.pid, signal.SIGKILL)


def _reason(code: int | None) -> str:
    if code is None or code >= 0:
        return f"ended with code {code}"
    with suppress(ValueError):
        return f"was ended by {signal.Signals(-code).name}"
    return f"was ended by signal {-code}"


def _work(connection: Connection) -> None:
    """Work as a worker process: say that it is ready, then do what comes through the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server handles Ctrl-C
    end_with_parent()
    _tell_linux("oom_score_adj", "500")  # to end a worker, not the server or others, where memory runs out
    with suppress(ImportError):  # done already where this is the fork of a process that did it
        import_module(WARM)
    with suppress(OSError):
        connection.send_bytes(b"")
    while True:
        try:
            content = connection.recv_bytes()
        except (EOFError, OSError):
            return
        _tell_linux("clear_refs", "5")  # so that the peak memory is that of the next piece of work
        try:
            function, args = pickle.loads(content)  # noqa: S301 - from our own server
            answer = pickle.dumps((True, function(*args)))
        except BaseException as error:  # noqa: BLE001 - every error is passed to the server
            answer = _failure(error)
        with suppress(OSError):  # the server closed the pipe: the next receive ends this process
            connection.send_bytes(answer)


def _failure(error: BaseException) -> bytes:
    error.add_note("".join(traceback.format_exception(error)))
    try:
        content = pickle.dumps((False, error))
        pickle.loads(content)  # noqa: S301 - some exceptions can be pickled but not come back
    except Exception as why:  # noqa: BLE001 - some exceptions cannot be unpickled, for whatever reason
        plain = RuntimeError(f"{type(error).__name__}: {error} (as text, since it cannot be sent: {why})")
        plain.add_note("\n".join(getattr(error, "__notes__", [])))
        return pickle.dumps((False, plain))
    return content


def _tell_linux(name: str, value: str) -> None:
    """Set what Linux knows of this process; other systems have no such files."""
    with suppress(OSError):
        Path("/proc/self", name).write_text(value)


def memory_of(pid: int | None) -> int:
    """Return the resident memory of a process, bytes; 0 where the system does not tell (macOS, Windows)."""
    try:
        pages = int((_PROC / str(pid) / "statm").read_bytes().split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def memory_share(processes: int) -> int:
    """Return the memory that each of some worker processes may use, bytes: an equal share, but at least 1 GB."""
    return max(_MIN_MEMORY_BYTES, int(machine_memory() * _MEMORY_SHARE / processes))


def machine_memory() -> int:
    """Return the memory that this process and its children can use in all, bytes: that of the machine or container."""
    limits = [*_cgroup_limits(_PROC, _CGROUPS)]
    with suppress(ValueError, OSError, AttributeError):  # Windows
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return min(limits, default=0)


def _cgroup_limits(proc: Path, cgroups: Path) -> list[int]:
    """Return the limits of the control groups that this process is in, of version 2 and 1; "max" is none."""
    limits = []
    try:
        lines = (proc / "self/cgroup").read_text().splitlines()
    except OSError:
        return []
    for line in lines:
        _, controllers, place = line.split(":", 2)
        if controllers not in {"", "memory"}:
            continue
        root = cgroups / controllers
        name = "memory.limit_in_bytes" if controllers else "memory.max"
        group = root / place.lstrip("/")
        # The groups above bound it too; in a container the path may be that of the host: then only the root is there.
        for folder in (group, *group.parents):
            with suppress(OSError, ValueError):
                limits.append(int((folder / name).read_text()))
            if folder == root:
                break
    return limits
