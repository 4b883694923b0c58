"""Label schemes: which ids are road, which are the ground most often confused with it, and which scheme ids are of.

What lies under the vehicle is road: labels whose scheme says otherwise are read by the wrong scheme.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from interloc.arrays import Float32Array, UInt8Array, UInt32Array
from interloc.drives.findings import Findings
from interloc.errors import ConfigError
from interloc.wording import listed

ROAD, CONFUSABLE = 1, 2
"""Groups of the selection kernel."""

MIN_ROAD_SHARE, MAX_ROAD_SHARE = 0.05, 0.9
MAX_UNKNOWN_SHARE = 0.05

_LABEL_COUNT = 1 << 16
_NEAREST_M, _FARTHEST_M = 2.5, 6.0
_LOWEST, _ABOVE_M = 20.0, 0.3
_HARDLY, _MOSTLY, _SIDEWALK = 0.25, 0.5, 0.1
_SIGN = 19  # the last id of the learning scheme
_ENOUGH = 50
_NUSCENES_ROAD, _NUSCENES_IDS = 11, 16
_MOVING_OBJECTS = frozenset({0, 9, 251})
_WITHOUT = "--labels geometry does without labels."


@dataclass(frozen=True)
class LabelScheme:
    """Meaning of the label ids."""

    name: str
    road: frozenset[int]
    """Ids of road."""
    confusable: frozenset[int] = field(default_factory=frozenset)
    """Ids of sidewalk, parking and other ground: what label errors take for road (paper, section V-C)."""
    known: frozenset[int] | None = None
    """All ids of the scheme; None where they are not known (custom ids)."""

    def means_the_same(self, other: "LabelScheme") -> bool:
        """Return whether the same ids are road, and the same are confused with it."""
        return (self.road, self.confusable) == (other.road, other.confusable)

    def groups(self) -> UInt8Array:
        """Return the (65536,) uint8 table from id to group: 1 road, 2 confusable, 0 neither."""
        table = np.zeros(_LABEL_COUNT, dtype=np.uint8)
        table[sorted(self.confusable)] = CONFUSABLE
        table[sorted(self.road)] = ROAD
        return table


SEMANTICKITTI = LabelScheme(
    name="semantickitti",
    road=frozenset({40, 60}),  # road and lane-marking: the learning map folds the second into the first
    confusable=frozenset({44, 48, 49}),  # parking, sidewalk, other-ground
    known=frozenset(
        {0, 1, 10, 11, 13, 15, 16, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 52, 60, 70, 71, 72, 80, 81, 99}
        | set(range(252, 260))
    ),
)
LEARNING = LabelScheme(
    name="learning",
    road=frozenset({9}),
    confusable=frozenset({10, 11, 12}),  # parking, sidewalk, other-ground
    known=frozenset(range(20)),
)
KITTI360 = LabelScheme(
    name="kitti360",
    road=frozenset({7}),
    confusable=frozenset({6, 8, 9}),  # ground, sidewalk, parking
    known=frozenset({*range(45), 65535}),  # 65535: -1, the licence plates
)
LAS = LabelScheme(
    name="las",
    road=frozenset({11}),  # road surface (ASPRS LAS 1.4)
    confusable=frozenset({2}),  # ground
    known=frozenset(range(256)),
)
SCHEMES = {scheme.name: scheme for scheme in (SEMANTICKITTI, LEARNING, KITTI360, LAS)}


_DELIBERATE = ("custom", "las")
"""Schemes by which clouds of road alone are read, as they are asked for, or delivered."""


def named_scheme(choice: str) -> LabelScheme | None:
    """Return the scheme that was asked for by its name or by its ids of road; None for "auto"."""
    if choice == "auto":
        return None
    if choice in SCHEMES:
        return SCHEMES[choice]
    fields = choice.replace(",", " ").split()
    if not fields or not all(text.isascii() and text.isdigit() for text in fields):
        raise ConfigError(
            f"label scheme {choice!r}: expected auto, {', '.join(SCHEMES)}, "
            "or the ids of road separated by commas (40,60)."
        )
    road = frozenset(int(text) for text in fields)
    if max(road) >= _LABEL_COUNT:
        raise ConfigError("label scheme: the ids of road must be numbers from 0 to 65535, at least one.")
    return LabelScheme(name="custom", road=road)


def guess_scheme(ids: Iterable[int], *, kitti360: bool) -> LabelScheme:
    """Guess the scheme from the distinct ids of some scans; `kitti360`: the pose lines are KITTI-360's.

    Raw ids have gaps: 2 to 9 are no SemanticKITTI ids. Ids up to 19 with a 9 (road) are the learning scheme; in a
    KITTI-360 drive ids up to 44 are its own, unless SemanticKITTI explains them all (a network trained on it).
    """
    found = {int(label) for label in ids}
    if _looks_like_learning(found):
        return LEARNING
    if kitti360 and found <= (KITTI360.known or found) and not found <= (SEMANTICKITTI.known or found):
        return KITTI360
    return SEMANTICKITTI


def _looks_like_learning(ids: Collection[int]) -> bool:
    """Return whether the ids fit the 20 classes of the learning scheme (its road, 9, is no raw id of SemanticKITTI)."""
    return 9 in ids and max(ids) <= 19


@dataclass(frozen=True)
class LabelJudgement:
    """What the label ids of some scans mean."""

    scheme: LabelScheme | None = None
    """None where nothing was counted, and no scheme was named."""
    counts: dict[int, int] = field(default_factory=dict)
    """How many points carry each id."""

    @property
    def road_share(self) -> float | None:
        """Share of road among the points."""
        return None if self.scheme is None else self._share(self.scheme.road)

    @property
    def ground_share(self) -> float | None:
        """Share of road, sidewalk, parking and other ground among the points: what is left of a reduced scan."""
        return None if self.scheme is None else self._share(self.scheme.road | self.scheme.confusable)

    @property
    def id_shares(self) -> dict[int, float]:
        """Share of the points that carry each id."""
        total = sum(self.counts.values())
        return {label: self.counts[label] / total for label in sorted(self.counts)} if total else {}

    @property
    def unknown_ids(self) -> list[int]:
        """Ids that the scheme does not know."""
        known = None if self.scheme is None else self.scheme.known
        return [] if known is None else sorted(set(self.counts) - known)

    def _share(self, ids: Iterable[int]) -> float | None:
        total = sum(self.counts.values())
        return sum(self.counts.get(label, 0) for label in ids) / total if total else None


def judge_labels(
    folder: str, counts: dict[int, int], choice: str, *, kitti360: bool, check: bool, findings: Findings
) -> LabelJudgement:
    """Find out what the label ids of some scans mean, by how many points carry each, and whether that makes sense.

    `choice` is the scheme that was asked for, or "auto"; `kitti360`: the pose lines are KITTI-360's.
    """
    scheme = named_scheme(choice)
    if scheme is None and counts:
        scheme = guess_scheme(counts, kitti360=kitti360)
        if scheme is not SEMANTICKITTI:
            findings.note(folder, f"the ids look like scheme {scheme.name} and are read as such.")
    judgement = LabelJudgement(scheme, counts)
    if check:
        check_labels(folder, judgement, findings)
    return judgement


def check_labels(folder: str, judgement: LabelJudgement, findings: Findings) -> None:
    """Check the share of road, and that the ids belong to the scheme."""
    scheme, counts, total = judgement.scheme, judgement.counts, sum(judgement.counts.values())
    if scheme is None or not total:
        return
    ids = sorted(counts)
    is_doubted = scheme.name not in _DELIBERATE and not re.fullmatch("geometry|network .*", folder)
    if len(ids) == 1 and is_doubted and ids[0] not in scheme.road:
        findings.refuse(
            folder,
            f"no point of the scans looked at is road: every one has the id {ids[0]}. Usual cause: a field that nobody "
            f"filled, or labels of ground without classes. {_WITHOUT}",
        )
        return
    road = sum(counts.get(label, 0) for label in scheme.road)
    is_moving = len(ids) > 1 and set(ids) <= _MOVING_OBJECTS
    # Scans that were cut to the road hold its ids alone; 9 alone may be the static points of labels of moving objects.
    is_cut = scheme.name != "learning" and set(ids) <= scheme.road
    is_too_much = (road > MAX_ROAD_SHARE * total and not is_cut) or (is_moving and max(ids) > 9)
    if is_too_much and is_doubted:
        seen = f"{road / total:.0%} of the points are road" if road else "the points are static (9) or moving (251)"
        cause = "labels of moving objects (9 static, 251 moving)" if is_moving else "labels of other classes"
        findings.refuse(
            folder,
            f"{seen} (ids {listed(ids, 12)}, read as scheme {scheme.name}); 10 to 40 % are usual. Usual cause: "
            f"{cause}, which do not tell road. {_WITHOUT} Scans that hold road alone are read by its ids "
            f"(--label-scheme {listed(sorted(scheme.road), 12)}).",
        )
        return
    if scheme.name not in {"custom", "learning", "las"} and _looks_like_learning(counts):
        findings.refuse(
            folder,
            f"all ids are 19 or less ({listed(ids, 20)}), which looks like the learning scheme (0..19, road = 9), "
            f"but they are read as {scheme.name}. Use label scheme 'learning' (--label-scheme learning). "
            "Usual cause: predictions that were not mapped back to the ids of the labels.",
        )
        return
    unknown = sum(counts[label] for label in judgement.unknown_ids)
    if unknown:
        message = (
            f"{unknown / total:.1%} of the points have ids that {scheme.name} does not know "
            f"({listed(judgement.unknown_ids, 12)})."
        )
        if unknown > MAX_UNKNOWN_SHARE * total:
            findings.warning(folder, f"{message} Usual cause: another label scheme; name it, or give the ids of road.")
        else:
            findings.note(folder, message)
    wanted = listed(sorted(scheme.road), 12)
    if road == 0:
        findings.refuse(
            folder,
            "no road was found by geometry in the scans looked at. Expected flat ground under the vehicle, and "
            "poses of the sensor that saw it. Usual cause: poses of another drive, or in another frame."
            if folder == "geometry"
            else f"no point of the scans looked at is road: the ids are {listed(ids, 20)}; road would be {wanted} "
            f"(scheme {scheme.name}). Usual cause: another label scheme; name it, or give the ids of road.",
        )
    elif road < MIN_ROAD_SHARE * total:
        findings.warning(
            folder,
            f"only {road / total:.2%} of the points are road (ids {wanted}); 10 to 40 % are usual. "
            "Usual cause: another label scheme, or labels of other scans.",
        )


def ids_below(points: Float32Array, labels: UInt32Array) -> Counter[int]:
    """Count the ids of the ground around the vehicle, of (N, 4) points in L and their (N,) labels."""
    x, y = points[:, 0], points[:, 1]
    with np.errstate(invalid="ignore", over="ignore"):
        squared = x * x + y * y
        near = (squared > _NEAREST_M**2) & (squared < _FARTHEST_M**2) & np.isfinite(points[:, 2])
    if np.count_nonzero(near) < _ENOUGH:
        return Counter()
    height = points[near, 2]
    lowest = height < np.percentile(height, _LOWEST) + _ABOVE_M
    ids, counts = np.unique(labels[near][lowest] & 0xFFFF, return_counts=True)
    return Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))


def check_below(folder: str, below: Counter[int], scheme: LabelScheme, ids: set[int], findings: Findings) -> None:
    """Check that the ground around the vehicle, by `ids_below` of some scans, is road; `ids` are all of these scans."""
    total = sum(below.values())
    if not total or not ids & scheme.road:  # without any road, that is said already
        return
    first_two, is_learning = below[0] + below[1], scheme.name == LEARNING.name
    if is_learning and max(ids) < _SIGN and below[1] > _SIDEWALK * total and first_two > _MOSTLY * total:
        findings.refuse(
            folder,
            f"{first_two / total:.0%} of the ground around the vehicle has id 0 or 1, which is no ground in "
            f"scheme {scheme.name}. Usual cause: the train ids of Cityscapes, whose road is 0. Use --label-scheme 0.",
        )
        return
    usual, count = below.most_common(1)[0]
    if sum(below[label] for label in scheme.road) > _HARDLY * total or count < _MOSTLY * total:
        return
    text = (
        f"{count / total:.0%} of the ground around the vehicle has id {usual}, which is no road in scheme "
        f"{scheme.name} (road: {', '.join(map(str, sorted(scheme.road)))}). "
    )
    if is_learning and usual + 1 in scheme.road:
        findings.refuse(
            folder,
            f"{text}Usual cause: ids that are one less, 0 to 18 with road = 8, as MMDetection3D writes them. Use "
            f"--label-scheme {usual}, or add 1 to every id.",
        )
    elif is_learning and usual == _NUSCENES_ROAD and max(ids) <= _NUSCENES_IDS:
        findings.refuse(
            folder,
            f"{text}Usual cause: the 16 classes of nuScenes-lidarseg, whose driveable surface is 11. Use "
            f"--label-scheme {usual}.",
        )
    elif usual in scheme.confusable | {0}:
        findings.warning(folder, f"{text}Usual cause: a drive off the road, or another label scheme.")
    else:
        findings.refuse(
            folder,
            f"{text}Usual cause: another label scheme; name it, or give the ids of road, such as --label-scheme "
            f"{usual}.",
        )
