"""A Chromium that reaches this machine only, and notes whatever goes wrong in its tabs."""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

# Without the parts that draw windows it takes two thirds of the processor time.
_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, _NAMES)), None)
LEAFLET = Path(__file__).resolve().parents[2] / "static" / "node_modules" / "leaflet"
PATIENCE_MS = 90_000
SIZE = {"width": 1280, "height": 800}

needs_page = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the PATH"),
    pytest.mark.skipif(not LEAFLET.is_dir(), reason="the page is not set up: npm ci in static/"),
]

_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",  # no other host has an address
]
_HERE = {"127.0.0.1", ""}
_WATCH_WORDS = """(button) => {
  window.saysCopied = new Promise((done) => {
    const look = () => button.textContent.includes("Copied") && done();
    new MutationObserver(look).observe(button, { childList: true });
  });
}"""
# The console tells of refused content too, but not of all of it, nor which rule refused it.
_TELL_VIOLATIONS = """
addEventListener("securitypolicyviolation", (event) =>
  console.error(`policy violated: ${event.violatedDirective} by ${event.blockedURI} in ${event.sourceFile}`));
"""


@contextmanager
def chromium(*arguments: str) -> Iterator[Any]:
    """Start the browser of this machine, with further arguments."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=[*_ARGUMENTS, *arguments])
        yield browser
        browser.close()


def copied_by(button: Any) -> str:
    """Press a button that copies; returns what it has put into the clipboard when it says so.

    A copy button says "Copied" for a moment only, which a busy machine may miss from outside.
    """
    button.evaluate(_WATCH_WORDS)
    button.press("Enter")
    button.page.evaluate("saysCopied")
    return str(button.page.evaluate("navigator.clipboard.readText()"))


class Watch:
    """What happens in the tabs of a test: errors and warnings, violations of the policy, requests to other hosts."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Forget the test before."""
        self.faults: list[str] = []
        self.elsewhere: list[str] = []
        self.origins: set[str] = set()
        self._excused: list[re.Pattern[str]] = []
        self._expected: list[re.Pattern[str]] = []

    def expect(self, pattern: str) -> None:
        """Name a fault that the test provokes: it must happen, and no other."""
        self._expected.append(re.compile(pattern))

    def excuse(self, pattern: str) -> None:
        """Name a fault that may happen, or not."""
        self._excused.append(re.compile(pattern))

    def follow(self, context: Any) -> None:
        """Watch all tabs of a context."""
        context.add_init_script(_TELL_VIOLATIONS)
        context.on("console", self._note_message)
        context.on("weberror", lambda error: self.faults.append(f"error: {error.error}"))
        context.on("request", self._note_request)

    def check(self) -> None:
        """Fail where something went wrong that no test asked for."""
        known = [*self._expected, *self._excused]
        unknown = [fault for fault in self.faults if not any(each.search(fault) for each in known)]
        assert not unknown, "\n".join(unknown)
        missing = [each.pattern for each in self._expected if not any(each.search(fault) for fault in self.faults)]
        assert not missing, f"{missing} did not happen; there were {self.faults}"
        assert not self.elsewhere, f"other servers were asked: {self.elsewhere}"

    def _note_message(self, message: Any) -> None:
        if message.type in {"error", "warning"}:
            self.faults.append(f"{message.type}: {message.text} ({message.location.get('url', '')})")

    def _note_request(self, request: Any) -> None:
        parts = urlsplit(request.url)
        if (parts.hostname or "") not in _HERE:
            self.elsewhere.append(request.url)
        elif parts.hostname:
            self.origins.add(f"{parts.scheme}://{parts.netloc}")


class Common:
    """A context that tests use one after the other: of those before it keeps the files of the page, and no more."""

    def __init__(self, launched: Any, watch: Watch) -> None:
        self._watch = watch
        self._context = launched.new_context(viewport=SIZE)
        self._context.set_default_timeout(PATIENCE_MS)
        watch.follow(self._context)
        self._first = self._context.new_page()  # which keeps the session
        self._session = self._context.new_cdp_session(self._first)
        self._kept: dict[str, Any] = {}

    def new_page(self) -> Any:
        return self._context.new_page()

    def kept_page(self, script: str, viewport: dict[str, int]) -> Any:
        """A tab with this script that stays, with the page in it, for the tests to come."""
        if script not in self._kept:
            self._kept[script] = self.new_page()
            self._kept[script].add_init_script(script)
            self._kept[script].emulate_media(reduced_motion="reduce")
        self._kept[script].set_viewport_size(viewport)
        return self._kept[script]

    def drop_kept_pages(self) -> None:
        """Begin anew after a test that failed: nobody knows in what state it left its tab."""
        self._kept.clear()

    def clear(self) -> None:
        """Take away what a test left."""
        for page in self._context.pages:
            if page != self._first and page not in self._kept.values():
                page.close()
        for page in self._context.pages:
            page.unroute_all()
        self._context.unroute_all()
        self._context.clear_permissions()
        for origin in tuple(self._watch.origins):  # a tab that closes may still ask for something
            kept = {"origin": origin, "storageTypes": "cookies,indexeddb,local_storage"}
            self._session.send("Storage.clearDataForOrigin", kept)


class Browser:
    """Makes contexts and tabs that are watched; they are closed with it."""

    def __init__(self, launched: Any, common: Common, watch: Watch) -> None:
        self._launched = launched
        self._common = common
        self._watch = watch
        self._contexts: list[Any] = []

    def new_context(self, **options: Any) -> Any:
        context = self._launched.new_context(**{"viewport": SIZE, **options})
        context.set_default_timeout(PATIENCE_MS)
        self._watch.follow(context)
        self._contexts.append(context)
        return context

    def new_page(self, viewport: dict[str, int] = SIZE) -> Any:
        """A tab of the common context."""
        page = self._common.new_page()
        page.set_viewport_size(viewport)
        return page

    def kept_page(self, script: str = "", viewport: dict[str, int] = SIZE) -> Any:
        """A tab of the common context that has loaded the page for the tests before, which `results.visit` leads on.

        To load the page anew takes most of the time of a test that only looks. Nothing moves by itself in such a tab.
        """
        page = self._common.kept_page(script, viewport)
        page.bring_to_front()
        return page

    def close(self, *, failed: bool = False) -> None:
        if failed:
            self._common.drop_kept_pages()
        self._common.clear()
        for context in self._contexts:
            context.close()
