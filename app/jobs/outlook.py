"""What jobs that wait are told: how many are before them, and roughly when they will start."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.jobs.queue import URGENT_AT_ONCE
from app.states import ACTIVE, DriveState, JobState
from app.store.models import Drive, Job
from app.work.kinds import DRIVE_CHANGING, URGENT

_STEADY_S = 5.0
_STEADY_SHARE = 0.05
_RECENT = 20  # jobs from whose time is judged how long the next ones will take


def outlook(session: Session, now: float, jobs_at_once: int) -> dict[str, str]:
    """Return what each job that waits for its turn is told, by its id; two or three queries, however many wait.

    Parameters
    ----------
    now
        Time by the clock of the database.
    jobs_at_once
        How many jobs run at the same time, without the urgent ones.
    """
    columns = (Job.id, Job.kind, Job.owner, Job.state, Job.created_at, Job.started_at, Job.done, Job.total)
    query = select(*columns).join(Drive, Drive.id == Job.drive_id)
    query = query.where(Job.state.in_(ACTIVE), Job.kind.in_(DRIVE_CHANGING) | (Drive.state != DriveState.CHECKING))
    rows = session.execute(query).all()
    told: dict[str, str] = {}
    for urgent, at_once in ((True, URGENT_AT_ONCE), (False, jobs_at_once)):
        mine = [row for row in rows if (row.kind in URGENT) == urgent]
        running = [row for row in mine if row.state == JobState.RUNNING]
        line = _in_order([row for row in mine if row.state == JobState.ACCEPTED], running)
        if not line:
            continue
        usual_s = _usual_seconds(session, urgent=urgent)
        starts = _starts(len(line), [_seconds_left(row, now, usual_s) for row in running], at_once, usual_s)
        told |= {row.id: _words(place, start) for place, (row, start) in enumerate(zip(line, starts, strict=True))}
    return told


def _in_order(waiting: Sequence[Any], running: Sequence[Any]) -> list[Any]:
    """Return the jobs in the order of `JobQueue.claim`: the client with the fewest at work is next."""
    at_work = Counter(row.owner for row in running)
    turns = []
    for row in sorted(waiting, key=lambda row: (row.created_at, row.id)):
        turns.append((at_work[row.owner], row.created_at, row.id, row))
        at_work[row.owner] += 1
    return [row for *_, row in sorted(turns, key=lambda turn: turn[:3])]


def _usual_seconds(session: Session, *, urgent: bool) -> float | None:
    """Return the mean time of recent jobs; None where there are none."""
    query = select(Job.finished_at - Job.started_at).where(
        Job.state == JobState.SUCCESSFUL, Job.kind.in_(URGENT) if urgent else Job.kind.not_in(URGENT)
    )
    times = session.scalars(query.order_by(Job.created_at.desc()).limit(_RECENT)).all()
    known = [seconds for seconds in times if seconds is not None]
    return sum(known) / len(known) if known else None


def _seconds_left(row: Any, now: float, usual_s: float | None) -> float | None:  # noqa: ANN401 - a row of columns
    """Return how long a job will still run; None where nothing tells."""
    spent = max(0.0, now - (row.started_at or now))
    known = seconds_left(spent, row.done, row.total)
    if known is not None:
        return known
    return None if usual_s is None else max(0.0, usual_s - spent)


def seconds_left(spent_s: float, done: int, total: int | None) -> float | None:
    """Return how long work that has taken some time so far will still take; None before that can be told.

    The beginning tells nothing: drive and map are read first.
    """
    if not total or not 0 < done <= total or spent_s < _STEADY_S or done < _STEADY_SHARE * total:
        return None
    return spent_s * (total - done) / done


def _starts(count: int, left: list[float | None], at_once: int, usual_s: float | None) -> list[float | None]:
    """Return in how many seconds each of the next jobs starts; None from the first on of which that is not known."""
    ends = [seconds for seconds in left if seconds is not None]
    if len(ends) < len(left):
        return [None] * count
    heapq.heapify(ends)
    places = max(at_once, len(ends))  # other servers may work too
    starts: list[float | None] = []
    for _ in range(count):
        start = 0.0 if len(ends) < places else heapq.heappop(ends)
        starts.append(start)
        if usual_s is None:
            break
        heapq.heappush(ends, start + usual_s)
    return starts + [None] * (count - len(starts))


def _words(before: int, seconds: float | None) -> str:
    place = {0: "It is the next one", 1: "1 job is before it"}.get(before, f"{before:,} jobs are before it")
    return f"{place}." if seconds is None else f"{place}; it should start in {_about(seconds)}."


def _about(seconds: float) -> str:
    """Return a time that is rounded so much that it does not change all the time."""
    if seconds <= 15:
        return "a few seconds"
    if seconds < 90:
        return f"about {30 * round(seconds / 30)} seconds"
    if seconds < 90 * 60:
        return f"about {round(seconds / 60)} minutes"
    return f"about {round(seconds / 3600)} hours"
