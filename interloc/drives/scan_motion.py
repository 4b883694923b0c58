"""Do the scans move as the poses do? A few pairs of scans are laid onto each other, and held against the poses."""

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.plan_matching import MAX_TURN_RAD, MIN_CELLS, GroundPlan, PlanMatch, road_plan, upright_plan
from interloc.drives.scans.raw import RawScans
from interloc.geometry import invert_transform, rotate_2d, rows_apart, travelled, wrap_angle, yaw_of

_APART_M = 7.0
_MUCH_M = 50.0
_PAIR_TURN_RAD = np.radians(50.0)
_SPREAD, _TELLING = 4, 4
_TURN_M = 10.0
"""From so far away a turn is seen as a shift."""

_TELLS_M = 0.3

_MATCHED = {"upright": 0.45, "road": 0.5}
"""Share of a plan that must lie on the other: streets reach 0.5 to 0.9 up to 23 m apart."""

_FAR_M, _FAR_RAD = 25.0, np.radians(60.0)
"""Where the poses move as far between two scans, these hardly see the same, and what lies on the other is chance."""

_CONTRADICTS_M, _STRONGLY_M, _UNKNOWN_M = 0.3, 0.6, 2.0
"""Where scans lie so much farther off than by the best motion, theirs is another one: with the right poses 0.19 m at
most, on real scans and where only the edges of the road are seen; with those of other drives 0.3 to 1 m."""

_NO_MOTION_M, _NO_MOTION_RAD = 2.0, np.radians(6.0)
_MAX_SHIFT = 30
_PLACES_WRONG = 2
_MAX_LATE, _LITTLE_M = 10, 3.0
_CLOSER, _CLOSER_M, _PLACES_CLOSER = 1.25, 0.15, 3
"""So much closer must scans lie with the motion of a mistake: with their own they lie up to 1.04 times as far off on
drives that turn hardly at all, and 0.7 to 0.4 times where they turn."""

_SCALES = np.exp(np.arange(-0.9, 0.91, 0.02))
_SCALINGS = np.stack([_SCALES, _SCALES, np.ones(len(_SCALES))], axis=1)
_MIRROR = (1.0, -1.0, -1.0)
_SCALE_APART_M, _SCALE_PLACES, _AGREE, _ALIKE = 3.0, 4, 0.75, 0.05
_OFF_SCALE, _STANDS = 0.07, 1e-4
"""Of the logarithm of a scale: on sound drives, real and simulated, it is 0.04 at most where places agree."""


_GROUND_SCALES = np.exp(np.arange(-60, 61) * 0.03)
_GROUND_PLACES, _GROUND_APART_M = 24, (3.0, 8.0)
_BESIDE, _RISE, _GAIN, _MIN_GAIN = 4, 0.004, 0.25, 0.004
"""Steps of the scale to a worse one; by how much more of the ground must contradict there at a place that tells; by
how much less with another scale, as a share of what contradicts, and at least."""


@dataclass(frozen=True)
class _Pair:
    """Two scans laid onto each other."""

    i: int
    j: int
    """Their rows among the scans that can be read."""
    kind: str
    """{"upright", "road"}: what was laid onto each other."""
    match: PlanMatch

    @property
    def motion(self) -> FloatArray:
        """That of the scans: x, y in metres and turn in radians."""
        return self.match.motion

    def lost_m(self, motions: FloatArray) -> FloatArray:
        """Return how much farther off the scans lie with (K, 3) motions than with their own; NaN as of `off_m`."""
        return self.match.off_m(motions) - self.match.best_off_m


@dataclass(frozen=True)
class _Explanation:
    """A way in which poses may be wrong, and how well it explains the scans."""

    words: str
    lost_m: FloatArray
    """(P,) float64: of each pair: how much farther off its scans lie than by the best motion."""

    @property
    def wrong(self) -> IntArray:
        """Pairs that it does not explain."""
        return np.flatnonzero(self.lost_m > _CONTRADICTS_M)


