"""Several tasks at a time, each in a process: what they say and how far they are comes back while they run."""

from __future__ import annotations

import os
import queue
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any, TypeVar

from interloc.errors import InterLocError

Task = TypeVar("Task")
Result = TypeVar("Result")

Report = Callable[[str, str, int, int], None]
"""Called with a task, what it is doing, and how much of how much is done; with 0 of 0 at its end."""

Say = Callable[[str], None]
"""Called with a line for the log."""

_REPORT_EVERY = 10

_messages: Any = None
"""In a worker: the queue to the main process."""


def run_in_processes(
    work: Callable[[Task, Report, Say], Result],
    tasks: Sequence[Task],
    workers: int,
    report: Report,
    say: Say,
) -> list[Result]:
    """Work on tasks in processes.

    Parameters
    ----------
    work
        A function of a module. When the run ends early it is left by KeyboardInterrupt, so it can tidy up.
    tasks
    workers : int
    report, say
        Called here with what the function reports and says there.

    Returns
    -------
    list
        In the order in which they were finished.

    Raises
    ------
    InterLocError
        What a task raised, or a process died. The other tasks are stopped.
    """
    context = get_context("spawn")
    messages = context.Queue()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker, initargs=(messages,))
    results = []
    try:
        waiting = {pool.submit(_work_reporting, work, task) for task in tasks}
        while waiting:
            finished, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
            _pass_on(messages, report, say)
            results += [future.result() for future in finished]
        _pass_on(messages, report, say)
    except BrokenProcessPool:
        _stop(pool)
        raise InterLocError(
            "a worker process was ended from outside. Usual cause: too little memory; try fewer --workers. "
            "Finished rows are kept: the same command goes on from there."
        ) from None
    except BaseException:
        _stop(pool)
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        messages.close()
    return results


def _stop(pool: ProcessPoolExecutor) -> None:
    """End the workers in the middle of their work."""
    processes = list((pool._processes or {}).values())  # noqa: SLF001 - no public way before Python 3.14
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()


def _pass_on(messages: Any, report: Report, say: Say) -> None:  # noqa: ANN401 - a queue of this or that context
    while True:
        try:
            message = messages.get(timeout=0.01)
        except queue.Empty:
            return
        if isinstance(message, str):
            say(message)
        else:
            report(*message)


def _start_worker(messages: Any) -> None:  # noqa: ANN401
    global _messages  # noqa: PLW0603 - queues reach a worker at its start only
    _messages = messages
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the main process, which ends the workers


_stopping = False


def _stop_work(*_: object) -> None:
    global _stopping  # noqa: PLW0603 - a signal knows no other place
    _stopping = True
    raise KeyboardInterrupt


def _work_reporting(work: Callable[[Task, Report, Say], Result], task: Task) -> Result:
    def report(name: str, what: str, done: int, total: int) -> None:
        if done == total or done % _REPORT_EVERY == 0:
            _messages.put((name, what, done, total))

    signal.signal(signal.SIGTERM, _stop_work)
    try:
        return work(task, report, _messages.put)
    except BaseException:
        if _stopping:
            os._exit(1)  # all is tidied up, and no further task may begin
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
