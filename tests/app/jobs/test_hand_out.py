"""The order of the work: quick work does not wait for long work, nor one client for another."""

import pytest

from app.jobs.processes import HandOut, Work


def add(hand_out: HandOut, words: str) -> None:
    """Let pieces of work of some clients wait; those with an exclamation mark are urgent."""
    for word in words.split():
        hand_out.add(Work((print, ()), word.rstrip("!"), urgent=word.endswith("!")))


def begun(hand_out: HandOut) -> list[Work]:
    """All that may begin now."""
    found = []
    while (taken := hand_out.take()) is not None:
        found.append(taken)
    return found


@pytest.mark.parametrize(
    ("slots", "at_work", "waiting", "ended", "expected"),
    [
        (2, "", "ann ann ann", [], "ann ann"),
        (2, "ann ann", "ann", [1], "ann"),
        (2, "eve eve", "eve! eve!", [], "eve!"),  # beside long work, but not in the last place
        (2, "eve eve", "eve! ann", [], "eve! ann"),
        (1, "eve", "eve eve ann ann", [], "ann"),  # who has nothing at work never waits for the many of another
        (2, "eve eve ann", "eve ann", [0], ""),  # as many are at work as there are slots
        (2, "eve eve ann", "eve ann", [0, 2], "ann"),  # the client with the fewest is next
        (1, "eve", "eve eve!", [0], "eve!"),
    ],
)
def test_what_begins_next(slots: int, at_work: str, waiting: str, ended: list[int], expected: str) -> None:
    hand_out = HandOut(slots)
    earlier: list[Work] = []
    for word in at_work.split():
        add(hand_out, word)
        earlier += begun(hand_out)
    add(hand_out, waiting)
    for number in ended:
        hand_out.done(earlier[number])
    assert " ".join(f"{each.client}{'!' * each.urgent}" for each in begun(hand_out)) == expected


def test_cancelled_work_is_passed_over_and_the_rest_is_done_in_its_order() -> None:
    hand_out = HandOut(1)
    pieces = [Work((print, ()), "ann") for _ in range(3)]
    for piece in pieces:
        hand_out.add(piece)
    pieces[0].future.cancel()
    assert begun(hand_out) == [pieces[1]]
