"""Fixes against poses that tell how the vehicle moved: which of them stand still, and how late they are.

A shift in time between the two shows by their shapes: they are the same, one after the other on the same road. From
positions alone, GNSS fixes without attitude, follows a georeference.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.findings import Findings
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d, rotation_from_rpy, travelled, wrap_longitude

MIN_FIXES = 3
MIN_EXTENT_M = 10.0
"""Less than this shows no heading."""

_AROUND_M = 50.0
"""Fixes count for a scan by how far was driven between the two: this is the standard deviation."""

_MAX_LAT_DEG = 89.0
_BIN_M = 1.0
_STATION_M = 5.0
_ROUNDS = 4
_USUAL_ERROR_M = 0.5
_BEST_STD_M = 0.3
"""No fix counts as better than this: what a receiver states of itself is often too good."""

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

_JUMP_M = 10.0  # further aside than by noise
_UNDECIDED_M = 20.0
_STANDS, _DRIVEN_M, _BRIDGED_M = 0.1, 2.0, 10.0
"""A fix stands still that moves by less than this share of what is driven meanwhile, over 2 m at least. Poses bridge a
few metres without a loss."""

_ALIKE, _ALIKE_M = 1.5, 0.1
"""Shifts at which no more than so much is left are as good as the best: the smallest is taken, and is not sure."""


@dataclass(frozen=True)
class Fixes:
    """Positions of a GNSS antenna."""

    lat_deg: FloatArray
    lon_deg: FloatArray
    alt_m: FloatArray
    """(K,) float64: on WGS84."""
    position: FloatArray
    """(K, 3) float64: where the antenna was in the world of the poses, metres."""
    distance_m: FloatArray
    """(K,) float64: distance driven until then, ascending."""
    std_m: FloatArray | None = None
    """(K,) float64 or None: one-sigma uncertainty along each horizontal axis, as the receiver states it; None where it
    states none."""
    arm_std_m: float = 0.0
    """One-sigma uncertainty that all fixes share: that of the place of the antenna on the vehicle."""

    @property
    def swapped(self) -> "Fixes | None":
        """The same with latitude and longitude exchanged; None where that is no place on Earth."""
        if not len(self.lon_deg) or np.abs(self.lon_deg).max() >= _MAX_LAT_DEG:
            return None
        return replace(self, lat_deg=self.lon_deg, lon_deg=self.lat_deg)

    @property
    def enu(self) -> FloatArray:
        """(K, 2) float64: east and north of the first of them, metres."""
        lonlat = np.stack([self.lon_deg, self.lat_deg], axis=-1)
        return enu_from_lonlat(lonlat[0, 1], lonlat[0, 0], lonlat)

    @property
    def off_poses_m(self) -> float:
        """Root mean square of what they are off the poses, laid on them in one piece, metres."""
        _, turn, move = fit_rigid(self.position[:, :2], self.enu, np.ones(len(self.position)))
        return float(np.linalg.norm(self.position[:, :2] @ turn.T + move - self.enu) / len(self.position) ** 0.5)


def extent_m(fixes: Fixes) -> float:
    """Return how far the fixes reach, metres: the diagonal of the box around them."""
    if not len(fixes.lat_deg):
        return 0.0
    return float(np.linalg.norm(np.ptp(fixes.enu, axis=0)))


def georeference_from_fixes(
    fixes: Fixes, T_world_lidar: FloatArray, distance_m: FloatArray, source: str
) -> Georeference:
    """Lay (N, 4, 4) poses, in a world whose z axis points up, on fixes, by the (N,) distances driven until each.

    Every few metres, the poses are turned about the vertical and moved so that they lie on the fixes with the least sum
    of weighted squares (closed form). The weights fall with the distance driven, so that drift of an odometry does not
    matter, and with the error of a fix, so that one that jumped does not either (Cauchy weights, some rounds). Between
    two such places, position and heading are interpolated. Roll and pitch are those of the poses.
    """
    fixes, arm_std_m = _averaged(fixes), fixes.arm_std_m
    cell = np.floor(distance_m / _STATION_M)
    stations = np.unique(np.concatenate([cell, cell + 1]))
    before, after = np.searchsorted(stations, cell), np.searchsorted(stations, cell + 1)
    share = distance_m / _STATION_M - cell
    laid = np.array([_laid_around(fixes, float(station) * _STATION_M) for station in stations])
    angle = np.unwrap(laid[:, 2])
    first, second = (_placed(laid[rows], T_world_lidar[:, :3, 3]) for rows in (before, after))
    step = second - first
    step[:, 0] = wrap_longitude(step[:, 0])
    placed = first + share[:, None] * step
    yaw = angle[before] + share * (angle[after] - angle[before])
    std_m = None if fixes.std_m is None else laid[before, 6] + share * (laid[after, 6] - laid[before, 6])
    if arm_std_m:
        std_m = np.hypot(0.0 if std_m is None else std_m, np.full(len(yaw), arm_std_m))
    zero = np.zeros(len(yaw))
    return Georeference(
        lat_deg=placed[:, 1].copy(),
        lon_deg=placed[:, 0].copy(),
        alt_m=placed[:, 2].copy(),
        R_enu_lidar=rotation_from_rpy(zero, zero, yaw) @ T_world_lidar[:, :3, :3],
        source=source,
        position_std_m=std_m,
    )


def _laid_around(fixes: Fixes, here_m: float) -> tuple[float, ...]:
    """Lay the poses on the fixes around a place on the way: longitude, latitude of an origin, turn, move, uncertainty.

    The turn is in radians, the move east, north and up and the uncertainty in metres: of the fixes as stated, or as
    they scatter where that is more, NaN where nothing is stated.
    """
    around, weights = _around(fixes.distance_m, here_m)
    stated = None if fixes.std_m is None else fixes.std_m[around]
    if stated is not None:
        weights = weights / (stated**2 + _BEST_STD_M**2)
    lonlat = np.stack([fixes.lon_deg[around], fixes.lat_deg[around]], axis=-1)
    origin = lonlat[int(np.argmax(weights))]
    enu = enu_from_lonlat(origin[1], origin[0], lonlat)
    ours, robust = fixes.position[around], weights
    for _ in range(_ROUNDS):
        _, turn, move = fit_rigid(ours[:, :2], enu, robust)
        error = np.linalg.norm(ours[:, :2] @ turn.T + move - enu, axis=1)
        scale = max(_USUAL_ERROR_M, 2.0 * float(np.median(error)))
        robust = weights / (1.0 + (error / scale) ** 2)
    angle, turn, move = fit_rigid(ours[:, :2], enu, robust)
    std_m = float("nan")
    if stated is not None:
        squares = ((ours[:, :2] @ turn.T + move - enu) ** 2).sum(axis=1) / 2  # along one axis
        std_m = float(np.sqrt(max(np.average(stated**2, weights=robust), np.average(squares, weights=robust))))
    up_m = float(np.average(fixes.alt_m[around] - ours[:, 2], weights=robust))
    return (*origin, angle, *move, up_m, std_m)


def _placed(laid: FloatArray, position: FloatArray) -> FloatArray:
    """Return (N, 3) longitude, latitude, altitude of (N, 3) positions, each by its row of (N, 7) `_laid_around`."""
    enu = rotate_2d(position[:, :2], laid[:, 2]) + laid[:, 3:5]
    return np.column_stack([lonlat_from_enu(laid[:, 1], laid[:, 0], enu), position[:, 2] + laid[:, 5]])


def _averaged(fixes: Fixes) -> Fixes:
    """Average the fixes of every metre driven: a stop at a light counts once."""
    _, member = np.unique(np.floor(fixes.distance_m / _BIN_M), return_inverse=True)
    count, lon_deg = np.bincount(member), fixes.lon_deg[0]

    def mean(values: FloatArray) -> FloatArray:
        return np.bincount(member, weights=values) / count

    return Fixes(
        mean(fixes.lat_deg),
        wrap_longitude(lon_deg + mean(wrap_longitude(fixes.lon_deg - lon_deg))),
        mean(fixes.alt_m),
        np.stack([mean(fixes.position[:, axis]) for axis in range(3)], axis=-1),
        mean(fixes.distance_m),
        None if fixes.std_m is None else mean(fixes.std_m),
    )


def _around(distance_m: FloatArray, here_m: float) -> tuple[slice, FloatArray]:
    """Return which fixes lie around a scan, and their weights; wider where there are few."""
    apart = np.abs(distance_m - here_m)
    spread = max(_AROUND_M, 1.5 * float(np.sort(apart)[min(MIN_FIXES, len(apart)) - 1]))
    first, last = np.searchsorted(distance_m, [here_m - 3 * spread, here_m + 3 * spread])
    around = slice(int(first), int(last))
    return around, np.exp(-0.5 * (apart[around] / spread) ** 2)


def fit_rigid(ours: FloatArray, theirs: FloatArray, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return angle, (2, 2) rotation and (2,) shift that lay (K, 2) points on others with least weighted squares."""
    share = weights / weights.sum()
    our_mean, their_mean = share @ ours, share @ theirs
    a, b = ours - our_mean, theirs - their_mean
    cosine = float(share @ (a * b).sum(axis=1))
    sine = float(share @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    angle = float(np.arctan2(sine, cosine))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return angle, turn, their_mean - turn @ our_mean


@dataclass(frozen=True)
class Standing:
    """A run of fixes that stand still while the vehicle drives, as where a receiver repeats its last position."""

    first: int
    """Row of the fix that the others repeat."""
    stop: int
    """Row of the first fix that moves again; how many there are where none does."""
    driven_m: float

    @property
    def repeated(self) -> slice:
        """The rows that tell nothing."""
        return slice(self.first + 1, self.stop)


def standing_fixes(positions: FloatArray, enu: FloatArray) -> list[Standing]:
    """Find where fixes stand still while the vehicle drives, by (K, 2) positions of poses and of fixes, metres."""
    found: list[Standing] = []
    ours, theirs = (list(map(complex, *each.T.tolist())) for each in (positions, enu))
    first, driven_m = 0, 0.0
    for row in range(1, len(ours) + 1):
        meanwhile_m = abs(ours[row] - ours[first]) if row < len(ours) else 0.0
        if row < len(ours) and abs(theirs[row] - theirs[first]) < _STANDS * max(meanwhile_m, _DRIVEN_M):
            driven_m = max(driven_m, meanwhile_m)
            continue
        if driven_m >= _DRIVEN_M:
            found.append(Standing(first, row, driven_m))
        first, driven_m = row, 0.0
    return found


def standing_in_words(runs: list[Standing], at: FloatArray, span: str) -> str:
    """Say which fixes stand still, by what (K,) tells when each was, and how that is written of two of them."""
    longest = sorted(runs, key=lambda run: -run.driven_m)[:3]
    named = "; ".join(f"{span.format(*at[[run.first, run.stop - 1]])}, {run.driven_m:.0f} m" for run in longest)
    return (
        f"{sum(run.stop - run.first - 1 for run in runs):,} of {len(at):,} fixes stand still while the vehicle drives "
        f"({named}{'; ...' if len(runs) > len(longest) else ''}): they are left out, and the poses tell where it was. "
        "Usual cause: a receiver that repeats its last position or lost its signal, or degrees with few decimals."
    )


def tell_standing(runs: list[Standing], at: FloatArray, span: str, source: str, findings: Findings) -> None:
    """Say it, with a warning where much was driven meanwhile."""
    if runs:
        tell = findings.warning if max(run.driven_m for run in runs) > _BRIDGED_M else findings.note
        tell(source, standing_in_words(runs, at, span))


@dataclass(frozen=True)
class Shift:
    """By how much fixes are late or early."""

    late: float
    """Fixes belong to poses that were so much earlier; in the unit of the times given."""
    metres: float
    """How far is driven meanwhile, the median."""
    undecided_m: float
    """So many metres along the track fixes may be off and fit as well."""
    is_there: bool
    """Without it, the poses are clearly farther off the fixes."""
    is_sure: bool
    """It is known to 3 m along the track, or to a tenth of itself."""
    before_m: float
    after_m: float
    """Root mean square of what the poses are off the fixes, piece by piece, without and with it."""

    @property
    def undecided(self) -> str:
        """Why fixes may be late or early without being seen to be, in words that follow; "" where that is seen."""
        if self.is_there or self.undecided_m < _UNDECIDED_M:
            return ""
        return (
            f"whether it is late or early against the poses cannot be told: up to {self.undecided_m:.0f} m along the "
            "road fit alike, as where the road neither bends nor the speed changes."
        )


def fit_shift(times: FloatArray, positions: FloatArray, fix_times: FloatArray, enu: FloatArray) -> Shift | None:
    """Find the shift in time by which poses lie best on fixes, piece by piece; None where there is too little of both.

    (N,) times and (N, 2) level positions of poses, (K,) times in the same unit and (K, 2) east and north of fixes,
    metres. On the tracks of KITTI with fixes once a second and a noise of up to 1 m, shifts of 0.5 to 18 s are found to
    0.1 s (straight sequence 04: to 1 s with the noise, which is told as unsure), and none where there is none.
    """
    step = max(1, -(-len(fix_times) // _MAX_FIXES))
    fix_times, enu = fix_times[::step], enu[::step]
    stays = ~_has_jumped(enu)
    fix_times, enu = fix_times[stays], enu[stays]
    windows = _windows(enu)
    duration = float(times[-1] - times[0])
    length = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
    if not len(windows[0]) or duration <= 0 or length <= 0:
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
    if not count:
        return None
    both = np.abs(2 * (fix_times - late - times[0]) - duration) <= duration  # what jumped must not just leave
    unshifted = _mean_square(times, positions, fix_times[both], enu[both], _windows(enu[both]))[0]
    metres = abs(late) / unit * _USUAL_SPEED_MPS
    gain = unshifted - best
    if not np.isfinite(unshifted):
        return None
    is_there = metres >= _MIN_SHIFT_M and gain >= _GAIN_M**2 and best <= _BETTER * unshifted
    is_there &= count * gain >= _SIGNIFICANT * max(best, 1e-6)
    likely = coarse[squares < best * (1 + 9.0 / count) + 1e-4]
    unsure_m = max(float(np.ptp(likely)) / 2 if len(likely) else 0.0, _FINE * unit) / unit * _USUAL_SPEED_MPS
    undecided_m = float(np.abs(likely).max(initial=0.0)) / unit * _USUAL_SPEED_MPS
    is_sure = unsure_m < max(_SURE_M, 0.1 * metres) and abs(late) < reach - _COARSE * unit  # at its end it is cut off
    is_sure &= len(alike) == 1
    is_there &= is_sure or (metres >= _UNSURE_M and best <= _MUCH_BETTER * unshifted)
    return Shift(late, metres, undecided_m, is_there, is_sure, float(np.sqrt(unshifted)), float(np.sqrt(best)))


def _has_jumped(enu: FloatArray) -> BoolArray:
    """Return which (K, 2) fixes lie aside, a few in a row: no vehicle drives there and back from one to the next."""
    steps = np.linalg.norm(np.diff(enu, axis=0), axis=1)
    aside = np.zeros(len(enu), dtype=np.bool_)
    for count in range(1, min(_MIN_IN_WINDOW, len(steps))):
        there_and_back = steps[:-count] + steps[count:]
        detour = there_and_back - np.linalg.norm(enu[count + 1 :] - enu[: -count - 1], axis=1)
        first = np.flatnonzero((detour > _JUMP_M) & (detour > there_and_back / 2)) + 1
        aside[np.add.outer(first, np.arange(count)).ravel()] = True
    return aside


def fit_moving(
    times: FloatArray, positions: FloatArray, fix_times: FloatArray, enu: FloatArray
) -> tuple[Shift | None, list[Standing]]:
    """Find which fixes stand still, and the shift of those that do not; parameters as of `fit_shift`."""
    late, shift = 0.0, None
    for _ in range(2):  # where fixes are late, they stand still for as long at each start
        then = [np.interp(fix_times - late, times, axis) for axis in positions.T]
        runs = standing_fixes(np.stack(then, axis=1), enu)
        moves = are_moving(runs, len(enu))
        if np.count_nonzero(moves) < MIN_FIXES:  # they are not the fixes of this drive
            return None, []
        shift = fit_shift(times, positions, fix_times[moves], enu[moves])
        if shift is None or not shift.is_there or late:
            break
        late = shift.late
    return shift, runs


def are_moving(runs: list[Standing], count: int) -> BoolArray:
    """Return (K,) which of so many fixes are in none of the runs."""
    moves: BoolArray = np.ones(count, dtype=np.bool_)
    for run in runs:
        moves[run.repeated] = False
    return moves


def misfit_m(times: FloatArray, positions: FloatArray, fix_times: FloatArray, enu: FloatArray) -> float:
    """Return the root mean square of what poses are off fixes, piece by piece; parameters as of `fit_shift`."""
    return float(np.sqrt(_mean_square(times, positions, fix_times, enu, _windows(enu))[0]))


def _windows(enu: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the rows of overlapping pieces of the track, one after the other, and how many each has."""
    driven = travelled(enu)
    starts = np.arange(0.0, max(driven[-1] - _WINDOW_M / 2, 1.0), _WINDOW_M / 2)
    rows = [np.flatnonzero((driven >= start) & (driven < start + _WINDOW_M)) for start in starts]
    rows = [each for each in rows if len(each) >= _MIN_IN_WINDOW]
    return np.concatenate([np.empty(0, np.int64), *rows]), np.array([len(each) for each in rows], np.int64)


def _mean_square(
    times: FloatArray, positions: FloatArray, fix_times: FloatArray, enu: FloatArray, windows: tuple[IntArray, IntArray]
) -> tuple[float, float]:
    """Return the mean square of what is left when poses are laid on fixes, and how many of these err independently."""
    inside = (fix_times >= times[0]) & (fix_times <= times[-1])
    ours = np.interp(fix_times, times, positions[:, 0]) + 1j * np.interp(fix_times, times, positions[:, 1])
    theirs = enu[:, 0] + 1j * enu[:, 1]
    rows, sizes = windows
    kept = inside[rows]
    counts = np.add.reduceat(kept, np.cumsum(sizes) - sizes, dtype=np.int64) if len(rows) else sizes
    enough = counts >= np.maximum(_MIN_IN_WINDOW - 1, 0.7 * sizes)  # of a piece within the drive
    if not enough.any():
        return float("inf"), 0.0
    rows, counts = rows[kept & np.repeat(enough, sizes)], counts[enough]
    begins = np.cumsum(counts) - counts
    a, b = (each[rows] - np.repeat(np.add.reduceat(each[rows], begins) / counts, counts) for each in (ours, theirs))
    turn = np.add.reduceat(np.conj(a) * b, begins)
    off = b - a * np.repeat(turn / np.maximum(np.abs(turn), 1e-9), counts)
    follows: BoolArray = np.ones(len(rows), dtype=np.bool_)
    follows[begins] = False  # the one before it is of another piece
    shared = float((np.conj(off[:-1]) * off[1:]).real[follows[1:]].sum())
    squares, free = float((np.abs(off) ** 2).sum()), int((2 * counts - 3).sum())
    alike = min(max(shared / max(squares, 1e-9), 0.0), 0.99)
    return squares / free, free * (1.0 - alike) / (1.0 + alike)


# Clocks that differ by what is known: TAI, GPS time, time zones.

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