def check_scan_motion(
    drive: FolderDrive, usable: IntArray, pose_file: str, findings: Findings, *, is_computed: bool = False
) -> None:
    """Check that the scans move as the poses do: in scale, direction, to the right side, at the right time.

    Pairs some metres apart, spread over the drive and where its motion changes most, are laid onto each other by all
    turns and shifts at once (`interloc.drives.plan_matching`). On real drives the motion of the poses fits as well as
    the best one. Where it does not at several places, usual mistakes are tried on the poses, and the one that explains
    all is named.
    """
    usable = np.asarray(usable, dtype=np.int64)
    if len(usable) < 2:
        return
    poses = drive.T_world_lidar[usable]
    matcher, pairs = _Matcher(drive, usable), []
    with findings.stage():
        pairs = matcher.pairs()
    near, laid = ([pair for pair in each if _is_near(_given_motion(poses, pair))] for each in (pairs, matcher.laid))
    mistakes = _mistakes(laid, poses)
    mistake = max(mistakes, key=lambda each: each.ratio, default=_Mistake(""))
    fault = _unlike(near, poses, mistake) or _in_another_unit(pairs, near, poses)
    tells = pairs or any(each.ratio * _CLOSER < 1.0 for each in mistakes)
    scale = _scale_of(matcher.laid, poses) if matcher.kind == "upright" else None
    is_unexplained = fault is None or fault[3] == _ANOTHER
    is_long = float(np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0))) > _MUCH_M
    is_checked = is_computed or drive.georeference is not None  # fixes tell the scale, too
    if scale is None and is_unexplained and is_long and not (is_checked or drive.is_slow):
        with findings.stage():
            scale = _scale_of_ground(drive, usable)
    is_off = scale is not None and abs(np.log(scale)) > _OFF_SCALE
    if scale is None and fault is None and is_long and not (is_checked and tells):
        what = "the scale of the poses is right" if tells else "the scans move as the poses do"
        say = findings.undecided if is_checked else findings.warning
        say(pose_file, f"whether {what} cannot be told: the scans hold too little that stands upright.")
    if mistake.is_clear and (fault is None or fault[1] < _PLACES_WRONG):
        text = f"the scans do not move as the poses do ({mistake.closer} of {mistake.of} places). {mistake.words}."
        if mistake.metres < _LITTLE_M:
            findings.warning(pose_file, text)
        else:
            findings.refuse(pose_file, text)
    elif is_off and is_unexplained:
        assert scale is not None
        text = f"the scans do not move as the poses do. {_scale_words(scale)}."
        findings.refuse(pose_file, text)
    elif fault is not None:
        pair, wrong, of, usual = fault
        x, y, turn = _given_motion(poses, pair)
        seen_x, seen_y, seen_turn = pair.motion
        text = (
            f"from scan {drive.frames[usable[pair.i]]} to {drive.frames[usable[pair.j]]} the poses move by "
            f"{np.hypot(x, y):,.1f} m and turn by {np.degrees(turn):.0f} degrees, the scans by "
            f"{np.hypot(seen_x, seen_y):.0f} m and {np.degrees(seen_turn):.0f} degrees"
        )
        if wrong < _PLACES_WRONG:
            findings.warning(pose_file, f"the poses jump: {text}. {usual}.")
            return
        findings.refuse(
            pose_file,
            f"the scans do not move as the poses do: {text} ({wrong} of {of} places looked at are like that). {usual}.",
        )


@dataclass(frozen=True)
class _Mistake:
    """A mistake in poses, against the poses as they are."""

    words: str
    ratio: float = 1.0
    """How many times as far off the scans lie without it as with it."""
    closer_m: float = 0.0
    """By how much less: 0.3 m and more where it is made, 0.1 m and less where poses are sound but scatter."""
    closer: int = 0
    of: int = 0
    """Places at which they lie closer with it, of how many."""
    metres: float = float("inf")
    """How far off the road comes to lie by it."""

    @property
    def is_clear(self) -> bool:
        """Whether it is the better explanation."""
        return self.ratio > _CLOSER and self.closer_m > _CLOSER_M and self.closer >= _PLACES_CLOSER


