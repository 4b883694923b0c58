"""What is called in a worker process: the three phases of a task, whatever its kind."""

from __future__ import annotations

import socket

from app.work.kinds import KINDS
from app.work.progress import Board
from app.work.task import Outcome, Part, Plan, Task
from interloc.errors import InterLocError


def prepare(task: Task) -> Plan:
    """Look at the input of a task, and cut it into parts."""
    _check(task)
    plan: Plan = KINDS[task.kind].load().prepare(task)
    return plan


def run(task: Task, part: Part) -> None:
    """Do one part of a task."""
    _check(task)
    KINDS[task.kind].load().run(task, part, Board(task).report_of(part))


def finish(task: Task, plan: Plan) -> Outcome:
    """Join the parts of a task into its result."""
    _check(task)
    outcome: Outcome = KINDS[task.kind].load().finish(task, plan)
    return outcome


def _check(task: Task) -> None:
    if not task.scratch.is_dir():
        raise InterLocError(
            f"The worker on {socket.gethostname()} does not see {task.scratch}. "
            "Workers of a cluster need the data folder of the service at the same place."
        )
    Board(task).check()
