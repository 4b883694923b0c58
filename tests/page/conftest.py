"""A browser whose every tab is watched, and a server with results."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.app.processes import ServerProcess, started
from tests.app.street import write_street
from tests.page.browsers import Browser, Common, Watch, chromium
from tests.page.other_site import served
from tests.page.results import SCANS, SHORT, TOKEN, Done, Scored, run_street, write_other_map


@pytest.fixture(scope="package")
def launched() -> Iterator[Any]:
    # To compile for speed what runs a few times takes a tenth of the processor time of these tests.
    with chromium("--js-flags=--no-opt --max-lazy") as browser:
        yield browser


@pytest.fixture(scope="package")
def common(launched: Any) -> tuple[Common, Watch]:
    """A context for all tests, and who watches it."""
    watch = Watch()
    return Common(launched, watch), watch


@pytest.fixture
def watch(common: tuple[Common, Watch]) -> Iterator[Watch]:
    """What went wrong in the tabs of this test; it fails with what was not expected."""
    _, watch = common
    watch.begin()
    yield watch
    watch.check()


FAILED = pytest.StashKey[bool]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    report = yield
    item.stash[FAILED] = report.failed or item.stash.get(FAILED, False)
    return report


@pytest.fixture
def browser(
    request: pytest.FixtureRequest, launched: Any, common: tuple[Common, Watch], watch: Watch
) -> Iterator[Browser]:
    browser = Browser(launched, common[0], watch)
    yield browser
    browser.close(failed=request.node.stash.get(FAILED, False))


@pytest.fixture(scope="package")
def other_site() -> Iterator[str]:
    """Origin of a page that may read the server with the results."""
    with served() as origin:
        yield origin


@pytest.fixture(scope="package")
def done(tmp_path_factory: pytest.TempPathFactory, other_site: str) -> Iterator[Done]:
    folder = tmp_path_factory.mktemp("page")
    street = write_street(folder / "street", SCANS)
    local = write_street(folder / "street_without_fixes", SCANS)
    (local / "geo.csv").unlink()
    with started(folder / "data", folder / "log", workers=1, cors_origins=other_site) as server:
        scored = run_street(server, street, osm={"file": "map.osm"})
        short = write_street(folder / "short", SHORT)
        yield Done(server, scored, run_street(server, local), short)


@pytest.fixture(scope="package")
def scored(done: Done, tmp_path_factory: pytest.TempPathFactory) -> Scored:
    """A result with something right, wrong, found, missed and out of reach."""
    street = write_street(tmp_path_factory.mktemp("layers") / "other map", SCANS)
    write_other_map(street)
    return Scored(done.server, run_street(done.server, street, osm={"file": "map.osm"}))


@pytest.fixture(scope="package")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    """An empty server that asks for `TOKEN`."""
    folder = tmp_path_factory.mktemp("closed")
    with started(folder / "data", folder / "log", workers=1, token=TOKEN) as server:
        yield server


@pytest.fixture
def page(browser: Browser) -> Any:
    return browser.new_page()
