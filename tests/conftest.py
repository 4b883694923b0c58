"""Settings of all tests."""

import gc
import logging
import os
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from interloc.drives.plan_matching import PlanMatch
from interloc.processes import GARBAGE_THRESHOLD

# No test measures time. CI draws the same examples each time; everyone else helps to find new ones.
settings.register_profile("interloc", deadline=None, max_examples=50, derandomize=bool(os.environ.get("CI")))
settings.load_profile("interloc")

# Tests of servers, browsers and whole chains. Those of the page come first: few processes need a browser then.
_SLOW = ("page", "app", "lab", "chain", "cli", "client", "ros", "odometry")
_SLOW += ("test_demo.py", "test_examples.py", "test_explain.py", "test_reference.py", "test_snippets.py")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """Take two processes per core, up to eight: tests of servers and browsers mostly wait. Each needs up to 1 GB.

    `-n logical` takes one per core, for tests that do not wait.
    """
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ or config.option.numprocesses == "logical":
        return None  # as many as it says
    cores = os.cpu_count() or 1
    return max(cores, min(2 * cores, 8))


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Collect no garbage while the tests are imported: there is none. Tell at once which test runs."""
    gc.disable()
    # pytest-rerunfailures tells each test to the main process, and asks about the next one: without this, what it sends
    # second waits 40 ms for the other side to confirm the first.
    connection = getattr(getattr(config, "failures_db", None), "sock", None)
    if connection is not None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give each of several processes a share of the slow tests first, of the quick ones last: all end together."""
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if processes == 1:
        return
    names = [item.path.relative_to(Path(__file__).parent).parts[0] for item in items]
    slow = [item for folder in _SLOW for item, name in zip(items, names, strict=True) if name == folder]
    quick = [item for item, name in zip(items, names, strict=True) if name not in _SLOW]
    items[:] = [
        item
        for number in range(processes)
        for part in (slow, quick)
        for item in part[number * len(part) // processes : (number + 1) * len(part) // processes]
    ]


def pytest_collection_finish() -> None:
    """Keep what all tests imported out of every later collection of garbage: it is never given back."""
    gc.freeze()
    gc.set_threshold(GARBAGE_THRESHOLD)
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> None:
    """Share it with the processes that tests start, before there are threads."""
    if (forks := sys.modules.get("tests.forks")) and not session.config.option.collectonly:
        forks.begin()


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Report, last, why tests were repeated, and which were not run and why: missing tools, missing real data."""
    for report in terminalreporter.stats.get("rerun", []):
        said = [line for line in report.longreprtext.splitlines() if line.startswith("E ")]
        terminalreporter.line("\n".join([f"repeated: {report.nodeid} ({report.when})", *said[:5]]), yellow=True)
    reports = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in reports)
    if reasons:
        terminalreporter.section(f"skipped: {reasons.total()} tests were not run", yellow=True, bold=True)
        for reason, count in reasons.most_common():
            terminalreporter.line(f"skipped: {count:3d} because of: {reason}", yellow=True)


@pytest.fixture(scope="session", autouse=True)
def _plans_are_laid_once() -> Iterator[None]:
    """Remember how scans lie on each other: hundreds of tests open the same few drives, and that is most of it."""
    lay = PlanMatch.of

    @lru_cache(maxsize=500)
    def laid(target: bytes, source: bytes, *turn: float) -> PlanMatch:
        return lay(np.frombuffer(target).reshape(-1, 2), np.frombuffer(source).reshape(-1, 2), *turn)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PlanMatch, "of", lambda target, source, *turn: laid(target.tobytes(), source.tobytes(), *turn))
        yield


@pytest.fixture(autouse=True)
def _pristine_log_of_the_library() -> None:
    """Take back what a command of the test before set up: messages pass on to whoever listens."""
    logger = logging.getLogger("interloc")
    logger.handlers.clear()
    logger.setLevel(logging.NOTSET)
    logger.propagate = True


@pytest.fixture
def untouched_logging() -> Iterator[None]:
    """Give the loggers back as they were, for tests of what sets them up."""
    loggers = [logging.getLogger(name) for name in ("", "app", "interloc", "uvicorn")]
    before = [(logger.handlers[:], logger.level) for logger in loggers]
    yield
    for logger, (handlers, level) in zip(loggers, before, strict=True):
        logger.handlers[:] = handlers
        logger.setLevel(level)
    logging.captureWarnings(capture=False)


@pytest.fixture
def data() -> Callable[[str], Path]:
    """Find a folder or file of the real data beside the project, or skip."""
    root = Path(__file__).resolve().parents[1].parent / "shared" / "data"

    def find(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"real data not here: {name}")
        return path

    return find


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A folder on a disk of 64 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64m", "none", disk], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no small disk can be mounted: {mounted.stderr.strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", "-l", disk], check=True)
