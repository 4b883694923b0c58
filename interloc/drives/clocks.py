"""Clocks that differ by what is known: TAI, GPS time, time zones."""

import math
from dataclasses import dataclass

_CERTAIN_S = 0.3
_CLOCKS = {
    37.0: "TAI, as PTP gives it, is 37 s ahead of UTC",
    36.0: "TAI was 36 s ahead of UTC in 2015 and 2016",
    18.0: "GPS time is 18 s ahead of UTC",
    17.0: "GPS time was 17 s ahead of UTC in 2015 and 2016",
    19.0: "TAI is 19 s ahead of GPS time",
}
_QUARTER_S, _MAX_ZONE_S = 900.0, 14 * 3600.0


@dataclass(frozen=True)
class ClockShift:
    """How far a clock is ahead of another."""

    ahead_s: float
    """Seconds; negative where it is behind."""
    why: str
    """What that is, in words."""


def known_shift(ahead_s: float) -> ClockShift | None:
    """Return the usual shift between two clocks that one is ahead by; None where it is none."""
    for known_s, why in _CLOCKS.items():
        if abs(abs(ahead_s) - known_s) < _CERTAIN_S:
            return ClockShift(math.copysign(known_s, ahead_s), why)
    zones = round(ahead_s / _QUARTER_S) if math.isfinite(ahead_s) else 0
    if zones and abs(ahead_s) <= _MAX_ZONE_S + 1 and abs(ahead_s - zones * _QUARTER_S) < _CERTAIN_S:
        return ClockShift(zones * _QUARTER_S, "a local time, or another time zone")
    return None
