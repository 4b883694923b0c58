"""Worker processes that end with their parent and leave Ctrl-C to it, and tasks that run in a pool of them."""

import concurrent.futures  # whose pool of processes is loaded when it is named: 20 ms
import gc
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import active_children, get_all_start_methods, get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar

from interloc.errors import ConfigError, InterLocError, install

Task = TypeVar("Task")
Result = TypeVar("Result")

Progress = Callable[[int, int], None]
"""Called with how much is done, and of how much: scans, keyframes or whatever a piece of work counts."""

GARBAGE_THRESHOLD = 200_000
"""Objects from which garbage is looked for in a process of our own; by default 700, which takes a tenth of its time."""

_PATIENCE_S = 10.0  # with a scheduler that does not answer

_messages: Any = None
"""In a worker: the queue to the parent process."""

_is_stopping = False
"""In a worker: whether the parent process has asked it to stop."""


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_in_processes(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    *,
    on_result: Callable[[Result], None] | None = None,
    on_message: Callable[[Any], None] | None = None,
    meanwhile: Callable[[], None] = lambda: None,
    hint: str = "",
) -> list[Result]:
    """Work on tasks in several processes; return the results in the order of the tasks.

    `work` is a function of a module; when the run ends early it is left by KeyboardInterrupt, so that it can tidy up.
    `on_result` is called with each result as soon as it is there, `on_message` with what `work` passes to
    `send_message`, `meanwhile` once they have begun. A worker process that was ended from outside is an InterLocError,
    to which `hint` is added. The first error of a task, or meanwhile, ends the others.
    """
    context = _context(work)
    messages = context.Queue()
    others = set(active_children())
    pool = concurrent.futures.ProcessPoolExecutor(
        min(workers, len(tasks)), mp_context=context, initializer=_start_worker, initargs=(messages,)
    )

    def pass_on_messages() -> None:
        while on_message is not None:
            try:
                on_message(messages.get(timeout=0.01))
            except queue.Empty:
                return

    try:
        with interrupts_held_back():
            futures = [pool.submit(_work_stoppably, work, task) for task in tasks]
        meanwhile()
        waiting: set[Future[Result]] = set(futures)
        while waiting:
            finished, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
            pass_on_messages()
            for future in finished:
                result = future.result()
                if on_result is not None:
                    on_result(result)
        pass_on_messages()
        return [future.result() for future in futures]
    except BaseException as error:
        pool.shutdown(wait=False, cancel_futures=True)
        _stop(set(active_children()) - others)  # `shutdown` does not wait for them a second time
        if isinstance(error, BrokenExecutor | EOFError):  # the latter where the process that forks them was
            guard = "" if context.get_start_method() == "fork" else "; in a script, no `if __name__ == '__main__':`"
            raise InterLocError(
                f"a worker process was ended from outside. Usual cause: too little memory; try fewer --workers{guard}."
                + (f" {hint}" if hint else "")
            ) from None
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        messages.close()


def in_own_process(work: Callable[[Task], Result], task: Task) -> Result:
    """Work on a task in a process of its own, which may die without anything else: then it is an InterLocError."""
    context = _context(work)
    with concurrent.futures.ProcessPoolExecutor(
        1, mp_context=context, initializer=_start_worker, initargs=(context.SimpleQueue(),)
    ) as pool:
        with interrupts_held_back():
            future = pool.submit(_work_stoppably, work, task)
        try:
            return future.result()
        except (BrokenExecutor, EOFError):
            raise InterLocError("its process was ended from outside. Usual cause: too little memory.") from None


def dask_client(address: str) -> Any:  # noqa: ANN401 - distributed has no types
    """Connect with the scheduler of a Dask cluster."""
    try:
        from distributed import Client  # noqa: PLC0415 - an extra

        connect: Any = Client
        return connect(address, timeout=_PATIENCE_S, name="interloc", set_as_default=False)
    except ImportError as error:
        raise ConfigError(
            f"a Dask scheduler is named ({address}), but Dask is not installed. Install it: {install('dask')}"
        ) from error
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigError(
            f"no Dask scheduler answers at {address} ({error or type(error).__name__}). "
            "Start one (`dask scheduler`), and workers (`dask worker ADDRESS`) that see the same files."
        ) from error


def stop_processes() -> None:
    """Ask all processes of this one to stop, and wait for them; they tidy up."""
    _stop(active_children())


def _context(work: Callable[..., Any]) -> Any:  # noqa: ANN401 - contexts have no common type
    """Return how processes for some work are started: forked, where the system can, from one that has imported it.

    That is this one, with all that it has loaded, where it has no second thread, which might hold a lock.
    """
    with suppress(OSError):  # no Linux
        if len(list(Path("/proc/self/task").iterdir())) == 1:
            return get_context("fork")
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload([(work.func if isinstance(work, partial) else work).__module__])
    return context


def _stop(processes: Collection[BaseProcess]) -> None:
    for process in processes:
        process.terminate()
    for process in processes:
        process.join()


def send_message(message: Any) -> None:  # noqa: ANN401 - whatever can be pickled
    """Send a message from the work of `run_in_processes` to its caller."""
    _messages.put(message)


def _start_worker(messages: Any) -> None:  # noqa: ANN401 - a queue of the spawn context
    global _messages  # noqa: PLW0603 - queues reach a worker only when it starts
    _messages = messages
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # not as in the process that it was forked from
    gc.freeze()  # else the first look for garbage makes a copy of all that was imported
    gc.set_threshold(GARBAGE_THRESHOLD)
    end_with_parent()


def _work_stoppably(work: Callable[[Task], Result], task: Task) -> Result:
    signal.signal(signal.SIGTERM, _stop_work)
    try:
        return work(task)
    except BaseException:
        if _is_stopping:
            os._exit(1)  # everything is tidied up, and no further task may begin
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _stop_work(*_: object) -> None:
    global _is_stopping  # noqa: PLW0603 - a signal handler has no other place
    _is_stopping = True
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the pool sends it again, and nothing may interrupt the tidying up
    raise KeyboardInterrupt


def end_with_parent() -> None:
    """Let a worker process end when its parent is killed, instead of working or waiting for ever."""

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Start processes in this block: they do not receive Ctrl-C, which their parent handles."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def peak_memory_bytes() -> int:
    """Return the largest resident memory of this process so far; 0 where the system does not report it."""
    try:
        import resource  # noqa: PLC0415 - not on Windows
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


class Stopwatch:
    """Adds up the time between laps under the names of the stages: `seconds`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def start(self) -> None:
        """Forget the time since the last lap."""
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Count the time since the last lap, or start, to a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now

    def add(self, seconds: Mapping[str, float]) -> None:
        """Add the times of another stopwatch."""
        for stage, time_s in seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time_s