def _mistakes(pairs: list[_Pair], poses: FloatArray) -> list[_Mistake]:
    """Try mistakes that scans tell well where the motion changes from one to the next: mirrored, some scans late."""
    if len(pairs) < _PLACES_CLOSER:
        return []
    step_m = float(np.median(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)))
    given = _motions(poses, pairs)
    tried = [("", given, 0.0), (_MIRRORED, given * _MIRROR, float("inf"))]
    shifts = (late for late in range(-_MAX_LATE, _MAX_LATE + 1) if late)
    tried += [(_late_words(late), _motions(poses, pairs, late), abs(late) * step_m) for late in shifts]
    motions = np.stack([motion for _, motion, _ in tried], axis=1)
    given_m, *others_m = np.stack([pair.match.off_m(of_pair) for pair, of_pair in zip(pairs, motions, strict=True)]).T
    found = []
    for (words, _, metres), off_m in zip(tried[1:], others_m, strict=True):
        known = np.isfinite(off_m)
        if np.count_nonzero(known) >= _PLACES_CLOSER:
            mean_m, with_it_m = float(given_m[known].mean()), float(off_m[known].mean())
            closer = int(np.count_nonzero(off_m[known] < given_m[known]))
            ratio = mean_m / max(with_it_m, 1e-3)
            found.append(_Mistake(words, ratio, mean_m - with_it_m, closer, int(np.count_nonzero(known)), metres))
    return found


def _scale_of(laid: list[_Pair], poses: FloatArray) -> float | None:
    """Return how many times as far as the poses the scans move, by most places alike; None: it cannot be told."""
    places: list[tuple[_Pair, FloatArray]] = []
    for pair in sorted(laid, key=lambda each: each.j):
        given = _given_motion(poses, pair)
        if np.hypot(given[0], given[1]) > _SCALE_APART_M and (not places or pair.i >= places[-1][0].j):
            places.append((pair, given))
    if len(places) < _SCALE_PLACES:
        return None
    lost_m = np.array([pair.lost_m(given * _SCALINGS) for pair, given in places])
    best = int(np.argmin(lost_m.sum(axis=0)))
    together, alone = np.log(_SCALES[best]), np.log(_SCALES[np.argmin(lost_m, axis=1)])
    is_alike = (np.abs(alone - together) < max(_ALIKE, abs(together) / 4)) & (lost_m[:, best] < _CONTRADICTS_M)
    enough = max(_SCALE_PLACES, _AGREE * len(places))
    return float(_SCALES[best]) if np.count_nonzero(is_alike) >= enough else None


def _scale_of_ground(drive: FolderDrive, usable: IntArray) -> float | None:
    """Return how many times as far as the poses the scans move, by which road comes to lie on road; None: untold."""
    poses = drive.T_world_lidar[usable]
    driven_m = travelled(poses[:, :3, 3])
    starts = np.unique(np.searchsorted(driven_m, np.linspace(0.0, driven_m[-1], _GROUND_PLACES)))
    plans: dict[int, GroundPlan] = {}
    found: list[FloatArray] = []
    standing: list[float] = []  # what contradicts if nothing moves
    for i in starts.tolist():
        for j in np.unique(np.searchsorted(driven_m, driven_m[i] + _GROUND_APART_M)).tolist():
            given = _planar(poses[i], poses[j]) if j < len(poses) else np.full(3, np.nan)
            if abs(given[2]) < MAX_TURN_RAD:
                for row in {i, j} - plans.keys():
                    plans[row] = GroundPlan.of(drive.ground_points(int(usable[row])))
                off = plans[i].contradiction(plans[j], given, np.append(_GROUND_SCALES, 0.0))
                found.append(off[:-1])
                standing.append(off[-1])
    shares = np.array(found).reshape(-1, len(_GROUND_SCALES))
    known = np.isfinite(shares).mean(axis=0) > 0.5 if len(shares) else np.zeros(len(_GROUND_SCALES), dtype=np.bool_)
    if not known.any():
        return None
    sums = np.where(known, np.nansum(shares, axis=0) / np.maximum(np.isfinite(shares).sum(axis=0), 1), np.inf)
    best, as_given = int(np.argmin(sums)), len(_GROUND_SCALES) // 2
    if not _BESIDE <= best < len(sums) - _BESIDE or np.nanmean(standing) < sums[as_given]:
        return None  # errors of labels that go with the sensor lie on each other where it stands
    beside = shares[:, [best - _BESIDE, best + _BESIDE]].mean(axis=1)
    tell = shares[beside > shares[:, best] + _RISE]
    gain = tell[:, as_given] - tell[:, best]
    is_off = gain.mean() > max(_MIN_GAIN, _GAIN * tell[:, best].mean()) if len(tell) else False
    agree = np.count_nonzero(gain > 0.0) if is_off else len(tell)
    if agree < max(_SCALE_PLACES, _AGREE * len(tell)):
        return None
    return float(_GROUND_SCALES[best]) if is_off else 1.0


