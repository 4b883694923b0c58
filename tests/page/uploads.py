"""The upload panel in a tab, and what has arrived on the server."""

import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from tests.app.processes import API
from tests.page.results import visit

_SENDS = re.compile(r"/drives/\w+/(files|scans)")


class Upload:
    """The upload panel, at its start; `sent` are the paths of the files that the tab has sent."""

    def __init__(self, page: Any, address: str) -> None:
        self.page = page
        self.sent: list[str] = []
        self.under_way: set[Any] = set()
        self.held: list[Any] = []
        self._listeners = {"request": self._note, "requestfinished": self._note_end, "requestfailed": self._forget}
        for event, call in self._listeners.items():
            page.on(event, call)
        visit(page, address, "panel=upload")
        page.wait_for_selector("#panel-upload :is(.drop, .upload-form, .upload-progress)")
        for name in ("Choose another", "Upload another", "Back"):  # what the test before has left
            button = page.locator("#panel-upload").get_by_role("button", name=name, exact=True)
            if button.is_visible():
                button.click()
        page.wait_for_selector("#panel-upload .drop")  # the map of a service without drives has one too, earlier

    def close(self) -> None:
        for event, call in self._listeners.items():
            self.page.remove_listener(event, call)

    def _note(self, request: Any) -> None:
        if _SENDS.search(request.url) and request.method != "GET":
            self.under_way.add(request)

    def _forget(self, request: Any) -> None:
        self.under_way.discard(request)

    def _note_end(self, request: Any) -> None:
        if request in self.under_way and (answer := request.response()) is not None and answer.ok:
            content = answer.json()
            self.sent += [file["path"] for file in content.get("files", [content])]
        self._forget(request)

    def pick(self, folder: Path) -> None:
        self.page.set_input_files("input[name=folder]", folder)
        self.page.wait_for_selector(".upload-form, #panel-upload .note.error")

    def choose(self, text: str) -> None:
        """Choose a radio or checkbox of the form, also where it is folded away."""
        self.open_all()
        self.page.locator("label.check", has_text=text).first.locator("input").check()

    def open_all(self) -> None:
        self.page.evaluate("document.querySelectorAll('.upload-form details').forEach((each) => (each.open = true))")

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def choose_another(self) -> None:
        self.press("Choose another")
        self.page.wait_for_selector("#panel-upload .drop")

    def text(self) -> str:
        return str(self.page.inner_text("#panel-upload"))

    def let_through(self, count: int) -> None:
        """Hold back all bundles of files but the first few."""
        held = self.held

        def decide(route: Any) -> None:
            nonlocal count
            count -= 1
            if count >= 0 or held is not self.held:
                route.continue_()
            else:
                held.append(route)

        self.page.route(_SENDS, lambda route: route.continue_() if route.request.method == "GET" else decide(route))

    def release(self) -> None:
        from playwright.sync_api import Error  # noqa: PLC0415 - may be missing

        held, self.held = self.held, []
        for route in held:
            with suppress(Error):  # the page may have given it up
                route.continue_()

    def wait_for_files(self, count: int) -> None:
        script = "count => Number(/Files\\s+(\\d+) of/.exec(document.body.innerText)?.[1] ?? 0) >= count"
        self.page.wait_for_function(script, arg=count)

    def only(self) -> None:
        """Upload without a job; returns when all is there."""
        self.press("Upload only")
        self.page.wait_for_selector("text=Upload another")

    def job(self) -> str:
        self.page.wait_for_url(re.compile("job="))
        found = re.search(r"job=(\w+)", self.page.url)
        assert found is not None
        return found.group(1)


def drive_of(client: httpx.Client, job_id: str) -> dict[str, Any]:
    job = client.get(f"{API}/jobs/{job_id}").raise_for_status().json()
    drive: dict[str, Any] = client.get(f"{API}/drives/{job['drive_id']}").raise_for_status().json()
    return drive


def newest(client: httpx.Client) -> dict[str, Any]:
    """The drive that was made last."""
    drive_id = client.get(f"{API}/drives").raise_for_status().json()["drives"][0]["id"]
    drive: dict[str, Any] = client.get(f"{API}/drives/{drive_id}").raise_for_status().json()
    return drive


def files_of(client: httpx.Client, drive_id: str) -> set[str]:
    answer = client.get(f"{API}/drives/{drive_id}/files", params={"limit": 10_000}).raise_for_status().json()
    return {file["path"] for file in answer["files"]}


SMALL_FILES = {"geo.csv", "map.osm", "poses.txt", "times.txt", "reduced.json"}


def check_reduced_drive(client: httpx.Client, drive_id: str, scans: int) -> None:
    """Check that all that belongs to a street that was reduced in the browser has arrived, and no more."""
    assert client.get(f"{API}/drives/{drive_id}").raise_for_status().json()["state"] == "ready"
    assert files_of(client, drive_id) == SMALL_FILES | {f"ground/labels/{frame:06d}.ground" for frame in range(scans)}
