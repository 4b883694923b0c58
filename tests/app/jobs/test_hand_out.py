"""The order of the work: quick work does not wait for long work, nor one client for another."""

from __future__ import annotations

from app.jobs.processes import HandOut, Work


def work(client: str, *, urgent: bool = False) -> Work:
    return Work((print, ()), client, urgent=urgent)


def begun(hand_out: HandOut) -> list[str]:
    """All that may begin now, by client."""
    clients = []
    while (taken := hand_out.take()) is not None:
        clients.append(taken.client)
    return clients


def busy(slots: int, *clients: str) -> tuple[HandOut, list[Work]]:
    """Pieces of work that are done, in the order of their beginning."""
    hand_out, at_work = HandOut(slots), []
    for client in clients:
        hand_out.add(work(client))
        taken = hand_out.take()
        assert taken is not None
        at_work.append(taken)
    return hand_out, at_work


def test_work_of_one_client_is_done_in_its_order_as_far_as_there_are_slots() -> None:
    hand_out = HandOut(2)
    pieces = [work("ann") for _ in range(3)]
    for piece in pieces:
        hand_out.add(piece)
    assert [hand_out.take(), hand_out.take(), hand_out.take()] == [pieces[0], pieces[1], None]
    hand_out.done(pieces[1])
    assert hand_out.take() is pieces[2]


def test_urgent_work_begins_beside_long_work_but_does_not_take_the_last_place() -> None:
    hand_out, _ = busy(2, "eve", "eve")
    for _ in range(2):
        hand_out.add(work("eve", urgent=True))
    assert begun(hand_out) == ["eve"]
    hand_out.add(work("ann"))
    assert begun(hand_out) == ["ann"]


def test_a_client_that_has_nothing_at_work_never_waits_for_the_many_of_another() -> None:
    hand_out, _ = busy(1, "eve")
    for client in ("eve", "eve", "ann", "ann"):
        hand_out.add(work(client))
    assert begun(hand_out) == ["ann"]


def test_the_client_with_the_fewest_pieces_is_next() -> None:
    hand_out, at_work = busy(2, "eve", "eve", "ann")
    for client in ("eve", "ann"):
        hand_out.add(work(client))
    hand_out.done(at_work[0])
    assert begun(hand_out) == []  # as many are at work as there are slots
    hand_out.done(at_work[2])
    assert begun(hand_out) == ["ann"]


def test_urgent_work_is_first() -> None:
    hand_out, at_work = busy(1, "eve")
    hand_out.done(at_work[0])
    hand_out.add(work("eve"))
    urgent = work("eve", urgent=True)
    hand_out.add(urgent)
    assert hand_out.take() is urgent


def test_cancelled_work_is_passed_over() -> None:
    hand_out = HandOut(1)
    first, second = work("ann"), work("ann")
    for piece in (first, second):
        hand_out.add(piece)
    first.future.cancel()
    assert hand_out.take() is second