def _is_near(given: FloatArray) -> bool:
    return bool(np.hypot(given[0], given[1]) < _FAR_M and abs(given[2]) < _FAR_RAD)


def _unlike(pairs: list[_Pair], poses: FloatArray, mistake: _Mistake) -> tuple[_Pair, int, int, str] | None:
    """Return the worst of some pairs, how many are like it, of how many, and the cause; None where poses are right."""
    as_given = _explained(pairs, _motions(poses, pairs), "")
    wrong = as_given.wrong
    if not len(wrong):
        return None
    worst = pairs[int(np.argmax(as_given.lost_m))]
    strong = [row for row in wrong if as_given.lost_m[row] > _STRONGLY_M]
    if strong or worst.kind == "upright":  # edges of a straight road hardly tell how far along it
        best = min(_explanations(pairs, poses), key=lambda each: (len(each.wrong), float(each.lost_m.mean())))
        if len(best.wrong) <= len(wrong) // 3 and len(wrong) - len(best.wrong) >= _PLACES_WRONG:
            return worst, len(wrong), len(pairs), best.words
    if not strong and len(wrong) <= _PLACES_WRONG:
        return None
    worst = pairs[max(strong or wrong.tolist(), key=lambda row: as_given.lost_m[row])]
    if len(wrong) >= _PLACES_WRONG:
        usual = mistake.words if mistake.is_clear else _ANOTHER
        return worst, len(wrong), len(pairs), usual
    usual = "Usual cause: an outage of GNSS or odometry, or scans missing there"
    return (worst, 1, len(pairs), usual) if len(pairs) > _PLACES_WRONG else None


def _in_another_unit(pairs: list[_Pair], near: list[_Pair], poses: FloatArray) -> tuple[_Pair, int, int, str] | None:
    """Return the same for poses that are far apart everywhere, while the scans move by a fixed share of that."""
    as_given = _explained(pairs, _motions(poses, pairs), "")
    if len(near) > len(pairs) // 3 or len(pairs) < 3 or len(as_given.wrong) < len(pairs):
        return None
    scaled = _scale_explanation(pairs, poses)
    is_scaled = len(scaled.wrong) <= len(pairs) // 4
    return (pairs[0], len(pairs), len(pairs), scaled.words) if is_scaled else None


