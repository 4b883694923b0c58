"""A browser whose every tab is watched, and a server with results."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.app.processes import ServerProcess, started
from tests.app.street import in_a_town, write_street
from tests.networks import write_model
from tests.page.browsers import Browser, Common, Watch, chromium
from tests.page.canvas import NOTE_PATHS
from tests.page.results import SCANS, SHORT, TILE, TOKEN, Done, Scored, run_street, write_other_map
from tests.page.uploads import Upload


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
def done(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Done]:
    folder = tmp_path_factory.mktemp("page")
    street = write_street(folder / "street", SCANS)
    (street / "map.osm").write_text(in_a_town((street / "map.osm").read_text()))
    local = write_street(folder / "street_without_fixes", SCANS)
    (local / "geo.csv").unlink()
    tiles = {"tile_url": TILE, "tile_attribution": "(c) Tiles Example"}
    with started(folder / "data", folder / "log", workers=1, **tiles) as server:
        scored = run_street(server, street, osm={"file": "map.osm"})
        short = write_street(folder / "short", SHORT)
        yield Done(server, scored, run_street(server, local), short)


@pytest.fixture(scope="package")
def scored(done: Done, tmp_path_factory: pytest.TempPathFactory) -> Scored:
    """A result with something right, wrong, found, missed and out of reach."""
    street = write_street(tmp_path_factory.mktemp("layers") / "other map", SCANS)
    write_other_map(street)
    (street / "map.osm").write_text(in_a_town((street / "map.osm").read_text()))
    return Scored(done.server, run_street(done.server, street, osm={"file": "map.osm"}))


@pytest.fixture(scope="package")
def guarded(done: Done, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    """A second server on the same data, which asks for `TOKEN`."""
    with started(done.data, tmp_path_factory.mktemp("guarded") / "log", workers=1, token=TOKEN) as server:
        server.client.headers["Authorization"] = f"Bearer {TOKEN}"
        yield server


@pytest.fixture(scope="package")
def uploads(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    """A server to upload to, with a network, and with another that is damaged."""
    folder = tmp_path_factory.mktemp("uploads")
    write_model(folder / "models" / "flat", height=32, width=256, road_half_width_m=5.0)
    write_model(folder / "models" / "torn", height=32, width=256)
    (folder / "models" / "torn" / "arch_cfg.yaml").unlink()
    settings = {"models": folder / "models", "max_recording_bytes": 50_000}
    with started(folder / "data", folder / "log", workers=1, **settings) as server:
        yield server


@pytest.fixture(scope="package")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive. Shared: do not change it."""
    return write_street(tmp_path_factory.mktemp("drives") / "street", SHORT)


@pytest.fixture
def upload(browser: Browser, uploads: ServerProcess) -> Iterator[Upload]:
    """The upload panel of a tab that has loaded the page for the tests before."""
    upload = Upload(browser.kept_page("/* of uploads */"), uploads.address)
    yield upload
    upload.close()


@pytest.fixture
def page(browser: Browser) -> Any:
    """A tab that the tests share."""
    return browser.kept_page(NOTE_PATHS)
