"""Label schemes: which ids are road, and which are the ground that is most often confused with it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from interloc.arrays import IntArray, UInt8Array
from interloc.drives.options import LabelSchemeChoice
from interloc.errors import ConfigError

ROAD, CONFUSABLE = 1, 2
"""Groups of the selection kernel."""

_LABEL_COUNT = 1 << 16


@dataclass(frozen=True)
class LabelScheme:
    """Meaning of the label ids.

    Attributes
    ----------
    name : str
    road : frozenset of int
        Ids of road.
    confusable : frozenset of int
        Ids of sidewalk, parking and other ground: what the paper's noise takes for road (section V-C).
    known : frozenset of int or None
        All ids of the scheme; None where they are not known (custom ids).
    """

    name: str
    road: frozenset[int]
    confusable: frozenset[int] = field(default_factory=frozenset)
    known: frozenset[int] | None = None

    def means_the_same(self, other: LabelScheme) -> bool:
        """Say whether the same ids are road, and the same are confused with it."""
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
SCHEMES = {scheme.name: scheme for scheme in (SEMANTICKITTI, LEARNING, KITTI360)}


def named_scheme(choice: LabelSchemeChoice) -> LabelScheme | None:
    """Return the scheme that was asked for; None for "auto".

    Raises
    ------
    ConfigError
        No such scheme, or custom ids that are none.
    """
    if isinstance(choice, str):
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
        choice = frozenset(int(text) for text in fields)
    if not choice or any(not 0 <= label < _LABEL_COUNT for label in choice):
        raise ConfigError("label scheme: the ids of road must be numbers from 0 to 65535, at least one.")
    return LabelScheme(name="custom", road=frozenset(int(label) for label in choice))


def guess_scheme(ids: IntArray, *, kitti360: bool) -> LabelScheme:
    """Tell the scheme from the ids that occur.

    Parameters
    ----------
    ids : (K,) int64
        Distinct label ids of some scans.
    kitti360 : bool
        The pose lines are KITTI-360's.

    Notes
    -----
    Raw ids have gaps: 2 to 9 are no SemanticKITTI ids. Ids up to 19 with a 9 (road) are the learning scheme; in a
    KITTI-360 drive ids up to 44 are its own, unless SemanticKITTI explains them all (a network trained on it).
    """
    if looks_like_learning(ids):
        return LEARNING
    found = {int(label) for label in ids}
    if kitti360 and found <= (KITTI360.known or found) and not found <= (SEMANTICKITTI.known or found):
        return KITTI360
    return SEMANTICKITTI


def looks_like_learning(ids: IntArray) -> bool:
    """Say whether the ids fit the 20 classes of the learning scheme (its road, 9, is no raw id of SemanticKITTI)."""
    return len(ids) > 0 and int(ids.max()) <= 19 and 9 in ids
