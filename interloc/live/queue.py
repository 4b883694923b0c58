"""Scans that wait for a session: few, and when it is too slow the oldest is dropped, which is counted and reported."""

from __future__ import annotations

from collections import deque
from threading import Condition
from typing import Generic, TypeVar

Item = TypeVar("Item")


class ScanQueue(Generic[Item]):
    """Hands items from one thread to another; never holds more than a few.

    Parameters
    ----------
    size : int
        How many may wait. A map of roads needs no scan in particular, and one that waits makes all after it late.

    Attributes
    ----------
    dropped : int
        Number of items dropped so far.
    """

    def __init__(self, size: int = 4) -> None:
        self.dropped = 0
        self._size = size
        self._items: deque[Item] = deque()
        self._changed = Condition()
        self._is_closed = False

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item) -> Item | None:
        """Add an item; return the oldest one if it had to go."""
        with self._changed:
            oldest = None
            if len(self._items) >= self._size:
                oldest = self._items.popleft()
                self.dropped += 1
            self._items.append(item)
            self._changed.notify()
            return oldest

    def get(self, timeout_s: float | None = None) -> Item | None:
        """Wait for the next item; None where the queue was closed and is empty, or nothing came in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._is_closed, timeout_s)
            return self._items.popleft() if self._items else None

    def close(self) -> None:
        """Say that nothing more comes."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
