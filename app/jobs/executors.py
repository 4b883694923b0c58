"""Where work is done: processes of this machine, or a Dask cluster, behind one `concurrent.futures.Executor`."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from contextlib import suppress
from typing import Any, TypeVar, TypeVarTuple

from app.jobs.processes import NoWorkersError, ProcessExecutor, WorkerLostError
from app.settings import Settings
from app.work.kinds import compile_kernels
from interloc.errors import ConfigError
from interloc.processes import cores, dask_client

_ASK_AGAIN_S = 5.0

Given = TypeVarTuple("Given")
Result = TypeVar("Result")


class DaskExecutor:
    """Work on the workers of a Dask cluster, which see the data folder at the same place.

    The cluster hands the work out by itself, so less holds than for processes of this machine: work that has begun
    cannot be killed, only asked to end (it looks a few times per second, but not within a long step such as the reading
    of a map); a piece of work has no limit of time, only the job as a whole; `dask worker --memory-limit` bounds the
    memory of a worker (`WorkerLostError` then, after some tries); and clients are not kept apart, but urgent work does
    go first. `count_loss` is called when a piece of work killed its workers.
    """

    def __init__(self, address: str, count_loss: Callable[[], None]) -> None:
        self._address = address
        self._count_loss = count_loss
        self._known_slots = (0.0, 0)
        self._asking = threading.Lock()
        self._client: Any  # of distributed, which has no types
        self._executor: Executor
        self._connect()

    def _connect(self) -> None:
        self._client = dask_client(self._address)
        # Not pure: a repeated call must be executed again, because its outcome is a file, not its value.
        self._executor = self._client.get_executor(pure=False)

    @property
    def slots(self) -> int:
        """Number of pieces of work that run at the same time."""
        return max(1, self.alive)

    @property
    def alive(self) -> int:
        """Number of threads of all workers, asked for every few seconds; 0 while the scheduler is away."""
        until, slots = self._known_slots
        if time.monotonic() >= until and self._asking.acquire(blocking=False):
            try:
                # It gives a scheduler up that was away for longer than its patience.
                if self._client.status == "closed":
                    self._connect()
                slots = sum(self._client.nthreads().values())
            except (OSError, ValueError, TimeoutError, ConfigError):
                slots = 0
            finally:
                self._known_slots = time.monotonic() + _ASK_AGAIN_S, slots
                self._asking.release()
        return slots

    def submit(
        self,
        fn: Callable[[*Given], Result],
        /,
        *args: *Given,
        client: str = "",  # noqa: ARG002
        seconds: float = float("inf"),  # noqa: ARG002
        urgent: bool = False,
    ) -> Future[Result]:
        """Do a piece of work; see `ProcessExecutor.submit`."""
        from dask.base import annotate  # noqa: PLC0415 - an extra
        from distributed.client import ClosedClientError  # noqa: PLC0415

        try:
            with annotate(priority=int(urgent)):
                return self._translated(self._executor.submit(fn, *args))
        except ClosedClientError as error:  # until `alive` has connected it again
            raise NoWorkersError("the Dask scheduler is away") from error

    def kill(self, future: Future[Any]) -> None:
        """End a piece of work that has not begun."""
        future.cancel()

    def _translated(self, theirs: Future[Result]) -> Future[Result]:
        """Return a future that fails as those of `ProcessExecutor` do."""
        ours: Future[Result] = Future()

        def cancel(future: Future[Result]) -> None:
            if future.cancelled():
                theirs.cancel()

        def pass_on(future: Future[Result]) -> None:
            if ours.cancelled() or not ours.set_running_or_notify_cancel():
                return
            try:
                ours.set_result(future.result())
            except CancelledError:
                ours.set_exception(WorkerLostError("the Dask cluster gave the work up"))
            except BaseException as error:  # noqa: BLE001 - whatever the work raised
                ours.set_exception(self._translate(error))

        ours.add_done_callback(cancel)
        theirs.add_done_callback(pass_on)
        return ours

    def _translate(self, error: BaseException) -> BaseException:
        from distributed.scheduler import KilledWorker, NoValidWorkerError  # noqa: PLC0415

        if isinstance(error, KilledWorker | NoValidWorkerError):
            self._count_loss()
            return WorkerLostError("the Dask workers that tried it died")
        return error

    def stop(self) -> None:
        """End all work at once."""
        with suppress(Exception):  # what cancels its work fails where the scheduler has gone
            self._executor.shutdown(wait=False)
        self._client.close(timeout=5)


WorkExecutor = ProcessExecutor | DaskExecutor
"""Does pieces of work: functions of modules with their arguments, which may take some seconds."""


def open_executor(settings: Settings, count_loss: Callable[[], None]) -> WorkExecutor:
    """Start the executor that the settings ask for."""
    if settings.dask is not None:
        return DaskExecutor(settings.dask, count_loss)
    return ProcessExecutor(settings.workers or cores(), count_loss, settings.worker_memory_bytes, compile_kernels)