class _Matcher:
    """Chooses pairs of scans, and lays them onto each other."""

    def __init__(self, drive: FolderDrive, usable: IntArray) -> None:
        self.drive, self.usable = drive, usable
        self.poses = drive.T_world_lidar[usable]
        self.kind = "upright" if isinstance(drive.scans, RawScans) else "road"
        self.laid: list[_Pair] = []
        """All that were laid onto each other, also those whose motion that does not tell."""
        self._plans: dict[int, FloatArray] = {}

    def pairs(self) -> list[_Pair]:
        """Return the pairs that lie firmly on each other."""
        starts = self._starts()
        found = [pair for start in starts if (pair := self._pair(start)) is not None]
        if not found and self.kind == "upright" and not self.drive.is_slow:
            self.kind = "road"
            self._plans.clear()
            self.laid.clear()
            found = [pair for start in starts if (pair := self._pair(start)) is not None]
        return found

    def _starts(self) -> list[int]:
        """Choose rows to start from: spread over the drive, and where its motion changes most."""
        position, yaw = self.poses[:, :3, 3], yaw_of(self.poses[:, :3, :3])
        driven = travelled(position)
        rows = np.array([row for row in rows_apart(position, _APART_M) if row < len(driven) - 1])
        if len(rows) < 3:
            rows = np.arange(len(driven) - 1)
        spread = rows[np.linspace(0, len(rows) - 1, _SPREAD).round().astype(np.int64)]
        ahead = np.minimum(np.searchsorted(driven, driven + _APART_M), len(driven) - 1)
        step = rotate_2d(position[ahead, :2] - position[:, :2], -yaw)
        motion = np.column_stack([step, _TURN_M * np.unwrap(wrap_angle(yaw[ahead] - yaw))])
        change = np.linalg.norm(np.diff(motion, axis=0), axis=1)
        tells = np.minimum(change[1:], change[:-1])  # from the scan before and to the next; at a jump one is small
        starts: list[int] = []
        for row in (np.argsort(-tells) + 1).tolist():
            if len(starts) == _TELLING or tells[row - 1] < _TELLS_M:
                break
            if all(abs(driven[row] - driven[other]) > 2 * _APART_M for other in starts):
                starts.append(row)
        return sorted({*spread.tolist(), *starts})

    def _pair(self, i: int) -> _Pair | None:
        """Lay a scan some metres on onto another, as far on as poses say; where that fails, as scans themselves do."""
        j = self._some_metres_on(i)
        if j > i + 1 and (pair := self._laid(i, j)) is not None:
            return pair
        near = self._laid(i, i + 1)  # the poses may be in another unit
        if near is None:
            return None
        given = _given_motion(self.poses, near)
        if near.lost_m(given[None])[0] < _CONTRADICTS_M and np.hypot(*given[:2]) > _NO_MOTION_M:
            return near
        gap = int(_APART_M / max(float(np.hypot(*near.motion[:2])), 0.5))
        return (gap > 1 and self._laid(i, min(len(self.usable) - 1, i + gap))) or near

    def _some_metres_on(self, i: int) -> int:
        last = min(len(self.usable), i + 200)
        there = invert_transform(self.poses[i]) @ self.poses[i + 1 : last]
        beyond = (np.linalg.norm(there[:, :2, 3], axis=1) > _APART_M) | (
            np.abs(yaw_of(there[:, :3, :3])) > _PAIR_TURN_RAD
        )
        return i + 1 + int(np.argmax(beyond)) if beyond.any() else last - 1

    def _laid(self, i: int, j: int) -> _Pair | None:
        given = _planar(self.poses[i], self.poses[j])
        if abs(given[2]) > MAX_TURN_RAD:
            return None
        target, source = self._plan(i), self._plan(j)
        if min(len(target), len(source)) < MIN_CELLS:
            return None
        match = PlanMatch.of(target, source, given[2])
        if not match.is_sure(given, _CONTRADICTS_M):
            match = PlanMatch.of(target, source)
        pair = _Pair(i, j, self.kind, match)
        self.laid.append(pair)
        if pair.match.share < _MATCHED[self.kind]:
            return None
        turns = max(abs(pair.motion[2]), abs(given[2]) / 3) > _NO_MOTION_RAD
        if self.kind == "road" and np.hypot(*pair.motion[:2]) < _NO_MOTION_M and not turns:
            return None  # a straight road looks the same from everywhere, best of all where points end at one range
        return pair

    def _plan(self, row: int) -> FloatArray:
        if row not in self._plans:
            index = int(self.usable[row])
            if self.kind == "upright" and isinstance(self.drive.scans, RawScans):
                points = self.drive.scans.points_of(int(self.drive.frames[index]))
                self._plans[row] = upright_plan(points.values[:, :3])
            else:
                self._plans[row] = road_plan(self.drive.ground_points(index).road)
        return self._plans[row]


