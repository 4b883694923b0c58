"""Found, ambiguous or not found: whether the best place is good, alone, and better than chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["found", "ambiguous", "not_found"]

MIN_LENGTH_M = 100.0
"""A shorter drive fits nearly everywhere."""

MIN_ROAD = 0.60
"""Least share of the track that must run on roads, of pieces with the least to say."""

MARGIN = 0.10
"""How much better than the next place, and than chance, the best must be."""


@dataclass(frozen=True)
class Decision:
    """What came out of a search, and why.

    Attributes
    ----------
    outcome : {"found", "ambiguous", "not_found"}
    reason : str
        A whole sentence.
    advice : str
        What would help, a whole sentence; "" where it was found.
    """

    outcome: Outcome
    reason: str
    advice: str = ""

    @property
    def found(self) -> bool:
        """True where there is one place."""
        return self.outcome == "found"


def too_short(length_m: float) -> Decision:
    """Refuse a drive that is too short to be looked for."""
    return Decision(
        "not_found",
        f"the drive is {length_m:.0f} m long, and under {MIN_LENGTH_M:.0f} m nearly every road fits it.",
        "Give a longer drive, or one pose that you know (--at).",
    )


def decide(road: float, score: float, runner_up: float, chance: float) -> Decision:
    """Decide by the figures of the best place.

    Parameters
    ----------
    road : float
        Share of the track on roads at the best place.
    score : float
        Of the best place; see `interloc.localization.evidence.Evidence`.
    runner_up : float
        Of the next best place, elsewhere.
    chance : float
        Of the best place for the same drive seen in a mirror. That one was never driven (unless the drive is
        straight), has as many curves and intersections, and shows how well this map explains such a drive by chance.

    Notes
    -----
    The score of the best place alone proves nothing: a curve more or less, and a wrong place does as well. What counts
    is its lead over the best wrong ones; `interloc benchmark locate` measures how far wrong places lead by chance.
    """
    longer = "A longer drive, the labels of its scans (for intersections), or a rough position (--near) would help."
    if road < MIN_ROAD:
        return Decision(
            "not_found",
            f"at the best place only {100 * road:.0f} % of the track run along roads of the map "
            f"(expected {100 * MIN_ROAD:.0f} % or more).",
            "Give a map that holds the roads driven; if it does, the poses may drift too much.",
        )
    if score - runner_up < MARGIN:
        return Decision(
            "ambiguous", f"the best place scores {score:.2f}, the next one {runner_up:.2f}: too close to call.", longer
        )
    if score - chance < MARGIN:
        return Decision(
            "not_found",
            f"the best place scores {score:.2f}, but so does chance: the same drive seen in a mirror, which nobody "
            f"drove, reaches {chance:.2f}.",
            longer,
        )
    return Decision("found", f"the best place scores {score:.2f}, the next one {runner_up:.2f}, chance {chance:.2f}.")
