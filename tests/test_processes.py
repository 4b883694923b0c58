"""Tasks in a pool of processes: what comes back, and what happens when one fails, dies or is stopped."""

import os
import signal
import time
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import pytest

from interloc.errors import InterLocError
from interloc.processes import run_in_processes, send_message

pytestmark = pytest.mark.filterwarnings("ignore:This process .* is multi-threaded")


@pytest.fixture(params=["fork", "forkserver"], autouse=True)
def _started_by(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("interloc.processes._context", lambda _: get_context(request.param))


def double(number: int) -> int:
    send_message(f"working on {number}")
    return 2 * number


def test_results_come_in_the_order_of_the_tasks_and_messages_while_they_run() -> None:
    results: list[int] = []
    messages: list[str] = []
    found = run_in_processes(double, [3, 1, 2], 2, on_result=results.append, on_message=messages.append)
    assert found == [6, 2, 4]
    assert sorted(results) == [2, 4, 6]
    assert sorted(messages) == ["working on 1", "working on 2", "working on 3"]


def die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_that_is_ended_from_outside() -> None:
    with pytest.raises(InterLocError, match=r"ended from outside.* try fewer --workers.*\. Finished rows are kept\."):
        run_in_processes(die, [1, 2], 2, hint="Finished rows are kept.")


def wait_or_fail(folder: Path, number: int) -> None:
    if number == 1:
        while not (folder / "begun-0").exists():
            time.sleep(0.01)
        raise InterLocError("task 1 failed")
    try:
        (folder / f"begun-{number}").touch()
        time.sleep(60)
    finally:
        (folder / "tidied-up").touch()


def test_a_failure_stops_the_other_tasks_which_tidy_up(tmp_path: Path) -> None:
    began = time.monotonic()
    with pytest.raises(InterLocError, match="task 1 failed"):
        run_in_processes(partial(wait_or_fail, tmp_path), [0, 1, 2, 3], 2)
    assert time.monotonic() - began < 30
    assert (tmp_path / "tidied-up").exists()


def test_a_failure_of_what_is_done_meanwhile_stops_the_tasks(tmp_path: Path) -> None:
    def refuse() -> None:
        while not (tmp_path / "begun-0").exists():
            time.sleep(0.01)
        raise InterLocError("refused")

    with pytest.raises(InterLocError, match="refused"):
        run_in_processes(partial(wait_or_fail, tmp_path), [0, 2], 2, meanwhile=refuse)
    assert (tmp_path / "tidied-up").exists()