def _planar(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return (..., 3) x, y in metres and turn in radians of (..., 4, 4) poses in others."""
    relative = invert_transform(first) @ second
    return np.concatenate([relative[..., :2, 3], yaw_of(relative[..., :3, :3])[..., None]], axis=-1)


def _given_motion(poses: FloatArray, pair: _Pair) -> FloatArray:
    """Return the motion of a pair by the poses."""
    return _planar(poses[pair.i], poses[pair.j])


def _motions(poses: FloatArray, pairs: list[_Pair], late: int = 0) -> FloatArray:
    """Return the (P, 3) motions of pairs by the poses of so many scans later; NaN where there are none."""
    rows = np.array([(pair.i, pair.j) for pair in pairs], dtype=np.int64).reshape(-1, 2) + late
    known = (rows[:, 0] >= 0) & (rows[:, 1] < len(poses))
    motions = np.full((len(pairs), 3), np.nan)
    motions[known] = _planar(poses[rows[known, 0]], poses[rows[known, 1]])
    return motions


def _explained(pairs: list[_Pair], motions: FloatArray, words: str) -> _Explanation:
    lost_m = np.array([pair.lost_m(motion[None])[0] for pair, motion in zip(pairs, motions, strict=True)])
    return _Explanation(words, np.nan_to_num(lost_m, nan=_UNKNOWN_M))


_ANOTHER = "Usual cause: poses of another sequence, or scans and poses of two clocks"
_MIRRORED = "They fit with left and right exchanged. Usual cause: poses in a frame with z down (NED, FRD)"


def _late_words(scans: int) -> str:
    count = f"{abs(scans)} scan{'' if abs(scans) == 1 else 's'}"
    return (
        f"They fit where each scan gets the pose of {count} {'later' if scans > 0 else 'earlier'}. Usual cause: "
        "scans and poses of two clocks, or that start at other frames"
    )


def _explanations(pairs: list[_Pair], poses: FloatArray) -> list[_Explanation]:
    """Try the usual mistakes."""
    given = _motions(poses, pairs)
    inverted = np.array([_planar(poses[pair.j], poses[pair.i]) for pair in pairs])
    tried = [
        _scale_explanation(pairs, poses),
        _explained(pairs, given * _MIRROR, _MIRRORED),
        _explained(pairs, inverted, "They fit inverted. Usual cause: transforms from the world to the sensor"),
    ]
    for degrees in (180, 90, -90, *range(-165, 180, 15)):
        if degrees:
            turned = np.column_stack([rotate_2d(given[:, :2], np.radians(degrees)), given[:, 2]])
            words = (
                f"They fit with the points turned by {degrees} degrees. Usual cause: poses of another sensor (IMU, "
                "camera) without the transform between the two"
            )
            tried.append(_explained(pairs, turned, words))
    shifts = sorted((late for late in range(-_MAX_SHIFT, _MAX_SHIFT + 1) if late), key=abs)
    tried += [_explained(pairs, _motions(poses, pairs, late), _late_words(late)) for late in shifts]
    if all(pair.kind == "upright" and np.hypot(*pair.motion[:2]) <= _NO_MOTION_M for pair in pairs):
        words = (
            "The scans stand still. Usual cause: a driver that repeats a scan, or points that were moved into the "
            "frame of the world already"
        )
        tried.append(_explained(pairs, np.zeros((len(pairs), 3)), words))
    return tried


def _scale_explanation(pairs: list[_Pair], poses: FloatArray) -> _Explanation:
    """Try the scale by which the scans move, the median where they hardly turn or turn alike."""
    given = _motions(poses, pairs)
    seen = np.array([pair.motion for pair in pairs])
    scale = float(np.median(np.hypot(*seen[:, :2].T) / np.maximum(np.hypot(*given[:, :2].T), 1e-6)))
    scale = scale if scale > _STANDS and abs(np.log(scale)) > _OFF_SCALE else 1.0
    return _explained(pairs, given * (scale, scale, 1.0), _scale_words(scale))


def _scale_words(scale: float) -> str:
    return (
        f"The poses move {1 / scale:.2f} times as far as the scans. Usual cause: the scale of a monocular "
        "or visual odometry, the radius of a wheel, another unit, or scans that were thinned out and numbered anew"
    )
