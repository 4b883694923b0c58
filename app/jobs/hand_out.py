"""Which piece of work is begun next: quick work does not wait for long work, nor one client for another.

`slots` pieces of work are done at a time. One more is begun if it is urgent, and one more, whatever it is, for a client
that has nothing at work: whoever holds all the others keeps only himself waiting. Urgent work comes first; then the
client with the fewest pieces at work; then the order of submission.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

EXTRA_SLOTS = 2


@dataclass(eq=False)
class Work:
    """A piece of work.

    Attributes
    ----------
    call
        Function, arguments.
    client : str
        For whom it is done.
    seconds : float
        How long it may take.
    urgent : bool
        Somebody waits for it.
    is_given_up : bool
        Nobody wants it any more.
    """

    call: tuple[Callable[..., Any], tuple[Any, ...]]
    client: str = ""
    seconds: float = float("inf")
    urgent: bool = False
    is_given_up: bool = False
    future: Future[Any] = field(default_factory=Future)


class HandOut:
    """The pieces of work that wait, and how many of each client are at work. The caller holds a lock.

    Parameters
    ----------
    slots
        How many pieces are done at a time, without the extra ones.
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
            busy = self._at_work.total()
            admitted = [work for work in self._waiting if busy < self._room_for(work)]
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

    def _room_for(self, work: Work) -> int:
        if not self._at_work[work.client]:
            return self._slots + EXTRA_SLOTS
        return self._slots + work.urgent
