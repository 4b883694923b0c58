"""Worker processes of this machine, one per slot: a process that dies loses nothing but its own work."""

from __future__ import annotations

import logging
import pickle
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from interloc.processes import end_with_parent, interrupts_held_back

_log = logging.getLogger(__name__)
_context = get_context("spawn")  # a worker inherits none of the threads, locks and connections of the server

Result = TypeVar("Result")


class WorkerLostError(Exception):
    """The worker that did a piece of work died, and the work is lost; it can be tried again."""


@dataclass
class _Work:
    call: tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]
    future: Future[Any] = field(default_factory=Future)


class ProcessExecutor:
    """Worker processes that take pieces of work in the order of submission.

    Parameters
    ----------
    slots
        Number of processes. They start in the background; one that dies is replaced.
    count_loss
        Called when a process died.
    """

    def __init__(self, slots: int, count_loss: Callable[[], None] = lambda: None) -> None:
        self.slots = slots
        self.count_loss = count_loss
        self._waiting: deque[_Work] = deque()
        self._change = threading.Condition()
        self._stopping = False
        self._slots = [_Slot(self, number) for number in range(slots)]

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:  # noqa: ANN401, D102
        return self._take(_Work((fn, args, kwargs)), self._waiting.append)

    def submit_urgent(self, fn: Callable[..., Result], /, *args: Any) -> Future[Result]:  # noqa: ANN401
        """Do a short piece of work before all work that waits."""
        return self._take(_Work((fn, args, {})), self._waiting.appendleft)

    def _take(self, work: _Work, enqueue: Callable[[_Work], None]) -> Future[Any]:
        with self._change:
            if self._stopping:
                raise RuntimeError("the executor was stopped")
            enqueue(work)
            self._change.notify()
        return work.future

    @property
    def alive(self) -> int:
        """Number of slots that can work; a process that died is replaced when there is work for it."""
        return sum(slot.thread.is_alive() for slot in self._slots)

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return [pid for slot in self._slots if (pid := slot.pid) is not None]

    def stop(self) -> None:
        """End all workers at once; running work is lost, waiting work is cancelled."""
        with self._change:
            self._stopping = True
            waiting = list(self._waiting)
            self._waiting.clear()
            self._change.notify_all()
        for work in waiting:
            work.future.cancel()
            work.future.set_running_or_notify_cancel()  # otherwise whoever waits for it would wait for ever
        for slot in self._slots:
            slot.kill()
        for slot in self._slots:
            slot.thread.join(10)

    def next_work(self) -> _Work | None:
        """Wait for the next piece of work for a slot and return it; None when the executor was stopped."""
        with self._change:
            while True:
                while not self._waiting and not self._stopping:
                    self._change.wait()
                if self._stopping:
                    return None
                work = self._waiting.popleft()
                if work.future.set_running_or_notify_cancel():
                    return work

    @property
    def is_stopping(self) -> bool:
        """Whether `stop` was called."""
        return self._stopping


class _Slot:
    """A thread that hands work to one worker process, and replaces the process when it dies."""

    def __init__(self, executor: ProcessExecutor, number: int) -> None:
        self._executor = executor
        self._worker: tuple[Any, Connection] | None = None
        self._lock = threading.Lock()
        self.thread = threading.Thread(target=self._serve, name=f"worker-{number}", daemon=True)
        self.thread.start()

    @property
    def is_alive(self) -> bool:
        worker = self._worker
        return worker is not None and worker[0].is_alive()

    @property
    def _has_hung_up(self) -> bool:
        """Whether an idle worker has closed its end of the pipe, as its death does: it sends nothing else unasked."""
        return self._worker is not None and self._worker[1].poll()

    @property
    def pid(self) -> int | None:
        worker = self._worker
        return None if worker is None else worker[0].pid

    def kill(self) -> None:
        with self._lock:
            if self._worker is not None:
                self._worker[0].kill()

    def _serve(self) -> None:
        with suppress(OSError):
            self._start()  # ahead of the first work: importing the compiler takes a second
        while (work := self._executor.next_work()) is not None:
            try:
                self._do(work)
            except BaseException as error:  # noqa: BLE001 - no piece of work may end a slot
                if not work.future.done():
                    work.future.set_exception(error)
        self._end()

    def _do(self, work: _Work) -> None:
        try:
            content = pickle.dumps(work.call)
        except Exception as error:  # noqa: BLE001 - whatever an argument raises
            work.future.set_exception(error)
            return
        if not self.is_alive or self._has_hung_up:
            self._end()
            self._start()
        assert self._worker is not None
        process, connection = self._worker
        try:
            connection.send_bytes(content)
            good, value = pickle.loads(connection.recv_bytes())  # noqa: S301 - from our own process
        except (EOFError, OSError):
            self._end()
            code = process.exitcode
            if not self._executor.is_stopping:
                self._executor.count_loss()
                _log.warning("a worker process (%s) died: %s", process.pid, _reason(code))
            work.future.set_exception(WorkerLostError(f"its worker process {_reason(code)}"))
            return
        work.future.set_result(value) if good else work.future.set_exception(value)

    def _start(self) -> None:
        with self._lock:
            if self._executor.is_stopping:
                raise WorkerLostError("the service is being stopped")
            ours, theirs = _context.Pipe()
            process = _context.Process(target=_work, args=(theirs,), daemon=True)
            with interrupts_held_back():
                process.start()
            theirs.close()  # so that the end of the process is noticed here
            self._worker = process, ours

    def _end(self) -> None:
        with self._lock:
            worker, self._worker = self._worker, None
        if worker is not None:
            process, connection = worker
            connection.close()
            process.join(1)
            if process.is_alive():
                process.kill()
                process.join()


def _reason(code: int | None) -> str:
    if code is None or code >= 0:
        return f"ended with code {code}"
    with suppress(ValueError):
        return f"was ended by {signal.Signals(-code).name}"
    return f"was ended by signal {-code}"


def _work(connection: Connection) -> None:
    """Work as a worker process: do what comes through the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server handles Ctrl-C
    end_with_parent()
    _warm_up()
    while True:
        try:
            content = connection.recv_bytes()
        except (EOFError, OSError):
            return
        _forget_peak_memory()
        try:
            function, args, kwargs = pickle.loads(content)  # noqa: S301 - from our own server
            answer = pickle.dumps((True, function(*args, **kwargs)))
        except BaseException as error:  # noqa: BLE001 - every error is passed to the server
            answer = _failure(error)
        with suppress(OSError):  # the server closed the pipe: the next receive ends this process
            connection.send_bytes(answer)


def _failure(error: BaseException) -> bytes:
    error.add_note("".join(traceback.format_exception(error)))
    try:
        content = pickle.dumps((False, error))
        pickle.loads(content)  # noqa: S301 - some exceptions can be pickled but not come back
    except Exception:  # noqa: BLE001 - some exceptions cannot be unpickled, for whatever reason
        plain = RuntimeError(f"{type(error).__name__}: {error}")
        plain.add_note("\n".join(getattr(error, "__notes__", [])))
        return pickle.dumps((False, plain))
    return content


def _warm_up() -> None:
    """Import what nearly all work needs."""
    with suppress(ImportError):
        import app.work.intersections  # noqa: F401, PLC0415


def _forget_peak_memory() -> None:
    """Reset the peak memory, so that it is that of the next piece of work; possible on Linux only."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
