"""A live session on the page: it is listed, and watched while it grows."""

import secrets
import threading
from collections.abc import Iterator
from typing import Any

from interloc.client.live import LiveSender
from interloc.config import DetectorConfig
from interloc.drives.folder import FolderDrive
from interloc.live.scan import LiveScan, play
from tests.live.conftest import config, crossing
from tests.page.browsers import needs_page
from tests.page.results import Done, address_of, visit

__all__ = ["config", "crossing"]

pytestmark = needs_page


def test_a_drive_is_watched_while_it_grows(
    page: Any, done: Done, crossing: FolderDrive, config: DetectorConfig
) -> None:
    is_half_way, go_on = threading.Event(), threading.Event()

    def scans(after: int) -> Iterator[LiveScan]:
        for scan in play(crossing, config, after=after):
            if scan.frame == 16:
                is_half_way.set()
                go_on.wait(60)
            yield scan

    name = f"a street, live {secrets.token_hex(4)}"  # no other session has, if this is not the first try
    begin = {"name": name, "config": config.model_dump(mode="json")}
    sender = LiveSender(done.server.address, None, begin, lambda _: None, keeps_all=True)
    thread = threading.Thread(target=lambda: sender.run(scans), daemon=True)
    thread.start()
    assert is_half_way.wait(60)
    visit(page, done.server.address, "panel=drives")
    page.get_by_role("button", name=name).click()
    note = page.locator(".stage-note")
    note.get_by_text("16 keyframes").wait_for()
    half = page.locator("#map").screenshot()
    go_on.set()
    note.get_by_text("48 keyframes · 1 intersection, 0 unsure · It has ended.").wait_for()
    thread.join(60)
    assert page.locator("#map").screenshot() != half
    link = address_of(page)  # to pass on
    visit(page, done.server.address, "panel=upload")
    note.get_by_text("48 keyframes").wait_for(state="hidden")
    visit(page, done.server.address, link.partition("#")[2])
    note.get_by_text("48 keyframes · 1 intersection, 0 unsure · It has ended.").wait_for()
