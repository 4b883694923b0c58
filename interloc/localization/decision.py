"""Found, ambiguous or not found: whether the best place is good, alone, and better than chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from interloc.localization.evidence import Evidence

Outcome = Literal["found", "ambiguous", "not_found"]

MIN_LENGTH_M = 100.0
"""A shorter drive fits nearly everywhere."""

MIN_ROAD = 0.70
"""Share of the track that must run along roads: wrong places with curves reach 0.72, right ones 0.73 to 0.96."""

MIN_SCORE = 1.15
"""Score of track and intersections together, where intersections were seen: a wrong place that led had 1.09."""

MARGIN = 0.10
"""How much better than the next place, and than chance, the best must be."""

FULL_LENGTH_M = 700.0
"""A shorter drive needs a larger lead, twice the margin at half this length: one of 500 m led by 0.10 in a mirror."""

FULL_LENGTH_ALONE_M = 1000.0
"""The same where the trajectory is all there is: one of 500 m led by 0.19 on a map that does not hold it."""

MIN_SEEN = 2
"""Intersections seen, from which on they count in the decision."""


@dataclass(frozen=True)
class Decision:
    """What came out of a search, and why.

    Attributes
    ----------
    outcome : {"found", "ambiguous", "not_found"}
    reason : str
        Why, to stand after "the drive was not placed: " or "found: ".
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
        "Give a longer drive, or the track of a phone that was along (interloc locate --gpx).",
    )


def decide(best: Evidence | None, runner_up: float, chance: float, length_m: float) -> Decision:
    """Decide by the figures of the best place.

    Parameters
    ----------
    best
        What speaks for the best place; None where nothing fitted at all.
    runner_up : float
        Score of the next best place, elsewhere.
    chance : float
        Score of the best place for the same drive seen in a mirror. That one was never driven (unless the drive is
        straight), has as many curves and intersections, and shows how well this map explains such a drive by chance.
    length_m : float
        Of the drive.

    Notes
    -----
    The score of the best place alone proves nothing: a curve less, and a wrong place does as well. What counts is its
    lead over the best wrong ones.
    """
    longer = "A longer drive, labels (for the intersections along it) or roughly where it was (near) would help."
    if best is None or best.road < MIN_ROAD:
        share = 0.0 if best is None else best.road
        return Decision(
            "not_found",
            f"at the best place only {100 * share:.0f} % of the track run along roads of the map "
            f"(expected {100 * MIN_ROAD:.0f} % or more).",
            "Give a map that holds the roads driven; if it does, the poses may drift too much.",
        )
    full_length_m = FULL_LENGTH_M if best.seen >= MIN_SEEN else FULL_LENGTH_ALONE_M
    margin = MARGIN * max(1.0, full_length_m / max(length_m, 1.0))
    if best.score - runner_up < margin:
        return Decision(
            "ambiguous",
            f"the best place scores {best.score:.2f}, the next one {runner_up:.2f}: not {margin:.2f} apart.",
            longer,
        )
    if best.score - chance < margin:
        return Decision(
            "not_found",
            f"the best place scores {best.score:.2f}, which is not {margin:.2f} better than chance: the same drive "
            f"seen in a mirror, which nobody drove, reaches {chance:.2f}.",
            longer,
        )
    if best.seen >= MIN_SEEN and best.score < MIN_SCORE:
        return Decision(
            "not_found",
            f"at the best place {best.at_nodes} of the {best.seen} intersections seen are at intersections of the map, "
            f"and {best.missed} of the {best.passed} passed were not seen.",
            "Give a map that holds the roads driven, better labels, or a longer drive.",
        )
    return Decision(
        "found", f"the best place scores {best.score:.2f}, the next one {runner_up:.2f}, chance {chance:.2f}."
    )
