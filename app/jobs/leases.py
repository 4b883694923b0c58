"""Which leases have run out, also where the clock of the database was set forward or back.

A lease is a time by the clock of the database. When that jumps forward, all leases seem to have run out; when it jumps
back, those of dead servers seem to last for hours. Servers that live renew their leases several times within the length
of one, so after a jump that length is waited for: then every lease of a living server is a good one again, and one that
lies farther ahead than any server writes it is of a dead one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from app.store.clock import ClockWatch


class LeaseClock:
    """What one server knows of the time.

    Parameters
    ----------
    lease_s
        Length of a lease.
    monotonic
        A clock that never jumps.
    """

    def __init__(self, lease_s: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._lease_s = lease_s
        self._watch = ClockWatch(lease_s / 3, monotonic)

    def bounds(self, now: float) -> tuple[float, float]:
        """Return two times by the clock of the database, which it shows as `now`: leases that end between them hold.

        Those that end by the first or after the second have run out.
        """
        is_settled = self._watch.look(now) >= self._lease_s
        first = now if is_settled or not self._watch.has_jumped else -math.inf
        return first, now + 2 * self._lease_s if is_settled else math.inf
