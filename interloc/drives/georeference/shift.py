"""A shift in time between poses and fixes: both have the same shape, one after the other on the same road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray

_WINDOW_M = 150.0
"""Over so long a piece poses do not drift; the more of it turns, the better it tells the shift."""

_MIN_IN_WINDOW = 5
_MAX_FIXES = 1000
_COARSE, _FINE = 0.5, 0.05
"""Steps in which shifts are tried, in seconds at usual speeds."""

_MAX_SHIFT_S = 40.0
_USUAL_SPEED_MPS = 10.0
_BETTER, _GAIN_M, _SIGNIFICANT = 0.8, 0.3, 25.0
_MIN_SHIFT_M, _SURE_M = 1.5, 3.0
_UNSURE_M, _MUCH_BETTER = 5.0, 0.5
"""A shift that is not sure is told only where it is so large, and explains so much."""

_UNTOLD_M = 20.0
_ALIKE, _ALIKE_M = 1.5, 0.1
"""Shifts at which no more than so much is left are as good as the best: the smallest is taken, and is not sure."""


@dataclass(frozen=True)
class Shift:
    """By how much fixes are late or early."""

    late: float
    """Fixes belong to poses that were so much earlier; in the unit of the times given."""
    metres: float
    """How far is driven meanwhile, the median."""
    untold_m: float
    """So many metres along the track fixes may be off and fit as well."""
    is_there: bool
    """Without it, the poses are clearly farther off the fixes."""
    is_sure: bool
    """It is known to 3 m along the track, or to a tenth of itself."""
    before_m: float
    after_m: float
    """Root mean square of what the poses are off the fixes, piece by piece, without and with it."""

    @property
    def untold(self) -> str:
        """Why fixes may be late or early without being seen to be, in words that follow; "" where that is seen."""
        if self.is_there or self.untold_m < _UNTOLD_M:
            return ""
        return (
            f"whether it is late or early against the poses cannot be told: up to {self.untold_m:.0f} m along the road "
            "fit alike, as where the road neither bends nor the speed changes."
        )


def fit_shift(times: FloatArray, positions: FloatArray, fix_times: FloatArray, enu: FloatArray) -> Shift | None:
    """Find the shift in time by which poses lie best on fixes, piece by piece; None where there is too little of both.

    Parameters
    ----------
    times : (N,) float64
        Of the poses, ascending, in seconds or any other unit.
    positions : (N, 2) float64
        Of the poses, metres, in a level world.
    fix_times : (K,) float64
        Ascending, in the same unit.
    enu : (K, 2) float64
        East and north of the fixes, metres.

    Notes
    -----
    On the tracks of KITTI with fixes once a second and a noise of up to 1 m, shifts of 0.5 to 18 s are found to 0.1 s
    (straight sequence 04: to 1 s with the noise, which is told as unsure), and none where there is none.
    """
    step = max(1, -(-len(fix_times) // _MAX_FIXES))
    fix_times, enu = fix_times[::step], enu[::step]
    windows = _windows(enu)
    duration = float(times[-1] - times[0])
    length = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
    if not windows or duration <= 0 or length <= 0:
        return None
    unit = duration * _USUAL_SPEED_MPS / length  # what lasts as long as a second does at the usual speed

    def cost(late: float) -> tuple[float, float]:
        return _mean_square(times, positions, fix_times - late, enu, windows)

    reach = min(_MAX_SHIFT_S * unit, 0.4 * duration)
    coarse = np.arange(-reach, reach + 1e-9, _COARSE * unit)
    squares = np.array([cost(late)[0] for late in coarse])
    lower = squares <= np.minimum(np.append(squares[1:], np.inf), np.insert(squares[:-1], 0, np.inf))
    alike = coarse[lower & (squares <= _ALIKE * squares.min() + _ALIKE_M**2)]  # more than one, where speeds repeat
    around = alike[int(np.argmin(np.abs(alike)))]
    fine = around + np.arange(-_COARSE, _COARSE + 1e-9, _FINE) * unit
    late = float(min(fine, key=lambda each: cost(each)[0]))
    best, count = cost(late)
    unshifted = cost(0.0)[0]
    metres = abs(late) / unit * _USUAL_SPEED_MPS
    gain = unshifted - best
    if not np.isfinite(unshifted) or not count:
        return None
    is_there = metres >= _MIN_SHIFT_M and gain >= _GAIN_M**2 and best <= _BETTER * unshifted
    is_there &= count * gain >= _SIGNIFICANT * max(best, 1e-6)
    likely = coarse[squares < best * (1 + 9.0 / count) + 1e-4]
    unsure_m = max(float(np.ptp(likely)) / 2 if len(likely) else 0.0, _FINE * unit) / unit * _USUAL_SPEED_MPS
    untold_m = float(np.abs(likely).max(initial=0.0)) / unit * _USUAL_SPEED_MPS
    is_sure = unsure_m < max(_SURE_M, 0.1 * metres) and abs(late) < reach - _COARSE * unit  # at its end it is cut off
    is_sure &= len(alike) == 1
    is_there &= is_sure or (metres >= _UNSURE_M and best <= _MUCH_BETTER * unshifted)
    return Shift(late, metres, untold_m, is_there, is_sure, float(np.sqrt(unshifted)), float(np.sqrt(best)))


def misfit_m(times: FloatArray, positions: FloatArray, fix_times: FloatArray, enu: FloatArray) -> float:
    """Return the root mean square of what poses are off fixes, piece by piece; parameters as of `fit_shift`."""
    return float(np.sqrt(_mean_square(times, positions, fix_times, enu, _windows(enu))[0]))


def _windows(enu: FloatArray) -> list[IntArray]:
    """Return the rows of overlapping pieces of the track."""
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(enu, axis=0), axis=1))])
    starts = np.arange(0.0, max(driven[-1] - _WINDOW_M / 2, 1.0), _WINDOW_M / 2)
    rows = [np.flatnonzero((driven >= start) & (driven < start + _WINDOW_M)) for start in starts]
    return [each for each in rows if len(each) >= _MIN_IN_WINDOW]


def _mean_square(
    times: FloatArray, positions: FloatArray, fix_times: FloatArray, enu: FloatArray, windows: list[IntArray]
) -> tuple[float, float]:
    """Return the mean square of what is left when poses are laid on fixes, window by window, and how much is free.

    What the errors of neighbouring fixes share counts once: those of a phone stay alike over 50 m and more.
    """
    inside = (fix_times >= times[0]) & (fix_times <= times[-1])
    ours = np.interp(fix_times, times, positions[:, 0]) + 1j * np.interp(fix_times, times, positions[:, 1])
    theirs = enu[:, 0] + 1j * enu[:, 1]
    squares, shared, free = 0.0, 0.0, 0
    for window in windows:
        rows = window[inside[window]]
        if len(rows) < max(_MIN_IN_WINDOW - 1, 0.7 * len(window)):
            continue
        a, b = ours[rows] - ours[rows].mean(), theirs[rows] - theirs[rows].mean()
        turn = np.vdot(a, b)
        off = b - a * turn / max(abs(turn), 1e-9)
        squares += float((np.abs(off) ** 2).sum())
        shared += float(np.vdot(off[:-1], off[1:]).real)
        free += 2 * len(rows) - 3
    if not free:
        return float("inf"), 0.0
    alike = min(max(shared / max(squares, 1e-9), 0.0), 0.99)
    return squares / free, free * (1.0 - alike) / (1.0 + alike)
