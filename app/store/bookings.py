"""Disk space that bodies under way will take: it is booked when they are announced, and free again when they have come.

Without that many could begin at once where there is room for one, each not knowing of the others.
"""

from __future__ import annotations

import threading


class Bookings:
    """The sum of what is announced and has not come yet.

    Attributes
    ----------
    lock
        Held while the free space is looked at and a booking is made: no two see the same space.
    size_bytes : int
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.size_bytes = 0
